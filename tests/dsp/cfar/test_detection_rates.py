"""Probability of detection: closed forms of the literature, Monte Carlo, and limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats

from isacbench.dsp.cfar.detection_rates import detection_rate
from isacbench.dsp.cfar.factors import ca_factor
from isacbench.errors import InputError

SNRS_DB = np.arange(-10.0, 31.0, 4.0)
MODELS = pytest.mark.parametrize("swerling", [0, 1, 2, 3, 4])


@pytest.mark.parametrize("looks", [1, 2, 8, 64])
def test_a_steady_echo_in_known_noise_has_marcum_s_q(looks):
    threshold = special.gammainccinv(looks, 1e-4)
    expected = stats.ncx2.sf(2 * threshold, 2 * looks, 2 * looks * 10 ** (SNRS_DB / 10))
    np.testing.assert_allclose(detection_rate(SNRS_DB, 1e-4, looks), expected, atol=1e-12)


@pytest.mark.parametrize("looks", [1, 3, 16])
def test_swerling_1_and_2_in_known_noise_are_the_forms_of_the_literature(looks):
    """Meyer and Mayer, Radar Target Detection (1973), equations 2.4 and 2.5."""
    snr, threshold = 10 ** (SNRS_DB / 10), special.gammainccinv(looks, 1e-3)
    more = 1 + 1 / (looks * snr)
    first = np.exp(-threshold / (1 + looks * snr))
    if looks > 1:
        rest = first * more ** (looks - 1) * special.gammainc(looks - 1, threshold / more)
        first = special.gammaincc(looks - 1, threshold) + rest
    np.testing.assert_allclose(detection_rate(SNRS_DB, 1e-3, looks, swerling=1), first, atol=1e-10)
    second = special.gammaincc(looks, threshold / (1 + snr))
    np.testing.assert_allclose(detection_rate(SNRS_DB, 1e-3, looks, swerling=2), second, atol=1e-12)


def test_swerling_3_of_one_look_is_the_form_of_the_literature():
    snr, threshold = 10 ** (SNRS_DB / 10), -np.log(1e-5)
    half = 1 + snr / 2
    expected = (1 + threshold * snr / 2 / half**2) * np.exp(-threshold / half)
    np.testing.assert_allclose(detection_rate(SNRS_DB, 1e-5, swerling=3), expected, atol=1e-12)


@pytest.mark.parametrize("n", [1, 8, 72])
def test_one_look_of_swerling_1_in_n_training_cells_is_finn_and_johnson_s_form(n):
    factor, snr = ca_factor(1e-3, n), 10 ** (SNRS_DB / 10)
    expected = (1 + factor / n / (1 + snr)) ** -float(n)
    np.testing.assert_allclose(detection_rate(SNRS_DB, 1e-3, 1, n, swerling=1), expected, atol=1e-12)


@MODELS
@pytest.mark.parametrize(("looks", "n"), [(1, 16), (4, 16), (4, None)])
def test_detections_of_simulated_echoes_are_as_frequent(swerling, looks, n):
    rng, n_draws, snr_db, pfa = np.random.default_rng(swerling), 40_000, 5.0, 1e-2
    snr = 10 ** (snr_db / 10)
    common, each = (n_draws, 1), (n_draws, looks)
    power = {
        0: lambda: np.full(each, snr),
        1: lambda: np.broadcast_to(rng.exponential(snr, common), each),
        2: lambda: rng.exponential(snr, each),
        3: lambda: np.broadcast_to(rng.gamma(2, snr / 2, common), each),
        4: lambda: rng.gamma(2, snr / 2, each),
    }[swerling]()
    noise = (rng.normal(size=each) + 1j * rng.normal(size=each)) / np.sqrt(2)
    cell = (np.abs(np.sqrt(power) + noise) ** 2).mean(axis=1)
    if n is None:
        level = np.full(n_draws, special.gammainccinv(looks, pfa) / looks)
    else:
        level = ca_factor(pfa, n, looks) * rng.gamma(n * looks, 1 / (n * looks), n_draws)
    found = (cell > level).mean()
    expected = detection_rate(snr_db, pfa, looks, n, swerling).item()
    assert found == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / n_draws))


@MODELS
@given(pfa=st.floats(1e-8, 0.5), looks=st.integers(1, 40), n=st.none() | st.integers(2, 100))
def test_without_an_echo_it_is_the_false_alarm_rate_and_it_rises_with_snr(swerling, pfa, looks, n):
    rates = detection_rate([-200.0, -10.0, 0.0, 10.0, 40.0, 90.0], pfa, looks, n, swerling)
    assert rates[0] == pytest.approx(pfa, rel=1e-6, abs=1e-12)
    assert (np.diff(rates) >= -1e-12).all()
    assert rates[-1] > 0.999


@MODELS
def test_no_echo_an_infinite_one_and_many_training_cells_are_limits(swerling):
    np.testing.assert_allclose(detection_rate([-np.inf, np.inf], 1e-20, 4, swerling=swerling), [1e-20, 1])
    known = detection_rate(SNRS_DB, 1e-3, 2, None, swerling)
    np.testing.assert_allclose(detection_rate(SNRS_DB, 1e-3, 2, 100_000, swerling), known, atol=1e-3)


@pytest.mark.parametrize(
    ("given_values", "message"),
    [
        ({"swerling": 5}, "swerling = 5: allowed is a model from 0 to 4"),
        *(({name: 0}, name) for name in ("pfa", "looks", "n_training")),
    ],
)
def test_values_out_of_range_are_refused(given_values, message):
    with pytest.raises(InputError, match=message):
        detection_rate(10.0, **{"pfa": 1e-3, **given_values})
