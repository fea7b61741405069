"""Ambiguities of sensing with the PRS: closed forms against the transform of the mask, lobe by lobe."""

import numpy as np
import pytest

from isacbench.link.sensing.division import division_weights
from isacbench.link.sensing.noise_colouring import noise_covariance
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS, Prs, System, resource_elements
from tests.conftest import PRS_PAIRS

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


def side_peaks(spread):
    """Lags (n,) at which a cut of the response, whose peak is 1 at lag 0, is as high as anywhere else."""
    height = np.abs(spread)
    highest = height[1:].max()
    assert highest > 1e-9
    return 1 + np.flatnonzero(height[1:] > highest * (1 - 1e-9))


@pytest.mark.parametrize(("comb", "n_symbols"), PRS_PAIRS)
@pytest.mark.parametrize(("period", "offset"), [(1, 0), (2, 1), (5, 3)])
def test_the_highest_side_peaks_of_any_prs_are_where_the_documentation_has_them(
    comb, n_symbols, period, offset
):
    prs = Prs(comb, n_symbols, 0, period, offset)
    system = System(n_subcarriers=24, n_symbols=14 * period * 4, prs=prs)
    mask = resource_elements(system, "prs")
    spread = np.fft.fft(np.fft.ifft(mask, axis=0), axis=1) / mask.mean() / system.n_symbols
    # Along Doppler: bursts of 14 · period symbols repeat; the first lobe of either sign is highest.
    lobe_mps = system.wavelength_m / (2 * period * 14 * system.symbol_time_s)
    speeds = side_peaks(spread[0]) * system.velocity_bin_mps
    np.testing.assert_allclose(speeds, [lobe_mps, system.n_symbols * system.velocity_bin_mps - lobe_mps])
    # Along range: a symbol repeats after each comb-th part of the unambiguous range, a slot at rest never.
    alone = np.fft.ifft(mask[:, 14 * offset]) * system.n_subcarriers / mask[:, 14 * offset].sum()
    repeat_m = SPEED_OF_LIGHT_MPS / (2 * comb * system.subcarrier_spacing_hz)
    np.testing.assert_allclose(side_peaks(alone) * system.range_bin_m, repeat_m * np.arange(1, comb))
    assert np.abs(spread[1:, 0]).max() < 1e-12
