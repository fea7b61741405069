"""Tapers on bins, and the noise they correlate."""

import numpy as np
import pytest

from isacbench.dsp.sparse_bayes.tiles import BinTaper


@pytest.mark.parametrize("taper", [BinTaper.hann, BinTaper.none])
def test_rows_of_a_taper_have_the_noise_of_their_bins(taper):
    tapered = taper(np.arange(9.0))
    np.testing.assert_allclose(tapered.noise.diagonal(), 1)


def test_noise_of_some_rows_is_measured_on_noise(rng):
    tapered = BinTaper.hann(np.arange(12.0))
    noise = rng.standard_normal((12, 200_000))
    rows = tapered.weights[2:7] @ noise
    np.testing.assert_allclose(rows @ rows.T / noise.shape[1], tapered.at(slice(2, 7)).noise, atol=0.02)


def test_a_hann_taper_lowers_sidelobes_of_centred_kernels():
    bins = np.arange(-20.0, 21)
    tapered = BinTaper.hann(bins)
    kernel = np.sinc(bins - 0.3)
    far = np.abs(tapered.bins) > 6
    assert np.abs(tapered.weights @ kernel)[far].max() < 0.1 * np.abs(kernel[1:-1])[far].max()


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_bins_are_left_as_they_are(n):
    np.testing.assert_array_equal(BinTaper.hann(np.arange(float(n))).weights, np.eye(n))
