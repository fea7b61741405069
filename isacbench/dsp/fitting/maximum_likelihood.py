"""Maximum likelihood of a cell's plane waves: directions refined together on all elements, and resolved.

In white noise the likeliest directions leave the least power unexplained, each
plane wave with its best amplitude. The amplitudes are linear and drop out in
closed form (variable projection). All matrices are products of a small one
along u and a small one along w. The directions follow by damped Gauss-Newton
steps, whose curvature is the Fisher information of the directions, and by
Newton steps near the optimum.

Products square the condition of the responses: of two echoes a thousandth of a
Rayleigh cell apart they leave eight digits. That is enough for curvatures. The
misfit, which decides where steps end, is what filters show of the elements
after the echoes are subtracted, and keeps its digits.

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

from typing import NamedTuple

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.dsp.angles.line_subspaces import real_steering_slopes, unitary_transform
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.floating_point import round_step
from isacbench.dsp.positive_matrices import is_positive
from isacbench.model.kernels import within_period

GRAM_LOADING = 1e-14
"""Keeps the Gram matrix of coinciding directions invertible."""

ROUNDING = 1e-12
"""Precision of the unexplained power, relative to a cell's power."""

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


def real_snapshots(snapshots: Complex) -> Floats:
    """Real and imaginary parts (n, P, 2 s, Q) of snapshots (n, s, P, Q) after the unitary transform.

    Responses referred to the middle of the array are then real, and so is all that follows.
    """
    into_u, into_w = (unitary_transform(n).conj() for n in snapshots.shape[2:])
    turned = into_u.T @ snapshots @ into_w
    # Lines along u in front: all of them are one factor of a product.
    return np.concatenate([turned.real, turned.imag], axis=1).transpose(0, 2, 1, 3).copy()


def fit_waves(snapshots: Floats, u: Floats, w: Floats, found: Mask) -> WaveFit:
    """Fit the plane waves of each cell at given direction cosines (n, k).

    Snapshots are those of `real_snapshots`; amplitudes are free in each. Directions outside of the mask
    `found` (n, k) only fill the row.
    """
    n, k = found.shape
    along_u, along_w = _line(snapshots.shape[1], u, found), _line(snapshots.shape[3], w, found)
    # Of waves and their first derivatives with each other along one line.
    first = along_u[:, : 2 * k], along_w[:, : 2 * k]
    in_u, in_w = ((line @ line.transpose(0, 2, 1)).reshape(n, 2, k, 2, k) for line in first)
    gram = in_u[:, 0, :, 0] * in_w[:, 0, :, 0] + (GRAM_LOADING + ~found)[:, None, :] * np.eye(k)
    mixed = in_u[:, 1, :, 0] * in_w[:, 0, :, 1]
    slopes = np.empty((n, 2, k, 2, k))
    slopes[:, 0, :, 0], slopes[:, 0, :, 1] = in_u[:, 1, :, 1] * in_w[:, 0, :, 0], mixed
    slopes[:, 1, :, 0], slopes[:, 1, :, 1] = mixed.transpose(0, 2, 1), in_u[:, 0, :, 0] * in_w[:, 1, :, 1]
    cross = np.concatenate([in_u[:, 1, :, 0] * in_w[:, 0, :, 0], in_u[:, 0, :, 0] * in_w[:, 1, :, 0]], axis=1)
    matched = _outputs(snapshots, along_u[:, :k], along_w[:, :k], k)[:, 0, 0]
    # Solved together: the inverse of a nearly singular matrix has no digits to multiply by.
    wanted = [np.broadcast_to(np.eye(k), gram.shape), matched, cross.transpose(0, 2, 1)]
    solved = np.linalg.solve(gram, np.concatenate(wanted, axis=2))
    inverse, amplitude, leaning = np.split(solved, [k, k + matched.shape[2]], axis=2)

    # Differences are taken before products: those of the rest keep the digits that products lose.
    echoes = along_u[:, :k].transpose(0, 2, 1)[:, :, None] * amplitude.transpose(0, 2, 1)[:, None]
    rows = snapshots.shape[1] * snapshots.shape[2]
    rest = snapshots - (echoes.reshape(n, rows, k) @ along_w[:, :k]).reshape(snapshots.shape)
    outputs = _outputs(rest, along_u, along_w, k)
    missed = inverse @ outputs[:, 0, 0]
    amplitude = amplitude + missed
    misfit = np.concatenate([outputs[:, 1, 0], outputs[:, 0, 1]], axis=1) - cross @ missed
    both = np.concatenate([amplitude, amplitude], axis=1)
    curvature = (slopes.reshape(n, 2 * k, 2 * k) - cross @ leaning) * (both @ both.transpose(0, 2, 1))
    # The rest of the second derivatives vanishes with the misfit.
    moved = np.tile(leaning, (1, 2, 1)) * (misfit @ both.transpose(0, 2, 1))
    taken = np.tile(inverse, (1, 2, 2)) * (misfit @ misfit.transpose(0, 2, 1))
    hessian = curvature + moved + moved.transpose(0, 2, 1) - taken
    bent = np.vecdot(outputs, amplitude[:, None, None])
    wave = np.arange(k)
    for (i, j), row, column in (((2, 0), 0, 0), ((1, 1), 0, k), ((1, 1), k, 0), ((0, 2), k, k)):
        hessian[:, wave + row, wave + column] -= bent[:, i, j]
    own_power = np.sum(amplitude**2, axis=2)
    return WaveFit(
        u=u.copy(),
        w=w.copy(),
        unexplained=_energy(rest) - np.sum(outputs[:, 0, 0] * missed, axis=(1, 2)),
        rounding=ROUNDING * _energy(snapshots),
        gradient=np.sum(both * misfit, axis=2),
        curvature=curvature,
        hessian=hessian,
        power=own_power,
        alone=own_power / np.einsum("nii->ni", inverse),
    )


