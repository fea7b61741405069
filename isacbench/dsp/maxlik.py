"""Maximum likelihood of a cell's plane waves: directions refined together on all elements, and told apart.

In white noise the likeliest directions are those whose plane waves, each with
its best amplitude, leave the least power unexplained. The amplitudes drop out
in closed form (variable projection); the directions follow by damped
Gauss-Newton steps, whose curvature is the Fisher information of the
directions. All matrices are products of a small one along u and a small one
along w, so that the P Q elements are touched once a step.

The same curvature says how well two directions are told apart. A pair nearer
than noise would place two estimates of one direction is one direction.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", SIAM J. Numer. Anal. 10 (1973).
Kaufman, "A variable projection method for solving separable nonlinear least
squares problems", BIT 15 (1975).
Viberg and Ottersten, "Sensor array processing based on subspace fitting",
IEEE Trans. SP 39 (1991).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.planewaves import PlaneWaves

__all__ = ["refine_directions", "resolve_directions"]

Floats = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

DIAGONAL_LOADING = 1e-12
"""Keeps the Gram matrix of coinciding directions invertible; -120 dB is below any misfit."""

SMALLEST_SCALE = 1e-9
"""Root of the curvature along one direction, relative to the largest, that counts as none."""

FIRST_DAMPING, LESS_DAMPING, MORE_DAMPING = 1e-3, 0.2, 10.0
"""Marquardt's damping, relative to the curvature: at first, after a good and after a bad step."""

LARGEST_STEP = 0.5
"""Of a Rayleigh cell: farther the likelihood is no parabola."""

CONVERGED = 1e-10
"""Relative drop of the unexplained power below which a cell is done."""

ROUNDING = 1e-12
"""Of a cell's power: a step that seems to lose less may be as good, and is taken, lest rounding decide."""

LEAST_DEVIATIONS = 3.0
"""Standard deviations of their distance from which two directions are two, as
the three-sigma rule has it."""

REFIT_STEPS = 4
"""After a plane wave left or two became one, the others move little."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """Directions of n cells, what they leave unexplained, and where that falls.

    Attributes
    ----------
    u, w : ndarray of float64, shape (n, k)
    unexplained : ndarray of float64, shape (n,)
        Power.
    gradient : ndarray of float64, shape (n, 2 k)
        Half of the power's descent along all u, then all w.
    curvature : ndarray of float64, shape (n, 2 k, 2 k)
        Half of that of the power, amplitudes free, in the approximation of
        Gauss and Newton.
    power : ndarray of float64, shape (n, k)
        Of each plane wave, summed over elements and snapshots.
    alone : ndarray of float64, shape (n, k)
        Power that would be left unexplained without it, the other directions
        held.
    """

    u: Floats
    w: Floats
    unexplained: Floats
    gradient: Floats
    curvature: Floats
    power: Floats
    alone: Floats

    def at(self, cells: NDArray[np.int64] | NDArray[np.bool_]) -> _Fit:
        """Fit of some of the cells."""
        return _Fit(*(getattr(self, name.name)[cells] for name in fields(self)))

    def put(self, cells: NDArray[np.int64], other: _Fit) -> None:
        """Overwrite some of the cells, in place."""
        for name in fields(self):
            getattr(self, name.name)[cells] = getattr(other, name.name)


def refine_directions(snapshots: Complex, waves: PlaneWaves, n_steps: int) -> PlaneWaves:
    """Move the plane waves of each cell to where, together, they leave the least power unexplained.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, s, P, Q)
        s snapshots of each cell, in each of which amplitudes are free: its
        data, or a weighted basis of its signal subspace.
    waves : PlaneWaves
        Starts, k in a row.
    n_steps : int
        Most steps; cells that no longer change stop before.

    Returns
    -------
    PlaneWaves
        As many as at the start; u and w may leave [-1, 1], where directions repeat.
    """
    fit = _refined(snapshots, _fit(snapshots, waves.u, waves.w, waves.found), waves.found, n_steps)
    return PlaneWaves(fit.u, fit.w, waves.found)


def resolve_directions(
    snapshots: Complex, waves: PlaneWaves, noise: float, pfa: float, n_steps: int
) -> PlaneWaves:
    """Refine directions, and leave out what noise makes of them: weak waves and pairs that are one.

    Of a cell, the weakest wave leaves first, if noise is as strong. Then, of
    the two told apart least, both become one between them, if their distance
    is within its error. The others are refined again, until all stand. The
    last wave of a cell stays.

    A pair that close may explain more than one wave does and still leaves: a
    crowd of echoes, of which a cell shows only a few moments, is explained by
    two nearly cancelling waves that are no echoes.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, s, P, Q)
        As for `refine_directions`, in white noise.
    waves : PlaneWaves
        Starts, at least as many as there are sources.
    noise : float
        Noise power per element.
    pfa : float
        Probability that noise passes for a wave.
    n_steps : int
        Most steps of the first refinement.

    Returns
    -------
    PlaneWaves
    """
    found = waves.found.copy()
    fit = _refined(snapshots, _fit(snapshots, waves.u, waves.w, found), found, n_steps)
    changing = np.arange(len(found))
    while changing.size:
        u, w, fewer = _without_one(fit.at(changing), found[changing], noise, -np.log(pfa) * noise)
        changed = (fewer != found[changing]).any(axis=1)
        changing, fewer = changing[changed], fewer[changed]
        cells = snapshots[changing]
        fit.put(changing, _refined(cells, _fit(cells, u[changed], w[changed], fewer), fewer, REFIT_STEPS))
        found[changing] = fewer
    return PlaneWaves(fit.u, fit.w, found)


def _without_one(
    fit: _Fit, found: NDArray[np.bool_], noise: float, least_power: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Directions u and w of each cell and which are left, where one wave is too weak or two are one."""
    u, w, fewer = fit.u.copy(), fit.w.copy(), found.copy()
    several = np.count_nonzero(found, axis=1) > 1
    alone = np.where(found, fit.alone, np.inf)
    leaves = np.flatnonzero(several & (alone.min(axis=1, initial=np.inf) < least_power))
    fewer[leaves, alone[leaves].argmin(axis=1)] = False
    distance, first, second = _nearest_pair(fit, found, noise)
    merges = several & (distance < LEAST_DEVIATIONS)
    merges[leaves] = False
    cells = np.flatnonzero(merges)
    one, other = (cells, first[cells]), (cells, second[cells])
    fewer[other] = False
    share = fit.power[one] / (fit.power[one] + fit.power[other])
    u[one] = share * u[one] + (1 - share) * u[other]
    w[one] = share * w[one] + (1 - share) * w[other]
    return u, w, fewer


