"""Scatterers from plane waves: which of them are at home in their cell, and which are one seen twice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from isacbench.display import brief
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.bursts import SymbolBursts
from isacbench.dsp.rangedoppler import Bins, GatedMap
from isacbench.dsp.stable_order import rounded
from isacbench.dsp.windows import Window, bin_profile, fractional_bin

Floats = NDArray[np.float64]

DUPLICATE_CELL = np.array([0.3, 0.3, 0.01, 0.01])
"""Range and Doppler bins, u and w within which two points are one."""

TIE_DIGITS = 6
"""Of powers and amplitudes: what differs beyond is rounding, and the first of equals stays."""

ONE_ECHO = 0.95
"""Share of the energy in three bins that a single echo has to explain."""


@dataclass(frozen=True, eq=False)
class LocatedScatterers:
    """Estimated scatterers in the coordinates of the radio, each array of shape (n,).

    Attributes
    ----------
    range_bin, doppler_bin : ndarray of float64
        Absolute fractional bins.
    u, w : ndarray of float64
        Direction cosines.
    power : ndarray of float64
        Power |amplitude|² per element in the range-Doppler map.
    family : ndarray of int64
        Equal for those that one cell resolved: its plane waves explain it down
        to the noise. -1 for all others.
    """

    range_bin: Floats
    doppler_bin: Floats
    u: Floats
    w: Floats
    power: Floats
    family: NDArray[np.int64]

    __repr__ = brief

    def __len__(self) -> int:
        return self.power.size

    @classmethod
    def empty(cls) -> LocatedScatterers:
        """No scatterers."""
        none = np.empty(0)
        return cls(none, none, none, none, none, np.empty(0, dtype=np.int64))

    def select(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> LocatedScatterers:
        """Those that a mask or an index array picks."""
        return LocatedScatterers(
            self.range_bin[keep],
            self.doppler_bin[keep],
            self.u[keep],
            self.w[keep],
            self.power[keep],
            self.family[keep],
        )

    @property
    def next_family(self) -> int:
        """A number that no family has."""
        return int(self.family.max(initial=-1)) + 1

    def join(self, others: LocatedScatterers) -> LocatedScatterers:
        """These and others behind them, whose families are numbered on from these."""
        family = np.where(others.family >= 0, others.family + self.next_family, -1)
        return LocatedScatterers(
            np.concatenate([self.range_bin, others.range_bin]),
            np.concatenate([self.doppler_bin, others.doppler_bin]),
            np.concatenate([self.u, others.u]),
            np.concatenate([self.w, others.w]),
            np.concatenate([self.power, others.power]),
            np.concatenate([self.family, family]),
        )

    def interleaved(self, step_bins: float) -> LocatedScatterers:
        """These, and behind them candidates without power a step nearer and a step farther than each.

        Where extended objects are imaged at one point a bin, the candidates
        lie between the points.
        """
        shifted = [
            replace(
                self,
                range_bin=self.range_bin + step,
                power=np.zeros_like(self.power),
                family=np.full_like(self.family, -1),
            )
            for step in (-step_bins, step_bins)
        ]
        return self.join(shifted[0]).join(shifted[1])


class Located(NamedTuple):
    """Scatterers at the places of plane waves, and how strong they are in the cells around.

    Attributes
    ----------
    scatterers : LocatedScatterers
        n of them.
    along_range : ndarray of float64, shape (n, 3)
        Amplitude in the next nearer range cell, in their own, and in the next
        farther one.
    along_doppler : ndarray of float64, shape (n, 3)
        Amplitude in the next slower Doppler cell, in their own, and in the next
        faster one.
    """

    scatterers: LocatedScatterers
    along_range: Floats
    along_doppler: Floats

    def at_home(self, range_excess: float, doppler_excess: float) -> LocatedScatterers:
        """Scatterers that pass the own-cell test.

        Parameters
        ----------
        range_excess, doppler_excess : float
            How much stronger than in its own cell a plane wave may be in the
            next one, along range and along Doppler. 1 keeps local maxima only,
            which breaks up lines of scatterers.

        Returns
        -------
        LocatedScatterers
        """
        nearer, own, farther = self.along_range.T
        slower, _, faster = self.along_doppler.T
        # Halfway between two cells an echo is at home in both, not in neither.
        level = (1 + 10.0**-TIE_DIGITS) * own
        home = np.maximum(farther, nearer) <= range_excess * level
        home &= np.maximum(faster, slower) <= doppler_excess * level
        return self.scatterers.select(home)


def locate_waves(
    waves: PlaneWaves,
    tapered: GatedMap,
    bins: Bins,
    windows: tuple[Window, Window],
    dynamic_range_db: float,
    one_doppler: bool = False,
) -> Located:
    """Give plane waves a place in range and Doppler, by their amplitudes in the neighbouring cells.

    The amplitudes in two neighbouring bins place a scatterer between them.
    Along range, where streets are crowded, they often belong to several: the
    scatterer is then left in the middle of its bin, for a joint refinement to
    move.

    Parameters
    ----------
    waves : PlaneWaves
        Of the n cells of `bins`.
    tapered : GatedMap
    bins : (ndarray of int64, ndarray of int64)
        Absolute range and Doppler bin of each cell, shape (n,), none at the
        map's edge.
    windows : (Window, Window)
        That the map is tapered with along range and along Doppler.
    dynamic_range_db : float
        How far below the strongest plane wave of the 5 x 5 cells around it
        another may lie.
    one_doppler : bool, default False
        Whether a plane wave must look like one echo along Doppler. One
        between two movers, which the direction of neither fits, does not.

    Returns
    -------
    Located
    """
    rows, columns = index = tapered.index(bins)
    steps = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
    snapshots = np.stack([tapered.cells[rows + step[0], columns + step[1]] for step in steps])
    amplitudes = waves.amplitudes(snapshots, tapered.aperture)
    levels = np.abs(amplitudes)
    strongest = np.zeros(tapered.gate.shape)
    strongest[index] = levels[0].max(axis=1, initial=0)
    weakest = maximum_filter(strongest, size=5)[index][:, None] * 10 ** (-dynamic_range_db / 20)
    kept = waves.found & (levels[0] > 0) & (levels[0] >= weakest)
    if one_doppler:
        own, _, _, faster, slower = levels
        profile = np.stack([amplitudes[4], amplitudes[0], amplitudes[3]], axis=-1)
        kept &= _is_one_echo(profile, _offset(own, faster, slower, windows[1]), windows[1])
    own, farther, nearer, faster, slower = levels[:, kept]
    range_offset = _offset(own, farther, nearer, windows[0])
    profile = np.stack([amplitudes[2][kept], amplitudes[0][kept], amplitudes[1][kept]], axis=-1)
    range_offset[~_is_one_echo(profile, range_offset, windows[0])] = 0
    doppler_offset = _doppler_offset(own, faster, slower, windows[1], tapered.bursts)
    resolved = np.zeros(len(kept), dtype=np.bool_) if waves.resolved is None else waves.resolved
    cell = np.nonzero(kept)[0]
    scatterers = LocatedScatterers(
        bins[0][cell] + range_offset,
        bins[1][cell] + doppler_offset,
        waves.u[kept],
        waves.w[kept],
        own**2,
        np.where(resolved[cell], cell, -1),
    )
    return Located(
        scatterers, np.stack([nearer, own, farther], axis=1), np.stack([slower, own, faster], axis=1)
    )


def _offset(own: Floats, behind: Floats, before: Floats, window: Window) -> Floats:
    """Signed offset in bins, from the amplitudes in a bin and in the two next to it."""
    towards = np.where(behind >= before, 1, -1)
    ratio = np.divide(np.maximum(behind, before), own, out=np.zeros_like(own), where=own > 0)
    return towards * fractional_bin(ratio, window)


def _doppler_offset(
    own: Floats, faster: Floats, slower: Floats, window: Window, bursts: SymbolBursts | None
) -> Floats:
    """The same along Doppler, where bursts have a kernel of their own and no window."""
    if bursts is None or bursts.is_whole_frame:
        return _offset(own, faster, slower, window)
    stronger = np.maximum(faster, slower)
    return np.where(faster >= slower, 1, -1) * bursts.fractional_bin(own, stronger)


def _is_one_echo(profile: NDArray[np.complex128], offset: Floats, window: Window) -> NDArray[np.bool_]:
    """Whether amplitudes (..., 3) around a bin are those of one echo at that offset."""
    model = bin_profile(offset, window)
    explained = np.abs(np.sum(model.conj() * profile, axis=-1)) ** 2
    energy = np.sum(np.abs(model) ** 2, axis=-1) * np.sum(np.abs(profile) ** 2, axis=-1)
    one: NDArray[np.bool_] = explained >= ONE_ECHO * energy
    return one


def merge_duplicates(scatterers: LocatedScatterers) -> LocatedScatterers:
    """Keep the strongest of scatterers within 0.3 bins in range and Doppler and 0.01 in u and w.

    Stronger scatterers decide first, so that a chain of neighbours is thinned
    out and not merged into one. A family is as strong as its strongest: where
    two cells have resolved the same scatterers, those of one cell are kept.
    """
    points = np.column_stack([scatterers.range_bin, scatterers.doppler_bin, scatterers.u, scatterers.w])
    pairs = cKDTree(points / DUPLICATE_CELL).query_pairs(1.0, p=np.inf, output_type="ndarray")
    rank = np.empty(len(scatterers), dtype=np.int64)
    keys = scatterers.power, _family_power(scatterers)
    rank[np.lexsort([-rounded(power, TIE_DIGITS) for power in keys])] = np.arange(len(scatterers))
    swap = rank[pairs[:, 0]] > rank[pairs[:, 1]]
    pairs[swap] = pairs[swap][:, ::-1]
    alive = np.ones(len(scatterers), dtype=np.bool_)
    for stronger, weaker in pairs[np.argsort(rank[pairs[:, 0]], kind="stable")]:
        if alive[stronger]:
            alive[weaker] = False
    return scatterers.select(alive)


def _family_power(scatterers: LocatedScatterers) -> Floats:
    """Power (n,) of the strongest of each scatterer's family, its own where it has none."""
    related = scatterers.family >= 0
    strongest = np.zeros(scatterers.next_family)
    np.maximum.at(strongest, scatterers.family[related], scatterers.power[related])
    power = scatterers.power.copy()
    power[related] = strongest[scatterers.family[related]]
    return power
