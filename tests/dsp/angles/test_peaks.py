"""Peaks on lines and planes, against plain loops and exact parabolas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.peaks import line_maxima, line_peaks, plane_maxima, plane_peaks, vertex


def plain_vertex(left, middle, right):
    """Middle of the parabola through three samples, by polynomial fitting."""
    a, b, _ = np.polyfit([-1, 0, 1], [left, middle, right], 2)
    return min(max(-b / (2 * a), -0.5), 0.5)


def distinct(seed, *shape):
    """Spectra of distinct samples: no ties."""
    return np.random.default_rng(seed).permutation(np.prod(shape)).reshape(shape) + 1.0


@pytest.mark.parametrize(
    ("samples", "place"), [((1.0, 1.0, 1.0), 0), ((0.0, 1.0, 1.9), 0.5), ((1.9, 1.0, 0.0), -0.5)]
)
def test_equal_samples_have_their_vertex_in_the_middle_and_none_lies_beyond_half_a_step(samples, place):
    assert vertex(*np.array(samples)[:, None]) == place


@given(n=st.integers(1, 4), g=st.integers(3, 12), masked=st.booleans(), seed=st.integers(0, 9999))
def test_line_peaks_are_those_of_a_plain_loop(n, g, masked, seed):
    rng = np.random.default_rng(seed)
    spectra, grid = distinct(seed, n, g), np.linspace(-0.7, 0.4, g)
    n_peaks = rng.integers(0, 4, n)
    allowed = rng.random((n, g)) < 0.6 if masked else None
    spectrum, sample = line_maxima(spectra)
    kept = slice(None) if allowed is None else allowed[spectrum, sample]
    peaks = line_peaks(spectra, grid, n_peaks, (spectrum[kept], sample[kept]))
    assert peaks.place.shape == peaks.found.shape
    for row in range(n):
        one, maxima, step = spectra[row], [], grid[1] - grid[0]
        for i in range(1, g - 1):
            if one[i] > max(one[i - 1], one[i + 1]) and (allowed is None or allowed[row, i]):
                maxima.append(i)
        maxima = sorted(maxima, key=lambda i: -one[i])[: n_peaks[row]]
        expected = [grid[i] + step * plain_vertex(*one[i - 1 : i + 2]) for i in maxima]
        assert peaks.found[row].tolist() == [k < len(maxima) for k in range(peaks.found.shape[1])]
        np.testing.assert_allclose(peaks.place[row, : len(maxima)], expected, atol=1e-9)


@pytest.mark.parametrize("spectrum", [[1, 2, 3, 4], [4, 3, 2, 1], [2, 1, 1, 2], [1, 1, 1, 1]])
def test_the_ends_of_a_line_and_a_flat_line_are_no_peaks(spectrum):
    peaks = line_peaks(np.array([spectrum], dtype=float), np.arange(4.0), np.array([4]))
    assert not peaks.found.any()


def test_a_flat_top_of_two_samples_is_one_peak_between_them():
    peaks = line_peaks(np.array([[0.0, 1.0, 3.0, 3.0, 1.0, 0.0]]), np.arange(6.0), np.array([3]))
    assert peaks.place[peaks.found].tolist() == [2.5]


@pytest.mark.parametrize(("shape", "n_peaks"), [((0, 5), []), ((2, 5), [0, 0])])
def test_no_spectra_and_no_peaks_asked_for_give_none(shape, n_peaks):
    peaks = line_peaks(np.ones(shape), np.arange(5.0), np.array(n_peaks, dtype=np.int64))
    assert len(peaks.place) == shape[0]
    assert not peaks.found.any()


@given(st.integers(1, 3), st.integers(3, 7), st.integers(3, 7), st.integers(0, 5), st.integers(0, 9999))
def test_plane_peaks_are_those_of_a_plain_double_loop_on_two_circles(n, g, h, n_most, seed):
    power = distinct(seed, n, g, h)
    allowed = np.random.default_rng(seed).random(power.shape) < 0.8
    row, column, found = plane_peaks(power, plane_maxima(power, allowed), n_most)
    for k in range(n):
        maxima = []
        for i, j in np.ndindex(g, h):
            around = [power[k, (i + a) % g, (j + b) % h] for a in (-1, 0, 1) for b in (-1, 0, 1)]
            if allowed[k, i, j] and power[k, i, j] == max(around):
                maxima.append((power[k, i, j], i, j))
        maxima = sorted(maxima, reverse=True)[:n_most]
        assert found[k].sum() == len(maxima)
        assert found[k, : len(maxima)].all()
        for m, (height, i, j) in enumerate(maxima):
            level = np.log(power[k])
            up, down = level[(i - 1) % g, j], level[(i + 1) % g, j]
            left, right = level[i, (j - 1) % h], level[i, (j + 1) % h]
            assert row[k, m] == pytest.approx(i + plain_vertex(up, np.log(height), down))
            assert column[k, m] == pytest.approx(j + plain_vertex(left, np.log(height), right))


def test_zeros_beside_a_peak_and_spectra_of_zeros_have_places_without_a_warning():
    power = np.zeros((2, 5, 6))
    power[0, 2, 3] = 1.0
    row, column, found = plane_peaks(power, plane_maxima(power, power > 0), 2)
    assert (row[0, 0], column[0, 0]) == (2.0, 3.0)
    assert found.tolist() == [[True], [False]]
    assert np.isfinite(row).all()
    assert np.isfinite(column).all()
