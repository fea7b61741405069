"""Order of numbers that only rounding tells apart."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.ties import rounded

VALUES = st.floats(1e-100, 1e100)


@given(VALUES, st.integers(-50, 50))
def test_rounding_is_the_same_in_any_unit(value, exponent):
    scale = 2.0**exponent
    assert rounded(np.array([scale * value]), 9)[0] == scale * rounded(np.array([value]), 9)[0]


@given(VALUES, st.integers(3, 12))
def test_rounding_moves_by_no_more_than_half_the_last_digit(value, digits):
    assert abs(rounded(np.array([value]), digits)[0] - value) <= value * 10.0**-digits


def test_last_digits_are_gone_and_no_others():
    one = np.array([0.3, 0.3 * (1 + 1e-14), 0.3 * (1 + 1e-6)])
    few = rounded(one, 9)
    assert few[0] == few[1] < few[2]


def test_zero_stays():
    assert rounded(np.zeros(1), 9)[0] == 0
