"""The kind ``detection``: detectors on synthetic maps, and in front of estimators on scenarios.

A row of a map has the detector in the column ``estimator`` and no scores, for
there is no cloud. A row of a scenario is the ordinary one of an estimator
with the detector as its parameter. Both count cells: targets and how many of
them were detected, clear cells and how many of them were false alarms.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from itertools import product
from typing import Annotated, Any, ClassVar, get_args

import numpy as np
import pandas as pd
from pydantic import Field

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.images import Found, Image
from isacbench.bench.cells.rows import failed, status_of
from isacbench.bench.cells.task import (
    Entry,
    ImagingTask,
    Shared,
    Task,
    build_plugins,
    distinct_entries,
    element_snrs_db,
    entry_of,
    gained_snr_db,
)
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.kind import NO_SCENARIOS, SNR_GAIN, Kind, Scenarios
from isacbench.bench.kinds.power_maps import MAPS, draw_power_map, near
from isacbench.bench.suites.scenario_digest import digest
from isacbench.bench.suites.suite import Distinct, Listed, Suite
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, Line, LineStyle, Series, Table, Variant
from isacbench.checked_arrays import Mask
from isacbench.choices import MapName
from isacbench.dsp.cfar.detection_rates import detection_rate
from isacbench.errors import InputError
from isacbench.instrument.stages import stage
from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.plugins.contracts import Detection, Detector, Diagnoser
from isacbench.plugins.registry import get_detector
from isacbench.specifications import SpelledVariant, parse_spec, spec_variants

Pfa = Annotated[float, Field(gt=0, lt=1)]

COUNTS = ["n_targets", "n_hits", "n_clear", "n_false"]
"""Cells with a target, those of them detected, clear cells, and those of them detected."""

MAP_GAIN_DB = 10 * math.log10(System().processing_gain)
"""A target of a map stands for a unit scatterer in the range-Doppler map of one element (Table I)."""

CLEAR_CELLS = 3
"""A scenario's cells farther from any scatterer's than this are clear: a Hann taper reaches two bins."""

GROUP = ["scenario", "estimator", "params", "detector", "pfa", "snr_db"]

REFERENCE_PFA = 1e-3
"""Nominal rate whose numbers are shown, where it was run: the paper's."""

ROC_SNRS_DB = 10.0, 15.0, 20.0

NONE_FOUND = 0.1
"""Share of one false alarm of all clear cells at which a count of none is drawn on a logarithmic axis."""

KNOWN_NOISE = "known noise (closed form)"
KNOWN_NOISE_STYLE = LineStyle("", "dot", "")
DETECTED_AXIS = Axis("probability of detection", limits=charts.SHARE_LIMITS)


class DetectionSuite(Suite):
    """Suite of the kind ``detection``.

    Attributes
    ----------
    detectors : tuple of str
        Detectors as ``name[param=value,...]``: alone on the maps, and in front of
        every estimator on the scenarios.
    maps : tuple of str
        Synthetic maps, see `isacbench.bench.kinds.power_maps.draw_power_map`.
    pfa : tuple of float
        Nominal probabilities of false alarm on the maps. Empty: each detector's own.
    """

    kind: str = "detection"
    detectors: Listed[str]
    maps: Distinct[MapName] = get_args(MapName)
    pfa: Distinct[Pfa] = ()


