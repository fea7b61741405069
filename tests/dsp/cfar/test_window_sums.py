"""Sums over runs, one window or all of a line, against exact sums."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isacbench.dsp.cfar.window_sums import sliding_sums, sum_of_runs

SEEDS = st.integers(0, 2**32 - 1)


@st.composite
def windows(draw):
    """Length of a window, and runs in it that do not touch."""
    n_window = draw(st.integers(1, 40))
    ends = sorted(draw(st.sets(st.integers(0, n_window), max_size=6)))
    return n_window, tuple(zip(ends[::2], ends[1::2], strict=False))


def values_of(seed, *shape):
    """Non-negative values over twelve decades."""
    rng = np.random.default_rng(seed)
    return rng.standard_exponential(shape) * 10.0 ** rng.integers(-6, 7, shape)


@settings(max_examples=30)
@given(windows(), SEEDS)
def test_the_sum_of_runs_is_exact_to_the_rounding_of_a_tree_of_pairs(window, seed):
    n_window, runs = window
    values = values_of(seed, n_window)
    exact = sum((Fraction(value) for first, stop in runs for value in values[first:stop]), start=Fraction(0))
    found = sum_of_runs(values, runs)
    assert abs(Fraction(float(found)) - exact) <= exact * Fraction(20, 2**53)


@settings(max_examples=30)
@given(windows(), st.integers(0, 30), st.integers(1, 4), SEEDS)
def test_a_sliding_window_has_the_sum_of_each_window_to_the_last_bit(window, n_more, stride, seed):
    n_window, runs = window
    values = values_of(seed, stride * (n_window + n_more))
    total = np.full(values.size - (n_window - 1) * stride, np.nan)
    sliding_sums(values, runs, stride, total)
    for place in range(total.size):
        assert total[place] == sum_of_runs(values[place : place + n_window * stride : stride], runs)


@settings(max_examples=40)
@given(windows(), SEEDS)
def test_windows_side_by_side_have_the_sums_of_each_alone(window, seed):
    n_window, runs = window
    values = values_of(seed, n_window, 3, 2)
    together = sum_of_runs(values, runs)
    for place in np.ndindex(3, 2):
        assert together[place] == sum_of_runs(values[(slice(None), *place)], runs)


def test_a_peak_outside_the_runs_leaves_no_trace():
    values = np.ones(16)
    values[5] = 1e300
    assert sum_of_runs(values, ((0, 5), (6, 16))) == 15
    total = np.empty(6)
    sliding_sums(values, ((0, 3), (8, 11)), 1, total)
    assert total[3] > 1e299
    assert total.tolist()[:3] == [6.0, 6.0, 6.0]


@pytest.mark.parametrize("function", [sum_of_runs, sliding_sums])
def test_the_values_are_left_alone(function):
    values = np.arange(12.0)
    values.flags.writeable = False
    others = (1, np.empty(5)) if function is sliding_sums else ()
    function(values, ((0, 3), (4, 8)), *others)
    assert values.tolist() == list(range(12))
