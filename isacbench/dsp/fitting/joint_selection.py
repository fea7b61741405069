"""Scatterers that explain a range-Doppler map together: joint selection and joint refinement.

A plane wave that a cell shows may belong to a scatterer next door or be a
sidelobe of one far away. Here every scatterer answers for its share of all
the others' responses. An echo is the product of four kernels, along range,
Doppler, u and w, and so is the response of one scatterer's matched filter to
another: n scatterers cost four n x n products, whatever the array's size. Where
one column and one row of the array are read, those of u and w add instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.bursts import SymbolBursts
from isacbench.dsp.fitting.atom_fits import AtomFit, refine_atoms, settle_atoms
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.grating_lobes import best_lobes, lobes_within
from isacbench.dsp.fitting.pursuit import redundant
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.model.kernels import dirichlet
from isacbench.model.numerology import System

Floats = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]

PATCH = (3, 1)
"""Range and Doppler cells to either side that a matched filter reads: most of an echo's energy."""

NEIGHBOURHOOD_BINS = 2.0
"""Range and Doppler bins in which weaker scatterers are held against the strongest."""

COMPETING_RESPONSE = 0.3
"""Response from which two candidates compete: only the stronger joins in a round."""

TIE = 1e-6
"""Difference of two candidates, relative to them, that is rounding: of such the first joins."""

REPEATING_RESPONSE = 0.8
"""Response from which a candidate only repeats a member."""

LOADING = 1e-3
"""Of unit responses: keeps the amplitudes of scatterers half a bin apart from cancelling each other."""

LEAST_LOADING = 1e-9
"""Of unit responses: keeps equations of nearly equal scatterers soluble; leaves nothing of an echo behind."""

MAX_ROUNDS = 8
"""Rounds of the selection; four to six are usual."""

REFINEMENTS = 2
"""Gauss-Newton steps of the refinement: the start is within half a bin."""

EXPLAINING_STEPS = 3
"""Newton steps of a fit in four coordinates, before and after scatterers have left it."""

SETTLING_STEPS = 3
"""Steps on what is left of the map, where scatterers are close: each brings six digits or more."""

MOST_UNEXPLAINED = 2.0
"""Of white noise: what may be left around each scatterer of an explained map; means of 21 scatter by 0.2."""

HOPELESS = 20.0
"""The same after the first steps, from which no more of them help."""

LEAST_RESOLVED = 0.5
"""Share of scatterers from resolved cells below which a map is a crowd, and no fit is tried..."""

FEW = 16
"""... unless there are so few that it costs next to nothing."""

SLOPE_STEP_BINS = 1e-4
"""Step of central differences: their error of 1e-8 is far below what a Gauss-Newton step needs."""

MAX_SHIFT_BINS = 0.5
"""Farthest that the refinement moves a scatterer."""


@dataclass(frozen=True, eq=False)
class _Patches:
    """What the map holds around each of n scatterers, along the scatterer's own direction.

    Attributes
    ----------
    rows, columns : ndarray of int64, shapes (n, r) and (n, d)
        Range and Doppler indices of each patch.
    beam : ndarray of complex128, shape (n, r, d)
        Array output per element, steered to the scatterer.
    direction_response : ndarray of complex128, shape (n, n)
        Response of beam i to a unit echo from the direction of scatterer j.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    beam: Complex
    direction_response: Complex


@dataclass(frozen=True, eq=False)
class _Kernels:
    """Unit echoes of n scatterers on all patches: shapes (n, r, n) and (n, d, n), patch first."""

    along_range: Complex
    along_doppler: Complex

    @property
    def own_range(self) -> Complex:
        """Each scatterer's echo on its own patch, shape (n, r)."""
        return self.along_range.diagonal(axis1=0, axis2=2).T

    @property
    def own_doppler(self) -> Complex:
        """Each scatterer's echo on its own patch, shape (n, d)."""
        return self.along_doppler.diagonal(axis1=0, axis2=2).T


