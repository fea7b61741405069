"""Doppler spectra of range bins, and filters made of them."""

import numpy as np
import pytest

from isacbench.dsp.sparse_bayes.learning import learn_doppler_spectra
from tests.dsp.plane_wave_data import noise

BINS = np.arange(-8.0, 9)
LINES = np.arange(-6, 6.01, 0.25)
KERNELS = np.sinc(BINS - LINES[:, None])
NOISE = 1e-3


def rows(rng, *echoes, n_elements=40):
    """One range bin with lines (place, amplitude) of independent snapshots, and noise."""
    total = np.zeros((1, BINS.size, n_elements), dtype=complex)
    for place, amplitude in echoes:
        total[0] += amplitude * np.sinc(BINS - place)[:, None] * noise(n_elements, seed=rng)
    return total + np.sqrt(NOISE) * noise(*total.shape, seed=rng)


def test_two_lines_less_than_a_bin_apart_are_two_peaks(rng):
    spectra = learn_doppler_spectra(rows(rng, (0.0, 1), (0.75, 1)), LINES, KERNELS, np.array([NOISE]), 40)
    power = spectra.power[0]
    peaks = LINES[1:-1][(power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:]) & (power[1:-1] > 0.1)]
    np.testing.assert_array_equal(peaks, [0, 0.75])
    assert power[LINES == 0] == pytest.approx(1, abs=0.4)


def test_a_filter_passes_its_line_and_suppresses_another(rng):
    moving = rows(rng, (0.9, 10))
    data = moving + rows(rng, (0.0, 1))
    spectra = learn_doppler_spectra(data, LINES, KERNELS, np.array([NOISE]), 20)
    still = np.sinc(BINS)
    filters = spectra.filters(still, np.abs(LINES) > 0.3)
    assert filters @ still == pytest.approx(1)
    leak = np.mean(np.abs(np.einsum("rd,rdm->rm", filters, moving)) ** 2)
    assert leak < 0.1 * np.mean(np.abs(np.einsum("rd,rdm->rm", still[None] / (still @ still), moving)) ** 2)


def test_noise_alone_has_no_line(rng):
    spectra = learn_doppler_spectra(rows(rng), LINES, KERNELS, np.array([NOISE]), 20)
    assert spectra.power.max() < NOISE
