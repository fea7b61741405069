"""First atoms of a map: its static echoes, and its moving ones, learned tile by tile.

1. Doppler spectra of tapered range bins show which lines each of them holds.
2. Filters that suppress all other lines leave the static echoes, a layer of
   range and directions. It is learned in tiles of a few range bins.
3. The static line is projected out of the map. What is left is tapered along
   Doppler and learned in tiles of range and Doppler, which have Doppler as a
   coordinate of their own: limbs, wheels and turning cars spread their speeds.

Cost of R range bins, D Doppler bins and M elements: R D² M for the covariances,
R D³ a step for the spectra, and n³ a step for each tile of n dimensions; n is at
most `tiles.MOST_DIMENSIONS`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, label, maximum_filter

from isacbench.checked_arrays import Complex, Floats, Mask
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.sparse_bayes.learning import DopplerSpectra, learn_doppler_spectra
from isacbench.dsp.sparse_bayes.places import Reach, merge_neighbours
from isacbench.dsp.sparse_bayes.tiles import (
    BinTaper,
    DirectionGrid,
    MapTile,
    learn_tile,
    within_dynamic_range,
)

LINE_STEP_BINS = 0.25
"""Step of the Doppler spectra."""

LINES_BEYOND_BINS = 0.5
"""Part of the spectra beyond the reachable Doppler bins."""

SPECTRUM_STEPS = 8
"""Learning steps of the spectra."""

MISFIT_DB = 45.0
"""Noise floor of spectra and sectors below the mean power, for what their grids cannot model."""

STATIC_BINS = 0.3
"""Distance from 0 beyond which lines interfere with static echoes."""

MOVING_BINS = 0.1
"""Distance from 0 beyond which lines are moving: the static one is projected out."""

PEAK_BINS = 20
"""Cells whose mean power counts as that of the strongest echoes; half of it in single layers."""

DYNAMIC_RANGE_DB = 45.0
"""Range below the strongest echoes in which range bins are imaged."""

LINE_RANGE_DB = 30.0
"""Range below the strongest line nearby in which others are imaged."""

LINE_NEIGHBOURHOOD = 5, 9
"""Range bins and steps of the spectra that count as nearby."""

LINE_GROWTH = 3, 5
"""The same of the lines around active ones, which their tile may use."""

STATIC_ABOVE_NOISE = 1.5
"""Least power of a static range bin over noise."""

LINE_DEVIATIONS = 6.0
"""Least power of a line, in standard deviations of the mean power of noise over the array."""

TILE_BINS, CORE_BINS = 14, 8
"""Range bins of a tile, and those in its middle whose atoms are kept."""

TILE_LINES_BINS = 3.0
"""Doppler bins of a tile's core."""

LEAST_LINES_BINS = 1.0
"""A rest of lines smaller than this is no tile of its own."""

DOPPLER_SIDE_BINS = 1.5
"""Doppler bins beyond the core that a tile holds."""

GRID_SIDE_BINS = 1.3
"""The same of its grid, along Doppler."""

STATIC_SECTOR_DB, MOVING_SECTOR_DB = 25.0, 20.0
"""Range below the strongest direction in which a sector is active."""

STATIC_MARGIN, MOVING_MARGIN = 0.35, 0.15
"""Rayleigh cells around active directions that belong to the sectors."""

STATIC_DIMENSION, MOVING_DIMENSION = 1e-2, 2e-2
"""Singular value, relative to the largest, of a tile's dimensions that are kept."""

MOST_SECTOR_CELLS = 24
"""Cells of a tile, the strongest first, that its sectors are learned from."""

