"""Residual of a matching pursuit in four dimensions, the moves of a round, and atoms to drop.

The residual is seen through beams towards the directions of the region. Beams
of the map are formed once; those of atoms are products of four kernels, so that
a new residual needs no element of the array again.

The misfit of strong echoes scales with them. A residual peak is an echo only
if it exceeds the misfit that stronger atoms may leave there: the same fraction
of each of them, spread like its sidelobes.

Places are in Rayleigh cells, shape (n, 4): range, Doppler, u and w. The gain
of a move is the energy that it takes from the residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.dsp.bursts import SymbolBursts, whole_frame
from isacbench.dsp.fitting.atom_fits import AtomFit
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap, product_matrix, sum_of_echoes
from isacbench.dsp.floating_point import round_mantissa
from isacbench.model.gate import Gate
from isacbench.model.region import Interval

BEAMS_A_CELL = 2
"""Beams a Rayleigh cell: halfway between two of them an echo keeps 81 % of its power along each axis."""

MARGIN_BINS = 2
"""Range and Doppler bins beyond those of the region in which its echoes still show."""

NEIGHBOURHOOD_BINS = 2.0 + 1e-9
"""Range and Doppler bins in which weaker atoms are compared with the strongest, in any direction. More than
two: at the borders of their boxes atoms are two bins apart but for rounding."""

MOST_PAIRS = 1 << 15
"""Pairs of a place and an atom computed at once: 1 MiB of distances."""

SPLIT_OFFSETS_CELLS = (0.15, 0.5)
"""Least and largest distance of the two starts from the atom that is split."""

SPLIT_STANDOUT = 25.0
"""Gain of a split over the mean residual around it."""

SPLIT_RESIDUAL = 0.1
"""Residual around an atom, relative to it, above which a crowd is there and not a second echo."""

LEAST_FREE = 1e-6
"""Least share of an atom's second derivative, in energy, that is orthogonal to the atom; less is rounding."""

FIXED_POINT_STEPS = 40
"""Each halves the error of a level, or better."""

TIE_DIGITS = 9
"""Digits in which energies are compared: the rest is rounding."""

UNGAPPED = whole_frame(1)
"""Symbols of a frame that is sensed as a whole: the bound of its sidelobes holds for any number of them."""

ROUND_RANGE_DB = 6.0
"""Moves of a round gain at most this much less than the best one."""

APART_CELLS = 1.0 - 1e-9
"""Least distance between the moves of one round. Less than one: peaks are one apart but for rounding."""

SPLIT_PREFERENCE = 2.0
"""Factor by which a split is preferred to a new atom nearby, which would only be the first of two."""

PAIR_CELLS = 0.8
"""Distance from the atom that was split, within which its two parts must lie."""

MISFIT_SHARE, MISFIT_AROUND = 0.3, 6.0
"""Energy that a lone atom explains at most, over what is left elsewhere on its line and around itself, if it
may be the misfit of others."""

MOST_LEFT = 64
"""Number of strongest unexplained peaks of the residual whose sidelobes are not taken for atoms."""


