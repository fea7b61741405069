"""Subspace methods on a line of sensors, batched over many cells and in real arithmetic.

Forward-backward averaging makes a covariance centro-Hermitian; the unitary
transform then turns it into a real symmetric matrix, and a steering vector
referred to the middle of the subarray into a real vector. Everything after
the data is real.

References
----------
Pillai and Kwon, "Forward/backward spatial smoothing techniques for coherent
signal identification", IEEE Trans. ASSP 37 (1989).
Huarng and Yeh, "A unitary transformation method for angle-of-arrival
estimation", IEEE Trans. SP 39 (1991).
Schmidt, "Multiple emitter location and signal parameter estimation", IEEE
Trans. AP 34 (1986).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.dsp.cfar import ca_cfar
from isacbench.errors import require

__all__ = [
    "eigenvalue_cfar_order",
    "music_null_spectrum",
    "noise_edge",
    "noise_order",
    "real_steering",
    "smoothed_covariance",
]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def smoothed_covariance(snapshots: NDArray[np.complex128], n_subarray: int) -> Floats:
    """Forward-backward spatially smoothed covariance after the unitary transform.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, n_sensors, n_snapshots)
        One set of snapshots a cell.
    n_subarray : int
        Sensors of a subarray, 2 to n_sensors.

    Returns
    -------
    ndarray of float64, shape (n, n_subarray, n_subarray)
        Real, symmetric, non-negative definite. Mean eigenvalue in noise of
        power σ² is σ².
    """
    n_shifts = snapshots.shape[1] - n_subarray + 1
    whole = snapshots @ snapshots.conj().transpose(0, 2, 1)
    # The covariance of a subarray is a diagonal block of the whole array's.
    blocks = (whole[:, k : k + n_subarray, k : k + n_subarray] for k in range(n_shifts))
    forward = sum(blocks, start=np.zeros((), dtype=np.complex128)) / (n_shifts * snapshots.shape[2])
    transform = _unitary_transform(n_subarray)
    # The real part is the forward-backward average: the backward half adds the conjugate.
    covariance: Floats = (transform.conj().T @ forward @ transform).real
    return covariance


@lru_cache
def _unitary_transform(n: int) -> NDArray[np.complex128]:
    """Unitary matrix (n, n) that turns centro-Hermitian matrices into real ones."""
    half = n // 2
    identity, flip = np.eye(half), np.eye(half)[::-1]
    transform = np.zeros((n, n), dtype=np.complex128)
    transform[:half, :half], transform[n - half :, :half] = identity, flip
    transform[:half, n - half :], transform[n - half :, n - half :] = 1j * identity, -1j * flip
    transform /= np.sqrt(2)
    if n % 2:
        transform[half, half] = 1
    return transform


def real_steering(n_subarray: int, cosine: ArrayLike) -> Floats:
    """Steering vectors of a subarray, referred to its middle, after the same unitary transform.

    Parameters
    ----------
    n_subarray : int
    cosine : array_like, shape (g,)

    Returns
    -------
    ndarray of float64, shape (n_subarray, g)
        Columns of squared norm n_subarray.
    """
    half = n_subarray // 2
    arm = (n_subarray - 1) / 2 - np.arange(half)
    phase = np.pi * np.multiply.outer(arm, np.asarray(cosine, dtype=np.float64))
    middle = np.ones((n_subarray - 2 * half, phase.shape[1]))
    return np.concatenate([np.sqrt(2) * np.cos(phase), middle, np.sqrt(2) * np.sin(phase)])


def noise_edge(n_subarray: int, n_snapshots: int) -> float:
    """Largest eigenvalue of a noise covariance of unit power, for many sensors and snapshots.

    Parameters
    ----------
    n_subarray : int
    n_snapshots : int
        Independent snapshots; overlapping subarrays do not count.

    Returns
    -------
    float
        Upper edge (1 + sqrt(n_subarray / n_snapshots))² of the
        Marchenko-Pastur law.
    """
    return float((1 + np.sqrt(n_subarray / n_snapshots)) ** 2)


def noise_order(eigenvalues: Floats, largest_noise: float) -> NDArray[np.int64]:
    """Model order of each cell: eigenvalues that noise does not reach.

    Parameters
    ----------
    eigenvalues : ndarray of float64, shape (n, L)
        Descending.
    largest_noise : float
        Largest eigenvalue of the noise.

    Returns
    -------
    ndarray of int64, shape (n,)
        1 to L - 1: a detected cell holds one source at least, and one
        dimension is left to the noise.
    """
    order: Integers = np.clip(np.sum(eigenvalues > largest_noise, axis=1), 1, eigenvalues.shape[1] - 1)
    return order


def eigenvalue_cfar_order(eigenvalues: Floats, pfa: float) -> NDArray[np.int64]:
    """Model order by the paper's one-dimensional CA-CFAR over the sorted eigenvalues.

    As printed: eigenvalues that exceed their threshold are sources. On the 8
    eigenvalues of a subarray the window is tiny, and large neighbours mask
    each other.

    Parameters
    ----------
    eigenvalues : ndarray of float64, shape (n, L)
        Descending, L >= 3.
    pfa : float

    Returns
    -------
    ndarray of int64, shape (n,)
        1 to L - 1.
    """
    require(
        eigenvalues.shape[1] >= 3,
        "subarray elements",
        eigenvalues.shape[1],
        "3 and more, for a CFAR over eigenvalues",
    )
    n_training = (eigenvalues.shape[1] - 1) // 2
    detection = ca_cfar(np.maximum(eigenvalues, 0), (0, n_training), (0, 0), pfa)
    order: Integers = np.clip(np.sum(detection.mask, axis=1), 1, eigenvalues.shape[1] - 1)
    return order


def music_null_spectrum(eigenvectors: Floats, order: NDArray[np.int64], steering: Floats) -> Floats:
    """Squared distance of steering vectors from the signal subspace: the reciprocal of MUSIC's spectrum.

    Computed as L - |E_s^T a|² from the small signal subspace.

    Parameters
    ----------
    eigenvectors : ndarray of float64, shape (n, L, L)
        Columns by descending eigenvalue.
    order : ndarray of int64, shape (n,)
        Dimension of the signal subspace.
    steering : ndarray of float64, shape (L, g)
        From `real_steering`.

    Returns
    -------
    ndarray of float64, shape (n, g)
        0 on a source, L in empty directions.
    """
    n_sensors = len(steering)
    n_signal = int(order.max(initial=1))
    in_signal = np.arange(n_signal) < order[:, None]
    basis = eigenvectors[:, :, :n_signal] * in_signal[:, None, :]
    projection = basis.transpose(0, 2, 1) @ steering
    null: Floats = n_sensors - np.einsum("nkg,nkg->ng", projection, projection)
    return np.maximum(null, 0.0)
