"""Angular power spectra of planar snapshots over a grid of direction cosines, and their peaks off the grid.

Bartlett's and Capon's power and the null spectrum of MUSIC are all made of one
sum over real matrices B_k of L x M sensors, the squared projections
Σ_k (aᵀ B_k b)² of the steering vectors a along u and b along w. It is evaluated
separably, and its slopes lead from a sample to the extremum by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import minimum_filter

from isacbench.checked_arrays import Floats, Integers, Mask, parts_of
from isacbench.dsp.angles.line_subspaces import real_steering, real_steering_slopes
from isacbench.dsp.angles.peaks import in_rows, plane_peaks, strongest, with_neighbours
from isacbench.dsp.angles.plane_waves import PlaneWaves

CHUNK_VALUES = 2**16
"""Projections computed at once: half a megabyte stays in the cache."""

COLUMN_VALUES = 2**20
"""Entries of the matrices whose minima are sought at once, one for each minimum: 8 MiB."""

CANDIDATES = 2
"""Samples a peak asked for from which Newton's method starts."""

FLAT = 1e-6
"""Relative height of the peaks of a spectrum up to which it has none."""

MOST_STEPS = 30
"""Of Newton's method; most minima need four."""

CONVERGED = 1e-5
"""Step, in samples, beyond which another one would change only rounding: digits double with every step."""

ROUNDING = 1e-13
"""Relative rise of a level that is no rise."""