@dataclass(frozen=True, eq=False)
class BeamSpace:
    """Beams of a map towards the directions of a region, in the bins that it can reach.

    Attributes
    ----------
    reach : (slice, slice)
        Where in the map's range and Doppler bins those of the beams lie.
    u, w : ndarray of float64
        Directions in Rayleigh cells, equidistant.
    beams : ndarray of complex128, shape (n_range, n_doppler, n_u, n_w)
        Outputs of unit-energy beams.
    n_independent : float
        Rayleigh cells of the region itself: independent noise samples.
    """

    atom_map: AtomMap
    reach: tuple[slice, slice]
    u: Floats
    w: Floats
    beams: Complex
    n_independent: float

    @classmethod
    def from_map(cls, atom_map: AtomMap, gate: Gate, cosine_limits: tuple[Interval, Interval]) -> BeamSpace:
        """Form the beams within the lowest and highest u, and w."""
        u, w = (
            np.arange(np.floor(lower / step), np.ceil(upper / step) + 1) / BEAMS_A_CELL
            for (lower, upper), step in zip(cosine_limits, atom_map.cell_size[2:] / BEAMS_A_CELL, strict=True)
        )
        towards_u, towards_w = atom_map.bin_gain * atom_map.line(u, 2).value, atom_map.line(w, 3).value
        reach = _around(gate.reachable_range), _around(gate.reachable_doppler)
        beams = towards_u @ (atom_map.cells[reach] @ towards_w.T)
        n_directions = np.diff(cosine_limits)[:, 0] / atom_map.cell_size[2:]
        n_independent = float(np.count_nonzero(gate.reachable) * np.maximum(n_directions, 1).prod())
        return cls(atom_map, reach, u, w, beams, n_independent)

    @property
    def axes(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Places of the beams along range, Doppler, u and w, in Rayleigh cells."""
        in_range, in_doppler = self.reach
        return self.atom_map.range_bins[in_range], self.atom_map.doppler_bins[in_doppler], self.u, self.w

    def residual(self, fit: AtomFit) -> Complex:
        """Subtract the echoes of atoms from the beams."""
        atom_map, (in_range, in_doppler) = self.atom_map, self.reach
        along_range, along_doppler, along_u, along_w = (line.value for line in fit.lines)
        beams_u = along_u @ (atom_map.bin_gain * atom_map.line(self.u, 2).value.T)
        beams_w = along_w @ atom_map.line(self.w, 3).value.T
        seen = along_range[:, in_range], along_doppler[:, in_doppler], beams_u, beams_w
        return self.beams - sum_of_echoes(fit.amplitude, *seen)

    def peaks(self, residual: Complex, least_energy: float) -> tuple[Floats, Floats]:
        """Find the local maxima of a residual, sampled twice a Rayleigh cell along all coordinates.

        Parameters
        ----------
        residual : ndarray of complex128
            From `residual`.

        Returns
        -------
        places : ndarray of float64, shape (n, 4)
            In Rayleigh cells.
        energy : ndarray of float64, shape (n,)
        """
        # The long axes last: neighbours along an axis are compared a line at a time.
        lines_last = np.ascontiguousarray(residual.T)
        index, energy = _local_maxima(lines_last, least_energy)
        order = np.lexsort(index)
        index, energy = tuple(along[order] for along in index[::-1]), energy[order]
        along_range, along_doppler, along_u, along_w = self.axes
        places = np.stack(
            [
                along_range[0] + index[0] / 2,
                along_doppler[0] + index[1] / 2,
                along_u[index[2]],
                along_w[index[3]],
            ],
            axis=1,
        )
        return places, energy

    def energy_around(self, residual: Complex, places: Floats) -> Floats:
        """Energies (n, 81) of a residual's beams within about 1.5 Rayleigh cells of places (n, 4)."""
        samples_per_cell, last = (1, 1, BEAMS_A_CELL, BEAMS_A_CELL), np.array(residual.shape) - 1
        first = [axis[0] for axis in self.axes]
        # Atoms at the edge of their boxes lie halfway between two bins, but for rounding.
        at = np.rint(np.round((places - first) * samples_per_cell, TIE_DIGITS)).astype(np.int64)
        around = np.indices([3] * N_COORDINATES).reshape(N_COORDINATES, -1).T - 1
        samples = np.clip(np.clip(at, 0, last)[:, None] + around, 0, last)
        seen = residual[tuple(np.moveaxis(samples, 2, 0))]
        energy: Floats = seen.real**2 + seen.imag**2
        return energy


def _around(reachable: slice) -> slice:
    """Bins in which echoes from reachable ones show."""
    return slice(max(reachable.start - MARGIN_BINS, 0), reachable.stop + MARGIN_BINS)


def _local_maxima(beams: Complex, least_energy: float) -> tuple[tuple[Integers, ...], Floats]:
    """Indices and energies of the samples above a level that none of their 80 neighbours exceeds.

    By more than rounding: of an echo halfway between two samples both are maxima. Along the last two axes
    samples halfway between the outputs of beams (n_w, n_u, n_doppler, n_range) are put in.
    """
    *n_directions, n_rows, n_columns = beams.shape
    energy = np.empty((2 * n_rows - 1, 2 * n_columns - 1))
    # Plane by plane, which stays in the cache.
    highest, candidates = {}, {}
    for plane in np.ndindex(*n_directions):
        outputs = beams[plane]
        _energies(outputs, 1.0, energy[::2, ::2])
        # Halfway between neighbouring bins their sum is matched, with the energy of two.
        between = outputs[:, :-1] + outputs[:, 1:]
        _energies(between, 0.5, energy[::2, 1::2])
        _energies(outputs[:-1] + outputs[1:], 0.5, energy[1::2, ::2])
        _energies(between[:-1] + between[1:], 0.25, energy[1::2, 1::2])
        if energy.max() > least_energy:  # all others exceed no sample that is sought
            here = _highest_of_three(_highest_of_three(energy).T).T / (1 + 10.0**-TIE_DIGITS)
            found = np.flatnonzero((energy >= here) & (energy > least_energy))
            highest[plane], candidates[plane] = here.ravel(), (found, energy.ravel()[found])
    indices, levels = [np.empty((N_COORDINATES, 0), dtype=np.int64)], [np.empty(0)]
    for (w, u), (found, level) in candidates.items():
        for plane in product((w - 1, w, w + 1), (u - 1, u, u + 1)):
            if plane in highest:
                stays = level >= highest[plane][found]
                found, level = found[stays], level[stays]
        directions = np.full_like(found, w), np.full_like(found, u)
        indices.append(np.stack([*directions, *np.unravel_index(found, energy.shape)]))
        levels.append(level)
    return tuple(np.concatenate(indices, axis=1)), np.concatenate(levels)


def _energies(outputs: Complex, share: float, energy: Floats) -> None:
    """Write a share of the energies of contiguous outputs into an array."""
    squares = np.square(outputs.view(np.float64))
    if share != 1:
        squares *= share
    np.add(squares[:, ::2], squares[:, 1::2], out=energy)


def _highest_of_three(rows: Floats) -> Floats:
    """The highest of each value and those of the rows before and after it."""
    highest = rows.copy(order="K")
    np.maximum(highest[1:], rows[:-1], out=highest[1:])
    np.maximum(highest[:-1], rows[1:], out=highest[:-1])
    return highest


def descending(energy: Floats) -> Integers:
    """Sort energies, the largest first, and those equal but for rounding in their order.

    Parameters
    ----------
    energy : ndarray of float64, shape (n,)

    Returns
    -------
    ndarray of int64, shape (n,)
        Indices.
    """
    return np.argsort(-round_mantissa(energy, TIE_DIGITS), kind="stable")


def unwrapped(places: Floats, reference: Floats, periods: Floats) -> Floats:
    """Of all places (..., 4) where atoms are the same, those nearest to a reference, in Rayleigh cells.

    Elements half a wavelength apart cannot tell u = 1 from u = -1, nor sampled symbols one end of the Doppler
    bins from the other. `periods` (4,) are `AtomMap.periods`.
    """
    return places - periods * np.rint((places - reference) / periods)


def noise_maximum(n_independent: float, chance: float) -> float:
    """Level over the mean energy that the highest matched-filter output of noise exceeds by a small chance.

    The output over all four coordinates, off any grid, is a smooth field. Along one, a Rayleigh cell holds
    sqrt(πx/3) exp(-x) upcrossings of a level of x times the mean, and to first order as many per coordinate
    multiply. `n_independent` is the number of Rayleigh cells.

    References
    ----------
    Rice, "Mathematical analysis of random noise", Bell System Tech. J. 24 (1945).
    Adler and Taylor, "Random Fields and Geometry", Springer (2007), chapter 11.
    """
    samples = np.log(n_independent / chance)
    level = samples
    # A contraction where the level is above 4; lower levels do not occur.
    for _ in range(FIXED_POINT_STEPS):
        level = samples + N_COORDINATES / 2 * np.log(np.pi / 3 * max(level, N_COORDINATES))
    return float(level)


def sidelobe_envelope(distance: Floats, bursts: SymbolBursts = UNGAPPED) -> Floats:
    """Bound the amplitude response of an atom at distances (..., 4) from it, in Rayleigh cells."""
    envelope = np.ones(distance.shape[:-1])
    for axis in range(N_COORDINATES):
        envelope /= _sidelobe_drop(distance[..., axis], axis, bursts)
    return envelope


def _sidelobe_drop(along: Floats, axis: int, bursts: SymbolBursts) -> Floats:
    """Peak over the bound of the response at distances along a coordinate."""
    return bursts.sidelobe_drop(along) if axis == 1 else np.maximum(np.pi * np.abs(along), 1)


def sidelobe_energy(
    places: Floats, others: Floats, energy: Floats, bursts: SymbolBursts = UNGAPPED, least_range: float = 0.0
) -> Floats:
    """Most that echoes at other places (m, 4) show of their sidelobes at places (n, 4), all in phase.

    `energy` (m,) is theirs. Places are in Rayleigh cells. An echo nearer along range than `least_range` does
    not count.
    """
    if len(places) > (most := MOST_PAIRS // max(len(others), 1)):
        parts = np.split(places, range(most, len(places), most))
        return np.concatenate([sidelobe_energy(part, others, energy, bursts, least_range) for part in parts])
    distance = _distances(places, others)
    envelope = np.where(np.abs(distance[..., 0]) >= least_range, sidelobe_envelope(distance, bursts), 0)
    amplitude: Floats = envelope @ np.sqrt(energy)
    return amplitude**2


def _distances(places: Floats, others: Floats) -> Floats:
    """Distances (n, m, 4) of places from others, one coordinate after the other in memory."""
    return np.moveaxis(places.T[:, :, None] - others.T[:, None, :], 0, -1)


def strongest_around(places: Floats, fit: AtomFit) -> Floats:
    """Bound the energy that the strongest atom of a fit shows at places (n, 4), in Rayleigh cells.

    The larger of two: sidelobes of an atom anywhere, and all of the energy of one within two bins in range
    and Doppler, whose misfit has every direction. The energy of an atom is what the map shows of it
    (`AtomFit.shown_energy`). Atoms do not count at their own place.
    """
    if len(places) > (most := MOST_PAIRS // max(len(fit), 1)):
        parts = np.split(places, range(most, len(places), most))
        return np.concatenate([strongest_around(part, fit) for part in parts])
    if not len(places):
        return np.empty(0)
    distance, periods = _distances(places, fit.places), fit.atom_map.periods
    span = np.ptp(np.concatenate([places, fit.places]), axis=0)
    for axis in np.flatnonzero(span > periods / 2):
        distance[..., axis] -= periods[axis] * np.rint(distance[..., axis] / periods[axis])
    along_range, along_doppler = np.abs(distance[..., 0]), np.abs(distance[..., 1])
    near = (along_range < NEIGHBOURHOOD_BINS) & (along_doppler < NEIGHBOURHOOD_BINS)
    share = np.where(near, 1.0, sidelobe_envelope(distance, fit.atom_map.bursts) ** 2)
    itself = near & (along_range == 0) & (along_doppler == 0)
    itself[itself] = (distance[itself] == 0).all(axis=1)
    share[itself] = 0
    return (share * fit.shown_energy).max(axis=1, initial=0)


def split_gains(fit: AtomFit, residual_around: Floats, least_energy: float) -> tuple[Floats, Floats]:
    """Energy that two atoms for one would explain, from the products of the residual with its derivatives.

    Two echoes less than a Rayleigh cell apart differ from one by its first derivative in quadrature, and by
    its second: the one leads where their phases differ, the other where they do not. `residual_around` (n,)
    is the mean energy of the residual around each atom, and noise does not reach a gain of `least_energy`.

    Returned are the distances (n, 4) of the two atoms from the one, along the coordinate that gains most, and
    the energies gained (n,), 0 of atoms that are not to be split.
    """
    n = len(fit)
    lines, products, axes = fit.lines, fit.products, range(N_COORDINATES)
    curvature_outputs = fit.atom_map.correlate_curvatures(lines)
    gain, separation = np.zeros((2, n, N_COORDINATES))
    for axis, (value, _, second) in enumerate(lines):
        curved, energy = second @ value.T, np.sum(second**2, axis=1)
        others = np.prod([products[k].value for k in axes if k != axis], axis=0)
        slope = fit.correlations.slope[:, axis] - product_matrix(products, axis, None) @ fit.amplitude
        curvature = curvature_outputs[:, axis] - (others * curved) @ fit.amplitude
        # An atom's second derivative without the part that is the atom itself.
        free = energy - curved.diagonal() ** 2
        if np.any(free <= LEAST_FREE * energy):
            continue  # two elements always see one wave
        gain[:, axis] = np.abs(slope) ** 2 / products[axis].slopes.diagonal() + np.abs(curvature) ** 2 / free
        separation[:, axis] = np.sqrt(2 * np.abs((curvature / fit.amplitude).real) / free)
    axis, atom = gain.argmax(axis=1), np.arange(n)
    best = gain[atom, axis]
    stands_out = (best > SPLIT_STANDOUT * residual_around) & (residual_around < SPLIT_RESIDUAL * fit.power)
    offsets = np.zeros((n, N_COORDINATES))
    offsets[atom, axis] = np.clip(separation[atom, axis], *SPLIT_OFFSETS_CELLS)
    return offsets, np.where(stands_out & (best > least_energy), best, 0)


def needless_atoms(fit: AtomFit, most_lost: float, pitch: float = 0.0) -> tuple[Mask, Floats]:
    """Atoms without which others explain as much of the map, but for an energy of at most `most_lost`.

    Returned is a mask (n,) of atoms to drop, one less than a Rayleigh cell away from another at most: those
    that need not be replaced, and the weaker of two if the stronger can move instead. The places (n, 4) of
    the stronger ones are moved to the mean of their pair; above 0, `pitch` is that of a lattice for these
    means: powers of atoms that nearly cancel hold few digits, and steps would magnify the others.
    """
    places, power, lost = fit.places.copy(), fit.power, fit.lost_without()
    apart = unwrapped(places[:, None], places, fit.atom_map.periods) - places
    are_close = np.all(np.abs(apart) < 1, axis=2)
    may_go = are_close & (lost <= most_lost) & (power[:, None] <= power)
    drop, is_settled = np.zeros((2, len(fit)), dtype=np.bool_)
    for pair in np.argwhere(may_go)[descending(lost[may_go])[::-1]]:
        weaker, stronger = pair
        if is_settled[weaker]:
            continue
        drop[weaker] = True
        is_settled |= are_close[weaker]
        # The two ends of a coordinate meet at the stronger one's, not in the middle.
        near = unwrapped(places[pair], places[stronger], fit.atom_map.periods)
        mean = np.average(near, axis=0, weights=power[pair])
        places[stronger] = np.rint(mean / pitch) * pitch if pitch else mean
    return drop, places


def misfit_atoms(fit: AtomFit, left: Floats) -> Mask:
    """Atoms (n,) that explain no more than what may be the misfit of others.

    Of echoes in phase that are not resolved along a coordinate, m atoms explain polynomials up to degree
    2 m - 1 along its samples. What is left is like a Legendre polynomial, whose spectrum is highest one to
    three Rayleigh cells away, on both sides. Atoms there cancel each other, and leave a misfit further away.

    `left` (n,) is the highest energy left around each atom. It may show elsewhere: as it is along the
    coordinate in which sidelobes decay most, like a sidelobe along the others. An atom is dropped if two
    conditions hold. Beside all others it explains no more than may show at its place. And the atoms less than
    a Rayleigh cell away, itself included, explain at most (m² p)^(1/3). Here m is `MISFIT_SHARE` of what may
    show, or `MISFIT_AROUND` times what is left around the atom, if that is less; p is the sum of the energies
    of these atoms, of which those that cancel each other explain little.
    """
    apart = unwrapped(fit.places[:, None], fit.places, fit.atom_map.periods) - fit.places
    drops = np.stack([_sidelobe_drop(apart[..., k], k, fit.atom_map.bursts) for k in range(N_COORDINATES)])
    are_close = np.all(np.abs(apart) < 1, axis=2)
    shares = np.where(are_close, 0, (drops.max(axis=0) / drops.prod(axis=0)) ** 2)
    shown = (shares * left).max(axis=1, initial=0)
    misfit = np.minimum(MISFIT_SHARE * shown, MISFIT_AROUND * left)
    least = np.cbrt(misfit**2 * (are_close @ fit.power))
    is_misfit: Mask = fit.power * fit.own <= np.minimum(shown, least)
    for atom in np.flatnonzero(is_misfit):
        is_misfit[atom] = fit.energy_of(np.flatnonzero(are_close[atom])) <= least[atom]
    return is_misfit


def reachable_places(places: Floats, gate: Gate) -> Mask:
    """Tell which places (n, 4) lie within a bin of the ranges and speeds of the region."""
    bins = gate.range_bins[gate.reachable_range], gate.doppler_bins[gate.reachable_doppler]
    first, last = np.array([(along[0], along[-1]) for along in bins]).T
    inside = (places[:, :2] >= first - 1) & (places[:, :2] <= last + 1)
    return np.all(inside, axis=1)


def drop_lobe_images(
    places: Floats, gain: Floats, candidates: Integers, left: Integers, bursts: SymbolBursts
) -> Integers:
    """Drop the peaks in `left` that are grating lobes of the best candidates.

    Places (n, 4) and gains (n,) are of the peaks of the residual; candidates are indices of those that can
    become atoms, by descending gain, and `left` of those that no move explains. If the whole frame is used
    for sensing there are no grating lobes, and all peaks stay.
    """
    if bursts.is_whole_frame:
        return left
    left, best = left[: 2 * MOST_LEFT], candidates[:MOST_LEFT]
    distance = places[left][:, None] - places[best]
    lobes = (sidelobe_envelope(distance, bursts) ** 2 * gain[best]).max(axis=1, initial=0)
    return left[gain[left] > lobes]


def are_near(places: Floats, others: Floats, distance: float) -> Mask:
    """Tell which places (n, 4) have another one of (m, 4) nearer than a distance along every coordinate."""
    return np.any(np.all(np.abs(places[:, None] - others) < distance, axis=2), axis=1)


def are_split(centres: Floats, places: Floats) -> Mask:
    """Tell which atoms, split at centres (n, 4), have become two: around each lie two places of (m, 4)."""
    around: Integers = np.all(np.abs(centres[:, None] - places) < PAIR_CELLS, axis=2).sum(axis=1)
    return around >= 2


def least_chosen(gain: Floats) -> float:
    """Gain that moves of a round exceed, from the gains (n,) of all."""
    return float(gain.max(initial=0)) * 10 ** (-ROUND_RANGE_DB / 10)


def choose_moves(places: Floats, gain: Floats, is_new: Mask, atom_map: AtomMap, room: int) -> Integers:
    """Choose at most `room` moves, the best first, apart from each other, without sidelobes of better ones.

    Places (n, 4) are those of new atoms (`is_new`), and of atoms that may be split. Returned are indices.
    """
    if not gain.max(initial=0) > 0:
        return np.empty(0, dtype=np.int64)
    worth = np.where(is_new, gain, SPLIT_PREFERENCE * gain)
    eligible = np.flatnonzero(gain > least_chosen(gain))
    candidates = eligible[descending(worth[eligible])]
    amplitude, sidelobes = np.sqrt(gain), np.zeros(len(candidates))
    # Between bins a grating lobe may exceed its peak: it must not be chosen together with its peak.
    bursts = atom_map.bursts.with_equal_lobes
    # One coordinate after the other in memory: a map without echoes has tens of thousands of candidates.
    along = places[candidates].T.copy()
    chosen: list[int] = []
    while candidates.size and len(chosen) < room:
        move, candidates, along = int(candidates[0]), candidates[1:], along[:, 1:]
        chosen.append(move)
        distance = unwrapped(along.T, places[move], atom_map.periods) - places[move]
        sidelobes = sidelobes[1:] + sidelobe_envelope(distance, bursts) * amplitude[move]
        kept = (np.abs(distance) >= APART_CELLS).any(axis=1)
        kept &= ~is_new[candidates] | (amplitude[candidates] >= sidelobes)
        candidates, along, sidelobes = candidates[kept], along[:, kept], sidelobes[kept]
    return np.array(chosen, dtype=np.int64)
