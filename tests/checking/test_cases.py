"""Families of cases: their spaces, their spelling, and the strategies that the search draws from."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.checking.checks import Choice, Real, Whole
from isacbench.checking.stress import FAMILIES, cases_from, find_cases, find_families
from isacbench.errors import InputError
from isacbench.plugins.registry import get_detector, get_estimator

ANY_CASE = st.sampled_from([*FAMILIES.values()]).flatmap(cases_from)


@given(ANY_CASE)
def test_whatever_the_search_draws_is_found_again_by_its_spelling(case):
    assert find_cases(case.spec) == [case]


@pytest.mark.parametrize("family", FAMILIES.values(), ids=FAMILIES)
def test_every_family_has_words_and_cases_whose_input_follows_from_the_seed_and_checks_with_names(family):
    assert family.description
    plugin = get_estimator("music2d") if family.kind == "estimator" else get_detector("ca")
    for case in family.cases():
        assert find_cases(case.spec) == [case]
    (subject, checks), (again, _) = case.make(plugin, 1), case.make(plugin, 1)
    assert all(check.name and check.bound >= 0 for check in checks)
    assert len({check.name for check in checks}) == len(checks) > 0
    if family.kind == "detector":
        assert np.isfinite(subject.power).all()
        assert (subject.power >= 0).all()
        np.testing.assert_array_equal(subject.power, again.power)
    elif family.name != "ladder":
        np.testing.assert_array_equal(subject.scene.observation.cells, again.scene.observation.cells)


def test_a_family_name_stands_for_its_cases_in_the_table():
    assert find_cases("snr") == FAMILIES["snr"].cases()
    assert find_families(["snr"], {"estimator"}) == [FAMILIES["snr"]]
    assert {family.kind for family in find_families([], {"estimator"})} == {"estimator"}


def test_maps_of_one_level_fill_the_cells_that_their_names_say():
    for filled, share in (("zeros", 0.0), ("constant", 1.0), ("checkers", 0.5)):
        (case,) = find_cases(f"map[filled={filled},exponent=2.0]")
        is_filled = case.make(None)[0].scene.observation.cells == 100
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
    whole, real, words = Whole(2, 4, 2), Real(-1, 1, 0), Choice("a", "b")
    assert 2 in whole
    assert 4 in whole
    assert not any(value in whole for value in (1, 5, 3.0, True, "3"))
    assert -1.0 in real
    assert 1 in real
    assert not any(value in real for value in (1.1, math.nan, math.inf, True, "0"))
    assert "a" in words
    assert "c" not in words
    assert not any(value in Choice(1, 2) for value in (1.0, True, "1"))
