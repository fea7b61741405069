"""Scatterers that explain a range-Doppler map together: joint selection, grating lobes and joint fit.

A plane wave found in a cell may belong to a scatterer in the next cell or be
a sidelobe of one far away. So each scatterer is fitted together with all
others. An echo is the product of four kernels, along range, Doppler, u and w.
So is the response of one scatterer's matched filter to another: n scatterers
cost four n x n products for any size of the array. Where only one column and
one row of the array are read, the responses along u and w are added, not
multiplied.

Lobes next to each other differ by less than the sidelobes of other echoes.
A scatterer taken alone is easily put at a wrong one. Together scatterers are
resolved, because the echoes of all others are subtracted for each.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.dsp.bursts import SymbolBursts
from isacbench.dsp.fitting.atom_fits import AtomFit, polish_atoms, refine_atoms
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.pursuit import needless_atoms, noise_maximum
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.model.gate import Gate
from isacbench.model.kernels import dirichlet_slopes
from isacbench.model.numerology import System

PATCH = (3, 1)
"""Range and Doppler cells to either side that a matched filter reads: they hold most of an echo's energy."""

NEIGHBOURHOOD_BINS = 2.0
"""Range and Doppler bins in which weaker scatterers are compared with the strongest."""

COMPETING_RESPONSE = 0.3
"""Response above which two candidates compete: only the stronger joins, or changes its lobe, in a round."""

TIE = 1e-6
"""Relative difference that counts as rounding: of equal candidates the first joins, between equal lobes a
scatterer stays."""

REPEATING_RESPONSE = 0.8
"""Response above which a candidate only repeats a member."""

LOADING = 1e-3
"""Diagonal loading of unit responses: prevents scatterers half a bin apart from cancelling each other."""

LEAST_LOADING = 1e-9
"""Least loading: keeps equations of nearly equal scatterers soluble, and subtracts echoes completely."""

MAX_ROUNDS = 8
"""Rounds of the selection; four to six are usual."""

EXPLAINING_STEPS = 3
"""Newton steps of a fit in four coordinates, before and after scatterers have left it."""

POLISHING_STEPS = 3
"""Steps on the misfit of an explained map: each brings six digits or more."""

MOST_UNEXPLAINED = 2.0
"""Largest misfit around a scatterer of an explained map, in noise powers; means of 21 cells vary by 0.2."""

MOST_UNEXPLAINED_POWER = 20.0
"""Misfit after the first steps above which further steps do not help, in noise powers."""

MOST_MISPLACED = 1e-3
"""Largest misfit before the first step, per element, in powers of the strongest scatterer: a tenth of a bin
leaves as much. Sparse maps leave 1e-5; crowds leave 2e-3 and more, which no step explains."""

NOISE_CHANCE = 1e-2
"""Probability that noise alone explains a scatterer that is kept."""

LEAST_RESOLVED = 0.5
"""Share of scatterers from resolved cells below which a map counts as crowded, and no fit is tried."""

FEW = 16
"""Number of scatterers up to which the fit is tried in a crowded map too: it costs next to nothing."""

LOBE_ROUNDS = 16
"""Rounds of changes of lobes; two to four are usual."""