SAME_PLACE = np.array([0.2, 0.3, 0.235, 0.235])
"""Half widths in Rayleigh cells within which atoms of two tiles are one."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """A tapered map with its Doppler spectra.

    Attributes
    ----------
    taper : BinTaper
        Along range.
    cells : ndarray of complex128, shape (n_rows, n_doppler, size_u, size_w)
    """

    reach: Reach
    grid: DirectionGrid
    noise: float
    taper: BinTaper
    cells: Complex
    spectra: DopplerSpectra

    @property
    def is_reachable(self) -> Mask:
        """Rows in which echoes of the region show, shape (n_rows,)."""
        first, last = self.reach.range_limits
        return (self.taper.bins >= first - 1) & (self.taper.bins <= last + 1)

    def around(self, start: float, end: float) -> slice:
        """Rows of a tile whose core lies between two range bins."""
        side = (TILE_BINS - CORE_BINS) / 2
        first_bin = self.taper.bins[0]
        first = max(int(np.floor(start - side - first_bin)), 0)
        return slice(first, min(int(np.ceil(end + side - first_bin)), self.taper.bins.size))


def first_atoms(
    atom_map: AtomMap, reach: Reach, noise: float, range_taper: BinTaper
) -> tuple[Floats, Floats]:
    """Learn the echoes of a map, static ones first, then moving ones.

    Parameters
    ----------
    reach : Reach
        Where echoes can come from.
    noise : float
        Noise power of its cells.
    range_taper : BinTaper
        Taper along range. Without one, sidelobes along range become atoms where
        the map holds strong echoes; with one, objects whose echoes in phase
        have their energy at the edge of the band are lost.

    Returns
    -------
    places : ndarray of float64, shape (n, 4)
        In Rayleigh cells.
    strength : ndarray of float64, shape (n,)
        Amplitudes.
    """
    rows = _tapered(atom_map, reach, noise, range_taper)
    found = [*_static_atoms(rows), *_moving_atoms(rows)]
    places = np.concatenate([np.empty((0, 4)), *(each for each, _ in found)])
    strength = np.concatenate([np.empty(0), *(each for _, each in found)])
    return merge_neighbours(places, strength, SAME_PLACE)


def _tapered(atom_map: AtomMap, reach: Reach, noise: float, range_taper: BinTaper) -> _Rows:
    cells = np.tensordot(range_taper.weights, atom_map.cells, 1)
    n_rows, n_doppler = cells.shape[:2]
    mean_power = np.mean(cells.real**2 + cells.imag**2, axis=(1, 2, 3))
    first, last = reach.doppler_limits
    lines = np.arange(first - LINES_BEYOND_BINS, last + LINES_BEYOND_BINS + 1e-9, LINE_STEP_BINS)
    spectra = learn_doppler_spectra(
        cells.reshape(n_rows, n_doppler, -1),
        lines,
        atom_map.line(lines, 1).value,
        np.maximum(noise, mean_power * 10 ** (-MISFIT_DB / 10)),
        SPECTRUM_STEPS,
    )
    return _Rows(reach, DirectionGrid.of(reach), noise, range_taper, cells, spectra)


def _static_atoms(rows: _Rows) -> Iterator[tuple[Floats, Floats]]:
    """Atoms of the static layer, tile by tile."""
    line = rows.reach.atom_map.line(np.zeros(1), 1).value[0]
    filters = rows.spectra.filters(line, np.abs(rows.spectra.doppler_bins) > STATIC_BINS)
    layer = np.einsum("rd,rduw->ruw", filters, rows.cells)
    noise = np.sum(filters**2, axis=1) * rows.noise
    power = np.mean(layer.real**2 + layer.imag**2, axis=(1, 2))
    top = np.sort(power)[-PEAK_BINS // 2 :].mean()
    is_live = power > np.maximum(top * 10 ** (-DYNAMIC_RANGE_DB / 10), STATIC_ABOVE_NOISE * noise)
    is_live &= rows.is_reachable
    live = np.flatnonzero(is_live)
    if not live.size:
        return
    floor = np.maximum(noise, power * 10 ** (-MISFIT_DB / 10))
    sectors = rows.grid.sectors(layer[live], floor[live])
    bins = rows.taper.bins
    still = np.zeros(1), np.ones((1, 1)), np.eye(1)
    for start, end in _cores(bins[live[0]], bins[live[-1]]):
        if not is_live[(bins >= start - 1) & (bins <= end)].any():
            continue
        window = rows.around(start, end)
        shown = sectors[(live >= window.start) & (live < window.stop)]
        active = (shown > shown.max() * 10 ** (-STATIC_SECTOR_DB / 10)).any(axis=0)
        directions = rows.grid.grown(active, STATIC_MARGIN, is_box=True)
        median_noise = float(np.median(noise[window]))
        tile = MapTile(layer[window, None], rows.taper.at(window), *still, directions, median_noise)
        places, strength = learn_tile(tile, rows.grid, rows.reach, STATIC_DIMENSION)
        keep = _in_core(places[:, 0], start, end) & within_dynamic_range(places, strength)
        yield places[keep], strength[keep]


def _cores(first: float, last: float) -> Iterator[tuple[float, float]]:
    """Range bins, from one to below the other, that tiles share."""
    start = first
    while start <= last:
        end = min(start + CORE_BINS, last + 1)
        yield start, end
        start = end


def _in_core(along: Floats, start: float, end: float) -> Mask:
    """Atoms that the core of a tile keeps: each belongs to its nearest bin."""
    return (along >= start - 0.5) & (along < end - 0.5)


def _moving_atoms(rows: _Rows) -> Iterator[tuple[Floats, Floats]]:
    """Atoms of moving echoes, tile by tile of each connected group of lines."""
    movers = _MovingAtoms.of(rows)
    active = movers.active_lines()
    nearby = binary_dilation(active, np.ones(LINE_GROWTH, dtype=np.bool_))
    groups, n_groups = label(nearby)
    bins, lines = rows.taper.bins, rows.spectra.doppler_bins
    for group in range(1, n_groups + 1):
        own, around = active & (groups == group), groups == group
        live = np.flatnonzero(own.any(axis=1))
        if not live.size:
            continue
        for start, end in _cores(bins[live[0]], bins[live[-1]]):
            window = rows.around(start, end)
            used = np.flatnonzero(own[window].any(axis=0))
            is_near = (bins >= start - 1) & (bins <= end)
            for lowest, highest in _line_cores(lines[used]):
                is_own = (lines >= lowest - 0.01) & (lines < highest - 0.01)
                core = own & is_near[:, None] & is_own
                if core.any():
                    at = np.flatnonzero(core.any(axis=1))
                    limits = max(start, bins[at[0]] - 1), min(end, bins[at[-1]] + 2)
                    yield movers.atoms(around, limits, (lowest, highest))


def _line_cores(lines: Floats) -> Iterator[tuple[float, float]]:
    """Doppler bins, from one to below the other, that tiles of a group of lines share."""
    if not lines.size:
        return
    start, last = float(lines[0]), float(lines[-1])
    while start <= last + 1e-9:
        end = min(start + TILE_LINES_BINS, last + LINE_STEP_BINS)
        if last - end < LEAST_LINES_BINS:
            end = last + LINE_STEP_BINS
        yield start, end
        start = end


@dataclass(frozen=True, eq=False)
class _MovingAtoms:
    """Rows without their static line, tapered along Doppler.

    Attributes
    ----------
    cells : ndarray of complex128, shape (n_rows, n, size_u, size_w)
    weights : ndarray of float64, shape (n, n_doppler)
        From Doppler bins to those of the cells.
    doppler_bins : ndarray of float64, shape (n,)
        Bins that the cells are centred on.
    """

    rows: _Rows
    cells: Complex
    weights: Floats
    doppler_bins: Floats

    @classmethod
    def of(cls, rows: _Rows) -> _MovingAtoms:
        atom_map = rows.reach.atom_map
        line = atom_map.line(np.zeros(1), 1).value[0]
        others = np.eye(line.size) - np.multiply.outer(line, line) / (line @ line)
        # Between the grating lobes of bursts there are no sidelobes for a taper to lower.
        taper = BinTaper.hann if atom_map.bursts.is_whole_frame else BinTaper.none
        along_doppler = taper(atom_map.doppler_bins)
        weights = along_doppler.weights @ others
        cells = np.tensordot(rows.cells, weights, ([1], [1])).transpose(0, 3, 1, 2)
        return cls(rows, np.ascontiguousarray(cells), weights, along_doppler.bins)

    def active_lines(self) -> Mask:
        """Mask (n_rows, v) of moving lines that stand out from noise and from misfit of stronger ones."""
        spectra = self.rows.spectra
        is_moving = np.abs(spectra.doppler_bins) > MOVING_BINS
        power = spectra.power * is_moving
        least = maximum_filter(power, LINE_NEIGHBOURHOOD) * 10 ** (-LINE_RANGE_DB / 10)
        # Lines gather the power of cells, and of a bin's half-dozen lines: ten decibels more.
        least = np.maximum(least, power.max() * 10 ** (-(DYNAMIC_RANGE_DB + 10) / 10))
        deviation = spectra.noise[:, None] / np.sqrt(self.cells[0, 0].size)
        least = np.maximum(least, LINE_DEVIATIONS * deviation)
        return (power > least) & is_moving & self.rows.is_reachable[:, None]

    def atoms(
        self, around: Mask, limits: tuple[float, float], line_limits: tuple[float, float]
    ) -> tuple[Floats, Floats]:
        """Atoms of one tile: its core lies between two range bins and between two Doppler bins."""
        rows, lines = self.rows, self.rows.spectra.doppler_bins
        (start, end), (lowest, highest) = limits, line_limits
        window = rows.around(start, end)
        first_bin = self.doppler_bins[0]
        columns = slice(
            max(int(np.floor(lowest - DOPPLER_SIDE_BINS - first_bin)), 0),
            min(int(np.ceil(highest + DOPPLER_SIDE_BINS - first_bin)) + 1, self.doppler_bins.size),
        )
        used = around[window].any(axis=0) & (lines >= lowest - GRID_SIDE_BINS)
        used &= lines <= highest + GRID_SIDE_BINS
        weights = self.weights[columns]
        cells = self.cells[window, columns]
        along_doppler = rows.spectra.kernels[used] @ weights.T
        noise = weights @ weights.T + 1e-3 * np.eye(len(weights))
        lines_of_tile = lines[used], along_doppler, noise
        tile = MapTile(cells, rows.taper.at(window), *lines_of_tile, self._directions(cells), rows.noise)
        places, strength = learn_tile(tile, rows.grid, rows.reach, MOVING_DIMENSION)
        keep = _in_core(places[:, 0], start, end) & within_dynamic_range(places, strength)
        margin = LINE_STEP_BINS / 2
        keep &= (places[:, 1] >= lowest - margin) & (places[:, 1] < highest - margin)
        return places[keep], strength[keep]

    def _directions(self, cells: Complex) -> Mask:
        """Sectors that the strongest cells of a tile show."""
        flat = cells.reshape(-1, *cells.shape[2:])
        power = np.mean(flat.real**2 + flat.imag**2, axis=(1, 2))
        order = np.argsort(-power, kind="stable")[:MOST_SECTOR_CELLS]
        strongest = order[power[order] > power.max() * 10 ** (-MOVING_SECTOR_DB / 10)]
        floor = np.maximum(self.rows.noise, power[strongest] * 10 ** (-MISFIT_DB / 10))
        sectors = self.rows.grid.sectors(flat[strongest], floor)
        active = (sectors > sectors.max() * 10 ** (-MOVING_SECTOR_DB / 10)).any(axis=0)
        return self.rows.grid.grown(active, MOVING_MARGIN, is_box=False)
