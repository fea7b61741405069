"""Units of amplitudes, and the order of numbers that only rounding tells apart."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.floating_point import MOST_EXPONENT, round_mantissa, round_step, scale_to_unit
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


VALUES = st.floats(1e-100, 1e100)


@given(VALUES, st.integers(-50, 50))
def test_rounding_is_the_same_in_any_unit(value, exponent):
    scale = 2.0**exponent
    assert round_mantissa(np.array([scale * value]), 9)[0] == scale * round_mantissa(np.array([value]), 9)[0]


@given(VALUES, st.integers(3, 12))
def test_rounding_moves_by_no_more_than_half_the_last_digit(value, digits):
    assert abs(round_mantissa(np.array([value]), digits)[0] - value) <= value * 10.0**-digits


def test_last_digits_are_gone_and_no_others():
    one = np.array([0.3, 0.3 * (1 + 1e-14), 0.3 * (1 + 1e-6)])
    few = round_mantissa(one, 9)
    assert few[0] == few[1] < few[2]


def test_zero_stays():
    assert round_mantissa(np.zeros(1), 9)[0] == 0


PLACES, STEPS = st.floats(-100.0, 100.0), st.floats(1e-12, 0.5)


@given(PLACES, STEPS)
def test_a_place_moves_by_less_than_the_square_of_the_step_that_led_to_it(place, step):
    moved = round_step(np.array([place]), np.array([step]))[0] - place
    assert abs(moved) <= max(step**2 / 64, 1e-14 * abs(place))


@given(PLACES, STEPS)
def test_mirrored_places_stay_mirrored(place, step):
    one, other = (round_step(np.array([sign * place]), np.array([sign * step]))[0] for sign in (1, -1))
    assert one == -other


def test_far_from_the_aim_last_digits_are_forgotten_and_near_it_they_stay():
    places = np.array([[0.3123, 0.7456], [0.3123 + 1e-13, 0.7456 - 1e-13]])
    far = round_step(places, np.full((2, 2), 0.05))
    assert np.array_equal(far[0], far[1])
    assert np.array_equal(round_step(places, np.full((2, 2), 1e-9)), places)


def test_one_long_step_counts_for_all_coordinates_and_none_for_nothing():
    kept = round_step(np.full((2, 2), 0.123456789), np.array([[0.1, 0.0], [0.0, 0.0]]))
    assert kept[0, 0] == kept[0, 1] != 0.123456789
    assert (kept[1] == 0.123456789).all()