def select_jointly(
    scatterers: LocatedScatterers,
    gated: GatedMap,
    system: System,
    min_power: float,
    dynamic_range_db: float,
    n_members: int = 0,
) -> LocatedScatterers:
    """Select the scatterers that explain the map together.

    In rounds, candidates that stand out from what the members leave
    unexplained join, the strongest of those that compete; all amplitudes are
    fitted anew, and members that turn out weak beside their neighbours leave.
    Those of one family do not compete with each other: their cell has told them
    apart. Of gapped symbols, what was selected changes to its best grating lobes in
    the end (`isacbench.dsp.fitting.grating_lobes`).

    Parameters
    ----------
    scatterers : LocatedScatterers
        Candidates.
    gated : GatedMap
        Without tapers.
    system : System
    min_power : float
        Power per element that a matched filter's output must exceed.
    dynamic_range_db : float
        How far below the strongest of its neighbourhood a scatterer may lie.
    n_members : int, default 0
        The first of the candidates, which are members from the start.

    Returns
    -------
    LocatedScatterers
        With the powers of the joint fit.
    """
    if not len(scatterers):
        return scatterers
    patches = _read_patches(scatterers, gated)
    matched, response = _matched_filters(patches, _kernels(scatterers, patches, gated, system))
    likeness = np.where(_known_apart(scatterers), 0, np.abs(response))
    nearby = _nearby(scatterers, gated.doppler_kernel(system.n_symbols))
    weakest = 10 ** (-dynamic_range_db / 20)
    member = np.arange(len(scatterers)) < n_members
    amplitude = _fit(matched, response, member)
    residual = np.abs(matched - response @ amplitude)
    for _ in range(MAX_ROUNDS):
        candidate = np.where(member, 0, residual)
        strongest = np.where(nearby, np.maximum(np.abs(amplitude), candidate), 0).max(axis=1)
        joins = (candidate > weakest * strongest) & (candidate**2 > min_power)
        joins &= _wins(candidate, likeness > COMPETING_RESPONSE)
        joins &= ~(likeness[:, member] > REPEATING_RESPONSE).any(axis=1)
        if not joins.any():
            break
        member |= joins
        amplitude = _fit(matched, response, member)
        strongest = np.where(nearby, np.abs(amplitude), 0).max(axis=1)
        leaves = member & ((np.abs(amplitude) < weakest * strongest) | (np.abs(amplitude) ** 2 < min_power))
        if leaves.any():
            member &= ~leaves
            amplitude = _fit(matched, response, member)
        residual = np.abs(matched - response @ amplitude)
    chosen = replace(scatterers, power=np.abs(amplitude) ** 2).select(member)
    return _at_best_lobes(chosen, gated, system) if gated.sees_lobes else chosen


def _at_best_lobes(scatterers: LocatedScatterers, gated: GatedMap, system: System) -> LocatedScatterers:
    """Scatterers at those of their grating lobes where the map, less all others' echoes, shows them most."""
    if not len(scatterers):
        return scatterers
    bursts = gated.doppler_kernel(system.n_symbols)
    owner, doppler_bin = lobes_within(scatterers.doppler_bin, bursts, gated.gate)
    lobes = replace(scatterers.select(owner), doppler_bin=doppler_bin)
    patches = _read_patches(lobes, gated)
    matched, response = _matched_filters(patches, _kernels(lobes, patches, gated, system))
    chosen = best_lobes(matched, response, owner)
    amplitude = _fit(matched[chosen], response[np.ix_(chosen, chosen)], np.ones(chosen.size, dtype=np.bool_))
    return replace(lobes.select(chosen), power=np.abs(amplitude) ** 2)


