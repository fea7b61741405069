"""Subspace methods on a line of sensors, and the effect of rounding on any signal subspace.

A perturbation of size E rotates the space of the k largest eigenvectors by an
angle whose sine is at most E over the gap between the k-th eigenvalue and the
next (Davis and Kahan). Rounding perturbs every covariance. Where the gap is
only a few rounding errors wide, the subspace is arbitrary: in a white
covariance, within a group of equal eigenvalues, and beyond the last source of a
noise-free snapshot.

Forward-backward averaging makes a covariance centro-Hermitian; the unitary
transform then turns it into a real symmetric matrix, and a steering vector
referred to the middle of the subarray into a real vector. Everything after
the data is real.

References
----------
Davis and Kahan, "The rotation of eigenvectors by a perturbation III", SIAM J.
Numer. Anal. 7 (1970).
Pillai and Kwon, "Forward/backward spatial smoothing techniques for coherent
signal identification", IEEE Trans. ASSP 37 (1989).
Huarng and Yeh, "A unitary transformation method for angle-of-arrival
estimation", IEEE Trans. SP 39 (1991).
Schmidt, "Multiple emitter location and signal parameter estimation", IEEE
Trans. AP 34 (1986).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Complex, Floats, Integers, Mask, checked_array
from isacbench.dsp.angles.peaks import Peaks
from isacbench.model.kernels import sine_cosine, within_period
from isacbench.model.region import Interval

MOST_ROTATION = 1e-3
"""Largest sine of the angle by which rounding may rotate a signal subspace: three digits of a direction, in
units of the subarray's beam."""

ROUNDING_UNITS = 4
"""Rounding error of a decomposed covariance, per dimension: in last digits of the largest eigenvalue."""

SMALLEST_NULL = 1e-15
"""Squared distance from the signal subspace, relative, below which there is only rounding."""

LEAST_RADIUS = 0.5
"""Distance from 0 above which a root is a source: the spectrum of one farther in is flat."""

MOST_STEPS = 30
"""Of Newton's method. Three do but for the flattest nulls, of two sources about to merge."""

CONVERGED = 1e-5
"""Step, as a share of the reach, beyond which only rounding changes: digits double with every step."""


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

    From `Eigenpairs.rotation` (n, m) and the orders asked for (n,), 0 to m: the largest determined order up
    to that one, 0 where none is determined.
    """
    orders = np.arange(1, rotation.shape[1] + 1)
    determined = (rotation <= MOST_ROTATION) & (orders <= order[:, None])
    return np.where(determined, orders, 0).max(axis=1, initial=0)


def smoothed_covariance(snapshots: Complex, n_subarray: int) -> Floats:
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
    snapshots = checked_array("snapshots", snapshots, np.complex128)
    n_shifts = snapshots.shape[1] - n_subarray + 1
    whole = snapshots @ snapshots.conj().transpose(0, 2, 1)
    # The covariance of a subarray is a diagonal block of the whole array's.
    blocks = (whole[:, k : k + n_subarray, k : k + n_subarray] for k in range(n_shifts))
    forward = sum(blocks, start=np.zeros(())) / (n_shifts * snapshots.shape[2])
    transform = unitary_transform(n_subarray)
    # The real part is the forward-backward average: the backward half adds the conjugate.
    return (transform.conj().T @ forward @ transform).real


def line_eigenpairs(snapshots: Complex, n_subarray: int) -> Eigenpairs:
    """All eigenpairs of smoothed covariances.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, n_sensors, n_snapshots)
    n_subarray : int
        Sensors of a subarray, 2 to n_sensors.
    """
    values, vectors = np.linalg.eigh(smoothed_covariance(snapshots, n_subarray))
    return with_rounding(values[:, ::-1], vectors[:, :, ::-1])


@lru_cache
def unitary_transform(n: int) -> Complex:
    """Unitary matrix that turns centro-Hermitian matrices into real ones.

    Returns
    -------
    ndarray of complex128, shape (n, n)
        Sums and differences of mirrored sensors.
    """
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

    Columns of squared norm `n_subarray`, shape (n_subarray, g), for cosines (g,).
    """
    half = n_subarray // 2
    arm = (n_subarray - 1) / 2 - np.arange(half)
    phase = np.pi * np.multiply.outer(arm, np.asarray(cosine, dtype=np.float64))
    middle = np.ones((n_subarray - 2 * half, phase.shape[1]))
    sine, cosine = sine_cosine(phase)
    return np.concatenate([np.sqrt(2) * cosine, middle, np.sqrt(2) * sine])


def real_steering_slopes(n_subarray: int, cosine: Floats) -> Floats:
    """Real steering vectors of cosines (n, ...), with two derivatives of each: (n, 3, ..., n_subarray)."""
    half = n_subarray // 2
    rate = np.pi * ((n_subarray - 1) / 2 - np.arange(half))
    odd, even = (np.sqrt(2) * part for part in sine_cosine(np.multiply.outer(cosine, rate)))
    slopes = np.zeros((len(cosine), 3, *cosine.shape[1:], n_subarray))
    value, first, second = slopes.swapaxes(0, 1)
    head, middle, tail = (
        np.s_[..., :half],
        np.s_[..., half : n_subarray - half],
        np.s_[..., n_subarray - half :],
    )
    value[head], value[middle], value[tail] = even, 1, odd
    first[head], first[tail] = -rate * odd, rate * even
    second[head], second[tail] = -(rate**2) * even, -(rate**2) * odd
    return slopes


