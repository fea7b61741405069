"""Stages that cell-by-cell estimators share, one function a stage, in the order in which an image needs them.

1. `read_map` reads the range-Doppler map.
2. `detect` finds the cells that hold echoes, on a map tapered for low
   sidelobes, by a CFAR detector on one element or on the array's average power.
3. `read_cells` takes the snapshots of those cells, tapered less, for
   resolution. In them the estimator finds plane waves by its own method.
4. `locate` gives plane waves a place in range and Doppler.
5. `own_cell_test` drops those that are stronger in a neighbouring cell.
6. `merge_scatterers` makes one of scatterers that several cells saw.
7. `explain` selects the scatterers that explain the map together, and moves
   them between the bins to where the rest of the map leaves them.
8. `to_cloud` turns radio coordinates into points.

No stage needs a constant of the scene: what counts is the noise, the strongest
cells and the strongest scatterers nearby. Every stage marks its own time
(`isacbench.instrument.stages`).

References
----------
arXiv 2310.06401, for the map, the detection and the order of the stages. The
paper has neither `own_cell_test`, nor `merge_scatterers`, nor `explain`
(``docs/errata.md``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from isacbench.dsp.angles.aperture import Cross
from isacbench.dsp.angles.eigenpairs import Eigenpairs, separated_order
from isacbench.dsp.cell_detection import DetectedCells, detect_cells, white_noise
from isacbench.dsp.rangedoppler import Bins, GatedMap
from isacbench.dsp.scaling import amplitude_exponent, in_unit
from isacbench.dsp.scatterers import Located, LocatedScatterers, locate_waves, merge_duplicates
from isacbench.dsp.windows import Window
from isacbench.instrument.remarks import remark
from isacbench.instrument.stages import stage

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.dsp.angles.aperture import Aperture
    from isacbench.dsp.angles.plane_waves import PlaneWaves
    from isacbench.dsp.cell_detection import Integration
    from isacbench.dsp.detection import Detector
    from isacbench.model.cloud import PointCloud
    from isacbench.model.gate import Gate
    from isacbench.model.observation import Observation

Snapshots = NDArray[np.complexfloating[Any, Any]]

PrecisionStage = Literal["detection", "directions", "subspace", "selection"]
"""Uses of cells: the map and its test; snapshots, their Fourier spectra and amplitudes;
covariances, their eigenvectors and null spectra; the joint explanation."""

LAST_DIGITS_LOST = 4
"""Last digits of the strongest cell that sums over a few of them lose: noise, where there is no other."""

OWN_CELL_EXCESS = (3.0, 1.0)
"""Own-cell test along range, where lines of scatterers have no local maximum, and along Doppler."""


@dataclass(frozen=True, eq=False)
class ReadMap:
    """Range-Doppler map of an observation, in the precision of each stage.

    Attributes
    ----------
    observation : Observation
        Where it comes from.
    detection, directions, selection : GatedMap
        Cells for the detection, for the directions of plane waves, and for the
        joint explanation, without tapers, shape (n_range, n_doppler, *elements).
        One and the same where precisions are equal.
    unit : float
        Amplitude of 1 in the unit of the observation, a power of two.
    """

    observation: Observation
    detection: GatedMap
    directions: GatedMap
    selection: GatedMap
    unit: float


class Levels(NamedTuple):
    """Powers per element that stages hold cells and plane waves against, in the unit of the map read.

    Attributes
    ----------
    white : float
        White noise.
    floor : float
        What noise and leakage of strong echoes have at most.
    min_power : float
        What a plane wave or a scatterer must have.
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
    gate : Gate
        Bins of the power map.
    levels : Levels
    """

    cells: DetectedCells
    gate: Gate
    levels: Levels

    def strongest(self) -> Detected:
        """Strongest of the cells alone; none where there is none."""
        cell = self.cells.strongest_cell(self.gate)
        rows, columns = ([], []) if cell is None else ([cell[0]], [cell[1]])
        bins = np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)
        return self._replace(cells=replace(self.cells, bins=bins))


@dataclass(frozen=True)
class Reading:
    """Reading of the cells whose plane waves are sought.

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


