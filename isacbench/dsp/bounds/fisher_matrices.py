"""Inner products of echoes and of their slopes, and inverses of the Fisher matrices that they give.

An echo is a wave exp(jψ), ψ linear in the parameters. All inner products of
echoes and of their slopes are sums x^a exp(jxΔ) along one axis (a = 0, 1, 2),
multiplied over the axes: neither the grid nor the array is ever filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.choices import Sensing
from isacbench.display import short_repr
from isacbench.errors import require
from isacbench.model.numerology import System, resource_elements

N_PARAMETERS = 4

NEGLIGIBLE = 1e-3
"""Share of a variance that may be lost to rounding before the variance counts as infinite."""


class EchoSlopes:
    """Samples of an echo: phase slopes per bin along four axes, from their centroids.

    With the centroid as the origin, amplitudes are those at the middle of the
    aperture. That leaves the bound as it is and keeps sums free of
    cancellation. Resource elements are a union of products of subcarriers and
    symbols: one for the full grid, one for each comb offset of the PRS.

    Attributes
    ----------
    units : ndarray, shape (4,)
        Range bin, velocity bin, 1 and 1.
    blocks : list of (ndarray, ndarray)
        Slopes along subcarriers and symbols of each product.
    along_u, along_w : ndarray
        Slopes of the elements.
    reference : ndarray, shape (4,)
        Slopes of the centroid itself, seen from element (0, 0) on subcarrier 0 and symbol 0.
    """

    def __init__(self, system: System, array_shape: tuple[int, int], sensing: Sensing) -> None:
        mask = resource_elements(system, sensing)
        n_c, n_s = mask.shape
        n_p, n_q = array_shape
        require(min(array_shape) >= 2, "array_shape", array_shape, "2 elements and more along u and w")
        along_range, along_doppler = -2 * np.pi / n_c * np.arange(n_c), 2 * np.pi / n_s * np.arange(n_s)
        along_u, along_w = -np.pi * np.arange(n_p), -np.pi * np.arange(n_q)
        share = mask / max(mask.sum(), 1)
        centroid = (
            np.sum(share.T @ along_range),
            np.sum(share @ along_doppler),
            along_u.mean(),
            along_w.mean(),
        )
        self.reference = np.array(centroid)
        self.units = np.array([system.range_bin_m, system.velocity_bin_mps, 1.0, 1.0])
        along_range, along_doppler = along_range - centroid[0], along_doppler - centroid[1]
        self.along_u, self.along_w = along_u - centroid[2], along_w - centroid[3]
        combs, comb_of_symbol = np.unique(mask, axis=1, return_inverse=True)
        self.blocks = [
            (along_range[comb], along_doppler[comb_of_symbol == i])
            for i, comb in enumerate(combs.T)
            if comb.any()
        ]
        determined = self.blocks and np.linalg.matrix_rank(self.moments(), hermitian=True) > N_PARAMETERS
        allowed = f"subcarriers and symbols whose sensed elements ({sensing!r}) determine range and velocity"
        require(bool(determined), "system", system, allowed)

    def in_units(
        self, shape: tuple[int, ...], range_m: ArrayLike, velocity_mps: ArrayLike, u: ArrayLike, w: ArrayLike
    ) -> Floats:
        """Convert places (K,) to range bins, velocity bins, u and w, shape (4, K).

        Refused if there are not as many as amplitudes, whose shape is to be (K,), or they are not finite.
        """
        places = {"range_m": range_m, "velocity_mps": velocity_mps, "u": u, "w": w}
        for name, values in places.items():
            same = len(shape) == 1 and shape[0] > 0 and np.shape(values) == shape
            require(same and bool(np.all(np.isfinite(values))), name, values, "as many as amplitudes, finite")
        return np.array(list(places.values()), dtype=np.float64) / self.units[:, None]

    def moments(self) -> Floats:
        """Sum the products of 1 and the four slopes over all elements.

        Returns
        -------
        ndarray of float64, shape (5, 5)
        """
        gram = self.gram(np.zeros((N_PARAMETERS, 1)))
        return np.asarray(gram[:, :, 0, 0].real, dtype=np.float64)

    def gram(self, places: Floats) -> Complex:
        """Products (5, 5, K, K) of echoes of amplitude 1, and these times each slope, with each other.

        Places (4, K) are in range bins, velocity bins, u and w.
        """
        # Only differences of places count; small ones keep their digits.
        range_bin, doppler_bin, u, w = places - places.mean(axis=1, keepdims=True)
        delay_doppler: dict[tuple[int, int], Complex] = {}
        for along_range, along_doppler in self.blocks:
            delay, doppler = _axis_sums(range_bin, along_range), _axis_sums(doppler_bin, along_doppler)
            for i, j in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
                delay_doppler[i, j] = delay_doppler.get((i, j), 0) + delay[i] * doppler[j]
        over_u, over_w = _axis_sums(u, self.along_u), _axis_sums(w, self.along_w)
        # A row's and a column's powers of the four slopes add up.
        powers = np.eye(N_PARAMETERS + 1, N_PARAMETERS, k=-1, dtype=np.int64)
        gram = np.empty((N_PARAMETERS + 1, N_PARAMETERS + 1, *over_u.shape[1:]), dtype=np.complex128)
        for i, j in np.ndindex(gram.shape[:2]):
            in_range, in_doppler, in_u, in_w = (int(power) for power in powers[i] + powers[j])
            gram[i, j] = delay_doppler[in_range, in_doppler] * over_u[in_u] * over_w[in_w]
        return gram


@lru_cache(maxsize=8)
def echo_slopes(system: System, array_shape: tuple[int, int], sensing: Sensing) -> EchoSlopes:
    """Prepare the slopes of all sensed elements; those of the last few calls are kept.

    An `InputError` if the elements do not determine all four parameters of a scatterer alone.
    """
    return EchoSlopes(system, array_shape, sensing)


def _axis_sums(places: Floats, slopes: Floats) -> Complex:
    """Sums (3, K, K) of x^a exp(jx (place_l - place_k)) over the slopes x, a = 0, 1, 2."""
    waves = np.exp(1j * np.multiply.outer(places, slopes))
    return np.stack([(waves.conj() * slopes**power) @ waves.T for power in range(3)])


@dataclass(frozen=True, eq=False)
class Bound:
    """Smallest covariance that an unbiased estimator can have.

    Attributes
    ----------
    covariance : ndarray of float64, shape (..., 4, 4)
        Of (R, v, u, w) of each scatterer, in m, m/s and 1. A scatterer that
        cannot be resolved from others has infinite variances, and NaN elsewhere.
    """

    covariance: Floats

    __repr__ = short_repr

    @property
    def range_m(self) -> Floats:
        """Standard deviations (...) of the range."""
        return self._std(0)

    @property
    def velocity_mps(self) -> Floats:
        """Standard deviations (...) of the radial velocity."""
        return self._std(1)

    @property
    def u(self) -> Floats:
        """Standard deviations (...) of the direction cosine u."""
        return self._std(2)

    @property
    def w(self) -> Floats:
        """Standard deviations (...) of the direction cosine w."""
        return self._std(3)

    def _std(self, parameter: int) -> Floats:
        return np.sqrt(self.covariance[..., parameter, parameter])


@dataclass(frozen=True, eq=False)
class JointBound(Bound):
    """Bound of scatterers that are estimated together.

    Attributes
    ----------
    covariance : ndarray of float64, shape (K, 4, 4)
    joint_covariance : ndarray of float64, shape (K, 4, K, 4)
        With the covariances between scatterers, from which follow those of
        distances.
    """

    joint_covariance: Floats

    __repr__ = short_repr

    @classmethod
    def of_columns(cls, covariance: Floats, per_column: Floats) -> JointBound:
        """Scale a covariance of unit columns to the parameters' units.

        Parameters
        ----------
        covariance : ndarray of float64, shape (4, K, 4, K)
        per_column : ndarray of float64, shape (4, K)
            Parameter per unit column.
        """
        scaled = covariance * (per_column[:, :, None, None] * per_column)
        joint = scaled.transpose(1, 0, 3, 2)
        k = np.arange(per_column.shape[1])
        return cls(covariance=joint[k, :, k, :], joint_covariance=joint)


@dataclass(frozen=True, eq=False)
class KnownPart:
    """Positive semidefinite matrix over the unknowns of K scatterers, without what rounding may have made.

    Attributes
    ----------
    eigenvalue : ndarray of float64, shape (r,)
        Those that stand out of rounding.
    vector : ndarray of float64 or complex128, shape (n_unknowns, K, r)
        Their eigenvectors.
    merged : ndarray of bool, shape (K,)
        True for a scatterer that cannot be resolved from others.
    """

    eigenvalue: Floats
    vector: Floats | Complex
    merged: Mask

    __repr__ = short_repr

    @classmethod
    def of(cls, matrix: NDArray[np.inexact]) -> KnownPart:
        """Find the eigenvalues that are not zero to rounding.

        Parameters
        ----------
        matrix : ndarray, shape (n_unknowns, K, n_unknowns, K)
            Its entries are at most 1 in magnitude, and have the rounding errors of 1.
        """
        n_unknowns, n = matrix.shape[:2]
        size = n_unknowns * n
        eigenvalue, vector = np.linalg.eigh(matrix.reshape(size, size))
        # What rounding leaves of an eigenvalue 0.
        floor = size * np.finfo(np.float64).eps * max(eigenvalue[-1], 1.0)
        null = eigenvalue < floor
        vector = vector.reshape(n_unknowns, n, size)
        # A scatterer with a share in a null vector, even by its amplitude alone, cannot be resolved.
        shares = np.abs(vector) ** 2
        lost = shares[:, :, null].sum(axis=2) / floor
        rest = (shares[:, :, ~null] / eigenvalue[~null]).sum(axis=2)
        return cls(eigenvalue[~null], vector[:, :, ~null], np.any(lost > NEGLIGIBLE * rest, axis=0))


def inverse_where_known(known: KnownPart, n_nuisance: int = 0) -> Floats:
    """Invert a Fisher matrix; scatterers that cannot be resolved have infinite variances, NaN beside them.

    The first `n_nuisance` unknowns are not asked for: the result is the block (m, K, m, K) of the m others.
    """
    wanted = known.vector[n_nuisance:].real
    n_wanted, n = wanted.shape[:2]
    rows = wanted.reshape(n_wanted * n, -1)
    covariance: Floats = ((rows / known.eigenvalue) @ rows.T).reshape(n_wanted, n, n_wanted, n)
    covariance[:, known.merged] = np.nan
    covariance[:, :, :, known.merged] = np.nan
    for unknown in range(n_wanted):
        covariance[unknown, known.merged, unknown, known.merged] = np.inf
    return covariance