def refine_jointly(scatterers: LocatedScatterers, gated: GatedMap, system: System) -> LocatedScatterers:
    """Move scatterers between bins to where the map, less all others' echoes, has them.

    Each Gauss-Newton step fits all amplitudes together, takes from every
    patch what the others put there, and fits amplitude, range and Doppler of
    its scatterer to the rest.

    Parameters
    ----------
    scatterers : LocatedScatterers
    gated : GatedMap
        Without tapers.
    system : System

    Returns
    -------
    LocatedScatterers
        Moved by at most half a bin in range and in Doppler.

    References
    ----------
    Li and Stoica, "Efficient mixed-spectrum estimation with applications to
    target feature extraction", IEEE Trans. SP 44 (1996): RELAX.
    """
    if not len(scatterers):
        return scatterers
    patches = _read_patches(scatterers, gated)
    refined = scatterers
    everyone = np.ones(len(scatterers), dtype=np.bool_)
    kernels = _kernels(refined, patches, gated, system)
    amplitude = _fit(*_matched_filters(patches, kernels), everyone)
    range_limits = scatterers.range_bin - MAX_SHIFT_BINS, scatterers.range_bin + MAX_SHIFT_BINS
    doppler_limits = scatterers.doppler_bin - MAX_SHIFT_BINS, scatterers.doppler_bin + MAX_SHIFT_BINS
    for _ in range(REFINEMENTS):
        range_step, doppler_step = _gauss_newton(refined, amplitude, patches, kernels, gated, system)
        range_bin, doppler_bin = refined.range_bin + range_step, refined.doppler_bin + doppler_step
        refined = replace(
            refined,
            range_bin=np.clip(range_bin, *range_limits),
            doppler_bin=np.clip(doppler_bin, *doppler_limits),
        )
        kernels = _kernels(refined, patches, gated, system)
        amplitude = _fit(*_matched_filters(patches, kernels), everyone)
    return replace(refined, power=np.abs(amplitude) ** 2)


def explain_map(
    scatterers: LocatedScatterers, gated: GatedMap, system: System, noise: float
) -> LocatedScatterers | None:
    """Move scatterers in all four coordinates to the least-squares fit, if that explains the map.

    A fit bends to whatever is not modelled, and in a crowd this is more than
    the error that it removes.

    Parameters
    ----------
    scatterers : LocatedScatterers
    gated : GatedMap
        Without tapers.
    system : System
    noise : float
        Power of white noise per element.

    Returns
    -------
    LocatedScatterers or None
        Without those that noise does not tell from another. None where the map
        holds more than any places of these scatterers explain.
    """
    if not len(scatterers):
        return scatterers
    if len(scatterers) > FEW and np.mean(scatterers.family >= 0) < LEAST_RESOLVED:
        return None
    atom_map = AtomMap.from_map(gated, system)
    start = np.stack([scatterers.range_bin, scatterers.doppler_bin, scatterers.u, scatterers.w], axis=1)
    fit = refine_atoms(atom_map, start / atom_map.cell_size, EXPLAINING_STEPS)
    if _most_unexplained(scatterers, fit, gated, system) > HOPELESS * noise:
        return None
    while True:
        drop, places = redundant(fit, noise)
        scatterers = scatterers.select(~drop)
        if not len(scatterers):
            return scatterers
        fit = refine_atoms(atom_map, places[~drop], EXPLAINING_STEPS)
        if not drop.any():
            break
    if _most_unexplained(scatterers, fit, gated, system) > MOST_UNEXPLAINED * noise:
        return None
    return _placed(scatterers, settle_atoms(atom_map, fit, SETTLING_STEPS), gated)


def _placed(scatterers: LocatedScatterers, fit: AtomFit, gated: GatedMap) -> LocatedScatterers:
    """Scatterers at the places and with the power of their atoms."""
    cell_size = np.array([1.0, 1.0, 2 / gated.aperture.n_p, 2 / gated.aperture.n_q])
    range_bin, doppler_bin, u, w = (fit.places * cell_size).T
    return LocatedScatterers(range_bin, doppler_bin, u, w, fit.power / gated.n_elements, scatterers.family)


def _most_unexplained(scatterers: LocatedScatterers, fit: AtomFit, gated: GatedMap, system: System) -> float:
    """Largest mean power per element that the map holds beside all echoes, around any atom."""
    return float(_unexplained(_placed(scatterers, fit, gated), gated, system).max())