@dataclass(frozen=True, eq=False)
class CellSnapshots:
    """Snapshots of n detected cells, as one reading takes them.

    Attributes
    ----------
    reading : Reading
        Windows and neighbours.
    bins : (ndarray of int64, ndarray of int64), each shape (n,)
        Absolute range and Doppler bins.
    tapered : GatedMap
        Map behind the windows of the reading.
    snapshots : ndarray of complex, shape (n, s, *elements)
        Of each cell and its neighbours in range, the cell in the middle.
    levels : Levels
    """

    reading: Reading
    bins: Bins
    tapered: GatedMap
    snapshots: Snapshots
    levels: Levels

    def __len__(self) -> int:
        return len(self.snapshots)

    @property
    def own(self) -> Snapshots:
        """Snapshots (n, *elements) of the cells themselves."""
        return self.snapshots[:, self.snapshots.shape[1] // 2]


class StageSettings(Protocol):
    """Settings that the stages ask of an estimator, as `isacbench_algorithms.cellwise` has them."""

    @property
    def integration(self) -> Integration:
        """Elements whose power the detection map averages."""

    @property
    def detection_window(self) -> Window:
        """Taper of the map that cells are detected on."""

    @property
    def angle_pfa(self) -> float:
        """Probability that noise passes for a plane wave."""

    @property
    def dynamic_range_db(self) -> float:
        """Range below the strongest cells that is detected."""

    @property
    def local_dynamic_range_db(self) -> float:
        """Range below the strongest plane wave nearby that is kept."""

    @property
    def explain(self) -> Literal["joint", "none"]:
        """Joint selection and refinement of candidates, or none."""

    def aperture(self, observation: Observation) -> Aperture:
        """Elements that are read."""

    def dtype_in(self, stage: PrecisionStage) -> type[np.complexfloating[Any, Any]]:
        """Precision in which a stage reads cells."""

    def cell_detector(self) -> Detector:
        """Detector of range-Doppler cells."""

    def merge(self, scatterers: LocatedScatterers, /) -> LocatedScatterers:
        """Make one of scatterers that several cells saw."""

    def select(
        self, rdm: ReadMap, levels: Levels, candidates: LocatedScatterers, members: LocatedScatterers
    ) -> LocatedScatterers:
        """Select the scatterers that explain the map together."""

    def refine(self, rdm: ReadMap, levels: Levels, chosen: LocatedScatterers) -> LocatedScatterers:
        """Refine the selected scatterers together."""


def read_map(observation: Observation, estimator: StageSettings) -> ReadMap:
    """Read the range-Doppler map of the elements that an estimator needs.

    The others may never have been computed. Amplitudes are read in units of a
    power of two, so that no scale overflows.

    Parameters
    ----------
    observation : Observation
    estimator : StageSettings
        Its `aperture` and `dtype_in` count.

    Returns
    -------
    ReadMap
    """
    with stage("rdm"):
        aperture = estimator.aperture(observation)
        cells = observation.cross if isinstance(aperture, Cross) else observation.cells
        exponent = amplitude_exponent(cells)
        gated = GatedMap.of(observation, in_unit(cells, exponent), aperture)
        stages: tuple[PrecisionStage, ...] = ("detection", "directions", "selection")
        # Stages of one precision share one map.
        maps = {dtype: gated.astype(dtype) for dtype in set(map(estimator.dtype_in, stages))}
        detection, directions, selection = (maps[estimator.dtype_in(name)] for name in stages)
        return ReadMap(observation, detection, directions, selection, float(np.ldexp(1.0, exponent)))


def detect(rdm: ReadMap, estimator: StageSettings) -> Detected:
    """Detect the cells that hold echoes, by a CFAR detector, and measure noise and floor.

    White noise is never above the floor that was detected with, nor below
    rounding. Noise of an array's output is exponential, so that a plane wave
    must have -ln P_fa times the floor over the number of elements.

    Parameters
    ----------
    rdm : ReadMap
    estimator : StageSettings
        Its `detection_window`, `cell_detector`, `integration`,
        `dynamic_range_db` and `angle_pfa` count.

    Returns
    -------
    Detected
    """
    with stage("detection"):
        gated, window = rdm.detection, estimator.detection_window
        tapered = gated.tapered(window, gated.doppler_taper(window))
        cells = detect_cells(
            tapered, estimator.cell_detector(), estimator.integration, estimator.dynamic_range_db
        )
        last_digit = float(np.finfo(rdm.directions.cells.dtype).eps)
        rounding = max(LAST_DIGITS_LOST * last_digit, 1e-10) ** 2 * float(cells.power.max())
        white = min(max(white_noise(gated), rounding), cells.floor)
        min_power = -np.log(estimator.angle_pfa) * cells.floor / rdm.selection.n_elements
        return Detected(cells, tapered.gate, Levels(white, cells.floor, min_power))


def read_cells(rdm: ReadMap, detected: Detected, reading: Reading) -> CellSnapshots:
    """Read the snapshots of detected cells.

    Parameters
    ----------
    rdm : ReadMap
    detected : Detected
    reading : Reading

    Returns
    -------
    CellSnapshots
        Without cells at the map's edge, which lack a neighbour. They are
        detected only where the gate has no room for margins.
    """
    with stage("rdm"):
        gated, bins = rdm.directions, detected.cells.bins
        doppler_window = gated.doppler_taper(reading.doppler_window)
        tapered = gated.tapered(reading.range_window, doppler_window, neighbours=1)
        inside = tapered.surrounds(bins)
        bins = bins[0][inside], bins[1][inside]
        rows, columns = tapered.index(bins)
        steps = np.arange(reading.range_cells) - reading.range_cells // 2
        snapshots = tapered.cells[rows[:, None] + steps, columns[:, None]]
        return CellSnapshots(reading, bins, tapered, snapshots, detected.levels)


def determined_order(pairs: Eigenpairs, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Limit the dimensions of signal subspaces to those that rounding leaves determined.

    Parameters
    ----------
    pairs : Eigenpairs
        Of n covariances.
    order : ndarray of int64, shape (n,)
        Sources, as a test of the eigenvalues counts them.

    Returns
    -------
    ndarray of int64, shape (n,)
        0 where rounding has the choice among all eigenvectors. How many are
        fewer is remarked (`isacbench.instrument.remarks`).
    """
    separated = separated_order(pairs.rotation, order)
    remark("unseparated", int(np.count_nonzero(separated < order)), order.size)
    return separated


def locate(cells: CellSnapshots, waves: PlaneWaves, estimator: StageSettings) -> Located:
    """Give plane waves a place in range and Doppler, by their amplitudes in the neighbouring cells.

    Parameters
    ----------
    cells : CellSnapshots
    waves : PlaneWaves
        Of the same cells.
    estimator : StageSettings
        Its `local_dynamic_range_db` counts: what lies further below the
        strongest plane wave of the 5 x 5 cells around is left out.

    Returns
    -------
    Located
    """
    with stage("peaks"):
        reading, tapered = cells.reading, cells.tapered
        return locate_waves(
            waves,
            tapered,
            cells.bins,
            (reading.range_window, tapered.doppler_taper(reading.doppler_window)),
            estimator.local_dynamic_range_db,
            # Grating lobes put echoes of all speeds into every bin: next to none looks like one.
            reading.one_doppler and not tapered.sees_lobes,
        )


def own_cell_test(located: Located) -> LocatedScatterers:
    """Keep the scatterers that are no stronger in a neighbouring cell than in their own.

    Parameters
    ----------
    located : Located

    Returns
    -------
    LocatedScatterers
        Those at most `OWN_CELL_EXCESS` times as strong next door.
    """
    with stage("peaks"):
        return located.at_home(*OWN_CELL_EXCESS)


def merge_scatterers(scatterers: LocatedScatterers) -> LocatedScatterers:
    """Make one of scatterers that several cells saw: the strongest of those close together stays.

    Parameters
    ----------
    scatterers : LocatedScatterers

    Returns
    -------
    LocatedScatterers
        See `isacbench.dsp.scatterers.merge_duplicates`.
    """
    with stage("peaks"):
        return merge_duplicates(scatterers)


def explain(
    rdm: ReadMap, levels: Levels, seen: Sequence[LocatedScatterers], estimator: StageSettings
) -> LocatedScatterers:
    """Explain the map jointly: select scatterers that do so together, and refine them together.

    Parameters
    ----------
    rdm : ReadMap
    levels : Levels
    seen : sequence of LocatedScatterers
        Candidates of each reading. Those of a later one join if what was
        selected before leaves them unexplained.
    estimator : StageSettings
        Its `select` and `refine` do the work. With `explain` "none" neither
        does: the candidates of all readings are merged.

    Returns
    -------
    LocatedScatterers
    """
    chosen = LocatedScatterers.empty()
    if estimator.explain == "none":
        for candidates in seen:
            chosen = chosen.join(candidates)
        return estimator.merge(chosen)
    with stage("refinement"):
        for candidates in seen:
            chosen = estimator.select(rdm, levels, candidates, chosen)
        return estimator.refine(rdm, levels, chosen)


def to_cloud(rdm: ReadMap, found: LocatedScatterers) -> PointCloud:
    """Turn range, Doppler and direction cosines into points, their powers into those of the scene.

    Parameters
    ----------
    rdm : ReadMap
    found : LocatedScatterers

    Returns
    -------
    PointCloud
        Without what lies beyond the region (`isacbench.model.observation`).
    """
    with stage("peaks"):
        observation = rdm.observation
        # Unit by unit: its square may overflow where the power does not.
        unit_power = found.power / observation.system.processing_gain * rdm.unit * rdm.unit
        return observation.cloud(found.range_bin, found.doppler_bin, found.u, found.w, unit_power)