class MatchedFilters:
    """Matched filters of n scatterers, each on a patch of r x d cells around it.

    Kernels, and on a plane products of directions, are real but for phases: those of bins are taken from the
    beams, those of places and of the array's middle belong to the amplitudes.

    Parameters
    ----------
    scatterers : LocatedScatterers
    gated : GatedMap
        Without tapers.
    system : System
    beam : ndarray of complex128, shape (n, r, d), optional
        Of all scatterers, if it is known.

    Attributes
    ----------
    rows, columns : ndarray of int64, shapes (n, r) and (n, d)
        Range and Doppler indices of each patch.
    beam : ndarray of complex128, shape (n, r, d)
        Array output per element on the patch, steered to the scatterer.
    """

    def __init__(
        self, scatterers: LocatedScatterers, gated: GatedMap, system: System, beam: Complex | None = None
    ) -> None:
        self.scatterers, self.gated, self.system = scatterers, gated, system
        self.doppler = gated.doppler_kernel(system.n_symbols)
        self.rows = _around(scatterers.range_bin, gated.gate.range_bins, PATCH[0])
        self.columns = _around(scatterers.doppler_bin, gated.gate.doppler_bins, PATCH[1])
        self.beam = self._read() if beam is None else beam

    def __len__(self) -> int:
        return len(self.scatterers)

    def join(self, others: LocatedScatterers) -> MatchedFilters:
        """Append scatterers."""
        beam = np.concatenate([self.beam, MatchedFilters(others, self.gated, self.system).beam])
        return MatchedFilters(self.scatterers.join(others), self.gated, self.system, beam)

    def _read(self) -> Complex:
        """Beams (n, r, d) of the map."""
        gate, rows, columns = self.gated.gate, self.rows, self.columns
        filters = self._directions[0].conj() / self.gated.n_elements
        cells = self.gated.cells.reshape(*gate.shape, self.gated.n_elements)
        beam = np.empty((len(self), rows.shape[1], columns.shape[1]), dtype=np.complex128)
        # One by one: all patches together are many times the map.
        for row, column, direction, output in zip(rows, columns, filters, beam, strict=True):
            np.matmul(cells[row[0] : row[-1] + 1, column[0] : column[-1] + 1], direction, out=output)
        turn = np.exp(-1j * np.pi * (1 - 1 / self.system.n_subcarriers) * gate.range_bins)
        turn_back = np.exp(1j * np.pi * (1 - 1 / self.system.n_symbols) * gate.doppler_bins)
        return beam * turn[rows][:, :, None] * turn_back[columns][:, None, :]

    @cached_property
    def _directions(self) -> tuple[Complex, NDArray[np.inexact[Any]]]:
        """Array responses (n, elements), and responses (n, n) of beam i to a unit echo from direction j."""
        return self.gated.aperture.towards(self.scatterers.u, self.scatterers.w).about_middle()

    @cached_property
    def _unit_echoes(self) -> tuple[Floats, Floats]:
        """Echoes (n_range, n) and (n_doppler, n) of all scatterers in the gate."""
        gate, found = self.gated.gate, self.scatterers
        in_range, in_doppler = gate.range_bins[:, None], gate.doppler_bins[:, None]
        along_range = dirichlet_slopes(in_range - found.range_bin, self.system.n_subcarriers, 0)[0]
        along_doppler = self.doppler.slopes(in_doppler - found.doppler_bin, 0)[0]
        return along_range, along_doppler

    @cached_property
    def outputs(self) -> tuple[Complex, NDArray[np.inexact[Any]]]:
        """Outputs (n,) of the filters, per element, and responses (n, n) of each to unit echoes of all.

        A filter has 1 of its own.
        """
        along_range, along_doppler = self._unit_echoes
        in_range, range_filter = _filters(along_range, self.rows)
        in_doppler, doppler_filter = _filters(along_doppler, self.columns)
        response = (in_range @ along_range) * (in_doppler @ along_doppler) * self._directions[1]
        gain = response.diagonal().real.copy()
        output = (range_filter[:, None] @ self.beam @ doppler_filter[:, :, None])[:, 0, 0]
        return output / gain, response / gain[:, None]

    def echoes(self, amplitude: Complex) -> Complex:
        """Sums (n, r, d) of the echoes of all scatterers in each beam."""
        along_range, along_doppler = self._unit_echoes
        weighted = along_range[self.rows] * (self._directions[1] * amplitude)[:, None]
        return weighted @ along_doppler[self.columns].transpose(0, 2, 1)

    def amplitudes(self, member: Mask | None = None, loading: float = LOADING) -> Complex:
        """Amplitudes (n,) that explain the outputs of all members' filters together, 0 for the others."""
        matched, response = self.outputs
        members = np.arange(len(self)) if member is None else np.flatnonzero(member)
        square = response[np.ix_(members, members)] + loading * np.eye(members.size)
        target = matched[members].view(np.float64).reshape(-1, 2)
        amplitude = np.zeros_like(matched)
        amplitude[members] = np.linalg.solve(square, target) @ np.array([1, 1j])
        return amplitude


