"""PRS: the comb of 3GPP TS 38.211 on its symbols, and nothing between them."""

import numpy as np
import pytest

from isacbench.errors import InputError
from isacbench.model.numerology import System, prs_elements, resource_elements

SYSTEM = System()


def test_prs_are_5_percent_of_the_grid_of_table_one():
    mask = prs_elements(SYSTEM)
    assert mask.shape == (2048, 224)
    assert mask.sum() == 48 * 512
    assert mask.mean() == pytest.approx(0.054, abs=5e-4)


def test_every_element_is_where_the_standard_puts_it():
    system = System(n_subcarriers=13, n_symbols=131)
    expected = np.zeros((13, 131), dtype=bool)
    for slot in range(10):
        for symbol in range(14):
            for n in range(13):
                m = 14 * slot + symbol
                if m < 131 and slot % 4 == 0 and 1 <= symbol <= 12:
                    expected[n, m] = n % 4 == {0: 0, 1: 2, 2: 1, 3: 3}[(symbol - 1) % 4]
    np.testing.assert_array_equal(prs_elements(system), expected)


def test_four_successive_symbols_touch_every_subcarrier_once():
    mask = prs_elements(SYSTEM)
    for first in range(1, 10):
        np.testing.assert_array_equal(mask[:, first : first + 4].sum(axis=1), 1)


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


def test_all_is_the_whole_grid_and_another_name_an_error():
    np.testing.assert_array_equal(resource_elements(SYSTEM, "all"), np.ones((2048, 224), dtype=bool))
    np.testing.assert_array_equal(resource_elements(SYSTEM, "prs"), prs_elements(SYSTEM))
    with pytest.raises(InputError, match="unknown sensing 'pss': did you mean 'prs'"):
        resource_elements(SYSTEM, "pss")
