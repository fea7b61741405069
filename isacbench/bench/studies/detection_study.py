"""The study ``detection``: detectors on synthetic maps, and in front of estimators on scenarios.

A row of a map has the detector in the column ``estimator`` and no scores, for
there is no cloud. A row of a scenario is the ordinary one of an estimator
with the detector as its parameter. Both count cells: targets and how many of
them were detected, clear cells and how many of them were false alarms.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.isolation import array_digest
from isacbench.bench.cells.statuses import failed
from isacbench.bench.cells.timing import Trial
from isacbench.bench.studies.intervals import mean_band, share_band
from isacbench.bench.studies.medians import summarise
from isacbench.bench.studies.power_maps import PowerMap, draw_power_map, near
from isacbench.bench.studies.study import (
    ImagedScene,
    Scene,
    SharedObservation,
    distinct_entries,
    element_snrs_db,
    entry_of,
    gained_snr_db,
    require_scatterers,
)
from isacbench.bench.suites.detection_kind import COUNTS
from isacbench.bench.suites.scenario_digest import digest
from isacbench.dsp.cfar.detection_rates import detection_rate
from isacbench.errors import InputError
from isacbench.instrument.stages import stage
from isacbench.model.numerology import System
from isacbench.model.radio_coordinates import gain_db
from isacbench.plugins.contracts import Detection, Detector, Diagnoser
from isacbench.plugins.registry import get_detector, get_estimator
from isacbench.specifications import spec_variants

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike, NDArray

    from isacbench.bench.cells.cell import MeasuredImage
    from isacbench.bench.cells.record import Cell, Outcome
    from isacbench.bench.studies.study import Entry
    from isacbench.bench.suites.detection_kind import DetectionSuite
    from isacbench.choices import MapName
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Estimator
    from isacbench.specifications import SpelledVariant

    Mask = NDArray[np.bool_]

MAP_GAIN_DB = 10 * math.log10(System().processing_gain)
"""A target of a map stands for a unit scatterer in the range-Doppler map of one element (Table I)."""

CLEAR_CELLS = 3
"""A scenario's cells farther from any scatterer's than this are clear: a Hann taper reaches two bins."""

GROUP = ["scenario", "estimator", "params", "detector", "pfa", "snr_db"]


def detection_scenes(suite: DetectionSuite, scenarios: Mapping[str, Scenario]) -> list[Scene]:
    """Plan maps with every detector alone, and scenarios with every estimator behind every detector.

    Parameters
    ----------
    suite : DetectionSuite
    scenarios : mapping of str to Scenario
        By name.

    Returns
    -------
    list of Scene

    Raises
    ------
    InputError
        If a scenario has no scatterers or the name of a map, or an estimator takes no detector.
    """
    detectors = [variant for text in suite.detectors for variant in spec_variants(text)]
    alone, behind = _alone(detectors, suite.pfa), _behind(detectors, suite)
    require_scatterers(scenarios)
    if clash := set(suite.maps) & set(scenarios):
        raise InputError(f"scenarios: {min(clash)!r} is the name of a map as well; rename the scenario")
    maps: list[Scene] = [MapScene(suite, name, alone) for name in suite.maps]
    return maps + [
        ImagedScene(suite, scenario, behind, element_snrs_db(suite, gain_db(scenario)), measure=count_cells)
        for scenario in scenarios.values()
    ]


def known_noise_rate(snr_db: ArrayLike, pfa: float) -> NDArray[np.float64]:
    """Probability that a detector that knows the noise detects a target of a map: no CFAR finds more.

    Parameters
    ----------
    snr_db : array_like
        Of a target in its cell.
    pfa : float

    Returns
    -------
    ndarray of float64
        In closed form: targets of maps fluctuate as Swerling's model 1, and cells have one look.
    """
    return detection_rate(snr_db, pfa, swerling=1)


@dataclass(frozen=True, eq=False)
class SharedMap(SharedObservation):
    """Map that detectors test.

    Attributes
    ----------
    drawn : PowerMap
    power : ndarray of float64
        Of the map at the SNR, read-only.
    """

    drawn: PowerMap
    power: NDArray[np.float64]

    @property
    def n_true(self) -> int:
        """Number of cells with a target."""
        return int(self.drawn.targets.sum())

    def digest(self) -> str:
        """Digest of the map."""
        return array_digest(self.power)

    def _outcome(self, cell: Cell, plugin: Detector) -> Outcome:
        return self._counted_outcome(
            cell, partial(self._mask, plugin), lambda mask: (int(mask.sum()), self._counts(mask))
        )

    def _trial(
        self, plugin: Detector, met: Outcome, before_each: Callable[[], None]
    ) -> tuple[Trial, Callable[[Any], bool]]:
        masks: list[Mask] = []

        def detect(_: None) -> Mask:
            with stage("detection"):
                return self._mask(plugin)

        def is_same(mask: Mask) -> bool:
            masks.append(mask)
            return np.array_equal(mask, masks[0]) and self._counts(mask).items() <= met.extras.items()

        return Trial(before_each, detect), is_same

    def _mask(self, detector: Detector) -> Mask:
        """Mask of the cells that a detector detects, held to the contract."""
        detection = detector.detect(self.power)
        if not isinstance(detection, Detection):
            raise TypeError(f"detect() must return a Detection, not {type(detection).__name__}")
        mask, shape = np.asarray(detection.mask), self.power.shape
        if mask.dtype != np.bool_ or mask.shape != shape:
            raise ValueError(
                f"detect() must mark cells of a map of shape {shape}, not {mask.dtype} {mask.shape}"
            )
        return mask

    def _counts(self, mask: Mask) -> dict[str, int]:
        return _counts(mask, self.drawn.targets, self.drawn.clear)


class MapScene(Scene):
    """Synthetic map and the detectors that test it.

    Parameters
    ----------
    suite : DetectionSuite
    name : str
        Of the map.
    entries : sequence of Entry
        Detectors.
    """

    def __init__(self, suite: DetectionSuite, name: MapName, entries: Sequence[Entry[Detector]]) -> None:
        draw = partial(draw_power_map, name, seed=suite.seed)
        super().__init__(suite, name, entries, element_snrs_db(suite, MAP_GAIN_DB), draw)

    @cached_property
    def content(self) -> str:
        """Digest of the first map drawn: of what no rounding changes."""
        drawn = self._drawn_once(0)
        bits = np.packbits([drawn.targets, drawn.clear, drawn.noise.real > 0, drawn.echo.real > 0])
        return digest([self._suite.kind, self.name, hashlib.sha256(bits.tobytes()).hexdigest()])

    def observe(self, snr_db: float, trial: int) -> SharedMap:
        """Draw the map, for all detectors.

        Parameters
        ----------
        snr_db : float
        trial : int

        Returns
        -------
        SharedMap
        """
        drawn, target_snr_db = self._drawn_once(trial), gained_snr_db(snr_db, MAP_GAIN_DB)
        power = drawn.power(target_snr_db)
        power.setflags(write=False)
        return SharedMap(self._cell(snr_db, trial), {"snr_gain_db": target_snr_db}, drawn, power)


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
    return summarise(records, GROUP, _numbers)


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Counts and rates of one group, and the deviation of its images."""
    counts = {name: int(part[name].sum()) for name in COUNTS}
    n_failed = int(failed(part).sum())
    found = {"snr_gain_db": part["snr_gain_db"].iloc[0], "n_cells": len(part), "n_failed": n_failed, **counts}
    for name, hits, of in (("pd", "n_hits", "n_targets"), ("pfa_measured", "n_false", "n_clear")):
        low, high = share_band(counts[hits], counts[of], len(part) - n_failed)
        share = counts[hits] / counts[of] if counts[of] else math.nan
        found |= {name: share, f"{name}_low": low, f"{name}_high": high}
    mean, band = mean_band(part["deviation"].dropna().to_numpy())
    return found | {"deviation_mean": mean, "deviation_band": band}


