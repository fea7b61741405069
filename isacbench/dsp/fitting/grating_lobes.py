"""Choice of the grating lobe of each scatterer, by what the map holds there besides all other echoes.

Lobes next to each other differ by less than the sidelobes of other echoes.
A scatterer taken alone is easily put at a wrong one. Together scatterers are
told apart, because the echoes of all others are subtracted for each.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.dsp.bursts import SymbolBursts
from isacbench.model.gate import Gate

COMPETING_RESPONSE = 0.3
"""Response from which two scatterers do not change their lobes in the same round."""

MAX_ROUNDS = 16
"""Rounds of changes; two to four are usual."""

TIE = 1e-6
"""Relative difference of two lobes that counts as rounding: the scatterer then stays."""

LOADING = 1e-3
"""Of unit responses: keeps the amplitudes of scatterers half a bin apart from cancelling each other."""


def lobes_within(doppler_bin: Floats, bursts: SymbolBursts, gate: Gate) -> tuple[Integers, Floats]:
    """Find the grating lobes of scatterers within the speeds of the region.

    Parameters
    ----------
    doppler_bin : ndarray of float64, shape (n,)
    gate : Gate
        Of the map.

    Returns
    -------
    owner : ndarray of int64, shape (m,)
        Scatterer of each place: first the n scatterers at their own places, then
        their lobes.
    place : ndarray of float64, shape (m,)
        Doppler bins.
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
    """Choose for each scatterer the place where the map, less all others' echoes, shows it most.

    Parameters
    ----------
    matched : ndarray of complex128, shape (m,)
        Outputs of the matched filters of all places, of comparable scale.
    response : ndarray, shape (m, m)
        Of filter i to a scatterer at place j, 1 at its own.
    owner : ndarray of int64, shape (m,)
        Scatterer of each place, the first n of them 0 to n - 1.

    Returns
    -------
    ndarray of int64, shape (n,)
        Place of each scatterer.
    """
    n, everywhere = int(owner.max(initial=-1)) + 1, np.arange(owner.size)
    current = np.arange(n)
    if not n:
        return current
    first = np.searchsorted(np.sort(owner), current)
    for _ in range(MAX_ROUNDS):
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