def music_null_spectrum(eigenvectors: Floats, order: Integers, steering: Floats) -> Floats:
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
    basis = signal_basis(eigenvectors, order)
    projection = basis.transpose(0, 2, 1) @ steering
    null: Floats = len(steering) - np.einsum("nkg,nkg->ng", projection, projection)
    return np.maximum(null, 0.0)


def signal_basis(eigenvectors: Floats, order: Integers) -> Floats:
    """Bases (n, L, k) of signal subspaces, 0 beyond the order of each."""
    n_signal = int(order.max(initial=1))
    in_signal = np.arange(n_signal) < order[:, None]
    return eigenvectors[:, :, :n_signal] * in_signal[:, None, :]


def music_null_minima(
    eigenvectors: Floats, order: Integers, place: Floats, found: Mask, reach: float
) -> Floats:
    """Local minima of null spectra, by Newton's method from places (n, m) near them.

    Eigenvectors (n, L, L) are columns by descending eigenvalue, `order` (n,) the dimensions of signal
    subspaces. Places outside of the mask `found` stay. A minimum is at most `reach` from its place.
    """
    cell, entry = np.nonzero(found)
    basis = signal_basis(eigenvectors, order)[cell]
    minima, moved = place.copy(), place[cell, entry]
    low, high = moved - reach, moved + reach
    for _ in range(MOST_STEPS):
        slopes = real_steering_slopes(eigenvectors.shape[1], moved)
        level, first, second = np.moveaxis(slopes @ basis, 1, 0)
        # Half the derivatives of |E_s^T a|², which has a maximum where the null spectrum has a minimum.
        slope = np.sum(level * first, axis=1)
        bend = -np.sum(first**2 + level * second, axis=1)
        low, high = np.where(slope > 0, moved, low), np.where(slope < 0, moved, high)
        # Half of what is left always leads on. Where the spectrum is not convex, nothing else is known.
        limit = (high - low) / 2
        step = np.where(bend > 0, slope / np.where(bend > 0, bend, 1), np.sign(slope) * limit)
        step = np.clip(step, -limit, limit)
        moved = moved + step
        minima[cell, entry] = moved
        left = np.abs(step) > CONVERGED * reach
        if not left.any():
            break
        cell, entry, basis, moved, low, high = (of[left] for of in (cell, entry, basis, moved, low, high))
    return minima


def music_roots(eigenvectors: Floats, order: Integers, limits: Interval) -> Peaks:
    """Directions of the roots of the null spectrum's polynomial that are nearest to the unit circle.

    The null spectrum a^H (I - E_s E_s^H) a is a polynomial in exp(jπ cosine) of
    degree 2 L - 2, whose roots come in pairs mirrored at the unit circle. The
    inner one of each pair counts.

    Parameters
    ----------
    eigenvectors : ndarray of float64, shape (n, L, L)
        Columns by descending eigenvalue.
    order : ndarray of int64, shape (n,)
        Dimension of the signal subspace: most roots of each cell.
    limits : (float, float)
        Lowest and highest direction cosine.

    Returns
    -------
    Peaks
        Nearest to the circle first.

    References
    ----------
    Barabell, "Improving the resolution performance of eigenstructure-based
    direction-finding algorithms", ICASSP (1983).
    Rao and Hari, "Performance analysis of root-MUSIC", IEEE Trans. ASSP 37
    (1989).
    """
    n_sensors = eigenvectors.shape[1]
    basis = unitary_transform(n_sensors) @ signal_basis(eigenvectors, order)
    # Sums along the diagonals of E_s E_s^H are correlations of its columns with themselves.
    lines = scipy.fft.fft(basis, 2 * n_sensors, axis=1)
    lags = scipy.fft.ifft(np.sum(lines.real**2 + lines.imag**2, axis=2), axis=1)[:, :n_sensors]
    lags[:, 0] -= n_sensors
    polynomial = np.concatenate([lags[:, :0:-1].conj(), lags], axis=1)
    # Without a leading term two roots would lie at 0 and at infinity: far from the circle as well.
    leading = np.where(np.abs(polynomial[:, :1]) > SMALLEST_NULL, polynomial[:, :1], SMALLEST_NULL)
    companion = np.tile(np.eye(2 * n_sensors - 2, k=-1, dtype=np.complex128), (len(basis), 1, 1))
    companion[:, 0] = -polynomial[:, 1:] / leading
    roots = np.linalg.eigvals(companion)
    outward = np.take_along_axis(roots, np.argsort(np.abs(roots), axis=1), axis=1)
    inner, outer = outward[:, n_sensors - 2 :: -1], outward[:, n_sensors - 1 :]
    apart = np.abs(outer[:, None] * inner.conj()[:, :, None] - 1)
    mirrored = np.take_along_axis(outer, apart.argmin(axis=2), axis=1)
    # Half of the digits of a double root are lost, but not those of the mean of the two.
    cosine = -np.angle(inner + mirrored) / np.pi
    cosine = within_period(cosine, sum(limits) / 2)
    inside = (cosine >= limits[0]) & (cosine <= limits[1]) & (np.abs(inner) > LEAST_RADIUS)
    n_most = min(int(order.max(initial=0)), n_sensors - 1)
    found = inside[:, :n_most] & (np.arange(n_most) < order[:, None])
    return Peaks(cosine[:, :n_most], found)
