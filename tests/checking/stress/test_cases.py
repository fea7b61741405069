"""Families of cases: their spaces, their spelling, and the strategies that the search draws from."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.checking.stress.runs.families import FAMILIES, find_cases, find_families, table_of
from isacbench.checking.stress.runs.random_search import cases_from
from isacbench.checking.stress.spaces import Choice, Real, Whole
from isacbench.errors import InputError

ANY_CASE = st.sampled_from([*FAMILIES.values()]).flatmap(cases_from)


@given(ANY_CASE)
def test_whatever_the_search_draws_is_found_again_by_its_spelling(case):
    assert find_cases(case.spec) == [case]


@pytest.mark.parametrize("kind", ["estimator", "detector"])
def test_the_table_holds_cases_of_the_spaces_that_the_search_draws_from(kind):
    for case in table_of(kind):
        for name, space in case.spaces().items():
            assert getattr(case, name) in space
        assert find_cases(case.spec) == [case]


@pytest.mark.parametrize("family", FAMILIES.values())
def test_every_family_has_promises_and_words(family):
    case = family.table()[0]
    names = [promise.name for promise in case.promises]
    assert names
    assert len(set(names)) == len(names)
    assert all(promise.bound >= 0 for promise in case.promises)
    assert family.__doc__


def test_a_family_name_stands_for_its_cases_in_the_table():
    assert find_cases("snr") == FAMILIES["snr"].table()
    assert find_families(["snr"], {"estimator"}) == [FAMILIES["snr"]]
    assert {family.kind for family in find_families([], {"estimator"})} == {"estimator"}


def test_maps_of_one_level_fill_the_cells_that_their_names_say():
    for filled, share in (("zeros", 0.0), ("constant", 1.0), ("checkers", 0.5)):
        (case,) = find_cases(f"map[filled={filled},exponent=2.0]")
        is_filled = case.shot(0).seen.cells == 100
        assert np.mean(is_filled) == pytest.approx(share, abs=0.02), filled
    for axis in (0, 1):  # of checkers
        assert np.diff(is_filled, axis=axis).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("snt", "unknown family of cases 'snt': did you mean 'snr'"),
        ("snr[level=3]", "unknown parameter of case snr 'level': allowed are snr_db"),
        ("snr[snr_db=201]", "case snr: snr_db = 201; allowed are numbers from -80 to 200"),
        ("snr[snr_db=nan]", "case snr: snr_db = nan; allowed are numbers"),
        ("snr[snr_db=true]", "case snr: snr_db = True; allowed are numbers"),
        ("array[n_u=2.5]", "case array: n_u = 2.5; allowed are whole numbers from 2 to 32"),
        ("pair[noise=pink]", "case pair: noise = 'pink'; allowed are one of none, 20dB"),
    ],
)
def test_a_mistake_names_what_is_allowed(text, message):
    with pytest.raises(InputError) as caught:
        find_cases(text)
    assert message in str(caught.value)


def test_spaces_include_their_limits_and_nothing_beyond():
    assert 2 in Whole(2, 4)
    assert 4 in Whole(2, 4)
    assert not any(value in Whole(2, 4) for value in (1, 5, 3.0, True, "3"))
    assert -1.0 in Real(-1, 1)
    assert 1 in Real(-1, 1)
    assert not any(value in Real(-1, 1) for value in (1.1, math.nan, math.inf, True, "0"))
    assert "a" in Choice(("a", "b"))
    assert "c" not in Choice(("a", "b"))
    assert not any(value in Choice((1, 2)) for value in (1.0, True, "1"))
