"""Figures of merit of a frame: its rates, and peaks of its power."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.errors import InputError
from isacbench.link.waveform.figures_of_merit import (
    frame_rates,
    hard_decision_capacity,
    papr_ccdf,
    symbol_papr_db,
)
from isacbench.link.waveform.ofdm import layout, modulate
from isacbench.link.waveform.qam import constellation
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.numerology import System

MODULATIONS = ("qpsk", "16qam", "64qam", "256qam")


@pytest.mark.parametrize("modulation", MODULATIONS)
def test_a_frame_carries_the_bits_of_its_grid(modulation):
    system = System(n_subcarriers=48)
    rates = frame_rates(system, modulation)
    assert rates.n_data_bits == draw_grid(system, modulation).bits.size
    frame_time_s = 224 * 1.25 / 240e3
    assert rates.bit_rate_bps * frame_time_s == pytest.approx(rates.n_data_bits)


def test_the_prs_takes_a_twentieth_of_the_bits_and_the_prefix_a_fifth_of_the_time():
    rates = frame_rates(System(), "qpsk")
    # Of critical sampling, a symbol of two bits a sample.
    share = rates.bit_rate_bps / (2 * 491.52e6)
    assert share == pytest.approx((1 - 48 * 512 / (224 * 2048)) / 1.25)


@given(ber=st.floats(0, 1))
def test_the_capacity_of_decided_bits_is_symmetric_and_between_nothing_and_all(ber):
    capacity = float(hard_decision_capacity(ber))
    assert -1e-15 <= capacity <= 1
    assert capacity == pytest.approx(float(hard_decision_capacity(1 - ber)), abs=1e-12)
    # 1 - H2(p) lies between (1 - 2p)²/(2 ln 2) and (1 - 2p)².
    distance = (1 - 2 * ber) ** 2
    assert distance / (2 * np.log(2)) - 1e-12 <= capacity <= distance + 1e-12


def test_what_a_code_could_reach_is_the_capacity_of_the_decided_bits():
    rates = frame_rates(System(), "16qam")
    np.testing.assert_allclose(
        rates.achievable_rate_bps([0.0, 0.5, 1.0]), [rates.bit_rate_bps, 0, rates.bit_rate_bps], atol=1e-6
    )
    assert 0.49 < rates.achievable_rate_bps(0.11) / rates.bit_rate_bps < 0.51


@pytest.mark.parametrize("ber", [-0.1, 1.1, float("nan")])
def test_what_is_no_rate_of_errors_is_refused(ber):
    with pytest.raises(InputError, match="ber holds"):
        hard_decision_capacity(ber)


def test_an_unknown_modulation_is_refused():
    with pytest.raises(InputError, match="unknown modulation '8psk'"):
        frame_rates(System(), "8psk")


def gaussian(n_subcarriers, n_symbols):
    rng = np.random.default_rng(0)
    return rng.standard_normal((n_subcarriers, n_symbols, 2)) @ [1, 1j] / np.sqrt(2)


def test_one_subcarrier_has_no_peaks_and_n_in_phase_have_the_highest():
    one = np.zeros((32, 1))
    one[5] = 3.0
    alone = symbol_papr_db(one)
    # All of the power on one of 32: its envelope is flat.
    np.testing.assert_allclose(alone, 0, atol=1e-12)
    np.testing.assert_allclose(symbol_papr_db(np.ones((32, 4))), 10 * np.log10(32), atol=1e-12)


@pytest.mark.parametrize("oversampling", [1, 4])
def test_the_ratio_is_that_of_the_waveform(oversampling):
    system = System(n_subcarriers=64, n_symbols=9)
    symbols = np.random.default_rng(0).choice(constellation("16qam"), (64, 9))
    parts = layout(System(n_subcarriers=64, n_symbols=9), oversampling)
    frame = modulate(symbols, system, oversampling)[: 9 * parts.n_symbol].reshape(9, -1)
    peak = np.max(np.abs(frame[:, parts.n_prefix :]) ** 2, axis=1)
    expected_db = 10 * np.log10(peak / np.mean(np.abs(symbols) ** 2))
    np.testing.assert_allclose(symbol_papr_db(symbols, oversampling), expected_db, atol=1e-10)


def test_samples_between_find_higher_peaks_up_to_a_limit():
    found = [symbol_papr_db(gaussian(128, 200), oversampling) for oversampling in (1, 2, 4, 8, 16)]
    assert all((more >= fewer - 1e-9).all() for fewer, more in pairwise(found))
    assert (found[4] - found[0]).mean() > 0.4
    assert 0.01 < (found[4] - found[2]).mean() < 0.08


@pytest.mark.parametrize(("oversampling", "oversampled"), [(1, False), (8, True)])
def test_gaussian_samples_exceed_as_theory_says(oversampling, oversampled):
    papr_db = symbol_papr_db(gaussian(256, 1500), oversampling)
    for level_db in (8.0, 9.0, 10.0):
        probability = papr_ccdf(level_db, 256, oversampled=oversampled)
        deviation = np.sqrt(probability * (1 - probability) / papr_db.size)
        assert abs(np.mean(papr_db > level_db) - probability) < 4 * deviation


def test_at_the_critical_rate_the_ccdf_is_that_of_the_largest_of_n_exponentials():
    level = np.array([0.1, 1.0, 5.0, 10.0])
    expected = 1 - (1 - np.exp(-level)) ** 64
    np.testing.assert_allclose(papr_ccdf(10 * np.log10(level), 64, oversampled=False), expected, rtol=1e-12)


@pytest.mark.parametrize("oversampled", [False, True])
def test_the_ccdf_falls_from_one_to_zero(oversampled):
    ccdf = papr_ccdf(np.linspace(-400, 20, 200), 2048, oversampled=oversampled)
    assert ccdf[0] == pytest.approx(1, abs=1e-12)
    assert ccdf[-1] < 1e-30
    assert (np.diff(ccdf) <= 0).all()


def test_what_has_no_ratio_is_refused():
    for symbols in (np.ones(4), np.ones((4, 0)), np.ones((0, 4))):
        with pytest.raises(InputError, match="symbols of shape"):
            symbol_papr_db(symbols)
    for symbols in (np.zeros((4, 2)), np.full((4, 2), np.nan), np.full((4, 2), np.inf)):
        with pytest.raises(InputError, match="mean power of the symbols"):
            symbol_papr_db(symbols)
    with pytest.raises(InputError, match="oversampling"):
        symbol_papr_db(np.ones((4, 2)), 0)
