"""Orthogonal matching pursuit on a grid in range, Doppler, u and w.

1. A CFAR detector finds the range-Doppler cells that hold echoes.
2. The atom that explains most of the residual is sought in these cells and in
   all directions that the region spans, on a grid of half a Rayleigh cell, then
   on a finer one around the best place, and put between its samples by a
   parabola along each coordinate.
3. It joins the atoms before it, and the amplitudes of all are fitted
   anew, exactly: the residual is orthogonal to every atom. The pursuit goes on
   until an atom explains no more than noise does, or there are enough.
4. Atoms far below their neighbours only correct the places of those, and are
   dropped.

An atom never moves once it is chosen. That is the difference to `nomp4d`, which
moves all of them together after each round.

Cost of m detected cells, g x h directions whose steering vectors span s
dimensions, n cells of the map and K atoms: n s (m + g h) once, and n s + K m g h
an atom.

Fails where scatterers share a Rayleigh cell: the first atom lies between them,
stays there, and the next ones correct for it.

References
----------
Pati, Rezaiifar and Krishnaprasad, "Orthogonal matching pursuit: recursive
function approximation with applications to wavelet decomposition", Asilomar
(1993).
Tropp and Gilbert, "Signal recovery from random measurements via orthogonal
matching pursuit", IEEE Trans. Inf. Theory 53 (2007).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, prod
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.dsp.fitting.atom_fits import fit_atoms
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.grid_pursuit import PlaceGrid, pursue_on_grid
from isacbench.dsp.fitting.pursuit import strongest_around
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.errors import require, require_least
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.kernels import PERIOD
from isacbench.model.observation import Observation
from isacbench.model.region import Interval
from isacbench.plugins.contracts import Needs

from .chain import Detected, Levels, MapEstimator, detect, merge_scatterers, read_map

BIN_STEP = 0.75
"""Bins to either side of a detected cell that the finer grid spans: an echo peaks within half a bin."""


@dataclass(frozen=True)
class Omp4d(MapEstimator):
    """2D-FFT with OSCA-CFAR, then orthogonal matching pursuit in range, Doppler, u and w.

    Attributes
    ----------
    samples_per_cell : int
        Directions of the grid a Rayleigh cell of the array, along u and along w.
    zoom : int
        Atoms of the finer grid a step of the grid, along each coordinate.
    max_scatterers : int
        Largest number of atoms. Time grows with its square.
    detector, pfa, integration, angle_pfa, dynamic_range_db, local_dynamic_range_db
        See `isacbench_algorithms.chain.MapEstimator`. Noise alone shows an atom in one image of eight.
    precision, detection_window
        See `isacbench_algorithms.chain.MapEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    name: ClassVar[str] = "omp4d"

    angle_pfa: float = 1e-3
    dynamic_range_db: float = 33.0
    local_dynamic_range_db: float = 10.0
    samples_per_cell: int = 2
    zoom: int = 4
    max_scatterers: int = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        require_least(self, samples_per_cell=1, max_scatterers=1)
        require(1 <= self.zoom <= 8, "zoom", self.zoom, "1 to 8")

    @property
    def needs(self) -> Needs:
        """All elements of all cells."""
        return replace(super().needs, cells="gate")

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation."""
        rdm = read_map(observation, self)  # 2D-FFT
        detected = detect(rdm, self)  # OSCA-CFAR
        if not detected.cells.bins[0].size:
            return PointCloud.empty()
        with stage("spectrum"):
            atom_map = AtomMap.from_map(rdm.gated, observation.system, observation.cosine_limits)
            grid = self.grid(observation, detected, atom_map)
        places = self.pursue(atom_map, grid, detected.levels)  # best atom, exact amplitudes, and so on
        found = merge_scatterers(self.strong(atom_map, places))
        return self.to_cloud(rdm, found)

    def grid(self, observation: Observation, detected: Detected, atom_map: AtomMap) -> PlaceGrid:
        """Grid of the detected cells and of the directions that the region spans."""
        step = 1 / self.samples_per_cell
        u, w = (
            _cosine_cells(limits, size, step)
            for limits, size in zip(observation.cosine_limits, atom_map.cell_size[2:], strict=True)
        )
        bins = np.stack(detected.cells.bins, axis=1).astype(np.float64)
        return PlaceGrid(bins, u, w, np.array([BIN_STEP, BIN_STEP, step, step]), self.zoom)

    def pursue(self, atom_map: AtomMap, grid: PlaceGrid, levels: Levels) -> Floats:
        """Explain the map by atoms that exceed the highest output of noise.

        Returns
        -------
        ndarray of float64, shape (k, 4)
            Their places in Rayleigh cells.
        """
        with stage("refinement"):
            n_independent = len(grid.bins) * prod(max(np.ptp(line), 1.0) for line in (grid.u, grid.w))
            highest_noise = levels.white * np.log(n_independent / self.angle_pfa)
            pursued = pursue_on_grid(
                atom_map, grid, highest_noise, self.dynamic_range_db, self.max_scatterers
            )
            return pursued.places

    def strong(self, atom_map: AtomMap, places: Floats) -> LocatedScatterers:
        """Keep and fit the atoms that are not far below others nearby, or below sidelobes of others.

        Parameters
        ----------
        places : ndarray of float64, shape (k, 4)
            From `pursue`.
        """
        if not len(places):
            return LocatedScatterers.empty()
        with stage("refinement"):
            fit = fit_atoms(atom_map, places)
            strongest = strongest_around(places, fit)
            stays = fit.shown_energy >= strongest * 10 ** (-self.local_dynamic_range_db / 10)
            fit = fit_atoms(atom_map, places[stays], known=fit)
        range_bin, doppler_bin, u, w = (fit.places * atom_map.cell_size).T
        power, family = fit.shown_energy / prod(atom_map.array_shape), np.full(len(fit), -1)
        return LocatedScatterers(range_bin, doppler_bin, u, w, power, family)


def _cosine_cells(limits: Interval, size: float, step: float) -> Floats:
    """Cosines in Rayleigh cells from one limit to the other; the ends of a whole circle are one direction."""
    lower, upper = limits
    n_steps, is_open = ceil((upper - lower) / size / step), upper - lower < PERIOD
    return np.linspace(lower / size, upper / size, n_steps + is_open, endpoint=is_open)
