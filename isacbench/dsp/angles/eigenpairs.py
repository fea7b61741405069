"""Eigenpairs of covariances, with bounds on how far rounding rotates their signal subspaces.

A perturbation of size E rotates the space of the k largest eigenvectors by an
angle whose sine is at most E over the gap between the k-th eigenvalue and the
next (Davis and Kahan). Rounding perturbs every covariance. Where the gap is
only a few rounding errors wide, the subspace is arbitrary: in a white
covariance, within a group of equal eigenvalues, and beyond the last source of a
noise-free snapshot.

References
----------
Davis and Kahan, "The rotation of eigenvectors by a perturbation III", SIAM J.
Numer. Anal. 7 (1970).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from isacbench.checked_arrays import Floats, Integers

MOST_ROTATION = 1e-3
"""Largest sine of the angle by which rounding may rotate a signal subspace: three digits of a direction, in
units of the subarray's beam."""

ROUNDING_UNITS = 4
"""Rounding error of a decomposed covariance, per dimension: in last digits of the largest eigenvalue."""


class Eigenpairs(NamedTuple):
    """Largest eigenvalues of n covariances, their eigenvectors, and the effect of rounding on them.

    Attributes
    ----------
    values : ndarray of float64, shape (n, m)
        Descending.
    vectors : ndarray of float64, shape (n, L, m)
        Orthonormal columns.
    rotation : ndarray of float64, shape (n, m - 1)
        For each index k, the largest sine of the angle by which rounding may
        have rotated the space of the first k + 1 eigenvectors; 1 where that
        space is arbitrary.
    rounding : ndarray of float64, shape (n,)
        Level below which eigenvalues are rounding errors.
    """

    values: Floats
    vectors: Floats
    rotation: Floats
    rounding: Floats


def with_rounding(values: Floats, vectors: Floats) -> Eigenpairs:
    """Add the effect of rounding to a decomposition of covariances.

    Parameters
    ----------
    values : ndarray of float64, shape (n, m)
        Descending.
    vectors : ndarray of float64, shape (n, L, m)
    """
    last_digit = float(np.finfo(values.dtype).eps)
    rounding = ROUNDING_UNITS * vectors.shape[1] * last_digit * np.maximum(values[:, 0], 0)
    gap = values[:, :-1] - values[:, 1:]
    # Where a gap is less than rounding the angle is anything, and the ratio may overflow.
    rotation = np.divide(rounding[:, None], gap, out=np.ones_like(gap), where=gap > rounding[:, None])
    return Eigenpairs(values, vectors, rotation, rounding)


def separated_order(rotation: Floats, order: Integers) -> Integers:
    """Limit the dimensions of signal subspaces to those that are determined despite rounding.

    Parameters
    ----------
    rotation : ndarray of float64, shape (n, m)
        `Eigenpairs.rotation`.
    order : ndarray of int64, shape (n,)
        Orders asked for, 0 to m.

    Returns
    -------
    ndarray of int64, shape (n,)
        Largest determined order up to the one asked for; 0 where none is determined.
    """
    orders = np.arange(1, rotation.shape[1] + 1)
    determined = (rotation <= MOST_ROTATION) & (orders <= order[:, None])
    return np.where(determined, orders, 0).max(axis=1, initial=0)
