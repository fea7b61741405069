"""Direction cosines on their circle, and peaks of sampled spectra, placed between the samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Floats, Integers, Mask
from isacbench.model.kernels import PERIOD
from isacbench.model.region import Interval


def cosine_samples(limits: Interval, widest: float) -> Floats:
    """Sample direction cosines between two limits and once beyond either, or the whole circle.

    Samples are equidistant, at most `widest` apart. The circle, which begins at -1, is sampled where the
    samples beyond the limits would meet or overlap: a plane wave then has one place among them, not two.
    """
    span = limits[1] - limits[0]
    n_steps = max(int(np.ceil(span / widest * (1 - np.finfo(np.float64).eps))), 1)
    step = span / n_steps or widest
    if span + 2 * step >= PERIOD:
        n_steps = int(np.ceil(PERIOD / step))
        return np.linspace(-1, 1, n_steps, endpoint=False)
    return np.linspace(limits[0] - step, limits[0] + (n_steps + 1) * step, n_steps + 3)


def direction_samples(limits: tuple[Interval, Interval], widest: Iterable[float]) -> tuple[Floats, Floats]:
    """Sample u and w between their limits by `cosine_samples`."""
    u, w = map(cosine_samples, limits, widest)
    return u, w


def with_neighbours(spectra: Floats, grids: Sequence[Floats]) -> tuple[Floats, list[Floats]]:
    """Give spectra (n, *samples) over a whole circle the samples beyond either end that other spectra have.

    The last sample then stands before the first as well, and the first behind the last. Grids are from
    `cosine_samples`, one an axis.
    """
    framed = []
    for axis, grid in enumerate(grids, start=1):
        step = grid[1] - grid[0]
        if abs(grid.size * step - PERIOD) < step / 2:
            spectra = spectra.take(np.arange(-1, grid.size + 1), axis, mode="wrap")
            grid = np.r_[grid[0] - step, grid, grid[-1] + step]
        framed.append(grid)
    return spectra, framed


class Peaks(NamedTuple):
    """Peaks of many spectra, strongest first.

    Attributes
    ----------
    place : ndarray of float64, shape (n, k)
        Places, one row a spectrum.
    found : ndarray of bool, shape (n, k)
        Mask of the peaks; the other entries only fill the row.
    """

    place: Floats
    found: Mask


def vertex(left: Floats, middle: Floats, right: Floats) -> Floats:
    """Find the vertex of a parabola through three equidistant samples.

    Parameters
    ----------
    left, middle, right : ndarray of float64, same shape

    Returns
    -------
    ndarray of float64, same shape
        Offset from the middle in steps, -1/2 to 1/2.
    """
    curvature = left - 2 * middle + right
    slope = 0.5 * (left - right)
    offset = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature != 0)
    return np.clip(offset, -0.5, 0.5)


Places = tuple[NDArray[np.intp], ...]
"""Spectra, and samples of these along each axis, as `numpy.nonzero` gives them."""


def line_maxima(spectra: Floats) -> Places:
    """Find the local maxima of one-dimensional spectra (n, g), of equal neighbours the first.

    The two ends are none: the spectrum may go on rising.
    """
    inner = spectra[:, 1:-1]
    spectrum, sample = np.nonzero((inner > spectra[:, :-2]) & (inner >= spectra[:, 2:]))
    return spectrum, sample + 1


def line_peaks(spectra: Floats, grid: Floats, n_peaks: Integers, maxima: Places | None = None) -> Peaks:
    """Strongest local maxima of one-dimensional spectra.

    Parameters
    ----------
    spectra : ndarray of float64, shape (n, g)
    grid : ndarray of float64, shape (g,)
        Equidistant places of the samples.
    n_peaks : ndarray of int64, shape (n,)
        Most peaks to return of each spectrum.
    maxima : (ndarray of int, ndarray of int), each shape (m,), optional
        Those of `line_maxima` that may be peaks; without it all.

    Returns
    -------
    Peaks
        Refined by a parabola through three samples.
    """
    spectrum, sample = maxima or line_maxima(spectra)
    chosen = strongest(spectra[spectrum, sample], spectrum, n_peaks)
    spectrum, sample = spectrum[chosen], sample[chosen]
    left, middle, right = (spectra[spectrum, sample + shift] for shift in (-1, 0, 1))
    place = grid[sample] + vertex(left, middle, right) * (grid[1] - grid[0])
    return Peaks(*in_rows(len(spectra), spectrum, place))


def strongest(height: Floats, spectrum: Integers, n_most: Integers) -> Integers:
    """Choose the strongest of maxima (m,), at most n_most (n,) of each spectrum: indices of them.

    Spectra (m,) ascend; those of the chosen ones do so as well, with the strongest of each first.
    """
    descending = np.lexsort([-height, spectrum])
    return descending[numbered(spectrum) < n_most[spectrum]]


def numbered(spectrum: Integers) -> Integers:
    """Number the entries (m,) of each spectrum from 0; spectra ascend."""
    return np.arange(spectrum.size) - np.searchsorted(spectrum, spectrum)


def in_rows(n: int, spectrum: Integers, *values: Floats) -> tuple[NDArray[Any], ...]:
    """Rows (n, k) of values (m,), one a spectrum, and the mask of their entries; others only fill the row.

    Spectra (m,) ascend.
    """
    entry = numbered(spectrum)
    rows = np.zeros((len(values) + 1, n, int(entry.max(initial=0)) + 1))
    rows[:, spectrum, entry] = *values, np.ones(spectrum.size)
    return *rows[:-1], rows[-1] > 0


def plane_maxima(power: Floats, allowed: Mask) -> Places:
    """Find the local maxima among allowed samples of spectra (n, g, h) with circular axes, as of a DFT.

    None of the eight neighbours exceeds them.
    """
    _, n_rows, n_columns = power.shape
    spectrum, row, column = np.unravel_index(np.flatnonzero(allowed), power.shape)
    height = power[spectrum, row, column]
    is_maximum = np.ones(height.size, dtype=np.bool_)
    for up, right in product((-1, 0, 1), repeat=2):
        is_maximum &= height >= power[spectrum, (row + up) % n_rows, (column + right) % n_columns]
    return spectrum[is_maximum], row[is_maximum], column[is_maximum]


def plane_peaks(power: Floats, maxima: Places, n_most: int) -> tuple[NDArray[Any], ...]:
    """Place the strongest peaks of periodic two-dimensional spectra (n, g, h) between the samples.

    Returned are rows and columns (n, k), at most `n_most`, the strongest peak first, and the mask of the
    peaks; other entries only fill the row.
    """
    n, n_rows, n_columns = power.shape
    chosen = strongest(power[maxima], maxima[0], np.full(n, n_most))
    spectrum, row, column = (index[chosen] for index in maxima)
    peak = power[spectrum, row, column]
    top = np.where(peak > 0, peak, 1.0)

    def level(row: Integers, column: Integers) -> Floats:
        # A mainlobe is nearer to a parabola in its logarithm; of a ratio, which no unit changes.
        ratio = power[spectrum, row, column] / top
        return np.log(np.maximum(ratio, np.finfo(np.float64).tiny))

    middle = np.zeros_like(top)
    row_offset = vertex(level(row - 1, column), middle, level((row + 1) % n_rows, column))
    column_offset = vertex(level(row, column - 1), middle, level(row, (column + 1) % n_columns))
    return in_rows(n, spectrum, row + row_offset, column + column_offset)
