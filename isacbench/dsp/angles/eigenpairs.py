"""How far rounding leaves a signal subspace determined: eigenpairs that know what they are worth.

A perturbation of size E turns the space of the k largest eigenvectors by an
angle whose sine is at most E over the gap between the k-th eigenvalue and the
next (Davis and Kahan); of the singular vectors of a data matrix the same
holds with singular values (Wedin). Data are never better than rounding, so
that where the gap is a few units of rounding any direction is as good as any
other: in a white covariance, within a group of equal eigenvalues, behind the
last source of a noise-free snapshot.

A covariance squares its data, and with them their dynamic range: a source more
than 70 dB below another has half the digits, one more than 150 dB below has
none. The singular values of the data know it down to twice that.

References
----------
Davis and Kahan, "The rotation of eigenvectors by a perturbation III", SIAM J.
Numer. Anal. 7 (1970).
Wedin, "Perturbation bounds in connection with singular value decomposition",
BIT 12 (1972).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST_ROTATION = 1e-3
"""Sine of the angle by which rounding may turn a signal subspace: three digits of a direction, in units of
the subarray's beam."""


ROUNDING_UNITS = 4
"""Last digits of the largest value, per dimension, that data, their covariance and its decomposition lose."""

SPARE_DIMENSIONS = 4
"""Beyond those asked for: the more, the faster a subspace iteration converges."""

ITERATIONS = 4
"""Of a subspace. A source at the edge of the noise is then right to 1e-3 of its eigenvector, far below what
the noise does to it; a strong one to rounding."""


class Eigenpairs(NamedTuple):
    """Largest eigenvalues of n covariances, their eigenvectors, and what rounding makes of them.

    Attributes
    ----------
    values : ndarray of float64, shape (n, m)
        Descending.
    vectors : ndarray of float64, shape (n, L, m)
        Orthonormal columns.
    rotation : ndarray of float64, shape (n, m - 1)
        Largest sine of the angle by which rounding may have turned the space
        of the first k + 1 eigenvectors; 1 where they are any.
    rounding : ndarray of float64, shape (n,)
        Eigenvalues below are rounding.
    """

    values: Floats
    vectors: Floats
    rotation: Floats
    rounding: Floats

    def put(self, cells: Integers, other: Eigenpairs) -> None:
        """Overwrite some of the cells, in place."""
        for mine, theirs in zip(self, other, strict=True):
            mine[cells] = theirs

    @property
    def coarse(self) -> Integers:
        """Cells with a gap that their covariance cannot tell from rounding."""
        return np.flatnonzero((self.rotation > MOST_ROTATION).any(axis=1))


def pairs_of_covariance(values: Floats, vectors: Floats) -> Eigenpairs:
    """Eigenpairs as a decomposition of the covariances gives them.

    Parameters
    ----------
    values : ndarray of float64, shape (n, m)
        Descending.
    vectors : ndarray of float64, shape (n, L, m)

    Returns
    -------
    Eigenpairs

    Examples
    --------
    >>> pairs = pairs_of_covariance(np.array([[4.0, 1.0, 1.0]]), np.eye(3)[None])
    >>> (pairs.rotation < 1e-12).tolist()
    [[True, False]]
    """
    rounding = (
        ROUNDING_UNITS * vectors.shape[1] * float(np.finfo(values.dtype).eps) * np.maximum(values[:, 0], 0)
    )
    return Eigenpairs(
        values, vectors, _rotation(values[:, :-1] - values[:, 1:], rounding), np.asarray(rounding, np.float64)
    )


def pairs_of_data(data: Floats, n_pairs: int) -> Eigenpairs:
    """Eigenpairs of the covariance Xᵀ X of data X, which is never formed.

    Parameters
    ----------
    data : ndarray of float64, shape (n, rows, L)
    n_pairs : int
        Pairs to return, 1 to L.

    Returns
    -------
    Eigenpairs
        Of data much larger than what is asked for, by subspace iteration.

    Examples
    --------
    Two directions 180 dB apart, which a covariance holds for one:

    >>> pairs = pairs_of_data(np.diag([1.0, 1e-9, 0.0])[None], 3)
    >>> (pairs.rotation < 1e-3).tolist()
    [[True, True]]
    >>> pairs.values[0].round(20).tolist()
    [1.0, 1e-18, 0.0]
    """
    missing = max(n_pairs - data.shape[1], 0)
    rows = np.pad(data, ((0, 0), (0, missing), (0, 0))) if missing else data
    singular, right = _leading_rows(rows, n_pairs)
    # Of rows and columns, whichever are more: both take part in the sums.
    rounding = ROUNDING_UNITS * max(data.shape[1:]) * float(np.finfo(data.dtype).eps) * singular[:, 0]
    return Eigenpairs(
        singular**2,
        right.transpose(0, 2, 1),
        _rotation(singular[:, :-1] - singular[:, 1:], rounding),
        np.asarray(rounding**2, np.float64),
    )


def _leading_rows(data: Floats, n_pairs: int) -> tuple[Floats, Floats]:
    """Largest singular values (n, n_pairs) and their right singular vectors, as rows (n, n_pairs, L)."""
    n_basis = n_pairs + SPARE_DIMENSIONS
    if 2 * n_basis >= min(data.shape[1:]):
        _, singular, right = np.linalg.svd(data, full_matrices=False)
        return singular[:, :n_pairs], right[:, :n_pairs]
    basis = np.broadcast_to(
        start_basis(data.shape[2], n_basis).astype(data.dtype, copy=False),
        (len(data), data.shape[2], n_basis),
    )
    # Orthogonal after either factor: with both in one, weak directions would be lost to rounding.
    for _ in range(ITERATIONS):
        outputs = np.linalg.qr(data @ basis)[0]
        basis, small = np.linalg.qr(data.transpose(0, 2, 1) @ outputs)
    left, singular, _ = np.linalg.svd(small)
    return singular[:, :n_pairs], (basis @ left[:, :, :n_pairs]).transpose(0, 2, 1)


@lru_cache
def start_basis(n_sensors: int, n_basis: int) -> Floats:
    """Directions that no source is orthogonal to, the same in every run."""
    return np.random.default_rng(0).standard_normal((n_sensors, n_basis))


def _rotation(gap: Floats, rounding: Floats) -> Floats:
    """Bounds on sines, 1 where there is no gap."""
    sine = np.divide(rounding[:, None], gap, out=np.ones_like(gap), where=gap > 0)
    return np.minimum(sine, 1).astype(np.float64, copy=False)


def separated_order(rotation: Floats, order: Integers) -> Integers:
    """Largest order, not above the one asked for, at which a signal subspace is determined.

    Parameters
    ----------
    rotation : ndarray of float64, shape (n, m)
        As `Eigenpairs` have it.
    order : ndarray of int64, shape (n,)
        Orders asked for, 0 to m.

    Returns
    -------
    ndarray of int64, shape (n,)
        0 where rounding has the choice at any of them.

    Examples
    --------
    A group of three equal eigenvalues behind a large one, and none but equal:

    >>> separated_order(np.array([[1e-15, 1.0, 1.0], [1.0, 1.0, 1.0]]), np.array([3, 2])).tolist()
    [1, 0]
    """
    orders = np.arange(1, rotation.shape[1] + 1)
    determined = (rotation <= MOST_ROTATION) & (orders <= order[:, None])
    separated: Integers = np.where(determined, orders, 0).max(axis=1, initial=0)
    return separated
