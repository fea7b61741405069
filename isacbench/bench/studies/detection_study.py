"""The study ``detection``: detectors on maps that tell them apart, and with estimators behind them.

A row of a map has the detector in the column ``estimator`` and no scores, for
there is no cloud. A row of a scenario is the ordinary one of an estimator
with the detector as its parameter. Both count cells: targets and how many of
them were detected, clear cells and how many of them were false alarms.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
import pandas as pd

from isacbench.bench.cells.cell import failed_by, failure
from isacbench.bench.cells.isolation import array_digest
from isacbench.bench.cells.radio_coordinates import gain_db
from isacbench.bench.cells.record import DRAW_COLUMNS, Cell, Outcome, Record
from isacbench.bench.cells.statuses import failed
from isacbench.bench.cells.timing import Trial, timed
from isacbench.bench.studies.imaging_study import require_scatterers
from isacbench.bench.studies.intervals import mean_band, share_band
from isacbench.bench.studies.medians import median_times
from isacbench.bench.studies.power_maps import PowerMap, draw_power_map, near
from isacbench.bench.studies.study import Entry, ImagedScene, element_snrs_db, gained_snr_db
from isacbench.bench.suites.scenario_digest import digest
from isacbench.errors import InputError
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.plugins.contracts import Detection, Detector, Diagnoser
from isacbench.plugins.registry import canonical_params, get_detector, get_estimator
from isacbench.plugins.specifications import spec_variants

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.bench.cells.cell import MeasuredImage
    from isacbench.bench.cells.record import CellStatus
    from isacbench.bench.studies.study import Scene
    from isacbench.bench.suites.suite import DetectionSuite
    from isacbench.choices import MapName
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Estimator
    from isacbench.plugins.specifications import SpelledVariant

MAP_GAIN_DB = 10 * math.log10(System().processing_gain)
"""A target of a map stands for a unit scatterer in the range-Doppler map of one element (Table I)."""

CLEAR_CELLS = 3
"""A scenario's cells farther from any scatterer's than this are clear: a Hann taper reaches two bins."""

GROUP = ["scenario", "estimator", "params", "detector", "pfa", "snr_db"]
COUNTS = ["n_targets", "n_hits", "n_clear", "n_false"]


class DetectorStudy:
    """Probabilities of detection and of false alarm, on synthetic maps and on scenarios."""

    columns: ClassVar[Mapping[str, Any]] = {
        "snr_gain_db": math.nan,
        "detector": "",
        "pfa": math.nan,
        **dict.fromkeys(COUNTS, 0),
    }

    def scenes(self, suite: DetectionSuite, scenarios: Mapping[str, Scenario]) -> list[Scene]:
        """Maps with every detector alone, scenarios with every estimator behind every detector."""
        detectors = _variants(suite.detectors)
        alone, behind = _alone(detectors, suite.pfa), _behind(detectors, suite)
        require_scatterers(scenarios)
        if clash := set(suite.maps) & set(scenarios):
            raise InputError(f"scenarios: {min(clash)!r} is the name of a map as well; rename the scenario")
        maps: list[Scene] = [MapScene(suite, name, alone) for name in suite.maps]
        return maps + [
            ImagedScene(
                suite, scenario, behind, element_snrs_db(suite, gain_db(scenario)), measure=count_cells
            )
            for scenario in scenarios.values()
        ]


@dataclass(frozen=True, eq=False)
class SharedMap:
    """A map that detectors test.

    Attributes
    ----------
    cell : Cell
        Key of its rows, without a detector.
    drawn : PowerMap
    power : ndarray of float64
        Of the map at the SNR, read-only.
    labels : mapping of str to Any
        Further columns of every row.
    """

    cell: Cell
    drawn: PowerMap
    power: NDArray[np.float64]
    labels: Mapping[str, Any]

    def meet(self, entry: Entry[Detector]) -> Outcome:
        """Let a detector test the map."""
        outcome = _run_detector(entry.cell(self.cell), entry.plugin, self.drawn, self.power)
        return outcome.labelled({**self.labels, **entry.labels})

    def time_repeats(
        self, entry: Entry[Detector], met: Outcome, n: int, before_each: Callable[[], None]
    ) -> Outcome:
        """Let a detector test the map again and again."""
        masks: list[NDArray[np.bool_]] = []

        def detect(_: None) -> NDArray[np.bool_]:
            with stage("detection"):
                return _mask(entry.plugin.detect(self.power), self.power.shape)

        def is_same(mask: NDArray[np.bool_]) -> bool:
            masks.append(mask)
            counts = _counts(mask, self.drawn.targets, self.drawn.clear)
            return np.array_equal(mask, masks[0]) and counts.items() <= met.extras.items()

        outcome = timed(met, entry.cell(self.cell), Trial(before_each, detect), n, is_same)
        return outcome.labelled({**self.labels, **entry.labels})

    def failure_row(self, entry: Entry[Detector], status: CellStatus, reason: str, time_s: float) -> Outcome:
        """Row of a detector that left no other trace."""
        n_targets = int(self.drawn.targets.sum())
        outcome = failure(entry.cell(self.cell), status, reason, n_targets, time_s)
        return outcome.labelled({**self.labels, **entry.labels})

    def digest(self) -> str:
        """Digest of the map."""
        return array_digest(self.power)


class MapScene:
    """A synthetic map and the detectors that test it.

    Parameters
    ----------
    suite : DetectionSuite
    name : str
        Of the map.
    entries : sequence of Entry
        Detectors.
    """

    def __init__(self, suite: DetectionSuite, name: MapName, entries: Sequence[Entry[Detector]]) -> None:
        self.name = name
        self.snr_db = element_snrs_db(suite, MAP_GAIN_DB)
        self.entries = entries
        self._suite = suite
        self._map_name: MapName = name
        self._drawn: tuple[int, PowerMap] | None = None

    @cached_property
    def content(self) -> str:
        """Digest of the first map drawn: of what no rounding changes."""
        drawn = draw_power_map(self._map_name, 0, self._suite.seed)
        bits = np.packbits([drawn.targets, drawn.clear, drawn.noise.real > 0, drawn.echo.real > 0])
        return digest([self._suite.kind, self.name, hashlib.sha256(bits.tobytes()).hexdigest()])

    def observe(self, snr_db: float, trial: int) -> SharedMap:
        """Draw the map, for all detectors."""
        drawn, suite = self._draw(trial), self._suite
        target_snr_db = gained_snr_db(snr_db, MAP_GAIN_DB)
        power = drawn.power(target_snr_db)
        power.setflags(write=False)
        cell = Cell(suite.name, self.name, "", "", snr_db, trial, suite.seed, self.content)
        return SharedMap(cell, drawn, power, {"snr_gain_db": target_snr_db})

    def forget(self) -> None:
        """Let go of the map."""
        self._drawn = None

    def draws(self, n_trials: int) -> pd.DataFrame:
        """Give no scatterers: a map has none."""
        return pd.DataFrame(columns=DRAW_COLUMNS)

    def _draw(self, trial: int) -> PowerMap:
        if self._drawn is None or self._drawn[0] != trial:
            self._drawn = trial, draw_power_map(self._map_name, trial, self._suite.seed)
        return self._drawn[1]


def count_cells(shot: MeasuredImage) -> dict[str, int]:
    """Count cells of the range-Doppler map that an estimator's detector tested.

    Parameters
    ----------
    shot : MeasuredImage

    Returns
    -------
    dict of str to int
        ``n_targets``, cells nearest to a scatterer, and ``n_hits`` of them
        detected; ``n_clear``, cells more than three away from all of those,
        and ``n_false`` of them detected. Nothing where the estimator is no
        `Diagnoser`, or there is no observation.
    """
    if shot.observation is None or not isinstance(shot.estimator, Diagnoser):
        return {}
    diagnosis, system = shot.estimator.diagnose(shot.observation), shot.scenario.system
    truth = shot.scenario.truth
    range_m = np.linalg.norm(truth.xyz - shot.scenario.base_station_m, axis=1)
    rows = np.rint(range_m / system.range_bin_m).astype(np.int64) - diagnosis.range_bins[0]
    columns = np.rint(truth.velocity / system.velocity_bin_mps).astype(np.int64) - diagnosis.doppler_bins[0]
    mask = diagnosis.detection.mask
    inside = (rows >= 0) & (rows < mask.shape[0]) & (columns >= 0) & (columns < mask.shape[1])
    targets = np.zeros_like(mask)
    targets[rows[inside], columns[inside]] = True
    return _counts(mask, targets, ~near(targets, CLEAR_CELLS))


def summarise_detection(records: pd.DataFrame) -> pd.DataFrame:
    """Probabilities of detection and of false alarm, and the deviation of what was imaged.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each scenario or map, estimator (with its parameters),
        detector, nominal rate ``pfa`` and SNR: ``snr_gain_db``,
        ``n_cells``, ``n_failed`` and the counts, summed over trials;
        ``pd`` and ``pfa_measured`` with 95 % intervals, ``..._low`` and
        ``..._high`` (Wilson); ``deviation_mean`` with the half width of its
        95 % interval ``deviation_band`` (Student's t), NaN for a map;
        ``time_estimate_s_median`` as `isacbench.bench.studies.medians.median_times`
        has it. Fewer than five trials have no intervals.
    """
    rows = []
    for key, part in records.groupby(GROUP, sort=False):
        counts = {name: int(part[name].sum()) for name in COUNTS}
        deviation_mean, deviation_band = mean_band(part["deviation"].dropna().to_numpy())
        row: dict[str, Any] = {
            **dict(zip(GROUP, key, strict=True)),
            "snr_gain_db": part["snr_gain_db"].iloc[0],
            "n_cells": len(part),
            "n_failed": int(failed(part).sum()),
            **counts,
        }
        for name, hits, of in (("pd", "n_hits", "n_targets"), ("pfa_measured", "n_false", "n_clear")):
            low, high = share_band(counts[hits], counts[of], len(part) - row["n_failed"])
            share = counts[hits] / counts[of] if counts[of] else math.nan
            row |= {name: share, f"{name}_low": low, f"{name}_high": high}
        rows.append(row | {"deviation_mean": deviation_mean, "deviation_band": deviation_band})
    return pd.DataFrame(rows).join(median_times(records, GROUP), on=GROUP)


def _variants(specs: Sequence[str]) -> list[SpelledVariant]:
    """Specifications without grids."""
    return [variant for text in specs for variant in spec_variants(text)]


def _alone(detectors: Sequence[SpelledVariant], rates: Sequence[float]) -> list[Entry[Detector]]:
    """Every detector at every nominal rate, at its own where none is given."""
    entries = []
    for text, (name, params) in detectors:
        for rate in rates or [get_detector(name, **params).pfa]:
            detector = get_detector(name, **{**params, "pfa": rate})
            labels = {"detector": text, "pfa": detector.pfa}
            entries.append(Entry(name, canonical_params(detector), detector, labels))
    _refuse_repeats(entries)
    return entries


def _behind(detectors: Sequence[SpelledVariant], suite: DetectionSuite) -> list[Entry[Estimator]]:
    """Every estimator behind every detector."""
    entries = []
    for build in _builders(suite):
        for text, spec in detectors:
            detector = get_detector(spec.name, **spec.params)
            estimator = build(detector)
            own_pfa = getattr(estimator, "pfa", None)
            labels = {"detector": text, "pfa": detector.pfa if own_pfa is None else own_pfa}
            entries.append(Entry(estimator.name, canonical_params(estimator), estimator, labels))
    _refuse_repeats(entries)
    return entries


def _builders(suite: DetectionSuite) -> Iterator[Callable[[Detector], Estimator]]:
    """Functions that put a detector into each of a suite's estimators."""
    for text in suite.estimators:
        if text in suite.instances:
            yield partial(_with_detector, suite.instances[text])
            continue
        for variant, (name, params) in spec_variants(text):
            if "detector" in params:
                raise InputError(f"estimators: {variant!r} has a detector; its place is in detectors")
            yield partial(_built_with_detector, name, params)


def _built_with_detector(name: str, params: Mapping[str, Any], detector: Detector) -> Estimator:
    """Registered estimator behind a detector."""
    return get_estimator(name, **params, detector=detector)


def _with_detector(estimator: Estimator, detector: Detector) -> Estimator:
    """Same estimator behind another detector."""
    if "detector" not in {field.name for field in dataclasses.fields(cast("Any", estimator))}:
        raise InputError(f"estimator {estimator.name}: allowed are those with a parameter detector")
    return cast("Estimator", dataclasses.replace(cast("Any", estimator), detector=detector))


def _refuse_repeats(entries: Sequence[Entry[Any]]) -> None:
    keys = [(entry.name, entry.params) for entry in entries]
    for index, entry in enumerate(entries):
        if keys[index] in keys[:index]:
            raise InputError(
                f"detectors: {entry.labels['detector']!r} repeats a detector with equal parameters"
            )


def _run_detector(cell: Cell, detector: Detector, drawn: PowerMap, power: NDArray[np.float64]) -> Outcome:
    """Test a map, timed; whatever the detector raises becomes the record's reason."""
    n_targets = int(drawn.targets.sum())
    start = time.perf_counter()
    try:
        mask = _mask(detector.detect(power), power.shape)
        elapsed_s = time.perf_counter() - start
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed_by(error, cell, n_targets, time.perf_counter() - start)
    n_detected = int(mask.sum())
    record = Record(
        **vars(cell),
        status="ok" if n_detected else "no_detection",
        reason="",
        n_true=n_targets,
        n_estimated=n_detected,
        time_estimate_s=elapsed_s,
    )
    return Outcome(record, PointCloud.empty(), _counts(mask, drawn.targets, drawn.clear))


def _mask(detection: Detection, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mask of a detection, held to the contract."""
    if not isinstance(detection, Detection):
        raise TypeError(f"detect() must return a Detection, not {type(detection).__name__}")
    mask = np.asarray(detection.mask)
    if mask.dtype != np.bool_ or mask.shape != shape:
        raise ValueError(f"detect() must mark cells of a map of shape {shape}, not {mask.dtype} {mask.shape}")
    return mask


def _counts(
    mask: NDArray[np.bool_],
    targets: NDArray[np.bool_],
    clear: NDArray[np.bool_],
) -> dict[str, int]:
    values = (targets.sum(), (mask & targets).sum(), clear.sum(), (mask & clear).sum())
    return dict(zip(COUNTS, map(int, values), strict=True))
