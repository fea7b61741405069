"""Stages of cell-by-cell estimators, one function per stage in the order of imaging, and their base class.

1. `read_map` reads the range-Doppler map.
2. `detect` finds the cells that hold echoes, on a map tapered for low
   sidelobes, by a CFAR detector on the strongest beam, on the array's average
   power or on one element.
3. `read_cells` takes the snapshots of those cells, less tapered, for
   resolution. In them the estimator finds plane waves by its own method.
4. `determined` drops plane waves that stand for several scatterers: what their
   cell leaves unexplained does not determine their direction.
5. `locate` places plane waves in range and Doppler.
6. `CellwiseEstimator.own_cell_test` drops those that are stronger in a neighbouring Doppler
   cell, or much stronger in a neighbouring range cell.
7. `CellwiseEstimator.sidelobe_test` drops what stronger scatterers of other cells explain: the same
   scatterer seen twice, sidelobes and grating lobes.
8. `to_cloud` turns radio coordinates into points.

No stage needs a constant of the scene: levels follow from the noise, the strongest
cells and the strongest scatterers nearby. Every stage measures its own time
(`isacbench.instrument.stages`).

References
----------
arXiv 2310.06401, for the map, the detection and the order of the stages.
``docs/errata.md`` says what the paper has of `determined`, `own_cell_test` and
`sidelobe_test`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from types import FunctionType
from typing import Any, ClassVar, Literal, NamedTuple, cast, get_args

import numpy as np

from isacbench.checked_arrays import Complex, Integers
from isacbench.cores import one_blas_thread
from isacbench.dsp.angles.aperture import Aperture, Cross, Plane
from isacbench.dsp.angles.beamformers import strongest_direction
from isacbench.dsp.angles.line_subspaces import Eigenpairs, separated_order
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.cell_detection import (
    BeamsOfCells,
    DetectedCells,
    Integration,
    detect_cells,
    white_noise,
)
from isacbench.dsp.doppler_notch import check_notch, without_slow_points, without_static_echoes
from isacbench.dsp.fitting.joint_selection import MatchedFilters, select_jointly
from isacbench.dsp.floating_point import scale_to_unit
from isacbench.dsp.rangedoppler import GatedMap, TaperedMap
from isacbench.dsp.scatterers import LocatedScatterers, ScatterersInCells, locate_waves, merge_duplicates
from isacbench.dsp.windows import Window
from isacbench.errors import require, require_least, require_option, require_positive
from isacbench.instrument.remarks import Remarks, remark
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.gate import Bins
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Detection, Detector, Diagnosis, Needs, Spectrum

from .detectors import OscaCfar

CellPrecision = Literal["double", "single"]

LEAST_NOISE = 1e-10
"""Least noise amplitude relative to the strongest cell: 200 dB below it, fits need not be more exact."""

SIDELOBE_EXCESS = 1.1
"""Least amplitude over what a stronger scatterer of another cell shows there; above 1 for what is wrong
about its place. Images hardly change from 1.05 to 1.5."""

LEAST_LEFT = 0.33
"""Least share of an amplitude that is left without what all stronger scatterers show there."""


@dataclass(frozen=True, eq=False)
class ReadMap:
    """Range-Doppler map of an observation.

    Attributes
    ----------
    observation : Observation
        The observation that was read.
    gated : GatedMap
        Cells in double precision, without tapers, shape (n_range, n_doppler, *elements).
    unit : float
        Amplitude in the observation that is 1 in this map; a power of two.
    notch_mps : float or None
        Speed up to which points are left out of the image.
    """

    observation: Observation
    gated: GatedMap
    unit: float
    notch_mps: float | None = None


class Levels(NamedTuple):
    """Powers per element with which stages compare cells and plane waves, in the unit of `ReadMap`.

    Attributes
    ----------
    white : float
        White noise.
    floor : float
        Upper limit of noise and of the leakage of strong echoes.
    min_power : float
        Least power of a plane wave or a scatterer.
    """

    white: float
    floor: float
    min_power: float


class Detected(NamedTuple):
    """Cells that hold echoes, and the levels of their map.

    Attributes
    ----------
    cells : DetectedCells
        Their bins, the power map and its test.
    """

    cells: DetectedCells
    levels: Levels


@dataclass(frozen=True)
class SnapshotRule:
    """Way to read the cells whose plane waves are sought: tapers, neighbours, and the cells that count.

    Attributes
    ----------
    range_window, doppler_window : {"rect", "soft", "hamming", "hann", "blackman"}
        Tapers.
    range_cells : {1, 3}
        Neighbouring range cells that serve as snapshots, the cell itself in
        the middle. With 3, directions are means over the echoes in all three.
    resolved_only : bool
        Whether to keep only the cells that their plane waves explain down to
        the noise.
    one_doppler : bool
        Whether plane waves must look like one echo along Doppler.
    """

    range_window: Window
    doppler_window: Window
    range_cells: int = 1
    resolved_only: bool = False
    one_doppler: bool = False


@dataclass(frozen=True, eq=False)
class CellSnapshots:
    """Snapshots (complex samples of all elements) of n detected cells, as one snapshot rule takes them.

    Attributes
    ----------
    rule : SnapshotRule
        Tapers and neighbours.
    bins : (ndarray of int64, ndarray of int64), each shape (n,)
        Absolute range and Doppler bins.
    tapered : TaperedMap
        Map with the tapers of the rule.
    around : ndarray of complex, shape (n, 5, *elements)
        Samples of each cell, and of the next nearer, farther, slower and faster ones.
    beams : BeamsOfCells or None
        Their strongest beams, if they were detected on beams.
    pairs : Eigenpairs or None
        Those of the covariances of the clear cells, once an estimator has decomposed them.
    """

    rule: SnapshotRule
    bins: Bins
    tapered: TaperedMap
    around: Complex
    levels: Levels
    beams: BeamsOfCells | None = None
    pairs: Eigenpairs | None = None

    def __len__(self) -> int:
        return len(self.around)

    @property
    def clear(self) -> CellSnapshots:
        """The cells that a beam does not show alone."""
        if self.beams is None:
            return self
        clear = ~self.beams.alone
        bins = self.bins[0][clear], self.bins[1][clear]
        return replace(self, bins=bins, around=self.around[clear], beams=None)

    @property
    def own(self) -> Complex:
        """Samples (n, *elements) of the cells themselves."""
        return self.around[:, 0]

    @property
    def snapshots(self) -> Complex:
        """Samples (n, s, *elements) of each cell and its neighbours in range, the cell in the middle."""
        return self.around[:, [1, 0, 2]] if self.rule.range_cells == 3 else self.around[:, :1]


def read_map(observation: Observation, estimator: MapEstimator) -> ReadMap:
    """Read the range-Doppler map of the elements that an estimator needs.

    The other elements need never be computed. Amplitudes are read in units of
    a power of two, so that no scale of the observation overflows. With a notch,
    static echoes are taken out.

    Parameters
    ----------
    estimator : MapEstimator
        Its `aperture`, `notch_mps` and `detection_window` are used.
    """
    with stage("rdm"):
        aperture = estimator.aperture(observation)
        cells = observation.cross if isinstance(aperture, Cross) else observation.cells
        cells, unit = scale_to_unit(cells.astype(np.complex128, copy=False))
        gated = GatedMap.of(observation, cells, aperture)
        if estimator.notch_mps is not None:
            window = gated.doppler_taper(estimator.detection_window)
            gated = without_static_echoes(gated, observation.system, window)
        return ReadMap(observation, gated, unit, estimator.notch_mps)


def detect(rdm: ReadMap, estimator: MapEstimator) -> Detected:
    """Detect the cells that hold echoes, by a CFAR detector, and measure noise and floor.

    The level of white noise is limited to between `LEAST_NOISE` and the floor of
    the detection. The noise power of a beam is exponentially distributed, so
    that a plane wave must have -ln P_fa times the floor, over the number of
    elements.

    Parameters
    ----------
    estimator : MapEstimator
        Its `detection_window`, `precision`, `cell_detector`, `integration`,
        `m_of_n`, `dynamic_range_db` and `angle_pfa` are used.
    """
    with stage("detection"):
        gated, window = rdm.gated, estimator.detection_window
        dtype = np.complex64 if estimator.precision == "single" else np.complex128
        tapered = gated.tapered(window, gated.doppler_taper(window), dtype=dtype)
        cells = detect_cells(
            tapered,
            estimator.cell_detector(),
            estimator.integration,
            estimator.dynamic_range_db,
            estimator.m_of_n,
            rdm.observation.cosine_limits,
        )
        least_noise = LEAST_NOISE**2 * float(cells.power.max())
        white = min(max(white_noise(gated), least_noise), cells.floor)
        min_power = -np.log(estimator.angle_pfa) * cells.floor / gated.n_elements
        return Detected(cells, Levels(white, cells.floor, min_power))


def read_cells(rdm: ReadMap, detected: Detected, rule: SnapshotRule) -> CellSnapshots:
    """Read the snapshots of detected cells.

    Returns
    -------
    CellSnapshots
        Without cells at the map's edge, which lack a neighbour. Such cells
        are detected only where the gate has no room for margins.
    """
    with stage("rdm"):
        gated, bins = rdm.gated, detected.cells.bins
        doppler_window = gated.doppler_taper(rule.doppler_window)
        tapered = gated.tapered(rule.range_window, doppler_window, neighbours=1)
        inside = tapered.gate.surrounds(bins)
        bins, beams = (bins[0][inside], bins[1][inside]), detected.cells.beams
        around = tapered.around(bins)
        return CellSnapshots(rule, bins, tapered, around, detected.levels, beams and beams.select(inside))


def determined_order(pairs: Eigenpairs, order: Integers) -> Integers:
    """Limit the dimensions of signal subspaces to those that are determined despite rounding.

    Parameters
    ----------
    pairs : Eigenpairs
        Of n covariances.
    order : ndarray of int64, shape (n,)
        Number of sources from a test of the eigenvalues.

    Returns
    -------
    ndarray of int64, shape (n,)
        0 where rounding decides about every eigenvector. The number of
        covariances with fewer sources is counted as a remark
        (`isacbench.instrument.remarks`).
    """
    separated = separated_order(pairs.rotation, order)
    remark("unseparated", int(np.count_nonzero(separated < order)), order.size)
    return separated


def determined(cells: CellSnapshots, waves: PlaneWaves, estimator: CellwiseEstimator) -> PlaneWaves:
    """Keep the plane waves whose directions their cell determines; in resolved cells all are.

    Parameters
    ----------
    waves : PlaneWaves
        Of the same cells.
    estimator : CellwiseEstimator
        Its `largest_direction_error` is used.

    Returns
    -------
    PlaneWaves
        See `isacbench.dsp.angles.plane_waves.PlaneWaves.determined`.
    """
    largest_error = estimator.largest_direction_error
    if largest_error is None or cells.rule.resolved_only:
        return waves
    with stage("peaks"):
        return waves.determined(cells.own, cells.tapered.aperture, cells.levels.white, largest_error)


def locate(cells: CellSnapshots, waves: PlaneWaves, estimator: CellwiseEstimator) -> ScatterersInCells:
    """Locate plane waves in range and Doppler by their amplitudes in the neighbouring cells.

    Parameters
    ----------
    waves : PlaneWaves
        Of the same cells.
    estimator : CellwiseEstimator
        Its `local_dynamic_range_db` is used: plane waves further below the
        strongest one of the 5 x 5 cells around them are left out.
    """
    with stage("peaks"):
        return locate_waves(
            waves,
            cells.around,
            cells.tapered,
            cells.bins,
            estimator.local_dynamic_range_db,
            # Grating lobes put echoes of all speeds into every bin: hardly any then looks like one echo.
            cells.rule.one_doppler and not cells.tapered.sees_lobes,
            cells.rule.resolved_only,
            cells.levels.min_power,
            cells.levels.white / cells.tapered.aperture.n_elements,
        )


def merge_scatterers(scatterers: LocatedScatterers) -> LocatedScatterers:
    """Merge scatterers that several cells or rules saw: of those close together the strongest stays."""
    with stage("peaks"):
        return merge_duplicates(scatterers)


def to_cloud(rdm: ReadMap, scatterers: LocatedScatterers) -> PointCloud:
    """Turn range, Doppler and direction cosines into points, and powers into those of the scene.

    Returns
    -------
    PointCloud
        Without points outside the region (`isacbench.model.observation`), or within the notch.
    """
    with stage("peaks"):
        observation = rdm.observation
        # Unit by unit: its square may overflow where the power does not.
        unit_power = scatterers.power / observation.system.processing_gain * rdm.unit * rdm.unit
        cloud = observation.cloud(
            scatterers.range_bin, scatterers.doppler_bin, scatterers.u, scatterers.w, unit_power
        )
        if rdm.notch_mps is None:
            return cloud
        return without_slow_points(cloud, observation.system, rdm.notch_mps)


@dataclass(frozen=True)
class MapEstimator(ABC):
    """Base of estimators that detect cells of a range-Doppler map: their parameters and common stages.

    Their ``estimate`` runs on one thread of linear algebra (`isacbench.cores`).

    Attributes
    ----------
    separable : bool
        Class attribute: whether directions are sought along u and along w
        separately, so that one column and one row of the array suffice.
    detector : Detector
        Detector of range-Doppler cells.
    pfa : float or None
        Overrides the detector's probability of false alarm.
    integration : {"beams", "noncoherent", "element", "binary"}
        Detect on the strongest of the beams towards the directions of the region
        (`isacbench.dsp.beam_integration.BeamIntegration`), on power averaged over
        the array, on its element (0, 0), or where `m_of_n` elements or more detect, each
        in its own map (`isacbench.dsp.cell_detection.BinaryIntegration`). With
        "element", a separable estimator reads no more than the column and the
        row of that element, P + Q - 1 elements instead of P Q.
    m_of_n : int
        Elements that must detect a cell with `integration` "binary"; 1 unites
        the detections of all elements. Always 1 with the other integrations.
    angle_pfa : float
        Probability that noise is taken for a plane wave, or for a scatterer, in a cell chosen without
        regard to its power: one that noise has raised passes more often.
    dynamic_range_db : float
        Range below the strongest cells in which echoes are detected and modelled.
    local_dynamic_range_db : float
        Range below the strongest scatterer nearby in which others can be
        distinguished from its leakage.
    precision : {"double", "single"}
        Precision of the map on which cells are detected. All else is double:
        directions depend on the last digits of the snapshots (``docs/precision.md``).
    detection_window : {"hann", "rect", "soft", "hamming", "blackman"}
        Taper along range and Doppler of the map on which cells are detected.
        Its sidelobes must not look like echoes.
    notch_mps : float or None
        Speed up to which points are left out of the image, at least a velocity bin; static
        echoes are then taken out of the map before detection (`isacbench.dsp.doppler_notch`).
        None for no notch.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    separable: ClassVar[bool] = False

    detector: Detector = field(default_factory=lambda: OscaCfar(pfa=1e-4, order_axis=1))
    pfa: float | None = None
    integration: Integration = "beams"
    angle_pfa: float = 1e-5
    dynamic_range_db: float = 28.0
    local_dynamic_range_db: float = 16.5
    precision: CellPrecision = "double"
    detection_window: Window = "hann"
    m_of_n: int = 1
    notch_mps: float | None = None

    to_cloud = staticmethod(to_cloud)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        owner = next(base for base in cls.__mro__ if "estimate" in vars(base))
        estimate = vars(owner)["estimate"]
        if isinstance(estimate, FunctionType) and (owner is cls or not issubclass(owner, MapEstimator)):
            cls.estimate = one_blas_thread()(estimate)  # type: ignore[method-assign]

    def __post_init__(self) -> None:
        require(0 < self.angle_pfa < 1, "angle_pfa", self.angle_pfa, "between 0 and 1")
        require_positive(self, "dynamic_range_db", "local_dynamic_range_db")
        require_least(self, m_of_n=1)
        check_notch(self.notch_mps)
        require_option(self, "integration", get_args(Integration))
        binary = self.integration == "binary"
        require(binary or self.m_of_n == 1, "m_of_n", self.m_of_n, '1, or a number with integration "binary"')
        require_option(self, "precision", get_args(CellPrecision))
        require_option(self, "detection_window", get_args(Window))
        self.cell_detector()

    @property
    def needs(self) -> Needs:
        """All elements, or one column and one row; and directions of detected cells only."""
        if self.integration == "element":
            return Needs("cross" if self.separable else "plane", "element", "detected")
        return Needs("plane", "beams" if self.integration == "beams" else "noncoherent", "detected")

    def aperture(self, observation: Observation) -> Aperture:
        """Elements that the estimator reads of an observation."""
        return (Cross if self.needs.elements == "cross" else Plane)(*observation.array.shape)

    def cell_detector(self) -> Detector:
        """Detector of range-Doppler cells, with `pfa` of this estimator if it is given."""
        if self.pfa is None:
            return self.detector
        return cast("Detector", replace(cast("Any", self.detector), pfa=self.pfa))

    @abstractmethod
    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation by calling the stages in order."""

    @one_blas_thread()
    def diagnose(self, observation: Observation) -> Diagnosis:
        """Show the range-Doppler map and its test."""
        rdm = read_map(observation, self)
        found, levels = detect(rdm, self)
        strongest = found.strongest()
        with Remarks() as remarks:
            spectra = self._spectra_of(rdm, Detected(strongest, levels))
        unseparated, unit = remarks.counts.get("unseparated"), rdm.unit
        return Diagnosis(
            # Unit by unit: its square may overflow where the power does not.
            found.tested_power.astype(np.float64) * unit * unit,
            Detection(
                found.detection.mask,
                found.detection.threshold * unit * unit,
                found.detection.noise * unit * unit,
            ),
            found.gate.range_bins,
            found.gate.doppler_bins,
            spectra,
            next(((int(row), int(column)) for row, column in zip(*strongest.bins, strict=True)), None),
            None if unseparated is None else unseparated.n == 0,
        )

    def _spectra_of(self, rdm: ReadMap, strongest: Detected) -> tuple[Spectrum, ...]:
        """Angular spectra of the strongest cell, for `diagnose`; none by default."""
        return ()


@dataclass(frozen=True)
class CellwiseEstimator(MapEstimator):
    """Base of estimators that find plane waves in range-Doppler cells: parameters, and one method per stage.

    A subclass defines `plane_waves`, and `spectra` if it has any to show.
    To exchange another stage, give an argument or override one method:

    ==================  ===================================================
    stage               exchanged by
    ==================  ===================================================
    detection           argument `detector`
    plane waves         `plane_waves`; of subspace methods, the number of
                        sources: argument `model_order`, or `signal_order`
    own-cell test       arguments `range_excess` and `doppler_excess`, or
                        `own_cell_test`
    sidelobe test       `sidelobe_test`
    cloud               `to_cloud`
    ==================  ===================================================

    Attributes
    ----------
    range_window, doppler_window : {"rect", "soft", "hamming", "hann", "blackman"}
        Taper of the cells whose angles are estimated.
    max_sources : int
        Largest number of plane waves in a cell.
    largest_direction_error : float or None
        Rayleigh cells by which the direction of one of several plane waves of a
        cell may be wrong, given what they leave unexplained of it; None for any, as
        beamformers have it: their directions are off for reasons of their own.
    range_excess, doppler_excess : float
        Largest amplitude of a plane wave in the next cell over that in its own,
        along range, where lines of scatterers have no local maximum, and along
        Doppler.
    separable, detector, pfa, integration, angle_pfa, dynamic_range_db
        See `MapEstimator`.
    local_dynamic_range_db, precision, detection_window, notch_mps
        See `MapEstimator`.

    Raises
    ------
    InputError
        If a parameter is out of range.
    """

    range_window: Window = "rect"
    doppler_window: Window = "soft"
    max_sources: int = 6
    largest_direction_error: float | None = 0.33
    range_excess: float = 3.0
    doppler_excess: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_least(self, max_sources=1, range_excess=1, doppler_excess=1)
        error = self.largest_direction_error
        require(error is None or error > 0, "largest_direction_error", error, "above 0, or none")

    def estimate(self, observation: Observation) -> PointCloud:
        """Image one observation by the stages in order."""
        rdm = read_map(observation, self)  # 2D-FFT
        detected = detect(rdm, self)  # OSCA-CFAR
        cells = read_cells(rdm, detected, self.snapshot_rules()[0])  # P x Q snapshots
        if not len(cells):
            return PointCloud.empty()
        waves = self.waves(observation, cells)  # by the estimator's own method
        waves = determined(cells, waves, self)  # no directions between scatterers
        located = locate(cells, waves, self)  # range and velocity
        found = self.sidelobe_test(self.own_cell_test(located), rdm, detected.levels)
        return self.to_cloud(rdm, found)

    def own_cell_test(self, located: ScatterersInCells) -> ScatterersInCells:
        """Keep the scatterers that are not much stronger in a neighbouring cell than in their own."""
        with stage("peaks"):
            return located.in_own_cell(self.range_excess, self.doppler_excess)

    def sidelobe_test(self, located: ScatterersInCells, rdm: ReadMap, levels: Levels) -> LocatedScatterers:
        """Keep the scatterers that stand out of the sidelobes of stronger ones.

        Gaps between symbols make grating lobes nearly as strong as an echo itself:
        there the scatterers are those that together fit the map best.

        Parameters
        ----------
        rdm : ReadMap
            The map of their cells.

        Returns
        -------
        LocatedScatterers
            Those that stronger ones explain neither one by one, up to `SIDELOBE_EXCESS`, nor together,
            up to `LEAST_LEFT`.
        """
        system, gated, limit_db = rdm.observation.system, rdm.gated, self.local_dynamic_range_db
        if gated.sees_lobes:
            with stage("refinement"):
                filters = MatchedFilters(located.scatterers, gated, system)
                return select_jointly(filters, levels.min_power, limit_db).scatterers
        with stage("peaks"):
            return located.above_sidelobes(SIDELOBE_EXCESS, LEAST_LEFT, system).scatterers

    def snapshot_rules(self) -> tuple[SnapshotRule, ...]:
        """Readings of the cells, one after the other; `diagnose` draws the last."""
        return (SnapshotRule(self.range_window, self.doppler_window),)

    def waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find the plane waves of each cell; where a beam alone shows a cell, the wave in that beam.

        A covariance of such a cell holds more noise than echo, and only all elements together tell
        where the echo comes from.
        """
        beams = cells.beams
        if beams is None or not beams.alone.any():
            return self.plane_waves(observation, cells)
        with stage("peaks"):
            in_beams = strongest_direction(cells.own[beams.alone], *beams.select(beams.alone)[:2])
        if beams.alone.all():
            return in_beams
        return in_beams.among(self.plane_waves(observation, cells.clear), beams.alone)

    @abstractmethod
    def plane_waves(self, observation: Observation, cells: CellSnapshots) -> PlaneWaves:
        """Find the plane waves of each cell.

        Returns
        -------
        PlaneWaves
            One row per cell.

        Notes
        -----
        It measures its own stages (`isacbench.instrument.stages`).
        """

    def spectra(self, observation: Observation, cells: CellSnapshots) -> tuple[Spectrum, ...]:
        """Angular spectra of the first cell, with their tests and peaks, for `diagnose`; none by default."""
        return ()

    def _spectra_of(self, rdm: ReadMap, strongest: Detected) -> tuple[Spectrum, ...]:
        cells = read_cells(rdm, strongest, self.snapshot_rules()[-1])
        return self.spectra(rdm.observation, cells) if len(cells) else ()
