"""Orthogonal matching pursuit on a grid in range, Doppler, u and w.

1. A CFAR detector finds the range-Doppler cells that hold echoes.
2. The grid is made of these cells and of all directions that the region spans.
   The atom that explains most of the residual is sought on it, and then on
   a grid eight times finer around it.
3. It joins the atoms before it, and the amplitudes of all are fitted
   anew, exactly: the residual is orthogonal to every atom. The pursuit goes on
   until an atom explains no more than noise does, or there are enough.
4. Atoms far below their neighbours make up for places between the grid's, and
   are dropped.

Atoms stay on the grid where they were found: what their places lack against
those of `nomp4d`, which moves all of them together, is the price of a grid.

Cost of m cells, g x h directions whose steering vectors span s dimensions, and
K atoms: m s (n + g h) once for n cells of the map, and K m g h an atom.

Fails where scatterers share a Rayleigh cell: the first atom lies between them,
stays there, and the next ones make up for it. There is no refinement.

References
----------
Pati, Rezaiifar and Krishnaprasad, "Orthogonal matching pursuit: recursive
function approximation with applications to wavelet decomposition", Asilomar
(1993).
Tropp and Gilbert, "Signal recovery from random measurements via orthogonal
matching pursuit", IEEE Trans. Inf. Theory 53 (2007).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import ClassVar

import numpy as np

from isacbench.dsp.angles.planar_spectra import cosine_samples
from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.grid_pursuit import PlaceGrid, Pursued, pursue_on_grid
from isacbench.dsp.fitting.pursuit import strongest_around
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.errors import require
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation

from .chain import Detected, Levels, MapEstimator, detect, read_map

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
        See `isacbench_algorithms.chain.MapEstimator`.
    precision, detection_window
        See `isacbench_algorithms.chain.MapEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> from isacbench import load_scenario, observe
    >>> cloud = Omp4d(max_scatterers=50).estimate(observe(load_scenario("street"), snr_db=10))
    >>> 20 < len(cloud) <= 50
    True
    """

    name: ClassVar[str] = "omp4d"

    dynamic_range_db: float = 33.0
    local_dynamic_range_db: float = 10.0
    samples_per_cell: int = 2
    zoom: int = 4
    max_scatterers: int = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("samples_per_cell", 1), ("zoom", 1), ("max_scatterers", 1)):
            require(getattr(self, name) >= least, name, getattr(self, name), f"{least} and more")

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        PointCloud
        """
        rdm = read_map(observation, self)  # 2D-FFT
        detected = detect(rdm, self)  # OSCA-CFAR
        if not detected.cells.bins[0].size:
            return PointCloud.empty()
        with stage("spectrum"):
            atom_map = AtomMap.from_map(rdm.selection, observation.system, observation.cosine_limits)
            grid = self.grid(observation, detected, atom_map)
        atoms = self.pursue(atom_map, grid, detected.levels)  # best atom, exact amplitudes, and so on
        found = self.merge(self.strong(atoms, atom_map))
        return self.to_cloud(rdm, found)

    def grid(self, observation: Observation, detected: Detected, atom_map: AtomMap) -> PlaceGrid:
        """Grid of the detected cells and of the directions that the region spans.

        Parameters
        ----------
        observation : Observation
        detected : Detected
        atom_map : AtomMap

        Returns
        -------
        PlaceGrid
        """
        step = 1 / self.samples_per_cell
        u, w = (
            cosine_samples((lower / size, upper / size), step)[1:-1]
            for (lower, upper), size in zip(observation.cosine_limits, atom_map.cell_size[2:], strict=True)
        )
        bins = np.stack(detected.cells.bins, axis=1).astype(np.float64)
        return PlaceGrid(bins, u, w, np.array([BIN_STEP, BIN_STEP, step, step]), self.zoom)

    def pursue(self, atom_map: AtomMap, grid: PlaceGrid, levels: Levels) -> Pursued:
        """Explain the map by atoms of the grid that exceed the noise.

        Parameters
        ----------
        atom_map : AtomMap
        grid : PlaceGrid
        levels : Levels

        Returns
        -------
        Pursued
        """
        with stage("refinement"):
            least_energy = -np.log(self.angle_pfa) * levels.white
            return pursue_on_grid(
                atom_map, grid, least_energy, self.dynamic_range_db, self.max_scatterers
            )

    def strong(self, atoms: Pursued, atom_map: AtomMap) -> LocatedScatterers:
        """Keep the atoms that are not far below others nearby, or below the sidelobes of others.

        Parameters
        ----------
        atoms : Pursued
        atom_map : AtomMap

        Returns
        -------
        LocatedScatterers
        """
        with stage("peaks"):
            strongest = strongest_around(atoms.places, atoms, atom_map.bursts) if len(atoms) else 0.0
            kept = atoms.shown >= strongest * 10 ** (-self.local_dynamic_range_db / 10)
            range_bin, doppler_bin, u, w = (atoms.places[kept] * atom_map.cell_size).T
            power = atoms.shown[kept] / prod(atom_map.array_shape)
            return LocatedScatterers(range_bin, doppler_bin, u, w, power, np.full(power.size, -1))
