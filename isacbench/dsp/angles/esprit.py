"""Two-dimensional unitary ESPRIT: paired direction cosines without a grid, for a batch of signal subspaces.

A subarray shifted by one element sees the same sources, each turned by its
own phase. After the unitary transform this is one real equation along u and
one along w. Both have the eigenvectors of the sources, so that the
eigenvalues of the one plus j times the other hold the pairs.

Both sides of an equation hold noise. Total least squares treats them alike;
least squares would take one for exact, and bias sources towards broadside.

References
----------
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
from numpy.typing import NDArray

from isacbench.checked_arrays import Floats, Mask, checked_array
from isacbench.dsp.angles.cosines import PERIOD, within_period
from isacbench.dsp.angles.line_subspaces import unitary_transform

UNRELIABLE = 0.4
"""Imaginary part of an eigenvalue over the distance of the nearest pair; noise that turns a pair from one
axis to the other makes it a half."""


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
    n, k = paired.shape
    reliable: Mask = np.ones(n, dtype=np.bool_)
    if k > 1:
        distance = np.abs(paired[:, :, None] - paired[:, None, :]) + np.where(np.eye(k) > 0, np.inf, 0)
        for one in (along_u, along_w):
            imaginary = np.abs(np.linalg.eigvals(one).imag).max(axis=1)
            reliable &= imaginary < UNRELIABLE * distance.min(axis=(1, 2))
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
