"""Maximum likelihood of a cell's plane waves: directions refined together on all elements, and told apart.

In white noise the likeliest directions are those whose plane waves, each with
its best amplitude, leave the least power unexplained. The amplitudes drop out
in closed form; the directions follow by damped Gauss-Newton steps, whose
curvature is the Fisher information of the directions, and by Newton steps near
the optimum (`isacbench.dsp.fitting.variable_projection`).

A cell is done when the next step promises no more than rounding. The power
itself would be too coarse a measure: a minimum is flat, and powers that agree
in all digits leave half the digits of a direction open.

From the same curvature follows the error of the distance of two directions. A
pair nearer than its error is one direction.

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

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.dsp.angles.cosines import within_period
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.fitting.variable_projection import WaveFit, fit_waves
from isacbench.dsp.stable_order import stepped

DIAGONAL_LOADING = 1e-12
"""Of the curvature in units of its diagonal: keeps the covariance of coinciding directions finite."""

SMALLEST_SCALE = 1e-9
"""Root of the curvature along one direction, relative to the largest, that counts as 0."""

FIRST_DAMPING, LESS_DAMPING, MORE_DAMPING = 1e-3, 0.05, 10.0
"""Marquardt's damping, relative to the curvature: at first, after a good and after a bad step."""

LARGEST_STEP = 0.5
"""Rayleigh cells of a step: farther away the likelihood is no parabola."""

NEAR = 0.05
"""Rayleigh cells: after a step as short, the next is Newton's, whose digits double."""

CONVERGED = 1e-21
"""Of a cell's power: a step that promises less, a few 1e-11 Rayleigh cells of Newton's, is the last."""

NEARLY_EXPLAINED = 1e-7
"""Share of a cell's power: waves that leave less are those of the cell; further steps place them."""

FINISHING_STEPS = 30
"""Further steps for such a cell: in the curved valley of waves in phase a tenth of a Rayleigh cell apart
every second step goes too far."""

LEAST_DEVIATIONS = 3.0
"""Standard deviations of their distance from which two directions are two: the three-sigma rule."""

REFIT_STEPS = 10
"""Most steps after a plane wave left or two became one: the others move little."""


def resolve_directions(
    snapshots: Complex, waves: PlaneWaves, noise: float, pfa: float, n_steps: int
) -> PlaneWaves:
    """Refine directions, drop waves as weak as noise, and merge pairs that noise does not tell apart.

    In each round of a cell, the weakest wave leaves if noise is as strong.
    Otherwise the nearest pair, relative to the error of its distance, becomes
    one wave if that distance is within its error. The others are refined
    again, until all stay. The last wave of a cell stays.

    Even a pair that explains more than one wave is merged: two nearly
    cancelling waves that are no echoes explain a crowd of echoes.

    Parameters
    ----------
    snapshots : ndarray of complex, shape (n, s, P, Q)
        s snapshots of each cell, in each of which amplitudes are free, in white
        noise: its data, or a weighted basis of its signal subspace.
    waves : PlaneWaves
        Starts, at least as many as there are sources.
    noise : float
        Noise power per element.
    pfa : float
        Probability that noise passes for a wave.
    n_steps : int
        Most steps of the first refinement; a cell that is explained to 70 dB by then takes up to 30 more.
    """
    found = waves.found.copy()
    fit = refined(snapshots, fit_waves(snapshots, waves.u, waves.w, found), found, n_steps, FINISHING_STEPS)
    changing = np.arange(len(found))
    while changing.size:
        u, w, fewer = _without_one(fit.at(changing), found[changing], noise, -np.log(pfa) * noise)
        changed = (fewer != found[changing]).any(axis=1)
        changing, fewer = changing[changed], fewer[changed]
        cells = snapshots[changing]
        fit.put(
            changing,
            refined(
                cells, fit_waves(cells, u[changed], w[changed], fewer), fewer, REFIT_STEPS, FINISHING_STEPS
            ),
        )
        found[changing] = fewer
    return PlaneWaves(fit.u, fit.w, found)


def _without_one(fit: WaveFit, found: Mask, noise: float, least_power: float) -> tuple[Floats, Floats, Mask]:
    """Directions u and w of each cell, and the mask of those left, after one wave left or two became one."""
    u, w, fewer = fit.u.copy(), fit.w.copy(), found.copy()
    several = np.count_nonzero(found, axis=1) > 1
    alone = np.where(found, fit.alone, np.inf)
    leaves = np.flatnonzero(several & (alone.min(axis=1, initial=np.inf) < least_power))
    fewer[leaves, alone[leaves].argmin(axis=1)] = False
    square, first, second = _nearest_pair(fit, found)
    merges = several & (square <= LEAST_DEVIATIONS**2 * noise)
    merges[leaves] = False
    cells = np.flatnonzero(merges)
    one, other = (cells, first[cells]), (cells, second[cells])
    fewer[other] = False
    share = fit.power[other] / (fit.power[one] + fit.power[other])
    for cosine in (u, w):
        cosine[one] += share * within_period(cosine[other] - cosine[one])
    return u, w, fewer


