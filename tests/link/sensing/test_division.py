"""Division by the transmitted symbols: weights against the definition, their moments, and what is allowed."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from isacbench.link.sensing.division import Signal, division_factors, division_weights, symbol_moduli
from isacbench.link.waveform.qam import constellation
from isacbench.model.numerology import Prs, System
from tests.conftest import refusal

SMALL = System(n_subcarriers=64, n_symbols=28)
MODULATIONS = ["qpsk", "16qam", "64qam", "256qam"]
DIVISIONS = ["reciprocal", "matched", "wiener"]

moduli = arrays(float, (2, 3), elements=st.floats(0.1, 2.0))
masks = arrays(bool, (2, 3)).filter(np.any)


def noise_factor(weights):
    """Noise power of a cell over that of the receiver."""
    return np.mean(weights.noise**2)


def pedestal(weights):
    """Mean power that a unit echo leaves in the cells of others."""
    return np.var(weights.echo)


def everything_equally_often(modulation):
    """Moduli of a grid in which all symbols of a constellation occur equally often."""
    return np.abs(constellation(modulation)).reshape(2, -1)


@given(moduli, masks, st.floats(-40, 40))
@settings(derandomize=True)
def test_weights_are_those_of_the_divisions_written_out(modulus, mask, snr_db):
    sent = modulus * mask
    snr = 10 ** (snr_db / 10)
    divided = {"reciprocal": mask + 0.0, "matched": sent**2, "wiener": sent**2 / (sent**2 + 1 / snr)}
    for division, echo in divided.items():
        expected = echo / np.mean(echo)
        weights = division_weights(sent, division, snr_db)
        np.testing.assert_allclose(weights.echo, expected, rtol=1e-12)
        np.testing.assert_allclose(weights.noise * sent, expected, rtol=1e-12)
        assert not weights.noise[~mask].any()


@given(moduli, masks, st.sampled_from(DIVISIONS), st.floats(-400, 400))
@settings(derandomize=True)
def test_an_echo_keeps_its_peak_and_noise_is_least_for_the_matched_division(modulus, mask, division, snr_db):
    weights = division_weights(modulus * mask, division, snr_db)
    assert np.mean(weights.echo) == pytest.approx(1, rel=1e-12)
    # Cauchy-Schwarz: mean(q |X|) = 1 asks for mean(q²) of at least 1 / mean(|X|²).
    least = 1 / np.mean((modulus * mask) ** 2)
    assert noise_factor(weights) >= least * (1 - 1e-12)
    assert noise_factor(division_weights(modulus * mask, "matched")) == pytest.approx(least, rel=1e-12)


@given(moduli, arrays(float, (2, 3), elements=st.floats(0.01, 2.0)), st.floats(-30, 30))
@settings(derandomize=True)
def test_no_echo_weights_leave_less_noise_and_pedestal_together_than_wiener_division(sent, other, snr_db):
    snr = 10 ** (snr_db / 10)
    wiener = division_weights(sent, "wiener", snr_db)
    echo = other / np.mean(other)
    least = noise_factor(wiener) / snr + pedestal(wiener)
    assert least <= (np.mean((echo / sent) ** 2) / snr + np.var(echo)) * (1 + 1e-9)


@pytest.mark.parametrize("modulation", MODULATIONS)
def test_wiener_division_goes_from_matched_to_reciprocal_as_the_snr_grows(modulation):
    modulus = everything_equally_often(modulation)
    for snr_db in (-300, -130, 160, np.inf):
        limit = division_weights(modulus, "matched" if snr_db < 0 else "reciprocal")
        weights = division_weights(modulus, "wiener", snr_db)
        np.testing.assert_allclose(weights.echo, limit.echo, rtol=1e-12)
        np.testing.assert_allclose(weights.noise, limit.noise, rtol=1e-12)


@pytest.mark.parametrize(
    ("modulation", "factor"), [("qpsk", 1), ("16qam", 17 / 9), ("64qam", 2.685417), ("256qam", 3.437130)]
)
def test_reciprocal_division_makes_noise_stronger_by_the_mean_reciprocal_power(modulation, factor):
    weights = division_weights(everything_equally_often(modulation), "reciprocal")
    assert noise_factor(weights) == pytest.approx(factor, rel=1e-6)
    assert pedestal(weights) == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize("modulation", MODULATIONS)
def test_matched_division_leaves_the_kurtosis_less_one_as_pedestal(modulation):
    # Square QAM of L levels: E|X|⁴ - 1 = (2/5) (L² - 4)/(L² - 1), from the sums of L odd numbers.
    n_points = len(constellation(modulation))
    expected = 0.4 * (n_points - 4) / (n_points - 1)
    weights = division_weights(everything_equally_often(modulation), "matched")
    assert pedestal(weights) == pytest.approx(expected, abs=1e-12)
    assert noise_factor(weights) == pytest.approx(1, rel=1e-12)


def test_the_prs_alone_costs_as_much_noise_as_it_leaves_elements_out():
    # 48 symbols of 224 and every fourth subcarrier.
    weights = division_weights(symbol_moduli(System(), Signal(sensing="prs")), "reciprocal")
    assert noise_factor(weights) == pytest.approx(224 * 4 / 48, rel=1e-12)
    assert 10 * np.log10(noise_factor(weights)) == pytest.approx(12.71, abs=0.005)


def test_data_change_with_the_trial_and_the_prs_keeps_unit_modulus_between_them():
    first, again, other = (symbol_moduli(SMALL, Signal("16qam"), trial) for trial in (0, 0, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    on_prs = symbol_moduli(SMALL, Signal("16qam", "prs")) > 0
    np.testing.assert_allclose(first[on_prs], 1, rtol=1e-12)


def test_a_grid_without_a_prs_is_refused():
    message = refusal(symbol_moduli, System(n_subcarriers=16, n_symbols=1), Signal(sensing="prs"))
    assert re.search("sensing = 'prs'.*16 subcarriers and 1 symbols; at least 2 symbols", message)
    late = System(n_subcarriers=16, n_symbols=28, prs=Prs(first_symbol=2, offset=2))
    assert "28 symbols; at least 31 symbols" in refusal(symbol_moduli, late, Signal(sensing="prs"))
    assert symbol_moduli(dataclasses.replace(late, n_symbols=31), Signal(sensing="prs")).any()


@pytest.mark.parametrize("division", DIVISIONS)
def test_factors_are_the_weights_with_the_phase_of_the_symbols_in_any_unit(division):
    rng = np.random.default_rng(5)
    symbols = rng.standard_normal((6, 8, 2)) @ [1, 1j]
    sensed = rng.random((6, 8)) < 0.7
    symbols[~sensed] = np.nan
    factors = division_factors(symbols, sensed, division, snr_db=2.0)
    moduli = np.where(sensed, np.abs(symbols), 0)
    unit = np.sqrt(np.mean(moduli[sensed] ** 2))
    weights = division_weights(moduli / unit, division, snr_db=2.0)
    np.testing.assert_allclose(factors[sensed] * symbols[sensed], weights.echo[sensed], rtol=1e-12)
    np.testing.assert_allclose(np.abs(factors) * unit, weights.noise, rtol=1e-12)
    np.testing.assert_allclose(division_factors(3 * symbols, sensed, division, 2.0), factors / 3, rtol=1e-12)


@pytest.mark.parametrize("modulation", MODULATIONS)
def test_only_qpsk_on_the_whole_grid_is_plain_whatever_the_division(modulation):
    for sensing, division in itertools.product(["all", "prs"], DIVISIONS):
        signal = Signal(modulation, sensing, division)
        assert signal.has_unit_modulus == (modulation == "qpsk" or sensing == "prs")
        assert signal.is_plain == (modulation == "qpsk" and sensing == "all")


@pytest.mark.parametrize(
    ("name", "value", "meant"),
    [("modulation", "QPSK", "qpsk"), ("sensing", "pr", "prs"), ("division", "wienr", "wiener")],
)
def test_an_unknown_choice_is_an_error_that_names_the_nearest_or_what_is_allowed(name, value, meant):
    assert refusal(Signal, **{name: value}).startswith(f"unknown {name} '{value}': did you mean '{meant}'")
    assert refusal(Signal, **{name: 16}).startswith(f"unknown {name} 16: allowed are ")


def test_weights_of_an_unknown_division_are_refused():
    message = refusal(division_weights, np.ones((2, 2)), "matchd")
    assert "unknown division 'matchd': did you mean 'matched'" in message
