"""Subspaces of a planar array: covariances, null spectra, and 2-D unitary ESPRIT.

A P x Q snapshot is read as all its L x M subarrays, forwards and backwards.
The unitary transform of a rectangle is that along u times that along w, so
that each subarray becomes L M real numbers twice over, and the steering
vector of a direction a product of two short real vectors.

A subarray shifted by one element sees the same sources, each turned by its
own phase. After the unitary transform this is one real equation along u and
one along w. Both have the eigenvectors of the sources, so that the
eigenvalues of the one plus j times the other hold the pairs.

Both sides of an equation hold noise. Total least squares treats them alike;
least squares would take one for exact, and bias sources towards broadside.

References
----------
Pillai and Kwon, "Forward/backward spatial smoothing techniques for coherent
signal identification", IEEE Trans. ASSP 37 (1989).
Zoltowski, Haardt and Mathews, "Closed-form 2-D angle estimation with
rectangular arrays in element space or beamspace via unitary ESPRIT", IEEE
Trans. SP 44 (1996).
Halko, Martinsson and Tropp, "Finding structure with randomness", SIAM Review
53 (2011), on subspace iteration.
Zoltowski, Haardt and Mathews, "Closed-form 2-D angle estimation with
rectangular arrays in element space or beamspace via unitary ESPRIT", IEEE
Trans. SP 44 (1996).
Golub and Van Loan, "An analysis of the total least squares problem", SIAM J.
Numer. Anal. 17 (1980).
Haardt and Nossek, "Unitary ESPRIT: how to obtain increased estimation accuracy
with a reduced computational burden", IEEE Trans. SP 43 (1995).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checked_arrays import Complex, Floats, Integers, Mask, checked_array, parts_of
from isacbench.dsp.angles.line_subspaces import Eigenpairs, unitary_transform, with_rounding
from isacbench.dsp.angles.planar_spectra import Minima, planar_minima, squared_projections
from isacbench.instrument.stages import stage
from isacbench.model.kernels import PERIOD, within_period

CHUNK_VALUES = 2**17
"""Values of the covariances decomposed or inverted at once: a megabyte stays in the cache."""

SPARE_DIMENSIONS = 4
"""Beyond those asked for: the more, the faster a subspace iteration converges."""

DEEP_NULL = 0.5
"""Share of a steering vector outside the subspace from which a minimum is no source: half of it."""

UNRELIABLE = 0.4
"""Imaginary part of an eigenvalue over the distance of the nearest pair; noise that turns a pair from one
axis to the other makes it a half."""


def subarray_shape(shape: tuple[int, ...], fraction: float) -> tuple[int, int]:
    """Size of subarrays of a share of an array, two elements at least along each axis that has them.

    Parameters
    ----------
    shape : (int, int)
        Elements P, Q of the array.
    fraction : float
        Length over array length, above 0, up to 1.

    Returns
    -------
    (int, int)
        Elements along u and along w.
    """
    n_u, n_w = (min(max(2, round(fraction * n)), n) for n in shape)
    return n_u, n_w


def planar_covariance(snapshots: Complex, subarray: tuple[int, int]) -> Floats:
    """Forward-backward spatially smoothed covariance of planar snapshots after the unitary transform.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, s, P, Q)
        One set of s snapshots a cell.
    subarray : (int, int)
        Elements L, M of a subarray, 1 to P and 1 to Q.

    Returns
    -------
    ndarray of float64, shape (n, L M, L M)
        Real, symmetric, non-negative definite. Mean eigenvalue in noise of
        power σ² is σ².
    """
    snapshots = checked_array("snapshots", snapshots, np.complex128)
    n, n_snapshots, n_p, n_q = snapshots.shape
    n_u, n_w = subarray
    n_subarrays = n_snapshots * (n_p - n_u + 1) * (n_q - n_w + 1)
    into_u, into_w = _into_subarrays(n_p, n_u) / np.sqrt(n_subarrays), _into_subarrays(n_q, n_w)
    parts = np.stack([snapshots.real, snapshots.imag], axis=3).reshape(n * n_snapshots * n_p, 2 * n_q)
    along_w = (parts @ into_w.T).reshape(n, n_snapshots, n_p, n_q - n_w + 1, 2, n_w)
    lines = along_w.transpose(0, 1, 3, 4, 2, 5).reshape(n, n_snapshots * (n_q - n_w + 1), 2 * n_p, n_w)
    # Real and imaginary parts are the forward-backward average: the backward half adds the conjugate.
    real = (into_u @ lines).reshape(n, 2 * n_subarrays, n_u * n_w)
    covariance: Floats = real.transpose(0, 2, 1) @ real
    return covariance


@lru_cache
def _into_subarrays(n: int, n_subarray: int) -> Floats:
    """Real matrix that reads all subarrays of n sensors after the unitary transform.

    From the n real parts, then the n imaginary parts, to those of each subarray.
    """
    transform = unitary_transform(n_subarray).conj().T
    shifted = [transform @ np.eye(n_subarray, n, k=shift) for shift in range(n - n_subarray + 1)]
    return np.concatenate([np.block([[one.real, -one.imag], [one.imag, one.real]]) for one in shifted])


def planar_eigenpairs(snapshots: Complex, subarray: tuple[int, int], n_pairs: int) -> Eigenpairs:
    """Largest eigenpairs, 1 to L M, of the smoothed covariances of snapshots (n, s, P, Q).

    The s snapshots of a cell share a covariance; subarrays have 1 to P and 1 to Q elements.
    """
    n_cells, n_sensors = len(snapshots), subarray[0] * subarray[1]
    values, vectors = np.empty((n_cells, n_pairs)), np.empty((n_cells, n_sensors, n_pairs))
    for some in parts_of(n_cells, CHUNK_VALUES // n_sensors**2):
        covariance = planar_covariance(snapshots[some], subarray)
        values[some], vectors[some] = leading_eigenpairs(covariance, n_pairs)
    return with_rounding(values, vectors)


def leading_eigenpairs(covariance: Floats, n_pairs: int) -> tuple[Floats, Floats]:
    """Largest eigenvalues (n, n_pairs), descending, and eigenvectors (n, L, n_pairs), by subspace iteration.

    Covariances (n, L, L) are symmetric and non-negative definite. Errors fall as (d / λ)^4, d the eigenvalue
    four places behind the last one asked for.
    """
    covariance = checked_array("covariance", covariance)
    n_sensors = covariance.shape[1]
    n_basis = n_pairs + SPARE_DIMENSIONS
    if 2 * n_basis >= n_sensors:
        values, vectors = np.linalg.eigh(covariance)
        return values[:, ::-1][:, :n_pairs], vectors[:, :, ::-1][:, :, :n_pairs]
    # Random directions: no source is orthogonal to them. The same in every run.
    start = np.random.default_rng(0).standard_normal((n_sensors, n_basis))
    # Four steps: a source at the edge of the noise is then right to 1e-3 of its eigenvector, far below the
    # effect of the noise, and a strong one to rounding.
    basis = np.linalg.qr(covariance @ start)[0]
    basis = np.linalg.qr(covariance @ basis)[0]
    # Once a basis is in the order of the eigenvalues, a second product costs it no digits.
    basis = np.linalg.qr(covariance @ (covariance @ basis))[0]
    values, vectors = np.linalg.eigh(basis.transpose(0, 2, 1) @ covariance @ basis)
    return values[:, ::-1][:, :n_pairs], basis @ vectors[:, :, ::-1][:, :, :n_pairs]


def planar_null_spectrum(basis: Floats, u: ArrayLike, w: ArrayLike) -> Floats:
    """Squared distance of the steering vectors of a grid from signal subspaces.

    Computed separably as L M - |E_s^T a|².

    Parameters
    ----------
    basis : ndarray of float64, shape (n, L, M, k)
        Orthonormal bases E_s of the signal subspaces; unused columns are 0.
    u : array_like, shape (g,)
    w : array_like, shape (h,)

    Returns
    -------
    ndarray of float64, shape (n, g, h)
        0 on a source, L M in empty directions.
    """
    null = basis.shape[1] * basis.shape[2] - squared_projections(basis, u, w)
    return np.maximum(null, 0.0)


def null_minima(basis: Floats, u: Floats, w: Floats, n_minima: Integers) -> Minima:
    """Deepest local minima of joint null spectra, placed off the grid by Newton's method.

    The basis is as for `planar_null_spectrum`. u (g,) and w (h,) are three or more equidistant samples; those
    on their border are no minima, for the spectrum may fall beyond. Returned are at most `n_minima` (n,) of
    each cell that hold half of their steering vector, and the deepest in any case.
    """
    with stage("spectrum"):
        null = planar_null_spectrum(basis, u, w)
    highest = DEEP_NULL * basis.shape[1] * basis.shape[2]
    return planar_minima(null, basis, (u, w), n_minima, highest, sign=-1)


class EspritDirections(NamedTuple):
    """Directions of k sources in each of n subspaces, in no order.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n, k)
        Direction cosines, -1 to 1.
    reliable : ndarray of bool, shape (n,)
        Cells in which either equation alone has real eigenvalues, compared
        with the distances of the pairs. Complex ones are those of two sources
        that noise separates along the wrong axis.
    """

    u: Floats
    w: Floats
    reliable: Mask


def most_sources(subarray: tuple[int, int]) -> int:
    """Sources that the shift of a subarray along either axis can tell apart.

    Parameters
    ----------
    subarray : (int, int)
        Elements along u and along w, two and more.
    """
    n_u, n_w = subarray
    return min((n_u - 1) * n_w, n_u * (n_w - 1))


def unitary_esprit(basis: Floats) -> EspritDirections:
    """Directions of the sources that span signal subspaces.

    Parameters
    ----------
    basis : ndarray of float64, shape (n, L, M, k)
        Orthonormal bases after the unitary transform; k at most
        `most_sources` of L, M.

    Returns
    -------
    EspritDirections
        Exact for exact subspaces, also where sources share u or share w.
    """
    n, n_u, n_w, k = basis.shape
    basis = checked_array("basis", basis)
    along_u, turn_u = _invariance(basis.reshape(n, n_u, n_w * k), k)
    along_w, turn_w = _invariance(basis.transpose(0, 2, 1, 3).reshape(n, n_w, n_u * k), k)
    paired = np.linalg.eigvals(along_u + 1j * along_w)
    u = within_period(turn_u[:, None] + 2 / np.pi * np.arctan(paired.real))
    w = within_period(turn_w[:, None] + 2 / np.pi * np.arctan(paired.imag))
    return EspritDirections(u, w, _reliable(along_u, along_w, paired))


def _reliable(along_u: Floats, along_w: Floats, paired: NDArray[np.inexact[Any]]) -> Mask:
    """Mask (n,) of the cells with imaginary parts, made by noise, far below the distances of the pairs."""
    to_itself = np.diag(np.full(paired.shape[1], np.inf))
    distance = np.abs(paired[:, :, None] - paired[:, None, :]) + to_itself
    imaginary = np.abs(np.linalg.eigvals(np.stack([along_u, along_w])).imag).max(axis=(0, 2))
    reliable: Mask = imaginary < UNRELIABLE * distance.min(axis=(1, 2))
    return reliable


def _invariance(lines: Floats, n_sources: int) -> tuple[Floats, Floats]:
    """Solve the shift equation along the first axis of lines (n, L, M k) by total least squares.

    The eigenvalues of the solution (n, k, k) are tan(π (u - turn) / 2). Of
    k + 1 turns the best is taken: no source is near its infinite tangent.
    """
    n, n_line, n_others = lines.shape
    rows = (n, (n_line - 1) * n_others // n_sources, n_sources)
    both = np.concatenate([(selection @ lines).reshape(rows) for selection in _selections(n_line)], axis=2)
    # Of orthonormal bases, the signal's eigenvalues are near 1: squares lose no digits of the null space.
    null = np.linalg.eigh(both.transpose(0, 2, 1) @ both)[1][:, :, :n_sources]
    even, odd = null[:, :n_sources], null[:, n_sources:]
    turn = PERIOD * np.arange(n_sources + 1) / (n_sources + 1)
    sine, cosine = (of(np.pi / 2 * turn)[:, None, None, None] for of in (np.sin, np.cos))
    turned = cosine * odd - sine * even
    best, cell = np.abs(np.linalg.det(turned)).argmax(axis=0), np.arange(n)
    tangent = -(cosine * even + sine * odd)[best, cell] @ np.linalg.inv(turned[best, cell])
    return tangent, turn[best]


@lru_cache
def _selections(n: int) -> tuple[Floats, Floats]:
    """Real matrices (n - 1, n): K_2 d = tan(π u / 2) K_1 d for the real steering vector d towards u."""
    shifted = unitary_transform(n - 1).conj().T @ unitary_transform(n)[1:]
    return np.ascontiguousarray(shifted.real), np.ascontiguousarray(-shifted.imag)
