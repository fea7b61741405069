"""The chain that cell-by-cell estimators share: detect, look into every cell, explain all cells together.

1. Range-Doppler cells are detected on a Hann-tapered map, whose sidelobes are
   low, by a CFAR detector on one element or on the array's average power.
2. The estimator itself finds plane waves in the P x Q snapshots of the cells.
   These are tapered less, for resolution.
3. Plane waves get a place in range and Doppler, pass the own-cell test, and
   are merged where cells saw one scatterer twice.
4. Of the candidates, those are selected that explain the map together, and
   then moved between the bins to where the rest of the map leaves them.

Steps 3 and 4 need no constant of the scene: what counts is the noise, the
strongest cells and the strongest scatterers nearby.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from isacbench.contracts import Detector, Diagnosis, Spectrum
from isacbench.dsp.detection import DetectedCells, Integration, detect_cells
from isacbench.dsp.joint import refine_jointly, select_jointly
from isacbench.dsp.planewaves import PlaneWaves
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scatterers import locate, merge_duplicates
from isacbench.dsp.windows import Window
from isacbench.errors import require
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation

from .detectors import OscaCfar

__all__ = ["CellwiseEstimator"]

Snapshots = NDArray[np.complex128]

DETECTION_WINDOW: Window = "hann"

OWN_CELL_EXCESS = (3.0, 1.0)
"""Own-cell test along range, where lines of scatterers have no local maximum, and along Doppler."""


@dataclass(frozen=True)
class CellwiseEstimator(ABC):
    """Parameters and steps of a cell-by-cell estimator; subclasses add how to find plane waves.

    Attributes
    ----------
    detector : Detector
        Of range-Doppler cells.
    pfa : float or None
        Overrides the detector's probability of false alarm.
    integration : {"noncoherent", "element"}
        Detect on power averaged over the array, or on one element.
    range_window, doppler_window : {"rect", "soft", "hamming", "hann", "blackman"}
        Taper of the cells whose angles are estimated.
    max_sources : int
        Most plane waves in a cell.
    angle_pfa : float
        Probability that noise passes for a plane wave, or for a scatterer.
    dynamic_range_db : float
        Below the strongest cells, what is neither detected nor modelled.
    local_dynamic_range_db : float
        Below the strongest scatterer nearby, what is not told from its leakage.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    detector: Detector = field(default_factory=lambda: OscaCfar(order_axis=1))
    pfa: float | None = None
    integration: Integration = "noncoherent"
    range_window: Window = "rect"
    doppler_window: Window = "soft"
    max_sources: int = 6
    angle_pfa: float = 1e-5
    dynamic_range_db: float = 28.0
    local_dynamic_range_db: float = 16.5

    def __post_init__(self) -> None:
        require(self.max_sources >= 1, "max_sources", self.max_sources, "1 and more")
        require(0 < self.angle_pfa < 1, "angle_pfa", self.angle_pfa, "between 0 and 1")
        for name in ("dynamic_range_db", "local_dynamic_range_db"):
            require(getattr(self, name) > 0, name, getattr(self, name), "above 0")
        self.cell_detector()

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        PointCloud
        """
        system = observation.system
        gated = GatedMap(observation.cells, observation.gate)
        tapered = self._tapered(gated)
        detected = self._detect(gated)
        # Only where region or speeds span the whole map do detected cells lie at its edge.
        inside = tapered.surrounds(detected.bins)
        bins = detected.bins[0][inside], detected.bins[1][inside]
        if not inside.any():
            return PointCloud.empty()
        snapshots = tapered.cells[tapered.index(bins)]
        min_power = -np.log(self.angle_pfa) * detected.floor / gated.n_elements
        waves = self.plane_waves(observation, snapshots, detected.floor, min_power)
        candidates = locate(
            waves,
            tapered,
            bins,
            (self.range_window, self.doppler_window),
            OWN_CELL_EXCESS,
            self.local_dynamic_range_db,
        )
        chosen = select_jointly(
            merge_duplicates(candidates), gated, system, min_power, self.local_dynamic_range_db
        )
        found = refine_jointly(chosen, gated, system)
        unit_power = found.power / system.processing_gain
        return observation.cloud(found.range_bin, found.doppler_bin, found.u, found.w, unit_power)

    def diagnose(self, observation: Observation) -> Diagnosis:
        """Show the range-Doppler map, its test, and the spectra of the strongest detected cell.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        Diagnosis
        """
        gated = GatedMap(observation.cells, observation.gate)
        detected = self._detect(gated)
        seen = gated.tapered(DETECTION_WINDOW, DETECTION_WINDOW).gate
        cell = detected.strongest_cell(seen)
        spectra: tuple[Spectrum, ...] = ()
        tapered = self._tapered(gated)
        if cell is not None and tapered.surrounds(bins := (np.array([cell[0]]), np.array([cell[1]]))).all():
            snapshot = tapered.cells[tapered.index(bins)]
            spectra = self.spectra(observation, snapshot, detected.floor)
        return Diagnosis(
            detected.power, detected.detection, seen.range_bins, seen.doppler_bins, spectra, cell
        )

    @abstractmethod
    def plane_waves(
        self, observation: Observation, snapshots: Snapshots, noise: float, min_power: float
    ) -> PlaneWaves:
        """Find the plane waves of each cell.

        Parameters
        ----------
        observation : Observation
        snapshots : ndarray of complex128, shape (n, P, Q)
        noise : float
            Power per element that noise and leakage have at most.
        min_power : float
            Power per element that a plane wave must have.

        Returns
        -------
        PlaneWaves
            One row a cell.
        """

    @abstractmethod
    def spectra(self, observation: Observation, snapshot: Snapshots, noise: float) -> tuple[Spectrum, ...]:
        """Angular spectra of one cell's snapshot (1, P, Q), with their tests and peaks."""

    def cell_detector(self) -> Detector:
        """Detector of range-Doppler cells, with this estimator's probability of false alarm if it has one."""
        if self.pfa is None:
            return self.detector
        return cast("Detector", replace(cast("Any", self.detector), pfa=self.pfa))

    def _detect(self, gated: GatedMap) -> DetectedCells:
        seen = gated.tapered(DETECTION_WINDOW, DETECTION_WINDOW)
        return detect_cells(seen, self.cell_detector(), self.integration, self.dynamic_range_db)

    def _tapered(self, gated: GatedMap) -> GatedMap:
        return gated.tapered(self.range_window, self.doppler_window)
