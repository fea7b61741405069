import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from isacbench.link.reception.channel import Paths, TappedDelay, TwoRay, channel_response
from isacbench.link.reception.channel_estimation import prs_estimator
from isacbench.link.waveform.resource_grid import draw_grid
from isacbench.model.echo import random_stream, white_gaussian
from isacbench.model.numerology import Prs, System
from tests.conftest import each_prs, few, refusal

WIDE = System(n_subcarriers=1024)
SMALL = System(n_subcarriers=256, n_symbols=224)


def late_by(system, delay_s):
    return channel_response(system, Paths(np.ones((1, 1)), np.array([delay_s]), np.zeros(1)))


def error_db(estimate, response):
    return 10 * np.log10(np.mean(np.abs(estimate - response) ** 2) / np.mean(np.abs(response) ** 2))


def test_the_noise_gain_is_the_number_of_responses_over_that_of_prs_elements():
    estimator = prs_estimator(WIDE)
    n_prs, n_basis = int(estimator.is_prs.sum()), estimator.basis.shape[1]
    assert n_prs == 12288
    # The prefix without the suffix has 224 delay bins, and a few more make up for fractions.
    assert 224 < n_basis < 224 + 25
    assert estimator.noise_gain == pytest.approx(n_basis / n_prs)


@pytest.mark.parametrize("n_symbols", [6, 7, 11, 60, 62, 224])
@pytest.mark.parametrize("time_order", [0, 1, 3])
def test_noise_reaches_the_estimate_as_the_noise_gain_says(n_symbols, time_order):
    system = System(n_subcarriers=256, n_symbols=n_symbols)
    n_bursts = 1 if n_symbols < 62 else 2 if n_symbols < 224 else 4
    if time_order >= n_bursts:
        message = f"time_order = {time_order}: allowed is a whole number below"
        assert message in refusal(prs_estimator, system, time_order)
        return
    estimator = prs_estimator(system, time_order)
    assert len(estimator.bursts) == n_bursts
    grid, streams = draw_grid(system), [random_stream("noise", trial, 0) for trial in range(8)]
    noises = [white_gaussian(stream, (n_symbols, 256)).T for stream in streams]
    powers = [np.mean(np.abs(estimator.estimate(noise, grid.symbols)) ** 2) for noise in noises]
    # At least 8 n_basis independent complex numbers make the mean.
    freedom = 2 * 8 * estimator.basis.shape[1]
    low, high = chi2.ppf([1e-4, 1 - 1e-4], freedom) / freedom
    assert low < np.mean(powers) / estimator.noise_gain < high


@given(fraction=st.floats(0, 1))
def test_no_delay_within_the_prefix_is_lost(fraction):
    estimator, grid = prs_estimator(SMALL), draw_grid(SMALL)
    response = late_by(SMALL, fraction * SMALL.isi_free_delay_s)
    assert error_db(estimator.estimate(response * grid.symbols, grid.symbols), response) < -95


@pytest.mark.parametrize("channel", [TwoRay(), TappedDelay(), TappedDelay("tdl_e", 40e-9)])
def test_channels_of_a_wide_band_are_estimated_to_95_db(channel):
    response = channel_response(WIDE, channel.paths(WIDE, random_stream("draw", 0, 0)))
    grid = draw_grid(WIDE)
    estimate = prs_estimator(WIDE).estimate(response * grid.symbols, grid.symbols)
    assert error_db(estimate, response) < -95


def test_data_does_not_change_the_estimate():
    estimator, response = prs_estimator(SMALL), late_by(SMALL, 30e-9)
    symbols = draw_grid(SMALL, "qpsk").symbols, draw_grid(SMALL, "256qam", trial=1).symbols
    np.testing.assert_array_equal(*(estimator.estimate(response * sent, sent) for sent in symbols))


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_polynomials_in_time_are_followed_up_to_the_order(order):
    system = System(n_subcarriers=64)
    grid, estimator = draw_grid(system), prs_estimator(system, order)
    expected = np.polyval(np.arange(1, order + 2), np.linspace(-1, 1, 224))
    # A burst tells of its middle, so let the channel stand still during bursts.
    sounded, middles = np.ones(224), [burst.mean() for burst in estimator.bursts]
    levels = np.interp(middles, np.arange(224), expected)
    for burst, level in zip(estimator.bursts, levels, strict=True):
        sounded[burst] = level
    values = np.polynomial.Polynomial.fit(middles, levels, order)(np.arange(224))
    estimate = estimator.estimate(sounded * grid.symbols, grid.symbols)
    assert estimate.shape == (64, 1 if order == 0 else 224)
    np.testing.assert_allclose(np.broadcast_to(estimate, (64, 224)) - values, 0, atol=1e-3)


def test_each_order_costs_noise():
    gains = [prs_estimator(SMALL, order).noise_gain for order in range(4)]
    assert np.all(np.diff(gains) > 0)


@given(n=st.integers(1, 80), m=st.integers(6, 70), prefix=st.sampled_from([0.0, 1 / 32, 1 / 4, 1.0]))
def test_a_flat_channel_is_known_whatever_the_frame(n, m, prefix):
    system = System(n_subcarriers=n, n_symbols=m, cyclic_prefix_ratio=prefix)
    grid = draw_grid(system)
    estimator = prs_estimator(system)
    estimate = estimator.estimate(2j * grid.symbols, grid.symbols)
    np.testing.assert_allclose(estimate, np.full((n, 1), 2j), rtol=0, atol=1e-3)
    gram = estimator.basis.conj().T @ estimator.basis
    np.testing.assert_allclose(gram, np.eye(gram.shape[0]), rtol=0, atol=1e-10)


@few
@given(each_prs(), st.integers(0, 2))
def test_a_channel_that_stands_during_bursts_is_known_with_any_prs(prs, order):
    system = System(n_subcarriers=64, n_symbols=14 * (prs.offset + 3 * prs.period), prs=prs)
    grid, estimator = draw_grid(system), prs_estimator(system, order)
    n_prs, n_basis = int(estimator.is_prs.sum()), estimator.basis.shape[1]
    assert len(estimator.bursts) == 3
    if order == 0:
        assert estimator.noise_gain == pytest.approx(n_basis / n_prs)
    course = np.polynomial.Polynomial(np.arange(1, order + 2) / np.array([1, 100, 1e4])[: order + 1])
    sounded = np.zeros(system.n_symbols)
    for burst in estimator.bursts:
        sounded[burst] = course(burst.mean())
    response = late_by(system, 100e-9)[:, :1]
    estimate = estimator.estimate(response * sounded * grid.symbols, grid.symbols)
    expected = response * course(np.arange(estimate.shape[1]))
    np.testing.assert_allclose(estimate, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_a_frame_whose_prs_misses_subcarriers_and_an_order_that_cannot_be_are_refused():
    for m in (1, 2, 4):
        message = refusal(prs_estimator, System(n_subcarriers=64, n_symbols=m))
        assert f"n_symbols = {m}: the PRS covers" in message
        assert "within symbols 1 to 4 of slot 0; at least 5 symbols are needed" in message
    late = System(n_subcarriers=64, n_symbols=14 + 13, prs=Prs(12, 12, 2, 3, 1))
    message = "within symbols 2 to 13 of slot 1; at least 28 symbols are needed"
    assert message in refusal(prs_estimator, late)
    assert len(prs_estimator(dataclasses.replace(late, n_symbols=28)).bursts) == 1
    for order in (-1, 4, 1.0, True):
        assert "allowed is a whole number below 4" in refusal(prs_estimator, System(n_subcarriers=63), order)
