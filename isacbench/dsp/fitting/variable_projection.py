"""Least-squares fits of a cell's plane waves, and the slope and curvature of the misfit by their directions.

In white noise the likeliest directions leave the least power unexplained, each
plane wave with its best amplitude. The amplitudes are linear and drop out in
closed form (variable projection). All matrices are products of a small one
along u and a small one along w, so that the P Q elements are touched once.

Products square the condition of the responses: two echoes a hundredth of a
Rayleigh cell apart keep twelve digits, a thousandth leaves eight.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
Kaufman, "A variable projection method for solving separable nonlinear least
squares problems", BIT 15 (1975).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask

DIAGONAL_LOADING = 1e-14
"""Keeps the Gram matrix of coinciding directions invertible."""

ROUNDING = 1e-12
"""Precision of the unexplained power, relative to a cell's power."""


class WaveFit(NamedTuple):
    """Least-squares fits of the plane waves of n cells, k waves each.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n, k)
        Direction cosines.
    unexplained : ndarray of float64, shape (n,)
        Power that the waves leave, summed over elements and snapshots.
    rounding : ndarray of float64, shape (n,)
        Largest difference of unexplained power that rounding makes.
    gradient : ndarray of float64, shape (n, 2 k)
        Half of the power's descent along all u, then all w.
    curvature : ndarray of float64, shape (n, 2 k, 2 k)
        Half of the power's second derivatives in the approximation of Gauss
        and Newton: the Fisher information, but for the noise.
    hessian : ndarray of float64, shape (n, 2 k, 2 k)
        The same without approximation.
    power : ndarray of float64, shape (n, k)
        Power of each plane wave, summed over elements and snapshots.
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

    def at(self, cells: Integers | Mask) -> WaveFit:
        """Select cells.

        Parameters
        ----------
        cells : ndarray of int64 or bool
            Indices or mask of the cells.
        """
        return WaveFit(*(values[cells] for values in self))

    def put(self, cells: Integers, other: WaveFit) -> None:
        """Overwrite cells in place.

        Parameters
        ----------
        cells : ndarray of int64
            Indices of the cells.
        other : WaveFit
            Their new fits.
        """
        for mine, theirs in zip(self, other, strict=True):
            mine[cells] = theirs


def fit_waves(snapshots: Complex, u: Floats, w: Floats, found: Mask) -> WaveFit:
    """Fit the plane waves of each cell at given directions.

    Parameters
    ----------
    snapshots : ndarray of complex128, shape (n, s, P, Q)
        s snapshots of each cell, in each of which amplitudes are free.
    u, w : ndarray of float64, shape (n, k)
        Direction cosines.
    found : ndarray of bool, shape (n, k)
        Mask of the plane waves; the other entries only fill the row.
    """
    k = found.shape[1]
    power = np.sum(snapshots.real**2 + snapshots.imag**2, axis=(1, 2, 3))
    along_u, along_w = _line(snapshots.shape[2], u, found), _line(snapshots.shape[3], w, found)
    turned = np.concatenate(along_u, axis=1).conj()[:, None] @ snapshots
    turned = turned.reshape(*turned.shape[:2], 3, k, turned.shape[3])

    def outputs(u_order: int, w_order: int) -> Complex:
        """Outputs (n, k, s) of filters matched to derivatives of the responses."""
        return np.einsum("nskq,nkq->nks", turned[:, :, u_order], along_w[w_order].conj())

    in_u, in_w = _products(along_u), _products(along_w)
    gram = in_u[0, 0] * in_w[0, 0] + (DIAGONAL_LOADING + ~found)[:, None, :] * np.eye(k)
    cross = np.concatenate([in_u[1, 0] * in_w[0, 0], in_u[0, 0] * in_w[1, 0]], axis=1)
    mixed = in_u[1, 0] * _adjoint(in_w[1, 0])
    slopes = np.block([[in_u[1, 1] * in_w[0, 0], mixed], [_adjoint(mixed), in_u[0, 0] * in_w[1, 1]]])
    matched = outputs(0, 0)
    # Solved together: the inverse of a nearly singular matrix has no digits to multiply by.
    wanted = [np.broadcast_to(np.eye(k), gram.shape), matched, _adjoint(cross)]
    solved = np.linalg.solve(gram, np.concatenate(wanted, axis=2))
    inverse, amplitude, leaning = np.split(solved, [k, k + matched.shape[2]], axis=2)

    misfit = np.concatenate([outputs(1, 0), outputs(0, 1)], axis=1) - cross @ amplitude
    both = np.concatenate([amplitude, amplitude], axis=1)
    curvature = ((slopes - cross @ leaning) * (both.conj() @ both.transpose(0, 2, 1))).real
    # The rest of the second derivatives vanishes with the misfit.
    moved = (np.tile(leaning, (1, 2, 1)) * (misfit.conj() @ both.transpose(0, 2, 1))).real
    taken = (np.tile(inverse, (1, 2, 2)) * (misfit @ _adjoint(misfit)).transpose(0, 2, 1)).real
    hessian = curvature + moved + moved.transpose(0, 2, 1) - taken
    wave = np.arange(k)
    for (i, j), row, column in (((2, 0), 0, 0), ((1, 1), 0, k), ((1, 1), k, 0), ((0, 2), k, k)):
        bent = outputs(i, j) - (in_u[i, 0] * in_w[j, 0]) @ amplitude
        hessian[:, wave + row, wave + column] -= np.sum((bent.conj() * amplitude).real, axis=2)
    own_power = np.sum(amplitude.real**2 + amplitude.imag**2, axis=2)
    return WaveFit(
        u=u.copy(),
        w=w.copy(),
        unexplained=power - np.sum((matched.conj() * amplitude).real, axis=(1, 2)),
        rounding=ROUNDING * power,
        gradient=np.sum((both.conj() * misfit).real, axis=2),
        curvature=curvature,
        hessian=hessian,
        power=own_power,
        alone=own_power / np.einsum("nii->ni", inverse).real,
    )


def _line(n_elements: int, cosine: Floats, found: Mask) -> list[Complex]:
    """Responses (n, k, elements) of unit norm, referred to the middle, and two derivatives; 0 for fillers."""
    arm = np.arange(n_elements) - (n_elements - 1) / 2
    response = np.exp(-1j * np.pi * cosine[:, :, None] * arm) * (found / np.sqrt(n_elements))[:, :, None]
    slope = -1j * np.pi * arm * response
    return [response, slope, -1j * np.pi * arm * slope]


def _products(line: list[Complex]) -> dict[tuple[int, int], Complex]:
    """Products (n, k, k) of derivatives of one order with those of another along one line."""
    orders = ((0, 0), (1, 0), (1, 1), (2, 0))
    return {(i, j): line[i].conj() @ line[j].transpose(0, 2, 1) for i, j in orders}


def _adjoint(matrices: Complex) -> Complex:
    """Conjugate transposes of matrices (n, i, j)."""
    return matrices.conj().transpose(0, 2, 1)