def _nearest_pair(
    fit: _Fit, found: NDArray[np.bool_], noise: float
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Of each cell, the pair least distant in units of its distance's standard deviation."""
    n, k = found.shape
    scale, relative = _scaled_curvature(fit)
    relative += np.tile(~found, 2)[:, None, :] * np.eye(2 * k)
    covariance = noise / 2 * np.linalg.inv(relative) / (scale[:, :, None] * scale[:, None, :])
    blocks = covariance.reshape(n, 2, k, 2, k).transpose(0, 2, 4, 1, 3)
    own = np.einsum("niiab->niab", blocks)
    spread = own[:, :, None] + own[:, None, :] - blocks - blocks.transpose(0, 1, 2, 4, 3)
    apart = np.stack([fit.u[:, :, None] - fit.u[:, None, :], fit.w[:, :, None] - fit.w[:, None, :]], axis=-1)
    determinant = spread[..., 0, 0] * spread[..., 1, 1] - spread[..., 0, 1] * spread[..., 1, 0]
    weighted = (
        spread[..., 1, 1] * apart[..., 0] ** 2
        - 2 * spread[..., 0, 1] * apart[..., 0] * apart[..., 1]
        + spread[..., 0, 0] * apart[..., 1] ** 2
    )
    square = np.divide(weighted, determinant, out=np.zeros_like(weighted), where=determinant > 0)
    pairs = found[:, :, None] & found[:, None, :] & ~np.eye(k, dtype=np.bool_)
    square = np.where(pairs, np.maximum(square, 0), np.inf).reshape(n, k * k)
    first, second = np.divmod(square.argmin(axis=1), k)
    return np.sqrt(square.min(axis=1)), first, second


def _refined(snapshots: Complex, fit: _Fit, found: NDArray[np.bool_], n_steps: int) -> _Fit:
    """Fit after damped Gauss-Newton steps."""
    n_lines = np.repeat(snapshots.shape[2:], found.shape[1])
    damping = np.full(len(snapshots), FIRST_DAMPING)
    rounding = ROUNDING * np.sum(snapshots.real**2 + snapshots.imag**2, axis=(1, 2, 3))
    moving = np.flatnonzero(found.any(axis=1))
    for _ in range(n_steps):
        if not moving.size:
            break
        old = fit.at(moving)
        step = _damped_step(old, damping[moving])
        # Shortened as a whole, a step still descends.
        step /= np.maximum(1, np.abs(step * n_lines / 2).max(axis=1) / LARGEST_STEP)[:, None]
        step_u, step_w = np.split(step, 2, axis=1)
        new = _fit(snapshots[moving], old.u + step_u, old.w + step_w, found[moving])
        better = new.unexplained <= old.unexplained + rounding[moving]
        fit.put(moving[better], new.at(better))
        damping[moving] *= np.where(better, LESS_DAMPING, MORE_DAMPING)
        done = better & (old.unexplained - new.unexplained <= CONVERGED * old.unexplained)
        moving = moving[~done]
    return fit


def _damped_step(fit: _Fit, damping: Floats) -> Floats:
    """Steps (n, 2 k) of Levenberg and Marquardt."""
    scale, relative = _scaled_curvature(fit)
    relative += damping[:, None, None] * np.eye(scale.shape[1])
    step: Floats = np.linalg.solve(relative, (fit.gradient / scale)[:, :, None])[:, :, 0] / scale
    return step


def _scaled_curvature(fit: _Fit) -> tuple[Floats, Floats]:
    """Scales (n, 2 k) that give the curvature a unit diagonal, and that curvature, loaded."""
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", fit.curvature), 0))
    # Fillers, and waves that have no power, are along for the ride.
    strongest = scale.max(axis=1, keepdims=True, initial=0)
    scale = np.maximum(scale, np.where(strongest > 0, SMALLEST_SCALE * strongest, 1))
    relative = fit.curvature / scale[:, :, None] / scale[:, None, :]
    return scale, relative + DIAGONAL_LOADING * np.eye(scale.shape[1])


def _fit(snapshots: Complex, u: Floats, w: Floats, found: NDArray[np.bool_]) -> _Fit:
    """Unexplained power at u and w, and its slope and curvature with all amplitudes free."""
    k = u.shape[1]
    a, a_slope = _line(snapshots.shape[2], u, found)
    b, b_slope = _line(snapshots.shape[3], w, found)
    along_u = np.concatenate([a, a_slope], axis=1).conj()[:, None] @ snapshots
    matched = np.einsum("nskq,nkq->nks", along_u[:, :, :k], b.conj())
    sloped = np.concatenate(
        [
            np.einsum("nskq,nkq->nks", along_u[:, :, k:], b.conj()),
            np.einsum("nskq,nkq->nks", along_u[:, :, :k], b_slope.conj()),
        ],
        axis=1,
    )
    aa, sa, ss = _gram(a, a), _gram(a_slope, a), _gram(a_slope, a_slope)
    bb, tb, tt = _gram(b, b), _gram(b_slope, b), _gram(b_slope, b_slope)
    gram = aa * bb + (DIAGONAL_LOADING + ~found)[:, None, :] * np.eye(k)
    cross = np.concatenate([sa * bb, aa * tb], axis=1)
    mixed = sa * tb.conj().transpose(0, 2, 1)
    slopes = np.concatenate(
        [
            np.concatenate([ss * bb, mixed], axis=2),
            np.concatenate([mixed.conj().transpose(0, 2, 1), aa * tt], axis=2),
        ],
        axis=1,
    )
    inverse = np.linalg.inv(gram)
    amplitude = inverse @ matched
    own_power = np.sum(amplitude.real**2 + amplitude.imag**2, axis=2)
    alone = own_power / np.einsum("nii->ni", inverse).real
    power = np.sum(snapshots.real**2 + snapshots.imag**2, axis=(1, 2, 3))
    unexplained = power - np.sum((matched.conj() * amplitude).real, axis=(1, 2))
    both = np.concatenate([amplitude, amplitude], axis=1)
    gradient = np.sum((both.conj() * (sloped - cross @ amplitude)).real, axis=2)
    curvature = (
        (slopes - cross @ inverse @ cross.conj().transpose(0, 2, 1)) * (both.conj() @ both.transpose(0, 2, 1))
    ).real
    return _Fit(u.copy(), w.copy(), unexplained, gradient, curvature, own_power, alone)


def _line(n_elements: int, cosine: Floats, found: NDArray[np.bool_]) -> tuple[Complex, Complex]:
    """Responses (n, k, elements) of unit norm, referred to the middle, and their slopes; 0 for fillers."""
    arm = np.arange(n_elements) - (n_elements - 1) / 2
    response = np.exp(-1j * np.pi * cosine[:, :, None] * arm) * (found / np.sqrt(n_elements))[:, :, None]
    return response, -1j * np.pi * arm * response


def _gram(left: Complex, right: Complex) -> Complex:
    product: Complex = left.conj() @ right.transpose(0, 2, 1)
    return product
