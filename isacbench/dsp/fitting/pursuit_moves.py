"""Choice of the moves of one round of a matching pursuit.

Places are in Rayleigh cells, shape (n, 4): range, Doppler, u and w. The gain
of a move is the energy that it takes from the residual.
"""

from __future__ import annotations

import numpy as np

from isacbench.checked_arrays import Floats, Integers, Mask
from isacbench.dsp.bursts import SymbolBursts
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.pursuit import descending, sidelobe_energy, sidelobe_envelope, unwrapped
from isacbench.model.gate import Gate

ROUND_RANGE_DB = 6.0
"""Moves of a round gain at most this much less than the best one."""

APART_CELLS = 1.0 - 1e-9
"""Least distance between the moves of one round. Less than one: peaks are one apart but for rounding."""

SPLIT_PREFERENCE = 2.0
"""Factor by which a split is preferred to a new atom nearby, which would only be the first of two."""

PAIR_CELLS = 0.8
"""Distance from the atom that was split, within which its two parts must lie."""

MOST_LEFT = 64
"""Number of strongest unexplained peaks of the residual whose sidelobes are not taken for atoms."""


def reachable_places(places: Floats, gate: Gate) -> Mask:
    """Tell which places lie within a bin of the ranges and speeds of the region.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    inside = np.ones(len(places), dtype=np.bool_)
    for axis, bins, reach in (
        (0, gate.range_bins, gate.reachable_range),
        (1, gate.doppler_bins, gate.reachable_doppler),
    ):
        inside &= (places[:, axis] >= bins[reach.start] - 1) & (places[:, axis] <= bins[reach.stop - 1] + 1)
    return inside


def clear_of_sidelobes(
    places: Floats, gain: Floats, candidates: Integers, left: Integers, bursts: SymbolBursts
) -> Integers:
    """Keep the candidates that are not sidelobes of peaks which no move explains.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
        Peaks of the residual.
    gain : ndarray of float64, shape (n,)
    candidates : ndarray of int64, shape (c,)
        Indices of peaks that can become atoms, by descending gain.
    left : ndarray of int64, shape (m,)
        Indices of peaks that no move explains, at most `MOST_LEFT`.

    Returns
    -------
    ndarray of int64
        Some of the candidates, in their order.
    """
    shown = sidelobe_energy(places[candidates], places[left], gain[left], bursts)
    return candidates[gain[candidates] >= shown]


def without_images(
    places: Floats, gain: Floats, candidates: Integers, left: Integers, bursts: SymbolBursts
) -> Integers:
    """Drop the peaks that are grating lobes of the best candidates.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
        Peaks of the residual.
    gain : ndarray of float64, shape (n,)
    candidates, left : ndarray of int64
        Indices of peaks that can become atoms, and of others, both by descending gain.

    Returns
    -------
    ndarray of int64
        Some of `left`; all of it if the whole frame is used for sensing, because
        there are no grating lobes then.
    """
    if bursts.is_whole_frame:
        return left
    left, best = left[: 2 * MOST_LEFT], candidates[:MOST_LEFT]
    distance = places[left][:, None] - places[best]
    lobes = (sidelobe_envelope(distance, bursts) ** 2 * gain[best]).max(axis=1, initial=0)
    return left[gain[left] > lobes]


def are_near(places: Floats, others: Floats, distance: float) -> Mask:
    """Tell which places have another one nearer than a distance along every coordinate.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
    others : ndarray of float64, shape (m, 4)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    return np.any(np.all(np.abs(places[:, None] - others) < distance, axis=2), axis=1)


def became_pairs(centres: Floats, places: Floats) -> Mask:
    """Tell which split atoms have become two: at least two atoms lie around their place.

    Parameters
    ----------
    centres : ndarray of float64, shape (n, 4)
        Places of the atoms that were split.
    places : ndarray of float64, shape (m, 4)
        Places of the present atoms.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    around: Integers = np.all(np.abs(centres[:, None] - places) < PAIR_CELLS, axis=2).sum(axis=1)
    return around >= 2


def choose_moves(places: Floats, gain: Floats, is_new: Mask, atom_map: AtomMap, room: int) -> Integers:
    """Choose the best moves of a round, apart from each other, without sidelobes of better ones.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
        Places of new atoms, and of atoms that may be split.
    gain : ndarray of float64, shape (n,)
    is_new : ndarray of bool, shape (n,)
    room : int
        Largest number of moves.

    Returns
    -------
    ndarray of int64
        Indices of moves, the best first.
    """
    if not gain.max(initial=0) > 0:
        return np.empty(0, dtype=np.int64)
    worth = np.where(is_new, gain, SPLIT_PREFERENCE * gain)
    eligible = np.flatnonzero(gain > gain.max() * 10 ** (-ROUND_RANGE_DB / 10))
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
