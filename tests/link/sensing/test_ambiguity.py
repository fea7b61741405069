"""Ambiguities of sensing with the PRS: closed forms against the transform of the mask, lobe by lobe."""

import numpy as np
import pytest

from isacbench.errors import InputError
from isacbench.link.sensing.ambiguity import point_spread, prs_ambiguities
from isacbench.link.sensing.division import division_weights
from isacbench.link.sensing.noise_colouring import noise_covariance
from isacbench.model.numerology import System
from isacbench.model.prs import resource_elements

PAPER = System()
VELOCITY_BIN_MPS = PAPER.velocity_bin_mps


def summed(system, sensing, range_offset, doppler_offset):
    """Point spread, element by element."""
    n, m = np.nonzero(resource_elements(system, sensing))
    phase = np.outer(range_offset, n / system.n_subcarriers)[:, None]
    phase = phase - np.outer(doppler_offset, m / system.n_symbols)[None]
    return np.exp(2j * np.pi * phase).mean(axis=-1)


@pytest.mark.parametrize("sensing", ["all", "prs"])
def test_the_point_spread_is_the_sum_over_resource_elements(sensing):
    system, range_offset, doppler_offset = System(n_subcarriers=18, n_symbols=75), [0, -3.3, 40], [0.4, -90]
    spread = point_spread(system, sensing, range_offset, doppler_offset)
    np.testing.assert_allclose(spread, summed(system, sensing, range_offset, doppler_offset), atol=1e-12)


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
    lobes = prs_ambiguities(PAPER, n_lobes=27)[:27]
    k = np.arange(1, 28)
    envelope = np.abs(np.sin(12 * np.pi * k / 56) / (12 * np.sin(np.pi * k / 56)))
    shown = np.array([lobe.height for lobe in lobes if lobe.range_m == 0])
    # Where the envelope is 0 there is no lobe: 12 k / 56 is whole for k = 14 alone.
    np.testing.assert_allclose(shown, envelope[envelope > 1e-9], rtol=1e-9)
    speeds = [lobe.speed_mps for lobe in lobes[:4]]
    np.testing.assert_allclose(speeds, 4 * VELOCITY_BIN_MPS * np.arange(1, 5), rtol=1e-12)
    assert speeds[0] == pytest.approx(7.34, abs=0.005)
    decibels = 20 * np.log10(envelope[:4])
    np.testing.assert_allclose(decibels, [-0.66, -2.79, -6.97, -15.78], atol=0.01)


def test_between_grating_lobes_four_bursts_cancel_at_whole_doppler_bins():
    spread = np.abs(point_spread(PAPER, "prs", [0], np.arange(1, 112)))[0]
    lobes = np.arange(1, 112) % 4 == 0
    assert spread[~lobes].max() < 1e-12


def test_the_comb_repeats_ranges_a_quarter_turn_of_doppler_away_and_never_at_rest():
    comb = [lobe for lobe in prs_ambiguities(PAPER) if lobe.range_m > 0]
    quarter_m, quarter_mps = PAPER.unambiguous_range_m / 4, 56 * VELOCITY_BIN_MPS
    places = [(lobe.range_m / quarter_m, lobe.speed_mps / quarter_mps) for lobe in comb]
    expected = [(1, -2), (1, -1), (1, 1), (2, -1), (2, 1), (3, -2), (3, -1), (3, 1)]
    np.testing.assert_allclose(places, expected, atol=1e-12)
    # Transforms of the four phases that the offsets 0, 2, 1, 3 give, over four.
    weak, strong = 1 / 2, np.sqrt(1 / 2)
    heights = [strong, weak, weak, strong, strong, strong, weak, weak]
    np.testing.assert_allclose([lobe.height for lobe in comb], heights, rtol=1e-9)
    assert quarter_m == pytest.approx(156.1, abs=0.05)
    assert quarter_mps == pytest.approx(102.8, abs=0.05)


def test_a_grid_without_prs_is_refused():
    with pytest.raises(InputError, match="no PRS in a grid"):
        point_spread(System(n_subcarriers=8, n_symbols=1), "prs", 0, 0)
    with pytest.raises(InputError, match="unknown sensing 'pss'"):
        point_spread(PAPER, "pss", 0, 0)
