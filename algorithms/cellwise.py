"""The chain that cell-by-cell estimators share: detect, look into every cell, explain all cells together.

1. Range-Doppler cells are detected on a Hann-tapered map, whose sidelobes are
   low, by a CFAR detector on one element or on the array's average power.
2. The estimator itself finds plane waves in the snapshots of the cells, of
   P x Q elements, or of one column and one row of them. These are tapered
   less, for resolution.
3. Plane waves get a place in range and Doppler, pass the own-cell test, and
   are merged where cells saw one scatterer twice.
4. Of the candidates, those are selected that explain the map together, and
   then moved between the bins to where the rest of the map leaves them.

An estimator may look at the cells more than once, behind different windows:
what a later look sees joins if the earlier ones leave it unexplained.

Steps 3 and 4 need no constant of the scene: what counts is the noise, the
strongest cells and the strongest scatterers nearby.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.angles.aperture import Aperture, Cross, Plane
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.cell_detection import DetectedCells, Integration, detect_cells, white_noise
from isacbench.dsp.fitting.joint_selection import refine_jointly, select_jointly
from isacbench.dsp.rangedoppler import Bins, GatedMap
from isacbench.dsp.scaling import amplitude_exponent, in_unit
from isacbench.dsp.scatterers import LocatedScatterers, locate, merge_duplicates
from isacbench.dsp.windows import Window
from isacbench.errors import require
from isacbench.instrument.remarks import Remarks
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Detection, Detector, Diagnosis, Needs, Spectrum

from .detectors import OscaCfar

__all__ = ["CellwiseEstimator", "Levels", "Look", "Precision", "PrecisionStage", "middle"]

Snapshots = NDArray[np.complexfloating[Any, Any]]

Precision = Literal["double", "single"]

PrecisionStage = Literal["detection", "directions", "subspace", "selection"]
"""What is done with cells: the map and its test; snapshots, their Fourier spectra and amplitudes;
covariances, their eigenvectors and null spectra; the joint explanation."""

DETECTION_WINDOW: Window = "hann"

ROUNDING_UNITS = 4
"""Last digits of the strongest cell that sums over a few of them lose: noise, where there is no other."""

OWN_CELL_EXCESS = (3.0, 1.0)
"""Own-cell test along range, where lines of scatterers have no local maximum, and along Doppler."""


class _Maps(NamedTuple):
    """One map, in the precision of each stage, its amplitudes in units of a power of two."""

    detection: GatedMap
    directions: GatedMap
    selection: GatedMap
    unit: float


class Levels(NamedTuple):
    """Power per element of white noise, and that which noise and leakage have at most."""

    white: float
    floor: float


@dataclass(frozen=True)
class Look:
    """How the cells are read whose plane waves are sought.

    Attributes
    ----------
    range_window, doppler_window : {"rect", "soft", "hamming", "hann", "blackman"}
        Tapers.
    range_cells : {1, 3}
        Neighbouring range cells that serve as snapshots, the cell itself in
        the middle. More give the mean direction of what a crowd of echoes
        spreads over them.
    resolved_only : bool
        Whether only cells count that their plane waves explain down to the
        noise.
    one_doppler : bool
        Whether plane waves must look like one echo along Doppler.
    """

    range_window: Window
    doppler_window: Window
    range_cells: int = 1
    resolved_only: bool = False
    one_doppler: bool = False


@dataclass(frozen=True)
class CellwiseEstimator(ABC):
    """Parameters and steps of a cell-by-cell estimator; subclasses add how to find plane waves.

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
    precision: Precision = "double"

    def __post_init__(self) -> None:
        require(self.max_sources >= 1, "max_sources", self.max_sources, "1 and more")
        require(0 < self.angle_pfa < 1, "angle_pfa", self.angle_pfa, "between 0 and 1")
        for name in ("dynamic_range_db", "local_dynamic_range_db"):
            require(getattr(self, name) > 0, name, getattr(self, name), "above 0")
        require(self.precision in ("double", "single"), "precision", self.precision, "single or double")
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
        with stage("rdm"):
            maps = self._read(observation)
            gated = maps.selection
        with stage("detection"):
            detected = self._detect(maps.detection)
            levels = _levels(maps, detected)
        min_power = -np.log(self.angle_pfa) * detected.floor / gated.n_elements
        chosen = LocatedScatterers.empty()
        for look in self.looks():
            with stage("peaks"):
                candidates = self._candidates(
                    observation, maps.directions, detected.bins, look, levels, min_power, chosen.next_family
                )
            with stage("refinement"):
                chosen = select_jointly(
                    chosen.join(candidates),
                    gated,
                    system,
                    min_power,
                    self.local_dynamic_range_db,
                    len(chosen),
                )
        with stage("refinement"):
            found = self.refine(chosen, gated, system, levels, min_power)
        with stage("peaks"):
            # Unit by unit: its square may overflow where the power does not.
            unit_power = found.power / system.processing_gain * maps.unit * maps.unit
            return observation.cloud(found.range_bin, found.doppler_bin, found.u, found.w, unit_power)

    def looks(self) -> tuple[Look, ...]:
        """How the cells are read, one look after the other; the last one is drawn by `diagnose`."""
        return (Look(self.range_window, self.doppler_window),)

    def refine(
        self, chosen: LocatedScatterers, gated: GatedMap, system: System, levels: Levels, min_power: float
    ) -> LocatedScatterers:
        """Refine the selected scatterers together.

        Parameters
        ----------
        chosen : Scatterers
        gated : GatedMap
            Without tapers.
        system : System
        levels : Levels
        min_power : float
            Power per element that a scatterer must have.

        Returns
        -------
        Scatterers
        """
        return refine_jointly(chosen, gated, system)

    def diagnose(self, observation: Observation) -> Diagnosis:
        """Show the range-Doppler map, its test, and the spectra of the strongest detected cell.

        Parameters
        ----------
        observation : Observation

        Returns
        -------
        Diagnosis
        """
        maps = self._read(observation)
        detected = self._detect(maps.detection)
        seen = _for_detection(maps.detection).gate
        cell = detected.strongest_cell(seen)
        spectra: tuple[Spectrum, ...] = ()
        separated = None
        look = self.looks()[-1]
        tapered = _looked_at(maps.directions, look)
        if cell is not None and tapered.surrounds(bins := (np.array([cell[0]]), np.array([cell[1]]))).all():
            snapshots = _snapshots(tapered, bins, look.range_cells)
            with Remarks() as remarks:
                spectra = self.spectra(observation, snapshots, _levels(maps, detected))
            separated = _separated(remarks)
        power, detection, unit = detected.power.astype(np.float64), detected.detection, maps.unit
        return Diagnosis(
            power * unit * unit,
            Detection(detection.mask, detection.threshold * unit * unit, detection.noise * unit * unit),
            seen.range_bins,
            seen.doppler_bins,
            spectra,
            cell,
            separated,
        )

    @abstractmethod
    def plane_waves(
        self,
        observation: Observation,
        look: Look,
        snapshots: Snapshots,
        levels: Levels,
        min_power: float,
    ) -> PlaneWaves:
        """Find the plane waves of each cell.

        Parameters
        ----------
        observation : Observation
        look : Look
        snapshots : ndarray of complex, shape (n, s, *elements)
            Of each cell and its neighbours in range, the cell in the middle,
            on the elements of `aperture`.
        levels : Levels
        min_power : float
            Power per element that a plane wave must have.

        Returns
        -------
        PlaneWaves
            One row a cell.

        Notes
        -----
        Its time counts for the stage ``peaks``, but for what it marks itself (`isacbench.instrument.stages`).
        """

    @abstractmethod
    def spectra(self, observation: Observation, snapshots: Snapshots, levels: Levels) -> tuple[Spectrum, ...]:
        """Angular spectra of one cell's snapshots (1, s, *elements), with their tests and peaks."""

    def cell_detector(self) -> Detector:
        """Detector of range-Doppler cells, with this estimator's probability of false alarm if it has one."""
        if self.pfa is None:
            return self.detector
        return cast("Detector", replace(cast("Any", self.detector), pfa=self.pfa))

    def _read(self, observation: Observation) -> _Maps:
        """Map of the elements that are needed; the others may never have been computed."""
        aperture = self.aperture(observation)
        cells = observation.cross if isinstance(aperture, Cross) else observation.cells
        exponent = amplitude_exponent(cells)
        gated = GatedMap.of(observation, in_unit(cells, exponent), aperture)
        maps = {
            dtype: gated.astype(dtype)
            for dtype in {self.dtype_in(stage) for stage in ("detection", "directions", "selection")}
        }
        return _Maps(
            detection=maps[self.dtype_in("detection")],
            directions=maps[self.dtype_in("directions")],
            selection=maps[self.dtype_in("selection")],
            unit=float(np.ldexp(1.0, exponent)),
        )

    def _detect(self, gated: GatedMap) -> DetectedCells:
        seen = _for_detection(gated)
        return detect_cells(seen, self.cell_detector(), self.integration, self.dynamic_range_db)

    def _candidates(
        self,
        observation: Observation,
        gated: GatedMap,
        detected: Bins,
        look: Look,
        levels: Levels,
        min_power: float,
        first_family: int,
    ) -> LocatedScatterers:
        """Scatterers that the cells show in one look."""
        tapered = _looked_at(gated, look)
        # Cells at the map's edge are detected only where the gate has no room for margins.
        inside = tapered.surrounds(detected)
        bins = detected[0][inside], detected[1][inside]
        if not inside.any():
            return LocatedScatterers.empty()
        with stage("rdm"):
            snapshots = _snapshots(tapered, bins, look.range_cells)
        waves = self.plane_waves(observation, look, snapshots, levels, min_power)
        located = locate(
            waves,
            tapered,
            bins,
            (look.range_window, gated.doppler_taper(look.doppler_window)),
            OWN_CELL_EXCESS,
            self.local_dynamic_range_db,
            first_family,
            # Grating lobes put echoes of all speeds into every bin: next to none looks like one.
            look.one_doppler and not gated.sees_lobes,
        )
        return merge_duplicates(located)


