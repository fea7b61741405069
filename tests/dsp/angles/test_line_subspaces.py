"""Subspace methods in real arithmetic, against their complex definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.line_subspaces import (
    music_null_minima,
    music_null_spectrum,
    real_steering,
    real_steering_slopes,
    smoothed_covariance,
)
from isacbench.dsp.angles.peaks import line_peaks
from isacbench.model.kernels import steering
from tests.dsp.plane_wave_data import noise, unitary_transform

SENSORS, SUBARRAY = 16, 10
GRID = np.linspace(-1, 1, 801)
LENGTHS = st.integers(2, 11)


def eigenvectors(lines, n_subarray=SUBARRAY):
    """Eigenvectors of the covariances of lines (n, sensors, snapshots), the strongest first."""
    return np.linalg.eigh(smoothed_covariance(lines, n_subarray))[1][:, :, ::-1]


def null_spectrum(lines, order, grid=GRID):
    """MUSIC null spectra (n, g) of lines."""
    return music_null_spectrum(eigenvectors(lines), np.full(len(lines), order), real_steering(SUBARRAY, grid))


@st.composite
def sources(draw):
    """One to three directions more than a Rayleigh cell of the subarray apart, and their echoes."""
    gaps = draw(st.lists(st.floats(0.25, 0.5), min_size=1, max_size=3))
    cosine = draw(st.floats(-0.9, -0.7)) + np.cumsum(gaps)
    gain = [draw(st.floats(0.5, 2)) * np.exp(1j * draw(st.floats(0, 2 * np.pi))) for _ in gaps]
    return cosine, np.array(gain)


@given(n_subarray=LENGTHS, cosine=st.lists(st.floats(-1, 1), min_size=1, max_size=4))
def test_real_steering_is_steering_from_the_middle_turned_by_the_unitary_transform(n_subarray, cosine):
    middle = np.exp(1j * np.pi * (n_subarray - 1) / 2 * np.array(cosine))
    expected = unitary_transform(n_subarray).conj().T @ (steering(n_subarray, cosine).T * middle)
    found = real_steering(n_subarray, cosine)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(np.sum(found**2, axis=0), n_subarray, rtol=1e-12)


@pytest.mark.parametrize("coherent", [True, False])
@given(echoes=sources())
def test_music_is_exact_on_noise_free_sources(coherent, echoes):
    cosine, gain = echoes
    # Coherent echoes reach all snapshots alike; smoothing alone restores the rank.
    waveforms = np.ones((len(gain), 1)) if coherent else np.fft.fft(np.eye(8))[: len(gain)]
    lines = (steering(SENSORS, cosine).T @ (gain[:, None] * waveforms))[None]
    assert null_spectrum(lines, len(gain), cosine).max() < 1e-10 * SUBARRAY
    peaks = line_peaks(-null_spectrum(lines, len(gain)), GRID, np.array([len(gain)]))
    assert peaks.found.all()
    np.testing.assert_allclose(np.sort(peaks.place[0]), cosine, atol=1e-4)


@given(n_cells=st.integers(1, 4), n_subarray=st.integers(3, 8), seed=st.integers(0, 999))
def test_the_null_spectrum_is_the_squared_projection_on_the_noise_subspace(n_cells, n_subarray, seed):
    vectors = eigenvectors(noise(n_cells, 10, 4, seed=seed), n_subarray)
    order = np.random.default_rng(seed).integers(1, n_subarray, n_cells)
    found = music_null_spectrum(vectors, order, real_steering(n_subarray, GRID[::50]))
    for cell in range(n_cells):
        for i, cosine in enumerate(GRID[::50]):
            a = real_steering(n_subarray, [cosine])[:, 0]
            expected = sum((vector @ a) ** 2 for vector in vectors[cell].T[order[cell] :])
            assert found[cell, i] == pytest.approx(expected, abs=1e-11)


@given(n_subarray=LENGTHS, cosine=st.lists(st.floats(-1, 1), min_size=1, max_size=4))
def test_slopes_of_real_steering_are_those_of_complex_steering_turned(n_subarray, cosine):
    arm = np.pi * ((n_subarray - 1) / 2 - np.arange(n_subarray))
    turn = unitary_transform(n_subarray).conj().T
    found = real_steering_slopes(n_subarray, np.array(cosine))
    for order in range(3):
        for row, place in zip(found[:, order], cosine, strict=True):
            expected = turn @ ((1j * arm) ** order * np.exp(1j * arm * place))
            np.testing.assert_allclose(row, expected, atol=1e-11 * n_subarray**order)


@given(echoes=sources(), offset=st.floats(-0.01, 0.01))
def test_nulls_of_noise_free_sources_are_found_exactly_from_places_nearby(echoes, offset):
    cosine, gain = echoes
    lines = (steering(SENSORS, cosine).T @ gain[:, None])[None]
    start = (cosine + offset)[None]
    order, found = np.array([len(gain)]), np.ones(start.shape, dtype=bool)
    minima = music_null_minima(eigenvectors(lines), order, start, found, 0.02)
    np.testing.assert_allclose(minima[0], cosine, atol=1e-7)


@given(seed=st.integers(0, 9999), order=st.integers(1, 4))
def test_minima_from_a_grid_are_flat_and_entries_that_are_not_found_stay(seed, order):
    vectors = eigenvectors(noise(3, SENSORS, 6, seed=seed))
    orders = np.minimum([order, 1, 2], order)
    null = music_null_spectrum(vectors, orders, real_steering(SUBARRAY, GRID))
    peaks = line_peaks(-null, GRID, orders)
    minima = music_null_minima(vectors, orders, peaks.place, peaks.found, GRID[1] - GRID[0])
    assert np.array_equal(minima[~peaks.found], peaks.place[~peaks.found])
    step = 1e-6
    around = np.stack([minima - step, minima, minima + step])
    for cell, entry in zip(*np.nonzero(peaks.found), strict=True):
        places = real_steering(SUBARRAY, around[:, cell, entry])
        left, middle, right = music_null_spectrum(vectors[[cell]], orders[[cell]], places)[0]
        assert abs(right - left) / (2 * step) < 1e-3
        assert middle <= max(left, right)


def test_another_step_would_lead_nowhere_from_the_flattest_minimum():
    vectors, orders, coarse = eigenvectors(noise(300, SENSORS, 6)), np.full(300, 4), GRID[::50]
    peaks = line_peaks(-music_null_spectrum(vectors, orders, real_steering(SUBARRAY, coarse)), coarse, orders)
    reach = coarse[1] - coarse[0]
    minima = music_null_minima(vectors, orders, peaks.place, peaks.found, reach)
    slopes = real_steering_slopes(SUBARRAY, minima).swapaxes(0, 1) @ vectors[:, :, :4]
    level, first, second = slopes
    slope, bend = np.sum(level * first, axis=2), -np.sum(first**2 + level * second, axis=2)
    inside = peaks.found & (abs(minima - peaks.place) < 0.999 * reach)
    assert inside.sum() > 300
    assert np.all(bend[inside] > 0)
    assert np.all(abs(slope / bend)[inside] < 1e-8)


def test_where_there_are_no_places_there_are_no_minima():
    vectors, none = np.stack([np.eye(SUBARRAY)] * 3), np.zeros((3, 0))
    assert music_null_minima(vectors, np.ones(3, dtype=int), none, none > 0, 0.1).shape == (3, 0)