def _nearest_pair(fit: WaveFit, found: Mask) -> tuple[Floats, Integers, Integers]:
    """Nearest pair of each cell: its squared distance (n,) over the variance in unit noise, and its waves."""
    n, k = found.shape
    scale, relative = _scaled_curvature(fit)
    relative += np.tile(~found, 2)[:, None, :] * np.eye(2 * k)
    # For noise of unit power, so that noise may be 0.
    covariance = np.linalg.inv(relative) / 2 / (scale[:, :, None] * scale[:, None, :])
    blocks = covariance.reshape(n, 2, k, 2, k).transpose(0, 2, 4, 1, 3)
    own = np.einsum("niiab->niab", blocks)
    spread = own[:, :, None] + own[:, None, :] - blocks - blocks.transpose(0, 1, 2, 4, 3)
    apart = within_period(
        np.stack([fit.u[:, :, None] - fit.u[:, None, :], fit.w[:, :, None] - fit.w[:, None, :]], axis=-1)
    )
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
    return square.min(axis=1), first, second


def refined(snapshots: Complex, fit: WaveFit, found: Mask, n_steps: int, n_finishing: int = 0) -> WaveFit:
    """Fit after damped Gauss-Newton and Newton steps; cells that are nearly explained take more."""
    half_cells = np.repeat(snapshots.shape[2:], found.shape[1]) / 2
    damping = np.full(len(snapshots), FIRST_DAMPING)
    near = np.zeros(len(snapshots), dtype=np.bool_)
    power = np.sum(snapshots.real**2 + snapshots.imag**2, axis=(1, 2, 3))
    least_gain = CONVERGED * power
    moving = np.flatnonzero(found.any(axis=1))
    for n_done in range(n_steps + n_finishing):
        if n_done == n_steps:
            moving = moving[fit.unexplained[moving] < NEARLY_EXPLAINED * power[moving]]
        if not moving.size:
            break
        old = fit.at(moving)
        step = _damped_step(old, damping[moving], near[moving])
        gain = np.sum(step * old.gradient, axis=1)
        # Shortened as a whole, a step still descends.
        length = np.abs(step * half_cells).max(axis=1)
        step /= np.maximum(1, length / LARGEST_STEP)[:, None]
        places = np.concatenate([old.u, old.w], axis=1) + step
        u, w = np.split(stepped(places * half_cells, step * half_cells) / half_cells, 2, axis=1)
        new = fit_waves(snapshots[moving], u, w, found[moving])
        # A step that loses no more than rounding is taken: rounding must not decide.
        better = new.unexplained <= old.unexplained + np.maximum(old.rounding, new.rounding)
        fit.put(moving[better], new.at(better))
        near[moving] = better & (length < NEAR)
        damping[moving] *= np.where(better, LESS_DAMPING, MORE_DAMPING)
        moving = moving[~(better & (gain <= least_gain[moving]))]
    return fit


def _damped_step(fit: WaveFit, damping: Floats, near: Mask) -> Floats:
    """Steps (n, 2 k) of Levenberg and Marquardt; near a minimum Newton steps, damped as much."""
    scale, relative = _scaled_curvature(fit)
    exact = np.flatnonzero(near)
    if exact.size:
        hessian = fit.hessian[exact] / scale[exact, :, None] / scale[exact, None, :]
        hessian += DIAGONAL_LOADING * np.eye(scale.shape[1])
        idle = fit.curvature[exact].diagonal(axis1=1, axis2=2) <= 0
        hessian += idle[:, :, None] * np.eye(scale.shape[1])
        convex = np.linalg.eigvalsh(hessian)[:, 0] > 0
        relative[exact[convex]] = hessian[convex]
    relative += damping[:, None, None] * np.eye(scale.shape[1])
    return np.linalg.solve(relative, (fit.gradient / scale)[:, :, None])[:, :, 0] / scale


def _scaled_curvature(fit: WaveFit) -> tuple[Floats, Floats]:
    """Scales (n, 2 k) that give the curvature a unit diagonal, and that curvature, loaded."""
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", fit.curvature), 0))
    # Fillers, and waves without power, have no curvature of their own.
    strongest = scale.max(axis=1, keepdims=True, initial=0)
    scale = np.maximum(scale, np.where(strongest > 0, SMALLEST_SCALE * strongest, 1))
    relative = fit.curvature / scale[:, :, None] / scale[:, None, :]
    return scale, relative + DIAGONAL_LOADING * np.eye(scale.shape[1])