class DetectionKind(Kind):
    """Probabilities of detection and of false alarm."""

    name = "detection"
    suite = DetectionSuite
    columns: ClassVar = {**SNR_GAIN, "detector": "", "pfa": math.nan, **dict.fromkeys(COUNTS, 0)}
    better: ClassVar = {
        "n_hits": "higher",
        **dict.fromkeys(["snr_gain_db", "pfa", "n_targets", "n_clear"], "neither"),
    }

    def tasks(self, suite: DetectionSuite, scenarios: Scenarios) -> list[Task]:
        """Plan maps with every detector alone, and scenarios with every estimator behind every detector."""
        detectors = [variant for text in suite.detectors for variant in spec_variants(text)]
        alone = distinct_entries("detector", _alone(suite, detectors))
        behind = distinct_entries("detector", _behind(suite, detectors))
        if clash := set(suite.maps) & set(scenarios):
            raise InputError(f"scenarios: {min(clash)!r} is the name of a map as well; rename the scenario")
        maps = [MapTask(suite, name, alone) for name in suite.maps]
        imaged = [ImagingTask(suite, one, behind, measure=count_cells) for one in scenarios.values()]
        return [*maps, *imaged]

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Probabilities of detection and of false alarm, and the deviation of what was imaged.

        One row for each scenario or map, estimator, detector, nominal rate ``pfa`` and SNR:
        ``snr_gain_db``, ``n_cells``, ``n_failed`` and the counts, summed over trials; ``pd`` and
        ``pfa_measured`` with 95 % intervals, ``..._low`` and ``..._high`` (Wilson); ``deviation_mean`` with
        the half width of its 95 % interval ``deviation_band`` (Student's t), NaN for a map;
        ``time_estimate_s_median``. Fewer than five trials have no intervals.
        """
        return statistics.summarise(rows, GROUP, _numbers)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Probabilities of detection and of false alarm over SNR, and deviations where imaged."""
        tables = []
        for key, part in self.summary(rows).groupby("scenario", sort=False):
            scenario = str(key)
            columns = [Column("SNR: after gain [dB]", "snr_gain_db", "{:.4g}", part=0)]
            title = f"{scenario}: deviation, P_d and P_fa of range-Doppler cells"
            if scenario in MAPS:
                part = part[part["pfa"] == reference_rate(part["pfa"])]
                title = f"{scenario}: P_d and P_fa of a nominal {part['pfa'].iloc[0]:g}"
            else:
                columns.append(Column("SNR: an element [dB]", "snr_db", "{:.1f}", part=0))
            part, by_detector = _with_lines(part.sort_values("snr_db"))
            lines = charts.spread_rows(part, ["snr_gain_db", "snr_db"], VARIANT)
            headings = {variant: variant[1] for variant in by_detector}
            columns += charts.spread_columns(headings, _rates_text)
            tables.append(Table(title, columns, lines))
        return tables

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Detectors on the maps over SNR and over their nominal rate, and in front of estimators."""
        # A count of none has a place on a logarithmic axis.
        summary = self.summary(rows)
        summary["false"] = summary["pfa_measured"].clip(lower=NONE_FOUND / summary["n_clear"].clip(lower=1))
        is_on_map = summary["scenario"].isin(list(MAPS))
        imaged = kind.title_stems(summary[~is_on_map], "scenario")
        on_maps = _map_charts(summary[is_on_map]) if is_on_map.any() else []
        return [*on_maps, *(_image_charts(part, name, stem) for name, stem, part in imaged)]


def _map_charts(summary: pd.DataFrame) -> list[ChartGroup]:
    """Detection and false alarms over SNR, and over each other; a column a map."""
    summary, lines = _with_lines(summary)
    rate = reference_rate(summary["pfa"])
    part = summary[summary["pfa"] == rate]
    x, false = Axis("SNR of a target in its cell [dB]"), _false_axis(part)
    snrs_db = np.linspace(part["snr_gain_db"].min(), part["snr_gain_db"].max(), 61)
    # A detector that knows the noise: no CFAR finds more. Targets fluctuate, and cells have one look.
    limit = Series(KNOWN_NOISE, snrs_db, detection_rate(snrs_db, rate, swerling=1), style=KNOWN_NOISE_STYLE)
    above, below = [], []
    for name, own in part.groupby("scenario", sort=False):
        series = charts.line_series(own, lines, "snr_gain_db", "pd", "pd")
        above.append(Chart(str(name), x, DETECTED_AXIS, [*series, limit]))
        series = charts.line_series(own, lines, "snr_gain_db", "false", "pfa_measured")
        below.append(Chart(f"{name}: false alarms, nominal {rate:g}", x, false, series, lines=[rate]))
    trials = statistics.trials_and_band(part["n_cells"].max())
    title = f"Detectors on synthetic maps, nominal P_fa {rate:g}; {trials}"
    over_snr = ChartGroup("maps", title, [*above, *below], n_columns=len(above))
    return [over_snr, _roc_charts(summary, lines)]


def _roc_charts(summary: pd.DataFrame, lines: Mapping[Variant, Line]) -> ChartGroup:
    """Probability of detection over the measured one of false alarm, a column a map, a row an SNR."""
    names, x, panels = list(summary["scenario"].unique()), _false_axis(summary), []
    rates = np.geomspace(summary["pfa"].min() / 3, 0.3, 61)
    snrs_db = charts.nearest_values(sorted(summary["snr_gain_db"].unique()), ROC_SNRS_DB)
    for snr_db, name in product(snrs_db, names):
        part = summary[(summary["snr_gain_db"] == snr_db) & (summary["scenario"] == name)]
        limit = [float(detection_rate(snr_db, rate, swerling=1)) for rate in rates.tolist()]
        series = charts.line_series(part, lines, "false", "pd")
        series.append(Series(KNOWN_NOISE, rates, limit, style=KNOWN_NOISE_STYLE))
        panels.append(Chart(f"{name}, {snr_db:.4g} dB", x, DETECTED_AXIS, series))
    title = "Detection over measured false alarms, a point a nominal P_fa"
    return ChartGroup("roc", title, panels, n_columns=len(names))


def _image_charts(part: pd.DataFrame, name: str, stem: str) -> ChartGroup:
    """Effect of detectors on estimators: deviation, detection and false alarms over SNR."""
    behind = f"{', '.join(part['estimator'].unique())} behind each detector"
    part, lines = _with_lines(part)
    over_snr, snr = partial(charts.line_series, part, lines, "snr_db"), Axis("SNR [dB]")
    deviation, rates = Axis("imaging deviation", log=True), sorted(part["pfa"].unique())
    false = over_snr("false", "pfa_measured")
    panels = [
        Chart("Images", snr, deviation, over_snr("deviation_mean", "deviation")),
        Chart("Cells of scatterers", snr, DETECTED_AXIS, over_snr("pd", "pd")),
        Chart("Cells far from scatterers", snr, _false_axis(part), false, lines=rates),
    ]
    title = f"{name}: {behind}; {statistics.trials_and_band(part['n_cells'].max())}"
    return ChartGroup(f"detection-{stem}", title, panels)


def _false_axis(part: pd.DataFrame) -> Axis:
    """Axis of false-alarm rates: whole decades around all of them and the nominal ones."""
    limits = charts.decades(pd.concat([part["false"].dropna(), part["pfa"]]))
    return Axis("probability of false alarm", log=True, limits=limits)


def _with_lines(part: pd.DataFrame) -> tuple[pd.DataFrame, dict[Variant, Line]]:
    """Name rows by their detector, with their estimator where there are several, and give each a line."""
    is_alone = part["estimator"].nunique() == 1 or part["scenario"].isin(list(MAPS)).all()
    labels = part["detector"] if is_alone else part["estimator"] + ", " + part["detector"]
    part = part.assign(estimator=part["detector"].str.partition("[")[0], params=labels)
    return part, charts.assign_lines({variant: variant[1] for variant in charts.variants_in(part)})


def reference_rate(rates: pd.Series[Any]) -> float:
    """Nominal rate that is shown: the paper's if it was run, otherwise the one nearest to it."""
    return float(min(rates.unique(), key=lambda rate: abs(math.log(rate / REFERENCE_PFA))))


def _rates_text(entry: Mapping[Any, Any]) -> str:
    """Deviation of an image, and probabilities of detection and false alarm."""
    if entry["n_failed"]:
        return charts.with_failures("", entry["n_failed"])
    deviation = charts.number_or_blank(entry["deviation_mean"], "{:.2f} ")
    # Nothing was counted where an estimator does not show its map.
    return f"{deviation}{charts.rate_text(entry['pd'], '{:.3f}')} {charts.rate_text(entry['pfa_measured'])}"


class MapTask(Task):
    """Synthetic map that detectors test."""

    def __init__(self, suite: DetectionSuite, name: MapName, entries: Sequence[Entry[Detector]]) -> None:
        draw = partial(draw_power_map, name, seed=suite.seed)
        super().__init__(suite, name, entries, element_snrs_db(suite, MAP_GAIN_DB), draw)

    @cached_property
    def content(self) -> str:
        """Digest of the first map drawn: of what no rounding changes."""
        first = self._draw_once(0)
        bits = np.packbits([first.targets, first.clear, first.noise.real > 0, first.echo.real > 0])
        return digest([self._suite.kind, self.name, hashlib.sha256(bits.tobytes()).hexdigest()])

    def observe(self, snr_db: float, trial: int) -> Shared:
        """Draw the map, for all detectors."""
        power_map, target_snr_db = self._draw_once(trial), gained_snr_db(snr_db, MAP_GAIN_DB)
        power, n_true = power_map.power(target_snr_db), int(power_map.targets.sum())
        power.setflags(write=False)
        return Shared(self._key(snr_db, trial), {"snr_gain_db": target_snr_db}, n_true, power)

    def call(self, shared: Shared, plugin: Detector) -> Mask:
        """Mask of the cells that a detector detects, held to the contract."""
        with stage("detection"):
            detection = plugin.detect(shared.data)
        if not isinstance(detection, Detection):
            raise TypeError(f"detect() must return a Detection, not {type(detection).__name__}")
        mask, shape = np.asarray(detection.mask), shared.data.shape
        if mask.dtype != np.bool_ or mask.shape != shape:
            raise ValueError(
                f"detect() must mark cells of a map of shape {shape}, not {mask.dtype} {mask.shape}"
            )
        return mask

    def score(self, shared: Shared, plugin: Detector, answer: Mask) -> Found:
        """Count hits and false alarms."""
        power_map, n_detected = self._draw_once(shared.key["trial"]), int(answer.sum())
        counts = _counts(answer, power_map.targets, power_map.clear)
        return {"status": status_of(n_detected), "n_estimated": n_detected, **counts}, PointCloud.empty()


def count_cells(image: Image) -> dict[str, int]:
    """Count cells of the range-Doppler map that an estimator's detector tested, the columns `COUNTS`.

    Targets are the cells nearest to a scatterer; clear ones are more than three away from all of those.
    Nothing where the estimator is no `Diagnoser`, or there is no observation.
    """
    if image.observation is None or not isinstance(image.estimator, Diagnoser):
        return {}
    diagnosis, system = image.estimator.diagnose(image.observation), image.scenario.system
    truth = image.scenario.truth
    range_m = np.linalg.norm(truth.xyz - image.scenario.base_station_m, axis=1)
    rows = np.rint(range_m / system.range_bin_m).astype(np.int64) - diagnosis.range_bins[0]
    columns = np.rint(truth.velocity / system.velocity_bin_mps).astype(np.int64) - diagnosis.doppler_bins[0]
    mask = diagnosis.detection.mask
    is_inside = (rows >= 0) & (rows < mask.shape[0]) & (columns >= 0) & (columns < mask.shape[1])
    targets = np.zeros_like(mask)
    targets[rows[is_inside], columns[is_inside]] = True
    return _counts(mask, targets, ~near(targets, CLEAR_CELLS))


def _numbers(part: pd.DataFrame) -> dict[str, Any]:
    """Counts and rates of one group, and the deviation of its images."""
    counts, n_failed = {name: int(part[name].sum()) for name in COUNTS}, int(failed(part).sum())
    numbers = {"snr_gain_db": part["snr_gain_db"].iloc[0], "n_cells": len(part), "n_failed": n_failed}
    numbers |= counts
    for name, hits, of in (("pd", "n_hits", "n_targets"), ("pfa_measured", "n_false", "n_clear")):
        numbers |= statistics.share_columns(name, counts[hits], counts[of], len(part) - n_failed)
    return numbers | statistics.deviation_columns(part)


def _alone(
    suite: DetectionSuite, detectors: Sequence[SpelledVariant]
) -> Iterator[tuple[str, Entry[Detector]]]:
    """Every detector at every nominal rate, at its own where none is given."""
    for (text, (name, params)), own in product(detectors, [{"pfa": rate} for rate in suite.pfa] or [{}]):
        detector = get_detector(name, **{**params, **own})
        yield text, entry_of(detector, detector=text, pfa=detector.pfa)


def _behind(suite: DetectionSuite, detectors: Sequence[SpelledVariant]) -> Iterator[tuple[str, Entry[Any]]]:
    """Every estimator behind every detector."""
    for spelled, plugin in build_plugins(suite, "estimator", suite.estimators):
        if not hasattr(plugin, "detector") or "detector" in parse_spec(spelled).params:
            raise InputError(
                f"estimators: {spelled!r}: allowed are estimators with a parameter detector, which is not "
                "set; list detectors under the key detectors"
            )
        for text, (name, params) in detectors:
            detector = get_detector(name, **params)
            estimator = dataclasses.replace(plugin, detector=detector)
            own_pfa = getattr(estimator, "pfa", None)
            pfa = detector.pfa if own_pfa is None else own_pfa
            yield text, entry_of(estimator, detector=text, pfa=pfa)


def _counts(mask: Mask, targets: Mask, clear: Mask) -> dict[str, int]:
    values = targets.sum(), (mask & targets).sum(), clear.sum(), (mask & clear).sum()
    return dict(zip(COUNTS, map(int, values), strict=True))