def _unexplained(scatterers: LocatedScatterers, gated: GatedMap, system: System) -> Floats:
    """Mean power per element (n,) that the map holds beside all echoes, around each scatterer."""
    patches = _read_patches(scatterers, gated)
    kernels = _kernels(scatterers, patches, gated, system)
    everyone = np.ones(len(scatterers), dtype=np.bool_)
    # What a loaded fit leaves of echoes 76 dB above the noise would count as unexplained.
    amplitude = _fit(*_matched_filters(patches, kernels), everyone, LEAST_LOADING)
    misfit = patches.beam - _echoes(kernels, patches.direction_response * amplitude)
    power: Floats = np.mean(misfit.real**2 + misfit.imag**2, axis=(1, 2)) * gated.n_elements
    return power


def _echoes(kernels: _Kernels, shares: Complex) -> Complex:
    """What scatterers leave on all patches (n, r, d), each with its share (n, n) of the patch's direction."""
    echoes: Complex = (kernels.along_range * shares[:, None, :]) @ kernels.along_doppler.transpose(0, 2, 1)
    return echoes


def _read_patches(scatterers: LocatedScatterers, gated: GatedMap) -> _Patches:
    n, aperture = len(scatterers), gated.aperture
    rows = _around(scatterers.range_bin, gated.gate.range_bins, PATCH[0])
    columns = _around(scatterers.doppler_bin, gated.gate.doppler_bins, PATCH[1])
    patch = gated.cells[rows[:, :, None], columns[:, None, :]].reshape(n, -1, *aperture.shape)
    responses = aperture.towards(scatterers.u, scatterers.w)
    beam = responses.beams(patch).reshape(n, rows.shape[1], columns.shape[1])
    return _Patches(rows, columns, beam, responses.gram())


