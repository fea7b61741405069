"""The kind ``imaging``: every scenario as it is, and its image scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.task import ImagingTask, build_estimators
from isacbench.bench.kinds import kind, scores
from isacbench.bench.kinds.kind import NO_SCENARIOS, OF_IMAGES, Kind, Scenarios
from isacbench.bench.kinds.scores import MANY_SCENARIOS, SCORES, average_scenarios, score_of, summarise_scores
from isacbench.bench.labels import references_in
from isacbench.bench.run_times import time_charts
from isacbench.bench.suites.suite import Suite
from isacbench.charts import VARIANT, ChartGroup, Column, Line, Table, Variant
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.model.scene import Scenario

TIME = f"{statistics.TIME}_median"
ESTIMATORS_A_TABLE = 4

IN_TABLES = (
    *("hausdorff_sum_m", "f_score", "objects_f_score", "gospa_skill", "precision", "recall"),
    *("density", "velocity_nmse"),
)
"""Scores that a table shows after the deviation, besides columns that the kind adds."""


class ImagingKind(Kind):
    """Scores of images, averaged over trials."""

    name = "imaging"
    metrics = OF_IMAGES
    has_scenes = True
    has_images = True

    def tasks(self, suite: Suite, scenarios: Scenarios) -> list[ImagingTask]:
        """Plan one task a scenario: the scenario as it is."""
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
        if rows.get(SPREAD_COLUMNS["deviation"], pd.Series()).notna().any():
            words += "; ± of references: spread over realisations"
        n_scenarios, tables = rows["scenario"].nunique(), kind.number_tables(rows)
        is_detail = n_scenarios > MANY_SCENARIOS
        if is_detail:
            title = f"mean over {statistics.trials_and_band(n_scenarios, 'scenario')}; {words}"
            times_s = statistics.median_times(rows, VARIANT)[TIME].to_dict()
            tables += self._estimators_over_snr(average_scenarios(rows), title, labels, times_s)
        times_s = statistics.median_times(rows, ["scenario", *VARIANT])[TIME].unstack("scenario").to_dict()
        for scenario, part in summarise_scores(rows).groupby("scenario", sort=False):
            title = f"{scenario}: mean of {statistics.trials_and_band(part['n_cells'].max())}; {words}"
            own_tables = self._estimators_over_snr(part, title, labels, times_s.get(scenario, {}))
            tables += [replace(table, is_detail=is_detail) for table in own_tables]
        return [*tables, *scores.object_tables(rows, scores.with_references(labels, references_in(rows)))]

    def _estimators_over_snr(
        self,
        summary: pd.DataFrame,
        title: str,
        labels: Mapping[Variant, str],
        times_s: Mapping[Any, float],
    ) -> list[Table]:
        """Tables of one scenario, or of a mean over scenarios, a few estimators in each, with their times."""
        names = [name for name in (*IN_TABLES, *self.columns) if f"{name}_mean" in summary]
        further = [(score_of(name), f"{name}_mean") for name in names]
        lines = charts.spread_rows(summary.sort_values("snr_db", kind="stable"), ["snr_db"], VARIANT)
        lines.append({"snr_db": "time [ms]"} | {one: {"time_s": time_s} for one, time_s in times_s.items()})
        tables = []
        for batch in charts.batched(charts.variants_in(summary), ESTIMATORS_A_TABLE):
            columns = [Column("SNR [dB]", "snr_db", "{:g}", part=0)]
            for place, variant in enumerate(batch, start=1):
                columns.append(
                    Column(f"{labels[variant]}: deviation", variant, _deviation_or_time, part=place)
                )
                for one, key in further:
                    form = Column("", key, one.form).text
                    columns.append(Column(one.name, variant, form, optional=one.optional, part=place))
            tables.append(Table(title, columns, lines))
        return tables

    def charts(self, rows: pd.DataFrame, scenarios: Scenarios = NO_SCENARIOS) -> list[ChartGroup]:
        """Deviation of all scenarios, all scores of each, and run time against error where the time counts.

        Of more than 12 scenarios only the mean of the deviation, and times.
        """
        lines, n_scenarios = kind.lines_of(rows), rows["scenario"].nunique()
        if n_scenarios > MANY_SCENARIOS:
            note = f"mean over {statistics.trials_and_band(n_scenarios, 'scenario')}"
            return [deviation_charts(average_scenarios(rows), lines, note), *time_charts(rows, lines)]
        summary = summarise_scores(rows)
        groups = [
            deviation_charts(
                summary, lines, f"mean of {statistics.trials_and_band(summary['n_cells'].max())}"
            )
        ]
        for name, stem, part in kind.title_stems(summary, "scenario"):
            names = [score for score in SCORES if f"{score}_mean" in part]
            groups.append(score_charts(part, names, f"curves-{stem}", lines, scenarios.get(name)))
        return [*groups, *time_charts(rows, lines)]


def deviation_charts(summary: pd.DataFrame, lines: Mapping[Variant, Line], note: str) -> ChartGroup:
    """Deviation over SNR, a chart a scenario, all on one scale."""
    panels = [
        scores.score_chart(str(scenario), SCORES["deviation"], "deviation_mean", part, lines, summary)
        for scenario, part in summary.groupby("scenario", sort=False)
    ]
    return ChartGroup("deviation", f"Imaging deviation: {note}", panels)


def score_charts(
    part: pd.DataFrame,
    names: Sequence[str],
    stem: str,
    lines: Mapping[Variant, Line],
    scenario: Scenario | None,
) -> ChartGroup:
    """Scores of one scenario over SNR, a chart a score; the title has its gain if the scenario is known."""
    title = f"{part['scenario'].iloc[0]}: mean of {statistics.trials_and_band(part['n_cells'].max())}"
    if scenario is not None:
        title += f"\na median scatterer after all gains: SNR {median_gain_db(scenario):+.1f} dB"
    ones = {name: score_of(name) for name in names}
    panels = [
        scores.score_chart(one.name, one, f"{name}_mean", part, lines, part) for name, one in ones.items()
    ]
    return ChartGroup(stem, title, panels)


def _deviation_or_time(entry: Mapping[Any, Any]) -> str:
    """Text of some trials, or in the last line of a table of the time of an image in ms."""
    if "time_s" in entry:
        return charts.number_or_blank(1e3 * entry["time_s"], "{:.1f}")
    return deviation_text(entry)


def deviation_text(entry: Mapping[Any, Any]) -> str:
    """Mean deviation of some trials with its band, and the trials that failed."""
    return charts.with_failures(scores.mean_text("deviation_mean", entry), entry["n_failed"])