def _energy(snapshots: Floats) -> Floats:
    """Sums of squares (n,)."""
    return np.einsum("npsq,npsq->n", snapshots, snapshots)


def _outputs(snapshots: Floats, along_u: Floats, along_w: Floats, k: int) -> Floats:
    """Outputs (n, i, j, k, s) of filters matched to derivatives of the orders i along u and j along w."""
    n, n_p, n_snapshots, n_q = snapshots.shape
    along_lines = snapshots.reshape(n, n_p * n_snapshots, n_q) @ along_w.transpose(0, 2, 1)
    beams = along_u @ along_lines.reshape(n, n_p, n_snapshots * along_w.shape[1])
    n_orders = along_u.shape[1] // k
    return np.einsum("niksjk->nijks", beams.reshape(n, n_orders, k, n_snapshots, n_orders, k)).copy()


def _line(n_elements: int, cosine: Floats, found: Mask) -> Floats:
    """Real responses of unit norm, their first and second derivatives (n, 3 k, elements); 0 for fillers."""
    slopes = real_steering_slopes(n_elements, cosine)
    slopes *= (found / np.sqrt(n_elements))[:, None, :, None]
    return slopes.reshape(len(found), 3 * found.shape[1], n_elements)


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
    found, data = waves.found.copy(), real_snapshots(snapshots)
    fit = refined(data, waves.u, waves.w, found, n_steps)
    changing = np.arange(len(found))
    while changing.size:
        u, w, fewer = _without_one(fit.at(changing), found[changing], noise, -np.log(pfa) * noise)
        changed = (fewer != found[changing]).any(axis=1)
        changing, fewer = changing[changed], fewer[changed]
        fit.put(changing, refined(data[changing], u[changed], w[changed], fewer, REFIT_STEPS))
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


def refined(snapshots: Floats, u: Floats, w: Floats, found: Mask, n_steps: int) -> WaveFit:
    """Fit after damped Gauss-Newton and Newton steps; cells that are nearly explained take more."""
    fit = fit_waves(snapshots, u, w, found)
    half_cells = np.repeat(snapshots.shape[1::2], found.shape[1]) / 2
    damping = np.full(len(snapshots), FIRST_DAMPING)
    near = np.zeros(len(snapshots), dtype=np.bool_)
    power = _energy(snapshots)
    least_gain = CONVERGED * power
    moving = np.flatnonzero(found.any(axis=1))
    for n_done in range(n_steps + FINISHING_STEPS):
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
        u, w = np.split(round_step(places * half_cells, step * half_cells) / half_cells, 2, axis=1)
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
        convex = is_positive(hessian)
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
