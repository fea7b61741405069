"""Order of numbers that only rounding tells apart."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.stable_order import round_mantissa, round_step

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
