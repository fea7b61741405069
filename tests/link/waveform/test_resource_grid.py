"""The resource grid: Gold sequences, PRS and data as 3GPP TS 38.211, 5.2.1, 7.4.1.7 and 7.3.1.5 have them."""

from functools import lru_cache, partial

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from py3gpp import nrPRBS, nrSymbolModulate

from isacbench.link.sensing.division import Signal
from isacbench.link.waveform.qam import bits_per_symbol, constellation, modulate_bits
from isacbench.link.waveform.resource_grid import draw_grid, gold_sequence, prs_c_init, prs_symbols
from isacbench.model.numerology import Prs, System
from tests.conftest import COMB_TURNS, PRS_PAIRS, few, refusal

# A slot with PRS, three without, and the beginning of another with PRS; no whole number of combs.
SYSTEM = System(n_subcarriers=13, n_symbols=4 * 14 + 6)

each_modulation = pytest.mark.parametrize("modulation", ["qpsk", "16qam", "64qam", "256qam"])


def c_init_as_printed(slot, symbol, n_id):
    """Initial value by the formula, in whole numbers of any size."""
    n_id_mod = n_id % 1024
    return (2**22 * (n_id // 1024) + 2**10 * (14 * slot + symbol + 1) * (2 * n_id_mod + 1) + n_id_mod) % 2**31


@lru_cache
def prs_as_printed(system, n_id):
    """PRS element by element, by another implementation's sequence and mapping."""
    grid = np.zeros((system.n_subcarriers, system.n_symbols), dtype=complex)
    prs = system.prs
    for slot in range(prs.offset, system.n_symbols // 14 + 1, prs.period):
        for symbol in range(prs.first_symbol, prs.first_symbol + prs.n_symbols):
            column = 14 * slot + symbol
            if column >= system.n_symbols:
                continue
            c_init = c_init_as_printed(slot, symbol, n_id)
            sequence = nrSymbolModulate(nrPRBS(c_init, 2 * system.n_subcarriers), "qpsk")
            offset = COMB_TURNS[prs.comb][(symbol - prs.first_symbol) % prs.comb]
            for m in range(system.n_subcarriers):
                if m * prs.comb + offset < system.n_subcarriers:
                    grid[m * prs.comb + offset, column] = sequence[m]
    grid.setflags(write=False)
    return grid


# The PRS.


@pytest.mark.parametrize("n_id", [0, 1, 1023, 1024, 3333, 4095])
def test_initial_values_are_those_of_the_printed_formula(n_id):
    # A radio frame at 240 kHz has 160 slots: large ones pass 2³¹.
    slot, symbol = (axis.ravel() for axis in np.mgrid[:160:13, :14])
    expected = [c_init_as_printed(int(a), int(b), n_id) for a, b in zip(slot, symbol, strict=True)]
    found = [prs_c_init(int(a), int(b), n_id) for a, b in zip(slot, symbol, strict=True)]
    assert found == expected


def test_every_prs_symbol_is_where_and_what_the_standard_says():
    np.testing.assert_allclose(prs_symbols(SYSTEM, 4095), prs_as_printed(SYSTEM, 4095), rtol=4e-16)


@pytest.mark.parametrize(("comb", "n_symbols"), PRS_PAIRS)
def test_every_symbol_of_other_combs_is_where_and_what_the_standard_says(comb, n_symbols):
    prs = Prs(comb, n_symbols, first_symbol=14 - n_symbols, period=2, offset=1)
    system = System(n_subcarriers=31, n_symbols=4 * 14, prs=prs)
    np.testing.assert_allclose(prs_symbols(system, 1030), prs_as_printed(system, 1030), rtol=4e-16)


@pytest.mark.parametrize("n_id", [-1, 4096, 0.5, 3.0, True, None])
def test_an_identity_that_does_not_exist_is_an_error(n_id):
    message = f"n_id = {n_id}: allowed is a whole number from 0 to 4095"
    for call in (partial(prs_symbols, SYSTEM), partial(draw_grid, SYSTEM), Signal):
        assert refusal(call, n_id=n_id) == message


# The grid.


@each_modulation
def test_data_go_symbol_by_symbol_from_the_lowest_subcarrier_up(modulation):
    grid = draw_grid(SYSTEM, modulation, trial=3, seed=4, n_id=4095)
    expected = prs_as_printed(SYSTEM, 4095).copy()
    is_prs = expected != 0
    n_bits = bits_per_symbol(modulation)
    words = iter(grid.bits.reshape(-1, n_bits))
    for column in range(SYSTEM.n_symbols):
        for row in range(SYSTEM.n_subcarriers):
            if not is_prs[row, column]:
                expected[row, column] = modulate_bits(next(words), modulation)[0]
    assert next(words, None) is None
    np.testing.assert_allclose(grid.symbols, expected, rtol=4e-16)
    np.testing.assert_array_equal(grid.is_prs, is_prs)
    assert grid.modulation == modulation


@each_modulation
def test_every_symbol_of_the_constellation_is_sent_equally_often(modulation):
    grid = draw_grid(System(n_subcarriers=512, n_symbols=56), modulation)
    n_bits = bits_per_symbol(modulation)
    words = grid.bits.reshape(-1, n_bits) @ 2 ** np.arange(n_bits)[::-1]
    counts = np.bincount(words, minlength=2**n_bits)
    expected = len(words) / 2**n_bits
    assert np.abs(counts - expected).max() < 5 * np.sqrt(expected)
    data = grid.symbols[~grid.is_prs]
    power = np.abs(constellation(modulation)) ** 2
    assert np.mean(np.abs(data) ** 2) == pytest.approx(1, abs=5 * power.std() / np.sqrt(data.size) + 1e-12)


def test_arrays_are_read_only_and_a_symbol_is_contiguous():
    grid = draw_grid(SYSTEM)
    assert grid.symbols.shape == grid.is_prs.shape == (13, 62)
    assert grid.symbols.flags.f_contiguous
    assert (grid.symbols.dtype, grid.is_prs.dtype, grid.bits.dtype) == (np.complex128, np.bool_, np.uint8)
    for array in (grid.symbols, grid.is_prs, grid.bits):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_trials_seeds_and_modulations_have_data_of_their_own_the_same_in_every_draw():
    first, second = (draw_grid(SYSTEM, "64qam", trial=1, seed=2, n_id=3) for _ in range(2))
    np.testing.assert_array_equal(first.symbols, second.symbols)
    np.testing.assert_array_equal(first.bits, second.bits)
    system = System(n_subcarriers=256, n_symbols=14)
    draws = [{}, {"trial": 1}, {"seed": 1}, {"trial": 1, "seed": 1}]
    grids = [draw_grid(system, **which) for which in draws]
    grids += [draw_grid(system, modulation) for modulation in ("16qam", "64qam", "256qam")]
    n = min(grid.bits.size for grid in grids)
    signs = np.array([1 - 2.0 * grid.bits[:n] for grid in grids])
    correlation = signs @ signs.T - n * np.eye(len(grids))
    assert np.abs(correlation).max() < 5 * np.sqrt(n)


def test_the_identity_changes_the_prs_and_leaves_the_data():
    one, other = draw_grid(SYSTEM, n_id=1), draw_grid(SYSTEM, n_id=2)
    np.testing.assert_array_equal(one.bits, other.bits)
    np.testing.assert_array_equal(one.symbols[~one.is_prs], other.symbols[~one.is_prs])
    assert (one.symbols[one.is_prs] != other.symbols[one.is_prs]).any()


@pytest.mark.parametrize(("n_subcarriers", "n_symbols"), [(1, 1), (7, 2), (1, 6), (3, 5)])
def test_small_frames_carry_what_prs_fits_and_data_elsewhere(n_subcarriers, n_symbols):
    system = System(n_subcarriers=n_subcarriers, n_symbols=n_symbols)
    prs = prs_symbols(system)
    np.testing.assert_allclose(prs, prs_as_printed(system, 0), rtol=4e-16)
    grid = draw_grid(system)
    n_prs = int((prs != 0).sum())
    assert grid.is_prs.sum() == n_prs
    assert grid.bits.size == 2 * (n_subcarriers * n_symbols - n_prs)
    np.testing.assert_allclose(np.abs(grid.symbols), 1, rtol=1e-15)


@pytest.mark.parametrize("name", ["trial", "seed"])
def test_a_negative_number_of_a_draw_is_an_error(name):
    message = f"{name} = -1: allowed is a whole number of 0 and more"
    assert refusal(draw_grid, SYSTEM, **{name: -1}) == message


@few
@example(0, 1)
@example(3072, 31)
@example(2**31 - 1, 200)
@given(st.integers(0, 2**31 - 1), st.integers(1, 300))
def test_pseudo_random_bits_are_those_of_py3gpp(c_init, length):
    np.testing.assert_array_equal(gold_sequence(c_init, length), nrPRBS(c_init, length))
