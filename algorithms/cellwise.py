"""Base of cell-by-cell estimators: their parameters, and a method for each stage to exchange.

The stages themselves are functions (`isacbench_algorithms.chain`). An estimator
calls them in order in its `estimate`, and adds how plane waves are found in the
snapshots of the cells.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, cast, get_args

import numpy as np

from isacbench.added_fields import added_field
from isacbench.dsp.angles.aperture import Aperture, Cross, Plane
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.cell_detection import Integration
from isacbench.dsp.fitting.joint_selection import refine_jointly, select_jointly
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.dsp.windows import Window
from isacbench.errors import require
from isacbench.instrument.remarks import Remarks
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Detection, Detector, Diagnosis, Needs, Spectrum

from . import chain
from .chain import CellSnapshots, Levels, PrecisionStage, Reading, ReadMap
from .detectors import OscaCfar

CellPrecision = Literal["double", "single"]

Explanation = Literal["joint", "none"]
"""Treatment of the candidates that the cells show: joint selection and refinement, or none."""


@dataclass(frozen=True)
class CellwiseEstimator(ABC):
    """Base of estimators that find plane waves in range-Doppler cells: parameters, and a method a stage.

    A subclass has `estimate`, which calls the stages in order, `plane_waves`,
    and `spectra` if it has any to show. A stage is exchanged by an argument or
    by overriding one method:

    ==================  ===================================================
    stage               exchanged by
    ==================  ===================================================
    detection           argument `detector`
    plane waves         `plane_waves`; of subspace methods, the number of
                        sources: argument `model_order`, or `signal_order`
    own-cell test       `own_cell_test`
    merging             `merge`
    joint selection     `select`, or none with argument `explain` "none"
    joint refinement    `refine`, or none with argument `explain` "none"
    cloud               `to_cloud`
    ==================  ===================================================

    Attributes
    ----------
    separable : bool
        Class attribute: whether directions are sought along u and along w
        apart, so that one column and one row of the array show them.
    single_stages : frozenset of {"detection", "directions", "subspace", "selection"}
        Class attribute: what `precision` "single" computes in single
        precision.
    detector : Detector
        Of range-Doppler cells.
    pfa : float or None
        Overrides the detector's probability of false alarm.
    integration : {"noncoherent", "element"}
        Detect on power averaged over the array, or on its element (0, 0). With
        "element", a separable estimator reads no more than the column and the
        row of that element, P + Q - 1 elements instead of P Q.
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
    precision : {"double", "single"}
        Of the cells. "single" in the stages whose effect on the curves is
        below 0.1 % (``docs/precision.md``): subspaces and joint least squares
        are double either way.
    explain : {"joint", "none"}
        What happens to the candidates that the cells show. "joint" selects
        those that explain the map together and refines them together; "none"
        makes all of them points. An estimator with several readings then
        merges the candidates of all of them.
    detection_window : {"hann", "rect", "soft", "hamming", "blackman"}
        Taper of the map that cells are detected on, along range and Doppler.
        Its sidelobes must not look like echoes.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    separable: ClassVar[bool] = False
    # Directions hang on the last digits of the snapshots: points would move by more than 1e-6 of their size.
    single_stages: ClassVar[frozenset[PrecisionStage]] = frozenset({"detection"})

    detector: Detector = field(default_factory=lambda: OscaCfar(order_axis=1))
    pfa: float | None = None
    integration: Integration = "noncoherent"
    range_window: Window = "rect"
    doppler_window: Window = "soft"
    max_sources: int = 6
    angle_pfa: float = 1e-5
    dynamic_range_db: float = 28.0
    local_dynamic_range_db: float = 16.5
    precision: CellPrecision = "double"
    explain: Literal["joint", "none"] = added_field("joint", before="joint")
    detection_window: Window = added_field("hann", before="hann")  # noqa: RUF009, a field

    own_cell_test = staticmethod(chain.own_cell_test)
    merge = staticmethod(chain.merge_scatterers)
    to_cloud = staticmethod(chain.to_cloud)

    def __post_init__(self) -> None:
        require(self.max_sources >= 1, "max_sources", self.max_sources, "1 and more")
        require(0 < self.angle_pfa < 1, "angle_pfa", self.angle_pfa, "between 0 and 1")
        for name in ("dynamic_range_db", "local_dynamic_range_db"):
            require(getattr(self, name) > 0, name, getattr(self, name), "above 0")
        require(self.precision in ("double", "single"), "precision", self.precision, "single or double")
        require(self.explain in get_args(Explanation), "explain", self.explain, "joint or none")
        windows, window = get_args(Window), self.detection_window
        require(window in windows, "detection_window", window, f"one of {', '.join(windows)}")
        self.cell_detector()

    @property
    def needs(self) -> Needs:
        """All elements, or the column and the row of one, and the directions of detected cells alone."""
        one_cross = self.separable and self.integration == "element"
        return Needs("cross" if one_cross else "plane", self.integration, "detected")

    def aperture(self, observation: Observation) -> Aperture:
        """Elements that are read of an observation."""
        return (Cross if self.needs.elements == "cross" else Plane)(*observation.array.shape)

    def dtype_in(self, stage: PrecisionStage) -> type[np.complexfloating[Any, Any]]:
        """Precision in which a stage reads cells."""
        return np.complex64 if self.precision == "single" and stage in self.single_stages else np.complex128

    def cell_detector(self) -> Detector:
        """Detector of range-Doppler cells, with this estimator's probability of false alarm if it has one."""
        if self.pfa is None:
            return self.detector
        return cast("Detector", replace(cast("Any", self.detector), pfa=self.pfa))

    def readings(self) -> tuple[Reading, ...]:
        """Windows that the cells are read behind, one reading after the other; `diagnose` draws the last."""
        return (Reading(self.range_window, self.doppler_window),)

    @abstractmethod
    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation: the stages of `isacbench_algorithms.chain` in order.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        PointCloud
        """

    @abstractmethod
    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find the plane waves of each cell.

        Parameters
        ----------
        observation : Observation
        cells : CellSnapshots

        Returns
        -------
        PlaneWaves
            One row a cell.

        Notes
        -----
        It marks its own stages (`isacbench.instrument.stages`).
        """

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """Angular spectra of the first cell, with their tests and peaks, for `diagnose`; none by default."""
        return ()

    def select(
        self, rdm: ReadMap, levels: Levels, candidates: LocatedScatterers, members: LocatedScatterers
    ) -> LocatedScatterers:
        """Select the scatterers that explain the map together.

        Parameters
        ----------
        rdm : ReadMap
        levels : Levels
        candidates : LocatedScatterers
            What one reading of the cells shows.
        members : LocatedScatterers
            What was selected from earlier readings.

        Returns
        -------
        LocatedScatterers
            Of both, see `isacbench.dsp.fitting.joint_selection.select_jointly`.
        """
        return select_jointly(
            members.join(candidates),
            rdm.selection,
            rdm.observation.system,
            levels.min_power,
            self.local_dynamic_range_db,
            len(members),
        )

    def refine(self, rdm: ReadMap, levels: Levels, chosen: LocatedScatterers) -> LocatedScatterers:
        """Refine the selected scatterers together.

        Parameters
        ----------
        rdm : ReadMap
        levels : Levels
        chosen : LocatedScatterers

        Returns
        -------
        LocatedScatterers
            See `isacbench.dsp.fitting.joint_selection.refine_jointly`.
        """
        return refine_jointly(chosen, rdm.selection, rdm.observation.system)

    def diagnose(self, observation: Observation) -> Diagnosis:
        """Show the range-Doppler map, its test, and the spectra of the strongest detected cell.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        Diagnosis
        """
        rdm = chain.read_map(observation, self)
        detected = chain.detect(rdm, self)
        cells = chain.read_cells(rdm, detected.strongest(), self.readings()[-1])
        with Remarks() as remarks:
            spectra = self.spectra(observation, cells) if len(cells) else ()
        power, detection, unit = detected.cells.power.astype(np.float64), detected.cells.detection, rdm.unit
        return Diagnosis(
            power * unit * unit,
            Detection(detection.mask, detection.threshold * unit * unit, detection.noise * unit * unit),
            detected.gate.range_bins,
            detected.gate.doppler_bins,
            spectra,
            detected.cells.strongest_cell(detected.gate),
            _separated(remarks),
        )


def _separated(remarks: Remarks) -> bool | None:
    """Whether signal and noise were separated in all subspaces; None where there were none."""
    count = remarks.counts.get("unseparated")
    return None if count is None else count.n == 0