def middle(snapshots: Snapshots) -> Snapshots:
    """Snapshots (n, *elements) of the cells themselves, out of those (n, s, *elements) with neighbours."""
    return snapshots[:, snapshots.shape[1] // 2]


def _for_detection(gated: GatedMap) -> GatedMap:
    """Map behind the windows that cells are detected with."""
    return gated.tapered(DETECTION_WINDOW, gated.doppler_taper(DETECTION_WINDOW))


def _looked_at(gated: GatedMap, look: Look) -> GatedMap:
    """Map behind the windows of a look."""
    return gated.tapered(look.range_window, gated.doppler_taper(look.doppler_window), neighbours=1)


def _levels(maps: _Maps, detected: DetectedCells) -> Levels:
    """Levels of a map; white noise is never above the floor that was detected with, nor below rounding."""
    last_digit = float(np.finfo(maps.directions.cells.dtype).eps)
    rounding = (ROUNDING_UNITS * last_digit) ** 2 * float(detected.power.max())
    return Levels(min(max(white_noise(maps.detection), rounding), detected.floor), detected.floor)


def _separated(remarks: Remarks) -> bool | None:
    """Whether signal and noise were separated in all subspaces; None where there were none."""
    count = remarks.counts.get("unseparated")
    return None if count is None else count.n == 0


def _snapshots(tapered: GatedMap, bins: Bins, n_range: int) -> Snapshots:
    """Snapshots (n, s, *elements) of cells and of their neighbours in range."""
    rows, columns = tapered.index(bins)
    steps = np.arange(n_range) - n_range // 2
    around: Snapshots = tapered.cells[rows[:, None] + steps, columns[:, None]]
    return around
