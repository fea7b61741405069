"""Cramér-Rao bounds, and inverses of Fisher matrices in which scatterers cannot be told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.display import brief

NEGLIGIBLE = 1e-3
"""Share of a variance that may be lost to rounding before the variance counts as infinite."""


@dataclass(frozen=True, eq=False)
class Bound:
    """Smallest covariance that an unbiased estimator can have.

    Attributes
    ----------
    covariance : ndarray of float64, shape (..., 4, 4)
        Of (R, v, u, w) of each scatterer, in m, m/s and 1. A scatterer that
        cannot be told from others has infinite variances, and NaN elsewhere.
    """

    covariance: Floats

    __repr__ = brief

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

    __repr__ = brief

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
        True for a scatterer that cannot be told from others.
    """

    eigenvalue: Floats
    vector: Floats | Complex
    merged: Mask

    __repr__ = brief

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
        # A scatterer with a share in a null vector, even by its amplitude alone, cannot be told from others.
        shares = np.abs(vector) ** 2
        lost = shares[:, :, null].sum(axis=2) / floor
        rest = (shares[:, :, ~null] / eigenvalue[~null]).sum(axis=2)
        return cls(eigenvalue[~null], vector[:, :, ~null], np.any(lost > NEGLIGIBLE * rest, axis=0))


def inverse_where_known(known: KnownPart, n_nuisance: int = 0) -> Floats:
    """Invert a Fisher matrix, with infinite variances for scatterers that cannot be told apart.

    Parameters
    ----------
    known : KnownPart
        Of the Fisher matrix.
    n_nuisance : int
        Unknowns, the first ones, that are not asked for.

    Returns
    -------
    ndarray of float64, shape (n_unknowns - n_nuisance, K, n_unknowns - n_nuisance, K)
        Block of the inverse. Merged scatterers have infinite variances and NaN elsewhere.
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
