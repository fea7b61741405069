"""Fits of a cell's plane waves: what they leave unexplained, and how that bends with their directions.

In white noise the likeliest directions leave the least power unexplained,
each plane wave with its best amplitude. The amplitudes drop out in closed
form (variable projection), and with them go digits: a product of responses
has the square of their condition. So there are two ways to the same numbers.

Products
    All matrices are products of a small one along u and a small one along w,
    so that the P Q elements are touched once. As long as the waves of a cell
    are clearly apart this costs no digit that counts.
Projections
    The responses on all elements are orthogonalised, and what is left of the
    snapshot and of the slopes is computed as such, not as the difference of
    two large numbers. For cells whose waves nearly coincide, or whose
    snapshots are explained almost to rounding.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
Kaufman, "A variable projection method for solving separable nonlinear least
squares problems", BIT 15 (1975).
Björck, "Numerical methods for least squares problems", SIAM (1996), on what
normal equations lose.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

DIAGONAL_LOADING = 1e-14
"""Keeps the Gram matrix of coinciding directions invertible, whose cells are then fitted by projections."""

LEAST_LOADING = 2.0**-50
"""The same for responses themselves, whose squares are never formed."""

WORST_CONDITION = 1e4
"""Largest diagonal element of an inverse Gram matrix that leaves twelve digits: pairs a hundredth of a
Rayleigh cell apart. Beyond, cells are fitted by projections."""

LEAST_UNEXPLAINED = 1e-9
"""Of a cell's power: as a difference of powers, what is left would have fewer than seven digits."""

PRODUCTS_ROUNDING = 1e-12
"""Of a cell's power: precision of what products leave unexplained."""

PROJECTIONS_ROUNDING = 1e-14
"""Of the geometric mean of a cell's power and what is left: the same of projections."""

_ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Derivatives along u and w: the response, its slopes, and how these bend."""


@dataclass(frozen=True, eq=False)
class WaveFit:
    """Directions of n cells, what they leave unexplained, and where that falls.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n, k)
        Direction cosines.
    unexplained : ndarray of float64, shape (n,)
        Power.
    rounding : ndarray of float64, shape (n,)
        Differences of unexplained power that mean nothing.
    gradient : ndarray of float64, shape (n, 2 k)
        Half of the power's descent along all u, then all w.
    curvature : ndarray of float64, shape (n, 2 k, 2 k)
        Half of that of the power, amplitudes free, in the approximation of
        Gauss and Newton: the Fisher information, but for the noise.
    hessian : ndarray of float64, shape (n, 2 k, 2 k)
        The same without approximation.
    power : ndarray of float64, shape (n, k)
        Of each plane wave, summed over elements and snapshots.
    alone : ndarray of float64, shape (n, k)
        Power that would be left unexplained without it, the other directions
        held.
    """

    u: Floats
    w: Floats
    unexplained: Floats
    rounding: Floats
    gradient: Floats
    curvature: Floats
    hessian: Floats
    power: Floats
    alone: Floats

    def at(self, cells: NDArray[np.int64] | NDArray[np.bool_]) -> WaveFit:
        """Fit of some of the cells."""
        return WaveFit(*(getattr(self, name.name)[cells] for name in fields(self)))

    def put(self, cells: NDArray[np.int64], other: WaveFit) -> None:
        """Overwrite some of the cells, in place."""
        for name in fields(self):
            getattr(self, name.name)[cells] = getattr(other, name.name)


class _Parts(NamedTuple):
    """Least squares of n cells, amplitudes eliminated.

    Attributes
    ----------
    amplitude : ndarray of complex128, shape (n, k, s)
    unexplained, rounding : ndarray of float64, shape (n,)
    inverse : ndarray of complex128, shape (n, k, k)
        Of the Gram matrix of the responses.
    leaning : ndarray of complex128, shape (n, k, 2 k)
        Amplitudes with which the responses make up the slopes along u and w.
    slopes : ndarray of complex128, shape (n, 2 k, 2 k)
        Products of what the responses leave of the slopes.
    misfit : ndarray of complex128, shape (n, 2 k, s)
        Products of the slopes with what is left of the snapshots.
    bent : ndarray of complex128, shape (n, 3, k, s)
        Those of the second derivatives, uu, uw and ww.
    """

    amplitude: Complex
    unexplained: Floats
    rounding: Floats
    inverse: Complex
    leaning: Complex
    slopes: Complex
    misfit: Complex
    bent: Complex

    def put(self, cells: NDArray[np.int64], other: _Parts) -> None:
        """Overwrite some of the cells, in place."""
        for mine, theirs in zip(self, other, strict=True):
            mine[cells] = theirs


def fit_waves(snapshots: Complex, u: Floats, w: Floats, found: NDArray[np.bool_]) -> WaveFit:
    """Fit the plane waves of each cell at given directions.

    Parameters
    ----------
    snapshots : ndarray of complex128, shape (n, s, P, Q)
        s snapshots of each cell, in each of which amplitudes are free.
    u, w : ndarray of float64, shape (n, k)
        Direction cosines.
    found : ndarray of bool, shape (n, k)
        Which entries are plane waves; the others only fill the row.

    Returns
    -------
    WaveFit
    """
    lines = _line(snapshots.shape[2], u, found), _line(snapshots.shape[3], w, found)
    power = np.sum(snapshots.real**2 + snapshots.imag**2, axis=(1, 2, 3))
    parts = _by_products(snapshots, lines, power, found)
    # Of waves that coincide, rounding decides the sign.
    condition = np.abs(np.einsum("nii->ni", parts.inverse).real).max(axis=1, initial=0)
    delicate = (condition > WORST_CONDITION) | (parts.unexplained < LEAST_UNEXPLAINED * power)
    cells = np.flatnonzero(delicate & found.any(axis=1))
    if cells.size:
        some = [[order[cells] for order in line] for line in lines]
        parts.put(cells, _by_projections(snapshots[cells], (some[0], some[1]), power[cells], found[cells]))
    return _assembled(u, w, parts)


def _line(n_elements: int, cosine: Floats, found: NDArray[np.bool_]) -> list[Complex]:
    """Responses (n, k, elements) of unit norm, referred to the middle, and two derivatives; 0 for fillers."""
    arm = np.arange(n_elements) - (n_elements - 1) / 2
    response = np.exp(-1j * np.pi * cosine[:, :, None] * arm) * (found / np.sqrt(n_elements))[:, :, None]
    slope = -1j * np.pi * arm * response
    return [response, slope, -1j * np.pi * arm * slope]


def _by_products(
    snapshots: Complex, lines: tuple[list[Complex], list[Complex]], power: Floats, found: NDArray[np.bool_]
) -> _Parts:
    """Least squares by products of lines."""
    along_u, along_w = lines
    k = found.shape[1]
    turned = np.concatenate(along_u, axis=1).conj()[:, None] @ snapshots
    turned = turned.reshape(*turned.shape[:2], 3, k, turned.shape[3])
    matched, *sloped = (np.einsum("nskq,nkq->nks", turned[:, :, i], along_w[j].conj()) for i, j in _ORDERS)
    in_u, in_w = _products(along_u), _products(along_w)
    gram = in_u[0, 0] * in_w[0, 0] + (DIAGONAL_LOADING + ~found)[:, None, :] * np.eye(k)
    cross = np.concatenate([in_u[1, 0] * in_w[0, 0], in_u[0, 0] * in_w[1, 0]], axis=1)
    mixed = in_u[1, 0] * in_w[1, 0].conj().transpose(0, 2, 1)
    slopes = np.concatenate(
        [
            np.concatenate([in_u[1, 1] * in_w[0, 0], mixed], axis=2),
            np.concatenate([mixed.conj().transpose(0, 2, 1), in_u[0, 0] * in_w[1, 1]], axis=2),
        ],
        axis=1,
    )
    # Solved, not multiplied by an inverse: of waves that coincide its elements have no digits that count.
    wanted = [np.broadcast_to(np.eye(k), gram.shape), matched, cross.conj().transpose(0, 2, 1)]
    solved = np.linalg.solve(gram, np.concatenate(wanted, axis=2))
    inverse, amplitude, leaning = np.split(solved, [k, k + matched.shape[2]], axis=2)
    bends = (in_u[2, 0] * in_w[0, 0], in_u[1, 0] * in_w[1, 0], in_u[0, 0] * in_w[2, 0])
    return _Parts(
        amplitude,
        power - np.sum((matched.conj() * amplitude).real, axis=(1, 2)),
        PRODUCTS_ROUNDING * power,
        inverse,
        leaning,
        slopes - cross @ leaning,
        np.concatenate(sloped[:2], axis=1) - cross @ amplitude,
        np.stack([left - bend @ amplitude for left, bend in zip(sloped[2:], bends, strict=True)], axis=1),
    )


def _products(line: list[Complex]) -> dict[tuple[int, int], Complex]:
    """Products (n, k, k) of derivatives of one order with those of another along one line."""
    orders = ((0, 0), (1, 0), (1, 1), (2, 0))
    return {(i, j): line[i].conj() @ line[j].transpose(0, 2, 1) for i, j in orders}


def _by_projections(
    snapshots: Complex, lines: tuple[list[Complex], list[Complex]], power: Floats, found: NDArray[np.bool_]
) -> _Parts:
    """Least squares by orthogonal projections on all elements."""
    n, n_snapshots, n_p, n_q = snapshots.shape
    k = found.shape[1]
    # One element more a wave: a filler has its own, a wave next to nothing.
    own = np.where(found, LEAST_LOADING, 1.0)[:, :, None] * np.eye(k)
    surface = [
        np.einsum("nkp,nkq->nkpq", lines[0][i], lines[1][j]).reshape(n, k, n_p * n_q) for i, j in _ORDERS
    ]
    responses = np.concatenate([surface[0], own], axis=2).transpose(0, 2, 1)
    slopes = np.zeros((n, n_p * n_q + k, 2 * k), dtype=np.complex128)
    slopes[:, : n_p * n_q] = np.concatenate(surface[1:3], axis=1).transpose(0, 2, 1)
    data = np.zeros((n, n_p * n_q + k, n_snapshots), dtype=np.complex128)
    data[:, : n_p * n_q] = snapshots.reshape(n, n_snapshots, n_p * n_q).transpose(0, 2, 1)
    basis, triangle = np.linalg.qr(responses)
    unturned = np.linalg.inv(triangle)
    left, in_basis = _projected(basis, data)
    left_slopes, slopes_in_basis = _projected(basis, slopes)
    adjoint = left_slopes.conj().transpose(0, 2, 1)
    unexplained = np.sum(left.real**2 + left.imag**2, axis=(1, 2))
    return _Parts(
        unturned @ in_basis,
        unexplained,
        PROJECTIONS_ROUNDING * np.sqrt(power * unexplained) + PROJECTIONS_ROUNDING**2 * power,
        unturned @ unturned.conj().transpose(0, 2, 1),
        unturned @ slopes_in_basis,
        adjoint @ left_slopes,
        adjoint @ left,
        np.stack([bend.conj() @ left[:, : n_p * n_q] for bend in surface[3:]], axis=1),
    )


def _projected(basis: Complex, vectors: Complex) -> tuple[Complex, Complex]:
    """What a basis (n, m, k) leaves of vectors (n, m, j), and their coordinates in it (n, k, j)."""
    adjoint = basis.conj().transpose(0, 2, 1)
    coordinates = adjoint @ vectors
    left = vectors - basis @ coordinates
    # Once more: of what is small beside the vector, rounding left a part in the basis.
    again = adjoint @ left
    return left - basis @ again, coordinates + again


def _assembled(u: Floats, w: Floats, parts: _Parts) -> WaveFit:
    """Slope and curvature of the unexplained power, from least squares."""
    amplitude, misfit, k = parts.amplitude, parts.misfit, u.shape[1]
    both = np.concatenate([amplitude, amplitude], axis=1)
    curvature = (parts.slopes * (both.conj() @ both.transpose(0, 2, 1))).real
    # The rest of the second derivatives vanishes with the misfit.
    leaning = np.concatenate([parts.leaning, parts.leaning], axis=1)
    moved = (leaning * (misfit.conj() @ both.transpose(0, 2, 1))).real
    tiled = np.tile(parts.inverse, (1, 2, 2))
    taken = (tiled * (misfit @ misfit.conj().transpose(0, 2, 1)).transpose(0, 2, 1)).real
    hessian = curvature + moved + moved.transpose(0, 2, 1) - taken
    bent = np.sum((parts.bent.conj() * amplitude[:, None]).real, axis=3)
    wave = np.arange(k)
    hessian[:, wave, wave] -= bent[:, 0]
    hessian[:, wave, wave + k] -= bent[:, 1]
    hessian[:, wave + k, wave] -= bent[:, 1]
    hessian[:, wave + k, wave + k] -= bent[:, 2]
    own_power = np.sum(amplitude.real**2 + amplitude.imag**2, axis=2)
    return WaveFit(
        u.copy(),
        w.copy(),
        parts.unexplained,
        parts.rounding,
        np.sum((both.conj() * misfit).real, axis=2),
        curvature,
        hessian,
        own_power,
        own_power / np.einsum("nii->ni", parts.inverse).real,
    )