def select_jointly(
    filters: MatchedFilters, min_power: float, dynamic_range_db: float, n_members: int = 0
) -> MatchedFilters:
    """Select the scatterers that explain the map together.

    In each round, candidates join the members if they stand out in the residual
    that the members leave; of competing candidates only the strongest joins.
    All amplitudes are then fitted anew, and members that are weak compared with
    their neighbours leave. Candidates of one family do not compete with each
    other: their cell has resolved them. With gapped symbols, the selected
    scatterers finally move to their best grating lobes
    (`isacbench.dsp.fitting.joint_selection`).

    Parameters
    ----------
    filters : MatchedFilters
        Of the candidates.
    min_power : float
        Power per element that a matched filter's output must exceed.
    dynamic_range_db : float
        Scatterers further below the strongest one of their neighbourhood are
        left out.
    n_members : int
        How many of the first candidates are members from the start.

    Returns
    -------
    MatchedFilters
        Of those selected, with the powers of the joint fit.
    """
    if not len(filters):
        return filters
    matched, response = filters.outputs
    likeness = np.where(_known_apart(filters.scatterers), 0, np.abs(response))
    competes, repeats = likeness > COMPETING_RESPONSE, likeness > REPEATING_RESPONSE
    first, second = np.nonzero(_nearby(filters))
    starts = np.searchsorted(first, np.arange(len(filters)))
    weakest = 10 ** (-dynamic_range_db / 20)
    member = np.arange(len(filters)) < n_members
    amplitude = filters.amplitudes(member)
    for _ in range(MAX_ROUNDS):
        explained = response @ amplitude.view(np.float64).reshape(-1, 2) @ np.array([1, 1j])
        residual = np.abs(matched - explained)
        candidate = np.where(member, 0, residual)
        strongest = np.maximum.reduceat(np.maximum(np.abs(amplitude), candidate)[second], starts)
        joins = (candidate > weakest * strongest) & (candidate**2 > min_power)
        some = np.flatnonzero(joins)
        joins[some] = _wins(candidate, some, competes[some]) & ~(repeats[some] & member).any(axis=1)
        if not joins.any():
            break
        member |= joins
        amplitude = filters.amplitudes(member)
        level = np.abs(amplitude)
        strongest = np.maximum.reduceat(level[second], starts)
        leaves = member & ((level < weakest * strongest) | (level**2 < min_power))
        if leaves.any():
            member &= ~leaves
            amplitude = filters.amplitudes(member)
    chosen = replace(filters.scatterers, power=np.abs(amplitude) ** 2).select(member)
    selected = MatchedFilters(chosen, filters.gated, filters.system, filters.beam[member])
    return _at_best_lobes(selected) if filters.gated.sees_lobes else selected


def _at_best_lobes(selected: MatchedFilters) -> MatchedFilters:
    """Move each scatterer to the grating lobe that fits the map best once all other echoes are subtracted."""
    if not len(selected):
        return selected
    gated, system, scatterers = selected.gated, selected.system, selected.scatterers
    owner, doppler_bin = lobes_within(scatterers.doppler_bin, selected.doppler, gated.gate)
    lobes = replace(scatterers.select(owner), doppler_bin=doppler_bin)
    filters = MatchedFilters(lobes, gated, system)
    chosen = best_lobes(*filters.outputs, owner)
    member = np.isin(np.arange(owner.size), chosen)
    at_lobes = replace(lobes, power=np.abs(filters.amplitudes(member)) ** 2).select(chosen)
    return MatchedFilters(at_lobes, gated, system, filters.beam[chosen])


