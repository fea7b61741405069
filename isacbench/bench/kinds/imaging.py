"""The kind ``imaging``: every scenario as it is, and its image scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import pandas as pd

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.kinds import kind, scores
from isacbench.bench.kinds.kind import NO_SCENARIOS, OF_IMAGES, Kind, Scenarios
from isacbench.bench.kinds.scenes import ImagingTask, build_estimators
from isacbench.bench.kinds.scores import MANY_SCENARIOS, SNR_AXIS, average_scenarios, summarise_scores
from isacbench.bench.plan.labels import find_limits
from isacbench.bench.run_times import time_charts
from isacbench.bench.suites.suite import Suite
from isacbench.charts import VARIANT, Chart, ChartGroup, Column, Line, Table, Variant
from isacbench.metrics.paper import Paper
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.model.scene import Scenario

DEVIATION_SPREAD = SPREAD_COLUMNS["deviation"]
ESTIMATORS_A_TABLE = 4

PRACTICALLY_ZERO = 1e-6
"""Smaller means do not stretch a logarithmic axis: such velocities are exact for any purpose."""

IMAGE_COLUMNS = {  # score: heading, and how early a terminal without room leaves it out
    "hausdorff_sum_m": ("Hausdorff [m]", 0),
    "f_score": ("F-score", 0),
    "objects_f_score": ("objects", 1),
    "gospa_skill": ("GOSPA skill", 2),
    "precision": ("precision", 3),
    "recall": ("recall", 3),
    "spatial": ("spatial", 4),
    "velocity_nmse": ("kinematic", 4),
}
"""Scores that a table shows after the deviation; the last two are its parts."""


class ScoreAxis(NamedTuple):
    """How a score is drawn: title of its chart, and name, unit and sort of its axis."""

    title: str
    axis: str
    log: bool = False


def _described(column: str, axis: str, log: bool = False) -> ScoreAxis:
    """Chart that is titled as the metric describes its score."""
    description = next(one.description for one in Paper.columns if one.name == column)
    return ScoreAxis(description[0].upper() + description[1:], axis, log)


SCORE_AXES = {
    "deviation": _described("deviation", "imaging deviation"),
    "hausdorff_sum_m": ScoreAxis("Sum of the three Hausdorff distances", "Hausdorff sum [m]"),
    "density": _described("density", "density error"),
    "velocity_nmse": _described("velocity_nmse", "velocity NMSE", log=True),
    "hausdorff_xy_m": _described("hausdorff_xy_m", "Hausdorff distance xy [m]"),
    "hausdorff_xz_m": _described("hausdorff_xz_m", "Hausdorff distance xz [m]"),
    "hausdorff_yz_m": _described("hausdorff_yz_m", "Hausdorff distance yz [m]"),
    "chamfer_m": _described("chamfer_m", "chamfer distance [m]"),
    "gospa_m": ScoreAxis("GOSPA distance: misplaced, missed and false points", "GOSPA distance [m]"),
    "gospa_skill": ScoreAxis("GOSPA's skill: 0 of an empty image, 1 of the truth", "GOSPA skill"),
    "velocity_error_mps": ScoreAxis("Velocity error of matched points", "velocity error [m/s]"),
    "f_score": ScoreAxis("F-score of points matched one to one within {radius_m:g} m", "F-score"),
    "objects_detected": ScoreAxis("Share of objects that were detected", "objects detected"),
    "n_objects_false": ScoreAxis("Found objects that are none", "false objects an image"),
    "precision": ScoreAxis(
        "Share of estimated points within {radius_m:g} m of a true scatterer", "precision"
    ),
    "recall": ScoreAxis("Share of true scatterers within {radius_m:g} m of an estimated point", "recall"),
}
SHARES = "f_score", "objects_detected", "precision", "recall"


class ImagingKind(Kind):
    """Scores of images, averaged over trials."""

    name = "imaging"
    metrics = OF_IMAGES
    has_images = True

    def scenes(self, suite: Suite, scenarios: Scenarios) -> list[ImagingTask]:
        """Plan one scene a scenario: the scenario as it is."""
        entries, metrics = build_estimators(suite), self.metrics_of(suite)
        return [ImagingTask(suite, scenario, entries, metrics=metrics) for scenario in scenarios.values()]

    def summary(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Average the trials of every scenario, estimator and SNR, see `summarise_scores`."""
        return summarise_scores(rows)

    def tables(self, rows: pd.DataFrame) -> list[Table]:
        """Scores and times, estimators over SNR, one table a scenario or more; then objects.

        Of more than 12 scenarios first their mean; the others are details.
        """
        labels, words = kind.labels_of(rows), f"{statistics.time_words(rows)} of an image"
        n_scenarios, found = rows["scenario"].nunique(), kind.number_tables(rows)
        is_detail = n_scenarios > MANY_SCENARIOS
        if is_detail:
            title = f"{statistics.mean_of_scenarios(n_scenarios)}; {words}"
            found += _estimators_over_snr(average_scenarios(rows), title, labels, rows)
        for scenario, part in summarise_scores(rows).groupby("scenario", sort=False):
            title = f"{scenario}: {statistics.mean_of_trials(int(part['n_cells'].max()))}; {words}"
            if DEVIATION_SPREAD in rows and rows[DEVIATION_SPREAD].notna().any():
                title += "; ± of references: spread over realisations"
            tables = _estimators_over_snr(part, title, labels, rows[rows["scenario"] == scenario])
            found += [replace(table, is_detail=is_detail) for table in tables]
        return [*found, *scores.object_tables(rows, scores.with_references(labels, find_limits(rows)))]

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Deviation of all scenarios, all scores of each, and run time against error where the time counts.

        Of more than 12 scenarios only the mean of the deviation, and times.
        """
        lines, n_scenarios = kind.lines_of(rows), rows["scenario"].nunique()
        if n_scenarios > MANY_SCENARIOS:
            note = statistics.mean_of_scenarios(n_scenarios)
            return [deviation_charts(average_scenarios(rows), lines, note), *time_charts(rows, lines)]
        summary = summarise_scores(rows)
        note = statistics.mean_of_trials(int(summary["n_cells"].max()))
        found = [deviation_charts(summary, lines, note)]
        for name, stem, part in kind.title_stems(summary, "scenario"):
            names = [score for score in SCORE_AXES if f"{score}_mean" in part]
            found.append(score_charts(part, names, f"curves-{stem}", lines, scenarios.get(name)))
        return [*found, *time_charts(rows, lines)]


def deviation_charts(summary: pd.DataFrame, lines: Mapping[Variant, Line], note: str) -> ChartGroup:
    """Deviation over SNR, a chart a scenario, all on one scale."""
    title, name, _ = SCORE_AXES["deviation"]
    y, panels = scores.score_axis(name, "linear", summary, "deviation_mean", "deviation"), []
    for scenario, part in summary.groupby("scenario", sort=False):
        series = charts.line_series(part, lines, "snr_db", "deviation_mean", "deviation")
        panels.append(Chart(str(scenario), SNR_AXIS, y, series))
    return ChartGroup("deviation", f"{title}\n{note}", panels)


def score_charts(
    part: pd.DataFrame,
    names: Sequence[str],
    stem: str,
    lines: Mapping[Variant, Line],
    scenario: Scenario | None,
) -> ChartGroup:
    """Scores of one scenario of `summarise_scores` over SNR, a chart a score.

    Where the scenario is not known, its radius and gain are not named.
    """
    title = f"{part['scenario'].iloc[0]}: {statistics.mean_of_trials(int(part['n_cells'].max()))}"
    if scenario is not None:
        title += f"\na median scatterer after all gains: SNR {median_gain_db(scenario):+.1f} dB"
    panels = []
    for score in names:
        heading, name, is_log = SCORE_AXES.get(score, ScoreAxis(score, score))
        scale: scores.Scale = "share" if score in SHARES else "log" if is_log else "linear"
        column = f"{score}_mean"
        y = scores.score_axis(name, scale, part, column, score, PRACTICALLY_ZERO)
        if is_log and y.limits is not None and (part[column] < y.limits[0]).any():
            y = replace(y, title=f"{name} (less: at the edge)")
        heading = heading.replace("{radius_m:g}", f"{scenario.radius_m:g}" if scenario else "1")
        series = charts.line_series(part, lines, "snr_db", column, score)
        panels.append(Chart(heading, SNR_AXIS, y, series))
    return ChartGroup(stem, title, panels)


def _estimators_over_snr(
    summary: pd.DataFrame, title: str, labels: Mapping[Variant, str], rows: pd.DataFrame
) -> list[Table]:
    """Tables of one scenario, or of a mean over scenarios, a few estimators in each, with times."""
    summary = summary.assign(spatial_mean=summary["hausdorff_sum_m_mean"] + summary["density_mean"])
    further = {score: one for score, one in IMAGE_COLUMNS.items() if f"{score}_mean" in summary}
    lines = charts.spread_rows(summary.sort_values("snr_db", kind="stable"), ["snr_db"], VARIANT)
    times_s = statistics.median_times(rows, VARIANT)[f"{statistics.TIME}_median"]
    lines.append({"snr_db": "time [ms]", **{one: {"time_s": time_s} for one, time_s in times_s.items()}})
    found = []
    for batch in charts.batched(charts.variants_in(summary), ESTIMATORS_A_TABLE):
        columns = [Column("SNR [dB]", "snr_db", "{:g}", part=0)]
        for part, variant in enumerate(batch, start=1):
            columns.append(Column(f"{labels[variant]}: deviation", variant, deviation_text, part=part))
            for score, (heading, optional) in further.items():
                form = "{:.1e}" if score == "velocity_nmse" else "{:.2f}"
                write = partial(_mean_text, f"{score}_mean", form)
                columns.append(Column(heading, variant, write, optional=optional, part=part))
        found.append(Table(title, columns, lines))
    return found


def _mean_text(column: str, form: str, entry: Mapping[Any, Any]) -> str:
    return charts.number_or_blank(entry[column], form) if column in entry else ""


def deviation_text(entry: Mapping[Any, Any]) -> str:
    """Mean deviation of some trials with its band and the trials that failed, or the time of an image."""
    if "time_s" in entry:
        return f"{1e3 * entry['time_s']:.1f}"
    return charts.with_failures(scores.mean_text("deviation", entry), entry["n_failed"])
