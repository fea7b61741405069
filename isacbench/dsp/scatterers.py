"""Scatterers from plane waves: location between bins, own-cell test, removal of duplicates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Complex, Floats, Integers, Mask
from isacbench.display import short_repr
from isacbench.dsp.angles.aperture import Aperture
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.bursts import SymbolBursts
from isacbench.dsp.floating_point import round_mantissa
from isacbench.dsp.rangedoppler import TaperedMap
from isacbench.dsp.windows import Window, bin_profile, fractional_bin, reach, taper
from isacbench.model.gate import Bins
from isacbench.model.kernels import PERIOD, dirichlet, within_period
from isacbench.model.numerology import System

DUPLICATE_CELL = np.array([0.3, 0.3, 0.01, 0.01])
"""Distances in range bins, Doppler bins, u and w within which two points count as one."""

TIE_DIGITS = 6
"""Digits to which powers and amplitudes are compared: the rest is rounding; of equal ones the first stays."""

FAINT = 0.05
"""Share of an amplitude below which the echo of another scatterer is not counted in it."""

ONE_ECHO = 0.95
"""Least share of the energy in three bins that a single echo must explain."""

NOISE_LEFT = 9.2
"""Noise powers that one echo leaves of three noisy bins in all but one of a thousand cases."""


@dataclass(frozen=True, eq=False)
class LocatedScatterers:
    """Estimated scatterers in the coordinates of the radio, each array of shape (n,).

    Attributes
    ----------
    range_bin, doppler_bin : ndarray of float64
        Absolute fractional bins.
    u, w : ndarray of float64
        Direction cosines, from -1 to 1 whatever period they are given in.
    power : ndarray of float64
        Power |amplitude|² per element in the range-Doppler map.
    family : ndarray of int64
        The same number for scatterers that one cell resolved: its plane waves
        explain it down to the noise. -1 for all others.
    """

    range_bin: Floats
    doppler_bin: Floats
    u: Floats
    w: Floats
    power: Floats
    family: Integers

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", within_period(self.u))
        object.__setattr__(self, "w", within_period(self.w))

    def __len__(self) -> int:
        return self.power.size

    @classmethod
    def empty(cls) -> LocatedScatterers:
        """No scatterers."""
        none = np.empty(0)
        return cls(none, none, none, none, none, np.empty(0, dtype=np.int64))

    def select(self, keep: Mask | Integers) -> LocatedScatterers:
        """Select scatterers.

        Parameters
        ----------
        keep : ndarray of bool or int64
            Mask or indices of the scatterers.
        """
        return LocatedScatterers(*(getattr(self, field.name)[keep] for field in fields(self)))

    def join(self, others: LocatedScatterers) -> LocatedScatterers:
        """Append scatterers; their families get the next free numbers."""
        n_families = self.family.max(initial=-1) + 1
        others = replace(others, family=np.where(others.family >= 0, others.family + n_families, -1))
        columns = ((getattr(part, field.name) for part in (self, others)) for field in fields(self))
        return LocatedScatterers(*(np.concatenate([*column]) for column in columns))


@dataclass(frozen=True, eq=False)
class ScatterersInCells:
    """Scatterers located from plane waves, the cells of these waves and their amplitudes nearby.

    Attributes
    ----------
    scatterers : LocatedScatterers
        n scatterers.
    cells : ndarray of int64, shape (n, 2)
        Absolute range and Doppler bins of the cells in which they were found.
    amplitudes : ndarray of complex128, shape (5, n)
        In their own cells, and in the next nearer, farther, slower and faster ones.
    tapered : TaperedMap
        Map of these cells.
    """

    scatterers: LocatedScatterers
    cells: Integers
    amplitudes: Complex
    tapered: TaperedMap

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.scatterers)

    def select(self, keep: Mask | Integers) -> ScatterersInCells:
        """Select scatterers.

        Parameters
        ----------
        keep : ndarray of bool or int64
            Mask or indices of the scatterers.
        """
        return replace(
            self,
            scatterers=self.scatterers.select(keep),
            cells=self.cells[keep],
            amplitudes=self.amplitudes[:, keep],
        )

    def in_own_cell(self, range_excess: float, doppler_excess: float) -> ScatterersInCells:
        """Select the scatterers that pass the own-cell test.

        The excesses are the largest amplitude of a plane wave in the next cell over that in its own, along
        range and along Doppler. 1 keeps local maxima only, which breaks up lines of scatterers.
        """
        own, nearer, farther, slower, faster = np.abs(self.amplitudes)
        # An echo halfway between two cells passes in both; without margin, rounding could drop it in both.
        level = (1 + 10.0**-TIE_DIGITS) * own
        own = np.maximum(farther, nearer) <= range_excess * level
        own &= np.maximum(faster, slower) <= doppler_excess * level
        return self.select(own)

    def above_sidelobes(self, excess: float, least_left: float, system: System) -> ScatterersInCells:
        """Select the scatterers that the echoes of stronger ones, found in other cells, do not explain.

        An echo shows in all cells and directions, by the tapered kernels of range and Doppler and the beam of
        the array. The strongest decide first, those of a family together, and what they drop explains
        nothing.

        `excess` is the least amplitude over what each stronger one shows there, `least_left` the least share
        of it that is left when what all stronger ones show there, with its phases, is subtracted. The
        strongest are first in the result.
        """
        ranked = self.select(_strongest_first(self.scatterers))
        found, own = ranked.scatterers, ranked.amplitudes[0]
        shown = ranked._echoes_at_others(system)
        elsewhere = (ranked.cells[:, None] != ranked.cells).any(axis=2)
        weaker, stronger = np.nonzero(np.tril(elsewhere & (np.abs(shown) > FAINT * np.abs(own)[:, None]), -1))
        u, w = (np.stack([cosine[weaker], cosine[stronger]], axis=1) for cosine in (found.u, found.w))
        echoes = shown[weaker, stronger] * ranked.tapered.aperture.towards(u, w).gram()[:, 0, 1]
        level, kept = np.abs(own), np.ones(len(own), dtype=np.bool_)
        while True:
            # Stronger ones alone count: after k rounds the k strongest are decided. Few rounds are needed.
            seen = echoes * kept[stronger]
            strongest = np.zeros(len(own))
            np.maximum.at(strongest, weaker, np.abs(seen))
            total = np.bincount(weaker, seen.real, len(own)) + 1j * np.bincount(weaker, seen.imag, len(own))
            passes = (level > excess * strongest) & (np.abs(own - total) > least_left * level)
            if np.array_equal(passes, kept):
                return ranked.select(kept)
            kept = passes

    def _echoes_at_others(self, system: System) -> Complex:
        """Amplitudes (n, n) in the cell of each scatterer of all their echoes, as if in one direction."""
        tapered, (range_window, doppler_window) = self.tapered, self.tapered.windows
        rows, columns = tapered.gate.index((self.cells[:, 0], self.cells[:, 1]))
        along_range = partial(dirichlet, n=system.n_subcarriers)
        along_doppler = tapered.untapered.doppler_kernel(system.n_symbols).response
        gate, found = tapered.gate, self.scatterers
        shown = _kernel(gate.range_bins, found.range_bin, range_window, along_range)[rows]
        shown *= _kernel(gate.doppler_bins, found.doppler_bin, doppler_window, along_doppler)[columns]
        shown *= self.amplitudes[0] / np.diag(shown)
        return shown


def _kernel(bins: Integers, places: Floats, window: Window, response: Callable[..., Complex]) -> Complex:
    """Amplitudes (bins, places) of echoes of one amplitude in tapered bins."""
    n_side = reach(window)
    untapered = response(np.arange(bins[0] - n_side, bins[-1] + n_side + 1), places)
    return taper(untapered, window, axis=0)


def _amplitudes_around(waves: PlaneWaves, around: Complex, aperture: Aperture) -> Complex:
    """Amplitudes (5, n, k) of waves in their cells and in the next; as many waves are solved together."""
    amplitudes = np.zeros((5, *waves.found.shape), dtype=np.complex128)
    n_waves = waves.found.sum(axis=1)
    for count in range(1, int(n_waves.max(initial=0)) + 1):
        cells = np.flatnonzero(n_waves == count)
        some, entries = waves.select(cells).compact(count)
        amplitudes[:, cells[:, None], entries] = some.amplitudes(around[cells].swapaxes(0, 1), aperture)
    return amplitudes


def locate_waves(
    waves: PlaneWaves,
    around: Complex,
    tapered: TaperedMap,
    bins: Bins,
    dynamic_range_db: float,
    one_doppler: bool = False,
    resolved: bool = False,
    min_power: float = 0.0,
    noise: float = 0.0,
) -> ScatterersInCells:
    """Locate plane waves in range and Doppler by their amplitudes in the neighbouring cells.

    The amplitudes in two neighbouring bins locate a scatterer between them.
    Along range, where streets are crowded, these amplitudes often belong to
    several scatterers. The scatterer then stays in the middle of its bin.

    Parameters
    ----------
    waves : PlaneWaves
        Of the n cells of `bins`.
    around : ndarray of complex, shape (n, 5, *elements)
        Samples of each cell, and of the next nearer, farther, slower and faster ones.
    tapered : TaperedMap
        The map that holds them.
    bins : (ndarray of int64, ndarray of int64)
        Absolute range and Doppler bin of each cell, shape (n,), none at the
        map's edge.
    dynamic_range_db : float
        Plane waves further below the strongest one of the 5 x 5 cells around
        them are left out.
    one_doppler : bool, default False
        Keep only plane waves that look like one echo along Doppler. This drops
        waves between two movers, which have the direction of neither.
    resolved : bool, default False
        Whether the plane waves explain their cells down to the noise, so that even close ones are apart.
    min_power : float, default 0
        Power per element that a plane wave must exceed.
    noise : float, default 0
        Noise power of an amplitude.
    """
    amplitudes = _amplitudes_around(waves, around, tapered.aperture)
    cell, entry = np.nonzero(waves.found)
    rows, columns = tapered.gate.index((bins[0][cell], bins[1][cell]))
    level = np.abs(amplitudes[0, cell, entry])
    strongest = np.zeros(tapered.gate.shape)
    np.maximum.at(strongest, (rows, columns), level)
    weakest = maximum_filter(strongest, size=5)[rows, columns] * 10 ** (-dynamic_range_db / 20)
    kept = (level**2 > min_power) & (level >= weakest)
    cell, entry = cell[kept], entry[kept]
    amplitudes, windows = amplitudes[:, cell, entry], tapered.windows
    own, nearer, farther, slower, faster = np.abs(amplitudes)
    in_ranges, range_offset = amplitudes[[1, 0, 2]], _offset(own, farther, nearer, windows[0])
    # Near the middle of a bin both neighbours are as strong, and only their phases tell the side.
    behind, before = (_one_echo_share(in_ranges, side * range_offset, windows[0]) for side in (1, -1))
    range_offset = np.where(before > behind, -range_offset, range_offset)
    range_offset[_one_echo_share(in_ranges, range_offset, windows[0], noise) < ONE_ECHO] = 0
    bursts = tapered.untapered.bursts if tapered.sees_lobes and windows[1] == "rect" else None
    doppler_offset = _offset(own, faster, slower, windows[1], bursts)
    loss = _own_share(range_offset, windows[0]) * _own_share(doppler_offset, windows[1], bursts)
    found = ScatterersInCells(
        LocatedScatterers(
            bins[0][cell] + range_offset,
            bins[1][cell] + doppler_offset,
            waves.u[cell, entry],
            waves.w[cell, entry],
            (own / loss) ** 2,
            np.where(resolved, cell, -1),
        ),
        np.column_stack(bins)[cell],
        amplitudes,
        tapered,
    )
    if not one_doppler:
        return found
    along_doppler = _one_echo_share(amplitudes[[3, 0, 4]], doppler_offset, windows[1], noise)
    return found.select(along_doppler >= ONE_ECHO)


def _offset(
    own: Floats, behind: Floats, before: Floats, window: Window, bursts: SymbolBursts | None = None
) -> Floats:
    """Signed offset in bins, from the amplitudes in a bin and in the two next to it.

    Along Doppler, untapered `bursts` give their own kernel, and `window` is not used.
    """
    stronger = np.maximum(behind, before)
    find = partial(fractional_bin, window=window) if bursts is None else bursts.fractional_bin
    offset = find(own, stronger)
    return np.where(behind >= before, offset, -offset)


def _own_share(offset: Floats, window: Window, bursts: SymbolBursts | None = None) -> Floats:
    """Amplitude of a unit echo in its own bin, at an offset from the middle of it."""
    if bursts is None:
        return np.abs(bin_profile(offset, window)[..., 1])
    return np.abs(bursts.slopes(offset, 0)[0])


def _one_echo_share(amplitudes: Complex, offset: Floats, window: Window, noise: float = 0.0) -> Floats:
    """Share of the energy of amplitudes (3, ...), in a bin and its neighbours, that one echo explains.

    Not counted is as much of what it leaves as noise may have.
    """
    model = np.moveaxis(bin_profile(offset, window), -1, 0)
    norm = np.sum(np.abs(model) ** 2, axis=0)
    explained = np.abs(np.sum(model.conj() * amplitudes, axis=0)) ** 2
    energy = np.maximum(norm * (np.sum(np.abs(amplitudes) ** 2, axis=0) - NOISE_LEFT * noise), explained)
    return np.divide(explained, energy, out=np.zeros_like(energy), where=energy > 0)


def merge_duplicates(scatterers: LocatedScatterers) -> LocatedScatterers:
    """Keep the strongest of scatterers within 0.3 bins in range and Doppler and 0.01 in u and w.

    Stronger scatterers decide first, so that a chain of neighbours is thinned
    out, not merged into one. A family is as strong as all its members together:
    where two cells have resolved the same scatterers, those of one cell are kept.
    """
    # The tree takes circles from 0 on.
    u, w = (scatterers.u + 1) % PERIOD, (scatterers.w + 1) % PERIOD
    points = np.column_stack([scatterers.range_bin, scatterers.doppler_bin, u, w])
    tree = cKDTree(points / DUPLICATE_CELL, boxsize=np.array([0, 0, PERIOD, PERIOD]) / DUPLICATE_CELL)
    pairs = tree.query_pairs(1.0, p=np.inf, output_type="ndarray")
    strongest_first = _strongest_first(scatterers)
    rank = np.argsort(strongest_first)
    return scatterers.select(np.sort(strongest_first[_thinned(np.sort(rank[pairs], axis=1), len(rank))]))


def _thinned(pairs: Integers, n: int) -> Mask:
    """Mask of n ranked things without the second of each pair whose first is left."""
    alive = np.ones(n, dtype=np.bool_)
    for stronger, weaker in pairs[np.argsort(pairs[:, 0], kind="stable")]:
        if alive[stronger]:
            alive[weaker] = False
    return alive


def _strongest_first(scatterers: LocatedScatterers) -> Integers:
    """Order of scatterers by power, those of a family together."""
    power, family_power = (
        -round_mantissa(p, TIE_DIGITS) for p in (scatterers.power, _family_power(scatterers))
    )
    return np.lexsort([power, scatterers.family, family_power])


def _family_power(scatterers: LocatedScatterers) -> Floats:
    """Power (n,) of each scatterer's family together, its own without a family."""
    power, family = scatterers.power, scatterers.family
    of_family = np.bincount(family[family >= 0], power[family >= 0])
    return np.where(family >= 0, np.append(of_family, 0)[family], power)
