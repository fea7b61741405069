"""PRS: the comb of 3GPP TS 38.211 on its symbols, and nothing between them."""

import contextlib
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.model.numerology import Prs, System, prs_elements, resource_elements
from tests.conftest import COMB_TURNS, PRS_PAIRS, each_prs, few, refusal

SYSTEM = System()


def test_prs_are_5_percent_of_the_grid_of_table_one():
    mask = prs_elements(SYSTEM)
    assert mask.shape == (2048, 224)
    assert mask.sum() == 48 * 512
    assert mask.mean() == pytest.approx(0.054, abs=5e-4)


@pytest.mark.parametrize("pair", PRS_PAIRS)
@few
@given(data=st.data(), n_symbols=st.integers(1, 100))
def test_every_element_is_where_the_standard_puts_it(pair, data, n_symbols):
    prs = data.draw(each_prs([pair]))
    system = System(n_subcarriers=13, n_symbols=n_symbols, prs=prs)
    expected = np.zeros((13, n_symbols), dtype=bool)
    for slot in range(prs.offset, 8, prs.period):
        for symbol in range(prs.first_symbol, prs.first_symbol + prs.n_symbols):
            for k in range(COMB_TURNS[prs.comb][(symbol - prs.first_symbol) % prs.comb], 13, prs.comb):
                if 14 * slot + symbol < n_symbols:
                    expected[k, 14 * slot + symbol] = True
    np.testing.assert_array_equal(prs_elements(system), expected)


@given(each_prs())
def test_as_many_successive_symbols_as_the_comb_has_subcarriers_touch_each_once(prs):
    mask = prs_elements(System(n_subcarriers=25, n_symbols=14 * (prs.offset + 1), prs=prs))[:, -14:]
    np.testing.assert_array_equal(mask.sum(axis=1), prs.n_symbols // prs.comb)
    for first in range(prs.first_symbol, prs.first_symbol + prs.n_symbols - prs.comb + 1):
        np.testing.assert_array_equal(mask[:, first : first + prs.comb].sum(axis=1), 1)


WRONG = [
    ({"comb": 3}, "prs.comb = 3: allowed is 2, 4, 6 or 12"),
    ({"comb": 4.0}, "prs.comb = 4.0: allowed is a whole number"),
    ({"offset": True}, "prs.offset = True: allowed is a whole number"),
    ({"period": 0}, "prs.period = 0: allowed is a whole number from 1"),
    ({"period": 2, "offset": 2}, "prs.offset = 2: allowed is from 0 to 1, below the period"),
    ({"offset": -1}, "prs.offset = -1: allowed is from 0 to 3"),
    ({"first_symbol": 3}, "prs.first_symbol = 3: allowed is from 0 to 2, so that 12 symbols fit"),
    ({"n_symbols": 4, "first_symbol": -1}, "prs.first_symbol = -1: allowed is from 0 to 10"),
    ({"n_symbols": 14}, "prs.n_symbols = 14: allowed is 4 or 12 with comb 4"),
    ({"comb": 12, "n_symbols": 6}, "prs.n_symbols = 6: allowed is 12 with comb 12"),
]


@pytest.mark.parametrize(("fields", "message"), WRONG)
def test_what_the_standard_does_not_have_is_refused_with_what_it_has(fields, message):
    assert refusal(Prs, **fields).startswith(message)


def test_no_other_pairs_of_comb_and_symbols_are_allowed():
    allowed = []
    for comb, n_symbols in itertools.product(range(1, 15), repeat=2):
        with contextlib.suppress(InputError):
            Prs(comb, n_symbols, 0)
            allowed.append((comb, n_symbols))
    assert allowed == PRS_PAIRS


def test_bursts_repeat_every_56_symbols():
    mask = prs_elements(SYSTEM)
    np.testing.assert_array_equal(mask[:, 56:], mask[:, :-56])
    assert np.flatnonzero(mask.any(axis=0))[:13].tolist() == [*range(1, 13), 57]


def test_a_slot_that_the_frame_cuts_off_is_not_sensed_with_unless_there_is_no_other():
    system = System(n_subcarriers=16, n_symbols=64)
    sensed = resource_elements(system, "prs")
    assert np.flatnonzero(sensed.any(axis=0)).tolist() == [*range(1, 13)]
    np.testing.assert_array_equal(sensed[:, :56], prs_elements(system)[:, :56])
    short = System(n_subcarriers=16, n_symbols=9)
    np.testing.assert_array_equal(resource_elements(short, "prs"), prs_elements(short))
    late = System(n_subcarriers=16, n_symbols=14 * 2 + 6, prs=Prs(offset=2))
    assert np.flatnonzero(resource_elements(late, "prs").any(axis=0)).tolist() == [*range(29, 34)]


def test_all_is_the_whole_grid_and_another_name_an_error():
    np.testing.assert_array_equal(resource_elements(SYSTEM, "all"), np.ones((2048, 224), dtype=bool))
    np.testing.assert_array_equal(resource_elements(SYSTEM, "prs"), prs_elements(SYSTEM))
    with pytest.raises(InputError, match="unknown sensing 'pss': did you mean 'prs'"):
        resource_elements(SYSTEM, "pss")
