"""Units of amplitudes: exact powers of two, only where they are needed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.scaling import MOST_EXPONENT, scale_to_unit
from isacbench.errors import InputError

CELLS = np.random.default_rng(0).standard_normal((3, 4, 2, 2, 2)).view(complex)[..., 0]


@given(st.integers(-1000, 500))
def test_cells_in_their_unit_are_the_same_bits_whatever_the_unit_was(exponent):
    scaled, unit = scale_to_unit(np.ldexp(CELLS.real, exponent) + 1j * np.ldexp(CELLS.imag, exponent))
    own = np.log2(scale_to_unit(2.0**60 * CELLS)[1]) - 60
    found = np.log2(unit)
    assert found == (own + exponent if abs(own + exponent) > MOST_EXPONENT else 0)
    np.testing.assert_array_equal(scaled, np.ldexp(1.0, int(exponent - found)) * CELLS)


@pytest.mark.parametrize("scale", [1e-36, 1e36])
def test_single_precision_stays_and_neither_overflows_nor_underflows(scale):
    scaled, _ = scale_to_unit((scale * CELLS).astype(np.complex64))
    assert scaled.dtype == np.complex64
    assert 0.4 < max(np.abs(scaled.real).max(), np.abs(scaled.imag).max()) < 1
    np.testing.assert_allclose(scaled / scaled[0, 0, 0, 0], CELLS / CELLS[0, 0, 0, 0], rtol=1e-5)


@pytest.mark.parametrize("cells", [CELLS, np.zeros_like(CELLS)])
def test_ordinary_cells_are_not_copied(cells):
    scaled, unit = scale_to_unit(cells)
    assert scaled is cells
    assert unit == 1


@pytest.mark.parametrize("value", [4e153, np.finfo(float).max])
def test_numbers_without_a_power_are_refused(value):
    with pytest.raises(InputError, match=r"observation: its largest amplitude = .* less than"):
        scale_to_unit(np.full((1, 1, 1), value * (1 + 1j)))


def test_one_element_far_above_the_first_row_sets_the_unit():
    cells = CELLS.copy()
    cells[1, 2, 1, 1] = 1e150
    assert scale_to_unit(cells)[1] == 2.0 ** np.frexp(1e150)[1]


def test_other_memory_orders_are_scaled_as_well_and_the_original_is_left():
    cells = np.asfortranarray(2.0**200 * CELLS)
    before = cells.copy()
    scaled, unit = scale_to_unit(cells)
    np.testing.assert_array_equal(scaled, 2.0**200 / unit * CELLS)
    np.testing.assert_array_equal(cells, before)