def explain_map(filters: MatchedFilters, noise: float) -> LocatedScatterers | None:
    """Move scatterers in all four coordinates to the least-squares fit, if that explains the map.

    `noise` is the power of white noise per element. Echoes that are not
    modelled bias the fit. In a crowd this error is larger than the one that the fit removes: None is returned
    where the map is crowded, or where the scatterers leave too much of it unexplained, many of them already
    before the fit. Scatterers that noise makes indistinguishable from another are left out.
    """
    scatterers, gated, system = filters.scatterers, filters.gated, filters.system
    if not len(scatterers):
        return scatterers
    most_left = MOST_UNEXPLAINED_POWER * noise
    n_independent = float(np.count_nonzero(gated.gate.reachable) * gated.n_elements)
    highest_noise = noise * noise_maximum(n_independent, NOISE_CHANCE)
    if len(scatterers) > FEW:
        if np.mean(scatterers.family >= 0) < LEAST_RESOLVED:
            return None
        misplaced = MOST_MISPLACED * gated.n_elements * float(np.abs(filters.outputs[0]).max()) ** 2
        if _most_unexplained(filters) > most_left + misplaced:
            return None
    atom_map = AtomMap.from_map(gated, system)
    start = np.stack([scatterers.range_bin, scatterers.doppler_bin, scatterers.u, scatterers.w], axis=1)
    fit = refine_atoms(atom_map, start / atom_map.cell_size, EXPLAINING_STEPS)
    if _most_unexplained(MatchedFilters(_placed(scatterers, fit, atom_map), gated, system)) > most_left:
        return None
    while True:
        drop, places = needless_atoms(fit, highest_noise)
        scatterers = scatterers.select(~drop)
        if not len(scatterers):
            return scatterers
        fit = refine_atoms(atom_map, places[~drop], EXPLAINING_STEPS)
        if not drop.any():
            break
    filters = MatchedFilters(_placed(scatterers, fit, atom_map), gated, system)
    if _most_unexplained(filters) > MOST_UNEXPLAINED * noise:
        return None
    return _placed(scatterers, polish_atoms(atom_map, fit, POLISHING_STEPS), atom_map)


def _placed(scatterers: LocatedScatterers, fit: AtomFit, atom_map: AtomMap) -> LocatedScatterers:
    """Scatterers at the places and with the power of their atoms."""
    range_bin, doppler_bin, u, w = (fit.places * atom_map.cell_size).T
    power = fit.power / np.prod(atom_map.array_shape)
    return LocatedScatterers(range_bin, doppler_bin, u, w, power, scatterers.family)


def _most_unexplained(filters: MatchedFilters) -> float:
    """Largest mean power per element around any scatterer after the echoes of all are subtracted."""
    # The usual loading leaves a rest of each echo: 76 dB above the noise it would count as unexplained.
    amplitude = filters.amplitudes(loading=LEAST_LOADING)
    misfit = filters.beam - filters.echoes(amplitude)
    power = np.mean(misfit.real**2 + misfit.imag**2, axis=(1, 2)) * filters.gated.n_elements
    return float(power.max())


def _filters(echoes: Floats, cells: Integers) -> tuple[Floats, Floats]:
    """Filters (n, b) matched to echoes (b, n) in k cells of each, and what they have there (n, k)."""
    filters, own = np.zeros_like(echoes.T, order="C"), np.take_along_axis(echoes.T, cells, axis=1)
    np.put_along_axis(filters, cells, own, axis=1)
    return filters, own