def _alone(detectors: Sequence[SpelledVariant], rates: Sequence[float]) -> list[Entry[Detector]]:
    """Every detector at every nominal rate, at its own where none is given."""
    return _labelled_entries(
        (text, detector.pfa, detector)
        for text, (name, params) in detectors
        for rate in rates or [get_detector(name, **params).pfa]
        for detector in [get_detector(name, **{**params, "pfa": rate})]
    )


def _behind(detectors: Sequence[SpelledVariant], suite: DetectionSuite) -> list[Entry[Estimator]]:
    """Every estimator behind every detector."""
    built = []
    for build in _builders(suite):
        for text, (name, params) in detectors:
            detector = get_detector(name, **params)
            estimator = build(detector=detector)
            own_pfa = getattr(estimator, "pfa", None)
            built.append((text, detector.pfa if own_pfa is None else own_pfa, estimator))
    return _labelled_entries(built)


def _builders(suite: DetectionSuite) -> Iterator[Callable[..., Any]]:
    """Functions of a detector that build a suite's estimators with it."""
    for text in suite.estimators:
        estimator: Any = suite.instances.get(text)
        if estimator is None:
            for variant, (name, params) in spec_variants(text):
                if "detector" in params:
                    raise InputError(
                        f"estimators: {variant!r} sets a detector; list detectors under the key detectors"
                    )
                yield partial(get_estimator, name, **params)
        elif "detector" in {field.name for field in dataclasses.fields(estimator)}:
            yield partial(dataclasses.replace, estimator)
        else:
            raise InputError(
                f"estimator {estimator.name} has no parameter detector, which a detection suite sets"
            )


def _labelled_entries(built: Iterable[tuple[str, float, Any]]) -> list[Entry[Any]]:
    """Entries of plugins, labelled with the text of their detector and its nominal rate."""
    entries = ((text, entry_of(plugin, detector=text, pfa=pfa)) for text, pfa, plugin in built)
    return distinct_entries("detector", entries)


def _counts(
    mask: NDArray[np.bool_],
    targets: NDArray[np.bool_],
    clear: NDArray[np.bool_],
) -> dict[str, int]:
    values = (targets.sum(), (mask & targets).sum(), clear.sum(), (mask & clear).sum())
    return dict(zip(COUNTS, map(int, values), strict=True))
