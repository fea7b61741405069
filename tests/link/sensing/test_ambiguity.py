"""Ambiguities of sensing with the PRS: closed forms against the transform of the mask, lobe by lobe."""

import numpy as np
import pytest

from isacbench.link.sensing.division import division_weights
from isacbench.link.sensing.noise_colouring import noise_covariance
from isacbench.model.numerology import System, resource_elements

PAPER = System()
VELOCITY_BIN_MPS = PAPER.velocity_bin_mps


def point_spread(system, sensing, range_offset_bins, doppler_offset_bins):
    """Range-Doppler response to an echo at distances from it, relative to its peak."""
    mask = resource_elements(system, sensing)
    range_turns = np.outer(range_offset_bins, np.arange(system.n_subcarriers)) / system.n_subcarriers
    doppler_turns = np.outer(np.arange(system.n_symbols), doppler_offset_bins) / system.n_symbols
    return np.exp(2j * np.pi * range_turns) @ mask @ np.exp(-2j * np.pi * doppler_turns) / mask.sum()


@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_at_whole_bins_it_is_the_transform_of_the_mask_and_the_correlation_of_noise(sensing):
    system = System(n_subcarriers=64, n_symbols=112)
    mask = resource_elements(system, sensing)
    spread = point_spread(system, sensing, np.arange(64), np.arange(112))
    transform = np.fft.fft(np.fft.ifft(mask, axis=0), axis=1)
    np.testing.assert_allclose(spread, transform / transform[0, 0], atol=1e-12)
    covariance = noise_covariance(division_weights(mask * 1.0, "reciprocal").noise)
    np.testing.assert_allclose(spread, covariance / covariance[0, 0], atol=1e-12)


def test_grating_lobes_stand_every_fourth_doppler_bin_under_the_envelope_of_one_burst():
    k = np.arange(1, 28)
    envelope = np.abs(np.sin(12 * np.pi * k / 56) / (12 * np.sin(np.pi * k / 56)))
    np.testing.assert_allclose(np.abs(point_spread(PAPER, "prs", [0], 4 * k))[0], envelope, atol=1e-12)
    assert pytest.approx(7.34, abs=0.005) == 4 * VELOCITY_BIN_MPS
    decibels = 20 * np.log10(envelope[:4])
    np.testing.assert_allclose(decibels, [-0.66, -2.79, -6.97, -15.78], atol=0.01)


def test_between_grating_lobes_four_bursts_cancel_at_whole_doppler_bins():
    spread = np.abs(point_spread(PAPER, "prs", [0], np.arange(1, 112)))[0]
    lobes = np.arange(1, 112) % 4 == 0
    assert spread[~lobes].max() < 1e-12


def test_the_comb_repeats_ranges_a_quarter_turn_of_doppler_away_and_never_at_rest():
    heights = np.abs(point_spread(PAPER, "prs", 512 * np.arange(1, 4), 56 * np.arange(-2, 2)))
    # Transforms of the four phases that the offsets 0, 2, 1, 3 give, over four.
    weak, strong = 1 / 2, np.sqrt(1 / 2)
    expected = [[strong, weak, 0, weak], [0, strong, 0, strong], [strong, weak, 0, weak]]
    np.testing.assert_allclose(heights, expected, atol=1e-9)
    assert PAPER.unambiguous_range_m / 4 == pytest.approx(156.1, abs=0.05)
    assert pytest.approx(102.8, abs=0.05) == 56 * VELOCITY_BIN_MPS


def test_symbol_by_symbol_a_comb_is_ambiguous_where_the_staggered_one_is_not():
    one_symbol = System(n_subcarriers=64, n_symbols=2)
    four_symbols = System(n_subcarriers=64, n_symbols=5)
    assert abs(point_spread(one_symbol, "prs", 16, 0)).item() == pytest.approx(1, rel=1e-12)
    assert abs(point_spread(four_symbols, "prs", 16, 0)).item() < 1e-12


def test_merging_four_combs_blindly_shows_moving_echoes_again_half_the_ambiguity_away():
    # 15 m/s turn the phase from symbol to symbol; the merged symbol is read as if nothing moved.
    turns = 15.0 / VELOCITY_BIN_MPS / 224
    group = System(n_subcarriers=2048, n_symbols=5)
    ghost = abs(point_spread(group, "prs", 1024, -turns * group.n_symbols)).item()
    # Phases 1, 1, -1, -1 of the offsets 0, 2, 1, 3: |1 + z - z² - z³| / 4.
    assert ghost == pytest.approx(np.cos(np.pi * turns) * np.sin(2 * np.pi * turns), rel=1e-9)
    assert 20 * np.log10(ghost) == pytest.approx(-12.93, abs=0.01)


def test_the_masked_transform_is_the_merging_of_combs_at_the_speed_of_each_doppler_bin():
    system = System(n_subcarriers=32, n_symbols=70)
    mask = resource_elements(system, "prs")
    rng = np.random.default_rng(5)
    received = mask * (rng.standard_normal(mask.shape) + 1j * rng.standard_normal(mask.shape))
    masked = np.fft.fft(np.fft.ifft(received, axis=0), axis=1)
    symbols = np.flatnonzero(mask.any(axis=0)).reshape(-1, 4)
    assert len(symbols) == 6
    for doppler_bin in (0, 3, -11):
        profile = np.zeros(32, dtype=complex)
        for group in symbols:
            turned = received[:, group] * np.exp(-2j * np.pi * group * doppler_bin / 70)
            merged = turned.sum(axis=1)
            # No subcarrier is met twice: the four combs fill one symbol.
            assert np.all((turned != 0).sum(axis=1) == 1)
            profile += np.fft.ifft(merged)
        np.testing.assert_allclose(profile, masked[:, doppler_bin], atol=1e-12)