def _around(places: Floats, bins: Integers, n_side: int) -> Integers:
    """Indices (n, k) of the bins around each place, shifted to stay inside the gate."""
    width = min(2 * n_side + 1, bins.size)
    first = np.clip(np.rint(places).astype(np.int64) - bins[0] - width // 2, 0, bins.size - width)
    return first[:, None] + np.arange(width)


def _nearby(filters: MatchedFilters) -> Mask:
    """Pairs (n, n) close enough in range and Doppler to be compared with each other."""
    range_bin, doppler_bin = filters.scatterers.range_bin, filters.scatterers.doppler_bin
    in_range = np.abs(range_bin[:, None] - range_bin)
    in_doppler = filters.doppler.to_lobe(np.abs(doppler_bin[:, None] - doppler_bin))
    return (in_range < NEIGHBOURHOOD_BINS) & (in_doppler < NEIGHBOURHOOD_BINS)


def _wins(candidate: Floats, which: Integers, competes: Mask) -> Mask:
    """Those (m,) of candidates (n,) that compete with no stronger one, and with no earlier one as strong."""
    rivals, own = np.where(competes, candidate, 0), candidate[which, None]
    stronger = rivals > (1 + TIE) * own
    first_as_strong = np.argmax(rivals >= (1 - TIE) * own, axis=1)
    return ~stronger.any(axis=1) & (first_as_strong >= which)


def _known_apart(scatterers: LocatedScatterers) -> Mask:
    """Pairs (n, n) of different scatterers of one family."""
    family = scatterers.family
    apart: Mask = (family[:, None] == family) & (family >= 0)
    np.fill_diagonal(apart, False)
    return apart


def lobes_within(doppler_bin: Floats, bursts: SymbolBursts, gate: Gate) -> tuple[Integers, Floats]:
    """Find the grating lobes of scatterers at Doppler bins (n,) within the speeds of the region.

    Returned are the scatterer of each place (m,), first the n scatterers at their own places, then their
    lobes; and the Doppler bins (m,) of the places.
    """
    n, reach = doppler_bin.size, gate.reachable_doppler
    slowest, fastest = gate.doppler_bins[reach.start] - 0.5, gate.doppler_bins[reach.stop - 1] + 0.5
    n_lobes = int((fastest - slowest) / bursts.lobe_period)
    steps = np.repeat(np.r_[0, -n_lobes:0, 1 : n_lobes + 1], n)
    owner = np.tile(np.arange(n), 2 * n_lobes + 1)
    # A single burst has an infinite period, and no step but 0.
    place = doppler_bin[owner] + (steps * bursts.lobe_period if n_lobes else 0.0)
    exists = (steps == 0) | ((place >= slowest) & (place <= fastest))
    return owner[exists], place[exists]


def best_lobes(matched: Complex, response: NDArray[np.inexact[Any]], owner: Integers) -> Integers:
    """Choose for each of n scatterers the place where the map, less all others' echoes, shows it most.

    `matched` (m,) are outputs of the matched filters of all places, of comparable scale; `response` (m, m) is
    that of filter i to a scatterer at place j, 1 at its own; `owner` (m,) is the scatterer of each place, the
    first n of them 0 to n - 1.
    """
    n, everywhere = int(owner.max(initial=-1)) + 1, np.arange(owner.size)
    current = np.arange(n)
    if not n:
        return current
    first = np.searchsorted(np.sort(owner), current)
    for _ in range(LOBE_ROUNDS):
        square = response[np.ix_(current, current)]
        amplitude = np.linalg.solve(square + LOADING * np.eye(n), matched[current])
        own = response[everywhere, current[owner]] * amplitude[owner]
        shown = np.abs(matched - response[:, current] @ amplitude + own)
        best = np.lexsort([-shown, owner])[first]
        gain = shown[best] - shown[current]
        changes = (gain > TIE * shown[current]) & _leads(gain, np.abs(square) > COMPETING_RESPONSE)
        if not changes.any():
            break
        current = np.where(changes, best, current)
    return current


def _leads(gain: Floats, competes: Mask) -> Mask:
    """Mask (n,) of the scatterers that gain most among those that they compete with; of equals the first."""
    leader = np.where(competes, gain, -np.inf).argmax(axis=1)
    return leader == np.arange(gain.size)
