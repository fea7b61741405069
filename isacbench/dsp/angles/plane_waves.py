"""Plane waves of cells: pairs of direction cosines, and their amplitudes on all elements that are read.

Row and column spectra give separate candidates for u and for w; k sources then
have up to k² intersections. The joint response of the snapshot tells sources
from ghosts. All Gram matrices follow from a small one along u and a small one
along w (`isacbench.dsp.angles.aperture`), so that the elements are touched once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask, checked_array
from isacbench.display import short_repr
from isacbench.dsp.angles.aperture import Aperture
from isacbench.dsp.angles.peaks import Peaks
from isacbench.model.kernels import within_period

DIAGONAL_LOADING = 1e-9
"""Keeps Gram matrices of nearly equal directions invertible; far below any misfit."""

TIE, TIE_UNITS = 1e-8, 80
"""Difference of two residuals, relative to the strongest wave, that counts as rounding: the larger of the
remainder of the loading and of so many last digits of the snapshots. On a cross, a further cosine of the
column explains as much with either of two cosines of the row whose own echoes are explained already."""

NOISE_DEVIATIONS = 3
"""Standard deviations that noise may displace a direction by."""


@dataclass(frozen=True, eq=False)
class PlaneWaves:
    """Plane waves found in each of n cells; rows are filled up to the same length k.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n, k)
        Direction cosines, from -1 to 1 whatever period they are given in.
    found : ndarray of bool, shape (n, k)
        Mask of the plane waves.
    """

    u: Floats
    w: Floats
    found: Mask

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", within_period(self.u))
        object.__setattr__(self, "w", within_period(self.w))

    def select(self, keep: Mask | Integers) -> PlaneWaves:
        """Select cells.

        Parameters
        ----------
        keep : ndarray of bool or int64
            Mask or indices of the cells.
        """
        return PlaneWaves(self.u[keep], self.w[keep], self.found[keep])

    def among(self, others: PlaneWaves, own: Mask) -> PlaneWaves:
        """Take these waves for the cells of a mask (n,), in order, and other waves for all others."""
        k = max(self.found.shape[1], others.found.shape[1])
        rows = np.zeros((3, own.size, k))
        for cells, waves in ((own, self), (~own, others)):
            rows[:, cells, : waves.found.shape[1]] = waves.u, waves.w, waves.found
        return PlaneWaves(rows[0], rows[1], rows[2] > 0)

    def compact(self, count: int) -> tuple[PlaneWaves, Integers]:
        """Keep the first `count` waves of each cell, at entries (n, count), which are returned as well.

        Small systems are best solved at their own size: those of cells with as many waves.
        """
        entries = np.argsort(~self.found, axis=1, kind="stable")[:, :count]
        u, w = (np.take_along_axis(cosine, entries, axis=1) for cosine in (self.u, self.w))
        found = np.take_along_axis(self.found, entries, axis=1)
        return PlaneWaves(u, w, found), entries

    def unexplained(self, snapshots: Complex, aperture: Aperture) -> Floats:
        """Power that the waves leave of snapshots, amplitudes fitted.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, *elements)
        aperture : Aperture
            The elements.

        Returns
        -------
        ndarray of float64, shape (n,)
            Per element.
        """
        responses = aperture.towards(self.u, self.w)
        residual = snapshots
        # Twice: without noise, the first fit leaves what its loading takes from the amplitudes.
        for _ in range(2):
            residual = residual - responses.synthesis(self.amplitudes(residual[None], aperture)[0])
        axes = tuple(range(1, residual.ndim))
        return np.mean(residual.real**2 + residual.imag**2, axis=axes)

    def direction_errors(self, snapshots: Complex, aperture: Aperture, noise: float) -> Floats:
        """Bound the errors of directions by what the waves of a cell leave unexplained.

        A wave can stand for several scatterers that its cell cannot resolve. The
        misfit is then no noise, and may have the very shape by which the wave's
        response changes with its direction. The bound is the displacement that
        this worst case causes, with the amplitudes and directions of all waves of
        the cell free: the misfit beyond noise, times the inverse of the
        concentrated Fisher information. To its square the noise adds that of
        three standard deviations.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, *elements)
        aperture : Aperture
            The elements.
        noise : float
            Power of white noise per element.

        Returns
        -------
        ndarray of float64, shape (n, k)
            In Rayleigh cells, 2/P in u and 2/Q in w; 0 where there is no plane wave.

        References
        ----------
        Stoica and Nehorai, "MUSIC, maximum likelihood, and Cramér-Rao bound", IEEE
        Trans. ASSP 37 (1989), for the concentrated information.
        """
        k = self.u.shape[1]
        responses, found = aperture.towards(self.u, self.w), self.found
        products, both = responses.slope_gram(), np.tile(found, (1, 2))
        response_slopes = np.where(found[:, :, None] & both[:, None, :], products[:, :k, k:], 0)
        matched = np.where(found, responses.matched(snapshots[None])[0], 0)
        fitted = np.linalg.solve(
            _restricted(products[:, :k, :k], found),
            np.concatenate([matched[:, :, None], response_slopes], axis=2),
        )
        amplitude = fitted[:, :, 0]
        axes = tuple(range(1, snapshots.ndim))
        misfit = np.mean(snapshots.real**2 + snapshots.imag**2, axis=axes)
        misfit -= np.sum(matched.conj() * amplitude, axis=1).real
        free_slopes = products[:, k:, k:] - response_slopes.conj().transpose(0, 2, 1) @ fitted[:, :, 1:]
        amplitudes = np.tile(amplitude, (1, 2))
        information = (amplitudes.conj()[:, :, None] * free_slopes * amplitudes[:, None, :]).real
        # Scaled to a diagonal of ones, so that waves of any power are inverted together.
        scale = np.where(both, np.diagonal(information, axis1=1, axis2=2), 1)
        scale = np.sqrt(np.maximum(scale, np.finfo(np.float64).tiny))
        scaled = _restricted(information / (scale[:, :, None] * scale[:, None, :]), both).real
        spread = np.diagonal(np.linalg.inv(scaled), axis1=1, axis2=2) / scale**2
        spread = spread[:, :k] + spread[:, k:]
        n_free = aperture.n_elements - 2 * found.sum(axis=1)
        beyond_noise = np.maximum(misfit - noise * n_free / aperture.n_elements, 0)
        by_noise = NOISE_DEVIATIONS**2 * noise / (2 * aperture.n_elements)
        unexplained = beyond_noise[:, None] + by_noise
        # Of waves that coincide, rounding may leave a variance below 0: nothing is known about them.
        squares = np.where(spread > 0, spread * unexplained, np.inf)
        return np.sqrt(np.where(found & (unexplained > 0), squares, 0))

    def determined(
        self, snapshots: Complex, aperture: Aperture, noise: float, largest_error: float
    ) -> PlaneWaves:
        """Keep the plane waves whose directions their cell determines.

        As long as the direction of a wave may be wrong by more than
        `largest_error`, the least certain one of its cell leaves. The last wave
        of a cell stays.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (n, *elements)
        aperture : Aperture
            The elements.
        noise : float
            Power of white noise per element.
        largest_error : float
            In Rayleigh cells, compared with `direction_errors`.
        """
        found = self.found.copy()
        n_waves = found.sum(axis=1)
        for count in range(int(n_waves.max(initial=0)), 1, -1):
            cells = np.flatnonzero(n_waves == count)
            waves, entries = replace(self, found=found).select(cells).compact(count)
            errors = waves.direction_errors(snapshots[cells], aperture, noise)
            least_certain = np.take_along_axis(entries, errors.argmax(axis=1)[:, None], axis=1)[:, 0]
            leaves = errors.max(axis=1) > largest_error
            found[cells[leaves], least_certain[leaves]] = False
            n_waves[cells[leaves]] -= 1
        return replace(self, found=found)

    def amplitudes(self, snapshots: Complex, aperture: Aperture) -> Complex:
        """Fit the amplitudes of the cell's plane waves in any snapshots, jointly on all elements.

        Parameters
        ----------
        snapshots : ndarray of complex, shape (s, n, *elements)
            Such as those of each cell and of its neighbours.
        aperture : Aperture
            The elements.

        Returns
        -------
        ndarray of complex128, shape (s, n, k)
            0 where there is no plane wave.
        """
        responses = aperture.towards(self.u, self.w)
        inverse = np.linalg.inv(_restricted(responses.gram(), self.found))
        matched = np.where(self.found, responses.matched(snapshots), 0)
        return np.einsum("nij,snj->sni", inverse, matched)


def pair_directions(
    snapshots: Complex,
    aperture: Aperture,
    u: Peaks,
    w: Peaks,
    min_power: float,
    dynamic_range_db: float,
    n_most: int,
) -> PlaneWaves:
    """Pair direction cosines by the joint response of all elements, without ghosts.

    Orthogonal matching pursuit over all intersections: in each round the pair
    joins that explains most of the residual, and all amplitudes are fitted anew.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, *elements)
    aperture : Aperture
        The elements.
    u, w : Peaks
        Candidates of each cell along either axis.
    min_power : float
        Least power |amplitude|² per element of a plane wave.
    dynamic_range_db : float
        Largest level of a plane wave below the cell's strongest.
    n_most : int
        Most plane waves in a cell.

    References
    ----------
    Pati, Rezaiifar and Krishnaprasad, "Orthogonal matching pursuit", Asilomar
    (1993).
    """
    snapshots = checked_array("snapshots", snapshots, np.complex64)
    n, n_w = len(snapshots), w.place.shape[1]
    n_pairs = u.place.shape[1] * n_w
    responses = aperture.towards(u.place, w.place)
    matched = responses.matched_intersections(snapshots).reshape(n, n_pairs)
    gram = responses.intersections_gram().reshape(n, n_pairs, n_pairs)
    eligible = (u.found[:, :, None] & w.found[:, None, :]).reshape(n, n_pairs)
    chosen = np.zeros((n, min(n_most, n_pairs)), dtype=np.int64)
    found = np.zeros(chosen.shape, dtype=np.bool_)
    residual, cell = matched, np.arange(n)
    first_power = np.max(matched.real**2 + matched.imag**2, axis=1, where=eligible, initial=0)
    tie = max(TIE, TIE_UNITS * float(np.finfo(snapshots.dtype).eps))
    for k in range(chosen.shape[1]):
        power = np.where(eligible[cell], residual.real**2 + residual.imag**2, 0)
        best_power = power.max(axis=1)
        strongest = first_power[cell]
        # The first of equals pairs the stronger peaks.
        least = best_power - tie * np.sqrt(best_power * strongest)
        best = np.argmax(eligible[cell] & (power >= least[:, None]), axis=1)
        grows = (best_power > min_power) & (best_power > strongest * 10 ** (-dynamic_range_db / 10))
        cell, best = cell[grows], best[grows]
        chosen[cell, k], found[cell, k] = best, True
        eligible[cell, best] = False
        members = chosen[cell, : k + 1]
        rows = gram[cell[:, None], members]
        square = np.take_along_axis(rows, members[:, None, :], axis=2) + DIAGONAL_LOADING * np.eye(k + 1)
        amplitude = np.linalg.solve(square, matched[cell[:, None], members, None])
        residual = matched[cell] - (rows.conj().transpose(0, 2, 1) @ amplitude)[:, :, 0]
    each = np.arange(n)[:, None]
    return PlaneWaves(u.place[each, chosen // n_w], w.place[each, chosen % n_w], found)


def _restricted(gram: Complex, active: Mask) -> Complex:
    """Gram matrices (n, k, k) with inactive members replaced by unit vectors of their own, loaded."""
    both = active[:, :, None] & active[:, None, :]
    restricted: Complex = np.where(both, gram, 0)
    restricted += (DIAGONAL_LOADING + ~active)[:, None, :] * np.eye(active.shape[1])
    return restricted