def _around(places: Floats, bins: NDArray[np.int64], n_side: int) -> NDArray[np.int64]:
    """Indices (n, k) of the bins around each place, shifted to stay inside the gate."""
    width = min(2 * n_side + 1, bins.size)
    first = np.clip(np.rint(places).astype(np.int64) - bins[0] - width // 2, 0, bins.size - width)
    around: NDArray[np.int64] = first[:, None] + np.arange(width)
    return around


def _kernels(scatterers: LocatedScatterers, patches: _Patches, gated: GatedMap, system: System) -> _Kernels:
    gate, doppler = gated.gate, gated.doppler_kernel(system.n_symbols)
    along_range = dirichlet(gate.range_bins, scatterers.range_bin, system.n_subcarriers)
    along_doppler = doppler.response(gate.doppler_bins, scatterers.doppler_bin)
    return _Kernels(
        along_range[patches.rows] / np.sqrt(system.n_subcarriers),
        along_doppler[patches.columns] / np.sqrt(system.n_symbols),
    )


def _matched_filters(patches: _Patches, kernels: _Kernels) -> tuple[Complex, Complex]:
    """Outputs (n,) of every scatterer's matched filter, and its responses (n, n) to every scatterer.

    A filter reads its patch and responds with 1 to its own scatterer.
    """
    own_range, own_doppler = kernels.own_range.conj(), kernels.own_doppler.conj()
    response = (own_range[:, None, :] @ kernels.along_range)[:, 0]
    response *= (own_doppler[:, None, :] @ kernels.along_doppler)[:, 0]
    response *= patches.direction_response
    own = response.diagonal().real.copy()
    matched = (own_range[:, None, :] @ patches.beam @ own_doppler[:, :, None])[:, 0, 0]
    return matched / own, response / own[:, None]


def _nearby(scatterers: LocatedScatterers, doppler: SymbolBursts) -> NDArray[np.bool_]:
    """Pairs (n, n) close enough in range and Doppler to be held against each other."""
    range_bin, doppler_bin = scatterers.range_bin, scatterers.doppler_bin
    near: NDArray[np.bool_] = (np.abs(range_bin[:, None] - range_bin) < NEIGHBOURHOOD_BINS) & (
        doppler.to_lobe(np.abs(doppler_bin[:, None] - doppler_bin)) < NEIGHBOURHOOD_BINS
    )
    return near


def _wins(candidate: Floats, competes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which candidates (n,) no other stronger one competes with, or an earlier one as strong."""
    rivals = np.where(competes, candidate, 0)
    stronger = rivals > (1 + TIE) * candidate[:, None]
    first_as_strong = np.argmax(rivals >= (1 - TIE) * candidate[:, None], axis=1)
    wins: NDArray[np.bool_] = ~stronger.any(axis=1) & (first_as_strong >= np.arange(candidate.size))
    return wins


def _known_apart(scatterers: LocatedScatterers) -> NDArray[np.bool_]:
    """Pairs (n, n) of different scatterers of one family."""
    family = scatterers.family
    apart: NDArray[np.bool_] = (family[:, None] == family) & (family >= 0)
    np.fill_diagonal(apart, False)
    return apart


def _fit(matched: Complex, response: Complex, member: NDArray[np.bool_], loading: float = LOADING) -> Complex:
    """Amplitudes (n,) that explain all members' filter outputs together, 0 for the others."""
    amplitude = np.zeros_like(matched)
    square = response[np.ix_(member, member)] + loading * np.eye(int(member.sum()))
    amplitude[member] = np.linalg.solve(square, matched[member])
    return amplitude


def _gauss_newton(
    scatterers: LocatedScatterers,
    amplitude: Complex,
    patches: _Patches,
    kernels: _Kernels,
    gated: GatedMap,
    system: System,
) -> tuple[Floats, Floats]:
    """Steps (n,) in range and Doppler bins, each scatterer's amplitude free, all others held."""
    n = len(scatterers)
    shares = patches.direction_response * amplitude
    np.fill_diagonal(shares, 0)
    others = _echoes(kernels, shares)
    own_range, own_doppler = kernels.own_range, kernels.own_doppler
    echo = own_range[:, :, None] * own_doppler[:, None, :]
    range_slope, doppler_slope = _own_slopes(scatterers, patches, gated, system)
    strength = np.abs(amplitude)
    phase = np.divide(amplitude, strength, out=np.ones_like(amplitude), where=strength > 0)[:, None, None]
    # Slopes of a unit echo: the four columns then have one unit, whatever that of the map.
    model = np.stack(
        [
            echo,
            1j * echo,
            phase * range_slope[:, :, None] * own_doppler[:, None, :],
            phase * own_range[:, :, None] * doppler_slope[:, None, :],
        ],
        axis=1,
    ).reshape(n, 4, -1)
    misfit = (patches.beam - others - amplitude[:, None, None] * echo).reshape(n, -1, 1)
    curvature = (model.conj() @ model.transpose(0, 2, 1)).real
    gradient = (model.conj() @ misfit).real
    step = (np.linalg.pinv(curvature, rcond=1e-10, hermitian=True) @ gradient)[:, :, 0]
    shift = np.divide(step[:, 2:], strength[:, None], out=np.zeros((n, 2)), where=strength[:, None] > 0)
    return shift[:, 0], shift[:, 1]


def _own_slopes(
    scatterers: LocatedScatterers, patches: _Patches, gated: GatedMap, system: System
) -> tuple[Complex, Complex]:
    """Derivatives (n, r) and (n, d) of each scatterer's echo on its own patch with its place, per bin."""
    n_subcarriers, n_symbols = system.n_subcarriers, system.n_symbols
    range_bins, doppler_bins = gated.gate.range_bins, gated.gate.doppler_bins
    doppler, step = gated.doppler_kernel(n_symbols), SLOPE_STEP_BINS
    nearer, farther = scatterers.range_bin - step, scatterers.range_bin + step
    range_rise = dirichlet(range_bins, farther, n_subcarriers) - dirichlet(range_bins, nearer, n_subcarriers)
    slower, faster = scatterers.doppler_bin - step, scatterers.doppler_bin + step
    doppler_rise = doppler.response(doppler_bins, faster) - doppler.response(doppler_bins, slower)
    return (
        np.take_along_axis(range_rise.T / (2 * step * np.sqrt(n_subcarriers)), patches.rows, axis=1),
        np.take_along_axis(doppler_rise.T / (2 * step * np.sqrt(n_symbols)), patches.columns, axis=1),
    )
