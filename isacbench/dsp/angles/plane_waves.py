"""Plane waves of cells: pairs of direction cosines, and their amplitudes on all elements that are read.

Row and column spectra give separate candidates for u and for w; k sources then
have up to k² intersections. The joint response of the snapshot tells sources
from ghosts. All Gram matrices follow from a small one along u and a small one
along w (`isacbench.dsp.angles.aperture`), so that the elements are touched once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from isacbench.checked_arrays import checked_array
from isacbench.display import brief
from isacbench.dsp.angles.aperture import Aperture, Responses
from isacbench.dsp.angles.cosines import within_period
from isacbench.dsp.angles.peaks import Peaks
from isacbench.dsp.array_types import Complex, Floats, Mask

DIAGONAL_LOADING = 1e-9
"""Keeps Gram matrices of nearly equal directions invertible; far below any misfit."""

TIE, TIE_UNITS = 1e-8, 80
"""Difference of two residuals, relative to the strongest wave, that counts as rounding: the larger of the
remainder of the loading and of so many last digits of the snapshots. On a cross, a further cosine of the
column explains as much with either of two cosines of the row whose own echoes are explained already."""


@dataclass(frozen=True, eq=False)
class PlaneWaves:
    """Plane waves found in each of n cells; rows are filled up to the same length k.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n, k)
        Direction cosines, from -1 to 1 whatever period they are given in.
    found : ndarray of bool, shape (n, k)
        Mask of the plane waves.
    resolved : ndarray of bool, shape (n,), or None
        Mask of the cells that their plane waves explain down to the noise, so
        that even close ones are apart; None before that is tested.
    """

    u: Floats
    w: Floats
    found: Mask
    resolved: Mask | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", within_period(self.u))
        object.__setattr__(self, "w", within_period(self.w))

    def select(self, keep: Mask) -> PlaneWaves:
        """Select cells.

        Parameters
        ----------
        keep : ndarray of bool or int64
            Mask or indices of the cells.

        Returns
        -------
        PlaneWaves
        """
        resolved = None if self.resolved is None else self.resolved[keep]
        return PlaneWaves(self.u[keep], self.w[keep], self.found[keep], resolved)

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
            residual = residual - responses.synthesis(self._fit(residual[None], responses)[0])
        axes = tuple(range(1, residual.ndim))
        power: Floats = np.mean(residual.real**2 + residual.imag**2, axis=axes)
        return power

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
        return self._fit(snapshots, aperture.towards(self.u, self.w))

    def _fit(self, snapshots: Complex, responses: Responses) -> Complex:
        inverse = np.linalg.inv(_restricted(responses.gram(), self.found))
        matched = np.where(self.found, responses.matched(snapshots), 0)
        amplitude: Complex = np.einsum("nij,snj->sni", inverse, matched)
        return amplitude


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

    Returns
    -------
    PlaneWaves

    References
    ----------
    Pati, Rezaiifar and Krishnaprasad, "Orthogonal matching pursuit", Asilomar
    (1993).
    """
    snapshots = checked_array("snapshots", snapshots, np.complex64)
    n, n_w = len(snapshots), w.place.shape[1]
    n_pairs = u.place.shape[1] * n_w
    responses = aperture.towards(u.place, w.place)
    # From here on in double precision: these arrays are small.
    matched = responses.matched_intersections(snapshots).reshape(n, n_pairs).astype(np.complex128, copy=False)
    gram = responses.intersections_gram().reshape(n, n_pairs, n_pairs)
    eligible = (u.found[:, :, None] & w.found[:, None, :]).reshape(n, n_pairs)
    cell = np.arange(n)[:, None]
    chosen = np.zeros((n, min(n_most, n_pairs)), dtype=np.int64)
    found = np.zeros(chosen.shape, dtype=np.bool_)
    residual = matched
    tie = max(TIE, TIE_UNITS * float(np.finfo(snapshots.dtype).eps))
    for k in range(chosen.shape[1]):
        power = np.where(eligible, residual.real**2 + residual.imag**2, 0)
        best_power = power.max(axis=1)
        if k == 0:
            strongest = best_power
        # The first of equals pairs the stronger peaks.
        least = best_power - tie * np.sqrt(best_power * strongest)
        best = np.argmax(eligible & (power >= least[:, None]), axis=1)
        growing = (best_power > min_power) & (best_power > strongest * 10 ** (-dynamic_range_db / 10))
        growing &= found[:, k - 1] if k else True
        if not growing.any():
            break
        chosen[:, k], found[:, k] = best, growing
        eligible[cell[:, 0], best] = False
        members, active = chosen[:, : k + 1], found[:, : k + 1]
        rows = gram[cell, members]
        square = _restricted(np.take_along_axis(rows, members[:, None, :], axis=2), active)
        target = np.where(active, matched[cell, members], 0)
        amplitude = np.linalg.solve(square, target[:, :, None])
        residual = matched - (rows.conj().transpose(0, 2, 1) @ amplitude)[:, :, 0]
    return PlaneWaves(u.place[cell, chosen // n_w], w.place[cell, chosen % n_w], found)


def _restricted(gram: Complex, active: Mask) -> Complex:
    """Gram matrices (n, k, k) with inactive members replaced by unit vectors of their own, loaded."""
    both = active[:, :, None] & active[:, None, :]
    restricted: Complex = np.where(both, gram, 0)
    restricted += (DIAGONAL_LOADING + ~active)[:, None, :] * np.eye(active.shape[1])
    return restricted
