"""Peaks on sampled spectra, placed between the samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

Floats = NDArray[np.float64]


class Peaks(NamedTuple):
    """Peaks of many spectra, strongest first.

    Attributes
    ----------
    place : ndarray of float64, shape (n, k)
        Places, one row a spectrum.
    found : ndarray of bool, shape (n, k)
        Which entries are peaks; the others only fill the row.
    """

    place: Floats
    found: NDArray[np.bool_]


def vertex(left: Floats, middle: Floats, right: Floats) -> Floats:
    """Offset of a parabola's vertex from the middle of three equidistant samples, at most half a step."""
    curvature = left - 2 * middle + right
    slope = 0.5 * (left - right)
    offset = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature != 0)
    return np.clip(offset, -0.5, 0.5)


def line_peaks(
    spectra: Floats, grid: Floats, n_peaks: NDArray[np.int64], allowed: NDArray[np.bool_] | None = None
) -> Peaks:
    """Strongest local maxima of one-dimensional spectra.

    Parameters
    ----------
    spectra : ndarray of float64, shape (n, g)
    grid : ndarray of float64, shape (g,)
        Equidistant places of the samples. Maxima at its two ends are not
        peaks: the spectrum may go on rising.
    n_peaks : ndarray of int64, shape (n,)
        Most peaks to return of each spectrum.
    allowed : ndarray of bool, shape (n, g), optional
        Samples that may be peaks; without it all.

    Returns
    -------
    Peaks
        Refined by a parabola through three samples.
    """
    inner = spectra[:, 1:-1]
    is_peak = (inner > spectra[:, :-2]) & (inner >= spectra[:, 2:])
    if allowed is not None:
        is_peak &= allowed[:, 1:-1]
    index, found = _highest(inner, is_peak, n_peaks)
    left, middle, right = (np.take_along_axis(spectra, index + shift, axis=1) for shift in range(3))
    place = grid[index + 1] + vertex(left, middle, right) * (grid[1] - grid[0])
    return Peaks(place, found)


def _highest(
    heights: Floats, is_peak: NDArray[np.bool_], n_peaks: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Samples of the highest peaks (n, k) of each line, highest first, and which entries are peaks."""
    line, sample = np.nonzero(is_peak)
    order = np.lexsort((-heights[line, sample], line))
    line, sample = line[order], sample[order]
    rank = np.arange(line.size) - np.searchsorted(line, line)
    few = rank < n_peaks[line]
    n_most = min(int(n_peaks.max(initial=0)), heights.shape[1])
    index = np.zeros((len(heights), n_most), dtype=np.int64)
    found = np.zeros(index.shape, dtype=np.bool_)
    index[line[few], rank[few]] = sample[few]
    found[line[few], rank[few]] = True
    return index, found


def plane_peaks(
    power: Floats, allowed: NDArray[np.bool_], n_most: int
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Strongest local maxima of periodic two-dimensional spectra.

    Parameters
    ----------
    power : ndarray of float64, shape (n, g, h)
        Both axes are circles, as those of a DFT are.
    allowed : ndarray of bool, same shape
        Samples that may be peaks.
    n_most : int
        Most peaks to return of each spectrum.

    Returns
    -------
    row, column : ndarray of float64, shape (n, k)
        Places between the samples, strongest peak first.
    found : ndarray of bool, shape (n, k)
        Which entries are peaks; the others only fill the row.
    """
    is_peak = allowed & (power >= maximum_filter(power, size=(1, 3, 3), mode="wrap"))
    n, n_rows, n_columns = power.shape
    height = np.where(is_peak, power, -np.inf).reshape(n, n_rows * n_columns)
    n_most = min(n_most, height.shape[1])
    index = np.argsort(-height, axis=1, kind="stable")[:, :n_most]
    found = np.isfinite(np.take_along_axis(height, index, axis=1))
    row, column = np.divmod(index, n_columns)
    spectrum = np.arange(n)[:, None]

    peak = power[spectrum, row, column]
    top = np.where(found & (peak > 0), peak, 1.0)

    def level(row: NDArray[np.int64], column: NDArray[np.int64]) -> Floats:
        # A mainlobe is nearer to a parabola in its logarithm; of a ratio, which no unit changes.
        ratio = power[spectrum, row, column] / top
        return np.log(np.maximum(ratio, np.finfo(np.float64).tiny))

    middle = np.zeros_like(top)
    row_offset = vertex(level(row - 1, column), middle, level((row + 1) % n_rows, column))
    column_offset = vertex(level(row, column - 1), middle, level(row, (column + 1) % n_columns))
    return row + row_offset, column + column_offset, found
