"""Units of amplitudes: exact powers of two, only where they are needed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isacbench.dsp.scaling import MOST_EXPONENT, amplitude_exponent, in_unit
from isacbench.errors import InputError

CELLS = np.random.default_rng(0).standard_normal((3, 4, 2, 2, 2)).view(complex)[..., 0]


@settings(max_examples=40)
@given(st.integers(-1000, 500))
def test_cells_in_their_unit_are_the_same_bits_whatever_the_unit_was(exponent):
    scaled = np.ldexp(CELLS.real, exponent) + 1j * np.ldexp(CELLS.imag, exponent)
    found = amplitude_exponent(scaled)
    own = amplitude_exponent(2.0**60 * CELLS) - 60
    assert found == (own + exponent if abs(own + exponent) > MOST_EXPONENT else 0)
    np.testing.assert_array_equal(in_unit(scaled, found), np.ldexp(1.0, exponent - found) * CELLS)


@pytest.mark.parametrize("scale", [1e-36, 1e36])
def test_single_precision_stays_and_neither_overflows_nor_underflows(scale):
    cells = (scale * CELLS).astype(np.complex64)
    scaled = in_unit(cells, amplitude_exponent(cells))
    assert scaled.dtype == np.complex64
    assert 0.4 < max(np.abs(scaled[:, :, 0].real).max(), np.abs(scaled[:, :, 0].imag).max()) < 1
    np.testing.assert_allclose(scaled / scaled[0, 0, 0, 0], CELLS / CELLS[0, 0, 0, 0], rtol=1e-5)


def test_ordinary_cells_are_not_copied():
    assert in_unit(CELLS, amplitude_exponent(CELLS)) is CELLS


def test_nothing_on_the_first_row_is_no_reason_to_leave_the_rest_as_it_is():
    cells = np.zeros_like(CELLS)
    cells[1, 2, 1, 1] = 1e150
    assert amplitude_exponent(cells) == np.frexp(1e150)[1]
    assert amplitude_exponent(np.zeros_like(CELLS)) == 0


def test_the_largest_numbers_that_have_a_power_and_subnormal_ones_have_a_unit():
    for value in (3e153, 1e-310):
        cells = np.full((1, 1, 1), value * (1 + 1j))
        assert 0.5 <= in_unit(cells, amplitude_exponent(cells)).real.item() < 1


@pytest.mark.parametrize("value", [4e153, np.finfo(float).max])
def test_numbers_without_a_power_are_refused(value):
    with pytest.raises(InputError, match=r"observation: its largest amplitude = .* less than"):
        amplitude_exponent(np.full((1, 1, 1), value * (1 + 1j)))


def test_one_element_far_above_the_first_row_sets_the_unit():
    cells = CELLS.copy()
    cells[1, 2, 1, 1] = 1e150
    assert amplitude_exponent(cells) == np.frexp(1e150)[1]


def test_other_memory_orders_are_scaled_as_well_and_the_original_is_left():
    cells = np.asfortranarray(2.0**200 * CELLS)
    before = cells.copy()
    exponent = amplitude_exponent(cells)
    np.testing.assert_array_equal(in_unit(cells, exponent), 2.0 ** (200 - exponent) * CELLS)
    np.testing.assert_array_equal(cells, before)