def squared_projections(columns: Floats, u: ArrayLike, w: ArrayLike) -> Floats:
    """Sum the squared projections of the steering vectors of a grid onto real matrices.

    Parameters
    ----------
    columns : ndarray of float64, shape (n, L, M, k)
        Matrices B_k of each cell, sensors after the unitary transform
        (`isacbench.dsp.angles.line_subspaces.unitary_transform`).
    u : array_like, shape (g,)
    w : array_like, shape (h,)

    Returns
    -------
    ndarray of float64, shape (n, g, h)
        Σ_k (aᵀ B_k b)², with the real steering vectors a of u and b of w, of
        squared norms L and M.
    """
    n, n_u, n_w, k = columns.shape
    towards_u, towards_w = real_steering(n_u, u), real_steering(n_w, w)
    total = np.empty((n, towards_u.shape[1], towards_w.shape[1]))
    for some in parts_of(n, CHUNK_VALUES // max(k * total[:1].size, 1)):
        projection = projections(columns[some], towards_u, towards_w)
        total[some] = np.vecdot(projection, projection)
    return total


def projections(columns: Floats, a: Floats, b: Floats) -> Floats:
    """Projections (n, g, h, k) of real matrices (n, L, M, k) on steering vectors a (L, g) and b (M, h)."""
    n, n_u, _, k = columns.shape
    along_w = (b.T @ columns).reshape(n, n_u, b.shape[1] * k)
    return (a.T @ along_w).reshape(n, a.shape[1], b.shape[1], k)


class Minima(NamedTuple):
    """Minima of the spectra of cells, cell by cell.

    Attributes
    ----------
    cell : ndarray of int64, shape (m,)
        Ascending.
    place : ndarray of float64, shape (m, 2)
        Direction cosines u and w.
    level : ndarray of float64, shape (m,)
        Squared projections there, times the sign of the spectrum.
    curvature : ndarray of float64, shape (m, 2, 2)
        Second derivatives.
    """

    cell: Integers
    place: Floats
    level: Floats
    curvature: Floats


def planar_minima(
    level: Floats,
    columns: Floats,
    grid: tuple[Floats, Floats],
    n_minima: Integers,
    highest: float,
    sign: Literal[-1, 1],
) -> Minima:
    """Find the lowest local minima of sampled spectra, and place them off the grid by Newton's method.

    Parameters
    ----------
    level : ndarray of float64, shape (n, g, h)
        Samples of ``sign`` times the squared projections onto `columns`, but
        for a constant. Those on the border are no minima, but for a circle's:
        the spectrum may fall beyond.
    columns : ndarray of float64, shape (n, L, M, k)
        As for `squared_projections`.
    grid : (ndarray of float64, ndarray of float64), shapes (g,) and (h,)
        Equidistant u and w of the samples, three and more, from
        `isacbench.dsp.angles.peaks.cosine_samples`.
    n_minima : ndarray of int64, shape (n,)
        Most minima to return of each cell.
    highest : float
        Level below which a minimum counts; the lowest of a cell counts in any case.
    sign : {-1, 1}
    """
    level, (u, w) = with_neighbours(level, grid)
    is_minimum = _is_minimum(level)
    lowest = level.min(axis=(1, 2), keepdims=True, where=is_minimum, initial=np.inf)
    is_minimum &= (level <= lowest) | (level < highest)
    samples = np.nonzero(is_minimum)
    chosen = strongest(-level[samples], samples[0], n_minima)
    cell, row, column = (index[chosen] for index in samples)
    reach = np.array([line[1] - line[0] for line in grid])
    minima = Minima(
        cell, np.stack([u[row], w[column]], axis=-1), np.empty(len(cell)), np.empty((len(cell), 2, 2))
    )
    for some in parts_of(len(cell), COLUMN_VALUES // max(columns[:1].size, 1)):
        minima.place[some], minima.level[some], minima.curvature[some] = descended_minima(
            columns, cell[some], minima.place[some], reach, sign
        )
    return minima


def descended_minima(
    columns: Floats, cell: Integers, start: Floats, reach: Floats, sign: Literal[-1, 1]
) -> tuple[Floats, Floats, Floats]:
    """Minima (m, 2) at most a reach (2,) from their starts, with level and curvature, by Newton's method.

    A step that leads upwards is not taken, and the next one from there is shorter.
    """
    place, radius = start.copy(), np.full(len(start), 0.5)
    level, gradient, curvature = _slopes(columns, cell, place, sign)
    left = np.arange(len(start))
    for _ in range(MOST_STEPS):
        limits = ((start[left] + side * reach - place[left]) / reach for side in (-1, 1))
        bend = curvature[left] * np.multiply.outer(reach, reach)
        step = _newton_step(gradient[left] * reach, bend, radius[left], *limits)
        length, moved = np.abs(step).max(axis=1), place[left] + step * reach
        going = length > CONVERGED
        place[left[~going]] = moved[~going]
        left, length, moved = left[going], length[going], moved[going]
        if not left.size:
            break
        reached = _slopes(columns, cell[left], moved, sign)
        lower = reached[0] <= level[left] + ROUNDING * np.abs(level[left])
        radius[left] = np.where(lower, radius[left], length / 4)
        for values, new in zip((place, level, gradient, curvature), (moved, *reached), strict=True):
            values[left[lower]] = new[lower]
    return place, level, curvature


def _is_minimum(level: Floats) -> Mask:
    """Mask of the samples (n, g, h) above none of their eight neighbours; those on the border are none."""
    is_minimum = np.zeros(level.shape, dtype=np.bool_)
    inner = np.s_[:, 1:-1, 1:-1]
    is_minimum[inner] = (level <= minimum_filter(level, size=(1, 3, 3)))[inner]
    return is_minimum


def _newton_step(gradient: Floats, curvature: Floats, radius: Floats, low: Floats, high: Floats) -> Floats:
    """Steps (n, 2) towards a minimum between limits; where the spectrum is not convex, downhill."""
    # At a limit, only along it.
    held = ((gradient > 0) & (low >= 0)) | ((gradient < 0) & (high <= 0))
    gradient = np.where(held, 0, gradient)
    curvature = np.where(held[:, None] | held[:, :, None], np.eye(2), curvature)
    values, axes = np.linalg.eigh(curvature)
    along = np.einsum("nij,ni->nj", axes, gradient)
    size = np.abs(values)
    step = -np.divide(along, size, out=np.zeros_like(along), where=size > 0)
    step = np.clip(step, -radius[:, None], radius[:, None])
    return np.clip(np.einsum("nij,nj->ni", axes, step), low, high)


def _slopes(
    columns: Floats, cell: Integers, place: Floats, sign: Literal[-1, 1]
) -> tuple[Floats, Floats, Floats]:
    """Levels (m,) at places (m, 2) of cells (m,) in order, first (m, 2) and second derivatives (m, 2, 2)."""
    n, n_u, n_w, k = columns.shape
    a, b = (real_steering_slopes(*line) for line in ((n_u, place[:, 0]), (n_w, place[:, 1])))
    rows, matrices = a.reshape(len(cell) * 3, n_u), columns.reshape(n, n_u, n_w * k)
    along = np.empty((len(rows), n_w * k))
    # Cell by cell: its matrix, large in Capon's method, is not copied for each of its places.
    for first, end in pairwise([*np.flatnonzero(np.diff(cell, prepend=-1)).tolist(), len(cell)]):
        np.matmul(rows[3 * first : 3 * end], matrices[cell[first]], out=along[3 * first : 3 * end])
    # Derivatives of the projections, their orders along u and w in front.
    projections = b[:, None] @ along.reshape(len(cell), 3, n_w, k)
    (level, along_w, ww), (along_u, uw, _), (uu, _, _) = projections.transpose(1, 2, 0, 3)
    gradient = np.stack([np.vecdot(level, along_u), np.vecdot(level, along_w)], axis=-1)
    uu = np.vecdot(along_u, along_u) + np.vecdot(level, uu)
    uw = np.vecdot(along_u, along_w) + np.vecdot(level, uw)
    ww = np.vecdot(along_w, along_w) + np.vecdot(level, ww)
    curvature = np.stack([uu, uw, uw, ww], axis=-1).reshape(len(cell), 2, 2)
    return sign * np.vecdot(level, level), 2 * sign * gradient, 2 * sign * curvature


@dataclass(frozen=True, eq=False)
class AngularSpectrum:
    """Angular power spectra of n cells over the directions of a region.

    Attributes
    ----------
    u, w : ndarray of float64, shapes (g,) and (h,)
        Direction cosines of the samples, from `isacbench.dsp.angles.peaks.cosine_samples`.
    power : ndarray of float64, shape (n, g, h)
        Per element.
    """

    u: Floats
    w: Floats
    power: Floats

    def waves(self, dynamic_range_db: float, n_most: int) -> PlaneWaves:
        """Find the strongest local maxima: plane waves between the samples.

        Parameters
        ----------
        dynamic_range_db : float
            Range below the strongest maximum of a cell.
        n_most : int
            Most maxima of a cell.

        Returns
        -------
        PlaneWaves
            Placed by parabolas through levels in dB.
        """
        framed, grid = with_neighbours(self.power, (self.u, self.w))
        is_peak = _is_minimum(-framed)
        highest = framed.max(axis=(1, 2), keepdims=True, where=is_peak, initial=0)
        is_peak &= framed >= highest * 10 ** (-dynamic_range_db / 10)
        is_peak &= ~self._is_flat[:, None, None]
        row, column, found = plane_peaks(framed, np.nonzero(is_peak), n_most)
        u, w = (line[0] + (line[1] - line[0]) * at for line, at in zip(grid, (row, column), strict=True))
        return PlaneWaves(u, w, found)

    @property
    def _is_flat(self) -> Mask:
        """Mask (n,) of the spectra whose peaks are rounding."""
        return self.power.max(axis=(1, 2)) <= (1 + FLAT) * self.power.min(axis=(1, 2))


@dataclass(frozen=True, eq=False)
class BeamformerSpectrum(AngularSpectrum):
    """Angular power spectra that are squared projections, or the reciprocals of such.

    Attributes
    ----------
    u, w, power
        See `AngularSpectrum`.
    columns : ndarray of float64, shape (n, L, M, k)
        As for `squared_projections`.
    reciprocal : bool
        Whether the power is a reciprocal.
    """

    columns: Floats
    reciprocal: bool

    def waves(self, dynamic_range_db: float, n_most: int) -> PlaneWaves:
        """Find the strongest local maxima: plane waves between the samples.

        Parameters
        ----------
        dynamic_range_db : float
            Range below the strongest maximum of a cell.
        n_most : int
            Most maxima of a cell.

        Returns
        -------
        PlaneWaves
            Placed by Newton's method.
        """
        sign: Literal[-1, 1] = 1 if self.reciprocal else -1
        samples = 1 / self.power if self.reciprocal else -self.power
        # A peak may be much narrower than the samples: its height counts, and not that of the sample.
        most = np.full(len(samples), n_most)
        minima = planar_minima(samples, self.columns, (self.u, self.w), CANDIDATES * most, np.inf, sign)
        chosen = strongest(-minima.level, minima.cell, most)
        cell, place, level = minima.cell[chosen], minima.place[chosen], minima.level[chosen]
        lowest = level[np.searchsorted(cell, cell)]
        found = (level <= lowest * 10 ** (sign * dynamic_range_db / 10)) & ~self._is_flat[cell]
        return PlaneWaves(*in_rows(len(samples), cell[found], *place[found].T))
