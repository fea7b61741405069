import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.compare.comparison import (
    DEFAULT_TOLERANCE,
    Tolerance,
    direction,
    merge_tolerances,
    parse_tolerance,
)
from isacbench.errors import InputError
from isacbench.plugins.scoring import Metrics

DESCRIBED = Metrics().columns(())


@given(st.floats(0, 1000), st.booleans())
def test_what_is_written_is_read_back(limit, is_relative):
    written = Tolerance("chamfer_m", limit, is_relative)
    read = parse_tolerance(str(written))
    assert (read.metric, read.is_relative) == ("chamfer_m", is_relative)
    assert math.isclose(read.limit, limit, rel_tol=1e-5, abs_tol=1e-300)


@pytest.mark.parametrize("text", ["a=5%", " a = 5 % ", "a=5e0%"])
def test_spaces_and_powers_of_ten_are_allowed(text):
    assert parse_tolerance(text) == Tolerance("a", 0.05, True)


@pytest.mark.parametrize(
    "text",
    ["", "deviation", "deviation=", "=5%", "a=-1%", "a=nan", "a=5%%", "a b=1", "a=1 2", "a=１", "a=1_0"],
)
def test_anything_else_is_refused_and_quoted(text):
    with pytest.raises(InputError, match="allowed is NAME=NUMBER%") as caught:
        parse_tolerance(text)
    assert repr(text) in str(caught.value)


def test_the_deviation_is_always_compared_and_the_last_word_counts():
    assert merge_tolerances([]) == (DEFAULT_TOLERANCE,)
    given_twice = [Tolerance("deviation", 1.0, False), Tolerance("a", 1, True), Tolerance("a", 2, True)]
    assert merge_tolerances(given_twice) == (given_twice[0], given_twice[2])


@pytest.mark.parametrize(
    ("column", "better"),
    [
        ("deviation", "lower"),
        ("recall", "higher"),
        ("resolved", "higher"),
        ("n_hits", "higher"),
        ("own", "lower"),
    ],
)
def test_directions_are_those_of_the_metric_and_lower_for_unknown_columns(column, better):
    assert direction(column, DESCRIBED, [column]) == better


@pytest.mark.parametrize("column", ["n_true", "n_estimated", "bound_u", "pfa", "seed", "timing"])
def test_what_has_no_better_direction_is_refused(column):
    with pytest.raises(InputError, match=f"{column} has no better direction; allowed are own"):
        direction(column, DESCRIBED, [column, "own"])
