"""Run time: stages, memory, and which estimators are worth their time.

A point is one estimator with its parameters, on one scenario at one SNR; of
more than 12 scenarios, on all of them, each of which counts as a trial.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from isacbench import charts
from isacbench.bench import statistics
from isacbench.bench.cells.rows import TIMING_COLUMNS, failed
from isacbench.bench.kinds import kind
from isacbench.bench.kinds.scores import MANY_SCENARIOS, summarise_scores
from isacbench.bench.labels import estimator_labels, references_in
from isacbench.charts import VARIANT, Axis, Chart, ChartGroup, Column, Line, LineStyle, Series, Table, Variant
from isacbench.instrument.stages import STAGES

PANEL = ["scenario", "snr_db"]
POINT = ["scenario", "estimator", "params", "snr_db"]
"""Key of a point."""

MEDIANS = [statistics.TIME, *TIMING_COLUMNS]
MEMORY = "peak_memory_mib"

MOST_PANELS = 4
FRONTIER = "Pareto frontier (its symbols are full)"
FRONTIER_STYLE = LineStyle("#737373", "solid", "")
REST = "none of these"
STAGE_STYLES = {
    stage: LineStyle(colour, "solid", "")
    for stage, colour in zip((*STAGES, REST), (*charts.COLOURS[: len(STAGES)], "#B8B8B8"), strict=True)
}


def is_timed(rows: pd.DataFrame) -> bool:
    """Tell whether any row has times that count."""
    return bool(rows["timing"].any())


def summarise_stages(rows: pd.DataFrame) -> pd.DataFrame:
    """Median times and memory of every scenario, estimator and SNR: ``stages.csv``.

    ``n_timed`` are the cells that were timed and did not fail; what has none is left out. The medians are
    ``time_estimate_s_median``, ``time_<stage>_s_median``, ``time_spread_s_median`` and
    ``peak_memory_mib_median``.
    """
    return _medians(rows, POINT)


def stage_tables(rows: pd.DataFrame) -> list[Table]:
    """Time of an estimate and of its stages over all SNRs and trials, a row an estimator.

    One table a scenario, or a template from which many scenes are made. Of more than 12 first all
    together; the others are details.
    """
    place = "template" if "template" in rows else "scenario"
    parts = dict(iter(_medians(rows, [place, *VARIANT]).groupby(place, sort=False)))
    is_detail = len(parts) > MANY_SCENARIOS
    tables = [_stage_table(f"{len(parts)} scenarios", _medians(rows, VARIANT))] if is_detail else []
    for name, part in parts.items():
        tables.append(replace(_stage_table(str(name), part), is_detail=is_detail))
    return tables


def _stage_table(name: str, table: pd.DataFrame) -> Table:
    times = "estimate", "spread", *STAGES
    columns = [
        Column("estimator", "label", part=0),
        Column("cells", "n_timed"),
        *(Column(one, f"time_{one}_s_median", "{:.2f}", scale=1e3) for one in times),
        Column("memory", "peak_memory_mib_median", "{:.1f}"),
    ]
    title = f"{name}: median processor time of an estimate and its stages [ms], peak memory [MiB]"
    return Table(title, columns, kind.with_labels(table))


def _medians(rows: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    timed = rows[rows["timing"] & ~failed(rows)]
    n_timed = timed.groupby(list(by), sort=False).size().rename("n_timed")
    return pd.concat([n_timed, statistics.median_times(timed, by, MEDIANS)], axis=1).reset_index()


def time_charts(rows: pd.DataFrame, lines: Mapping[Variant, Line]) -> list[ChartGroup]:
    """Run time against error, and stages of the fastest: of every scenario, or of many together.

    Nothing where no time counts.
    """
    timed = timed_rows(rows)
    if timed.empty:
        return []
    points, groups = summarise_points(timed), []
    for _, stem, part in kind.title_stems(points, "scenario"):
        # No point at all takes no time, and its error would be most of the axis.
        part = part[part["estimator"] != "empty"]
        groups.append(pareto_charts(part, f"pareto-{stem}", lines))
        groups += stage_charts(timed, part, f"stages-{stem}", lines)
    return groups


def chart_snrs(snrs_db: Sequence[float]) -> list[float]:
    """Choose the SNRs that have a chart: all up to four; of more the lowest, the highest and two between.

    Examples
    --------
    >>> chart_snrs([-30, -20, -10, 0, 10, 20])
    [-30, -10, 0, 20]
    """
    ordered = sorted(set(snrs_db))
    places = np.linspace(0, len(ordered) - 1, min(MOST_PANELS, len(ordered))).round().astype(int)
    return [ordered[place] for place in places]


def pareto_charts(part: pd.DataFrame, stem: str, lines: Mapping[Variant, Line]) -> ChartGroup:
    """Mean Hausdorff sum over median time of one scenario with both intervals, a chart an SNR.

    Points on the frontier are full, others open; those that failed or are missing in some trials are crosses.
    """
    snrs_db = chart_snrs(part["snr_db"].tolist())
    points = part[part["snr_db"].isin(snrs_db)]
    # References are level lines, whose times would only stretch the axis.
    own = points[~points["is_limit"]] if not points["is_limit"].all() else points
    x_limits = charts.decades(1e3 * own["time_s"])
    x = Axis("median processor time of an image [ms]", log=True, limits=x_limits)
    y = Axis("Hausdorff sum [m]", log=True, limits=charts.decades(points["hausdorff_sum_m_mean"]))
    panels = [
        Chart(f"{snr_db:g} dB", x, y, _pareto_series(points[points["snr_db"] == snr_db], lines, x_limits))
        for snr_db in snrs_db
    ]
    trials = statistics.trials_and_band(part["n_trials"].max())
    title = f"{part['scenario'].iloc[0]}: mean Hausdorff sum over median processor time of {trials}"
    return ChartGroup(stem, title, panels, n_columns=2, panel_in=(4.6, 3.6))


def _pareto_series(
    points: pd.DataFrame, lines: Mapping[Variant, Line], x_limits: tuple[float, float]
) -> list[Series]:
    """References as lines, estimators as points, and the frontier as steps."""
    series = []
    for row in points.to_dict("records"):
        label, style, _ = lines[row["estimator"], row["params"]]
        y, low, high = ([row[f"hausdorff_sum_m_{end}"]] for end in ("mean", "low", "high"))
        if row["is_limit"]:
            series.append(Series(label, x_limits, 2 * y, 2 * low, 2 * high, style=style))
            continue
        x, x_low, x_high = ([1e3 * row[name]] for name in ("time_s", "time_low_s", "time_high_s"))
        if math.isnan(y[0]):
            label, x, y = label + charts.NO_SCORE, [], []
        elif not row["is_complete"]:
            style = replace(style, symbol="x")
        elif not row["is_on_frontier"]:
            style = replace(style, symbol=f"{style.symbol}-open")
        series.append(Series(label, x, y, low, high, x_low, x_high, mark="points", style=style))
    frontier = points[points["is_on_frontier"]].sort_values("time_s")
    if len(frontier):
        errors = frontier["hausdorff_sum_m_mean"].tolist()
        times_ms = [*(1e3 * frontier["time_s"]), x_limits[1]]
        series.append(Series(FRONTIER, times_ms, [*errors, errors[-1]], mark="step", style=FRONTIER_STYLE))
    return series


def stage_charts(
    rows: pd.DataFrame, points: pd.DataFrame, stem: str, lines: Mapping[Variant, Line]
) -> list[ChartGroup]:
    """Shares of the stages in the run time of the estimators on the frontier, a chart an SNR.

    Nothing where no stage was timed, or nothing is on a frontier.
    """
    front = points[points["is_on_frontier"] & points["snr_db"].isin(chart_snrs(points["snr_db"].tolist()))]
    columns = {f"time_{one}_s": one for one in STAGES if rows.get(f"time_{one}_s", np.array([])).any()}
    if not columns or front.empty:
        return []
    scored = rows[~failed(rows)]
    shares = 100 * scored[[*columns]].fillna(0.0).div(scored["time_estimate_s"], axis=0)
    shares = pd.concat([scored[POINT], shares.rename(columns=columns)], axis=1).groupby(POINT).mean()
    # Medians of stages need not add up to the median of their sum.
    front = front.join(shares.assign(**{REST: (100 - shares.sum(axis=1)).clip(lower=0.0)}), on=POINT)
    x, panels = Axis("share of the processor time [%]", limits=(0, 100)), []
    for snr_db, group in front.sort_values("time_s").groupby("snr_db"):
        names = [
            f"{lines[row['estimator'], row['params']].label}: {_cost(row)}"
            for row in group.to_dict("records")
        ]
        bars = [
            Series(stage, group[stage], np.arange(len(group)), mark="bar", style=STAGE_STYLES[stage])
            for stage in (*columns.values(), REST)
        ]
        panels.append(Chart(f"{snr_db:g} dB", x, Axis("", categories=names), bars))
    title = f"{points['scenario'].iloc[0]}: share of the stages in the processor time"
    n_bars = max(len(chart.y.categories) for chart in panels)
    return [ChartGroup(stem, title, panels, n_columns=1, panel_in=(7.0, 0.6 + 0.26 * n_bars))]


def _cost(row: Mapping[Any, Any]) -> str:
    """Median time, and the peak memory where it was measured."""
    memory_mib = charts.number_or_blank(row.get(MEMORY, math.nan), ", {:.3g} MiB")
    return f"{1e3 * row['time_s']:.3g} ms{memory_mib}"


def pareto_frontier(time_s: ArrayLike, error: ArrayLike) -> NDArray[np.bool_]:
    """Tell which alternatives no other one beats in time and in error; lower is better in both.

    One beats another if it is worse in neither and better in one of them. Alternatives that are equal in both
    do not beat each other.

    Examples
    --------
    >>> pareto_frontier([1.0, 2.0, 3.0, 3.0], [5.0, 4.0, 4.5, 4.0]).tolist()
    [True, True, False, False]
    """
    times, errors = np.asarray(time_s), np.asarray(error)
    is_worse_in_neither = (times[:, None] <= times) & (errors[:, None] <= errors)
    is_better_in_one = (times[:, None] < times) | (errors[:, None] < errors)
    is_beaten: NDArray[np.bool_] = np.asarray(np.any(is_worse_in_neither & is_better_in_one, axis=0))
    return ~is_beaten


def timed_rows(records: pd.DataFrame) -> pd.DataFrame:
    """Rows whose time counts; of estimators that have such rows, those too that failed before one was there.

    Of more than 12 scenarios means over the trials of each, as trials of one scenario.
    """
    has_time = records["timing"].astype(bool)
    rows = records[has_time | (failed(records) & bool(has_time.any()))]
    n_scenarios = rows["scenario"].nunique()
    if n_scenarios <= MANY_SCENARIOS:
        return rows
    groups = rows.assign(failed=failed(rows)).groupby(POINT, sort=False)
    has_failed = groups["failed"].any()  # in any trial
    numbers = rows.select_dtypes(np.float64).columns.drop("snr_db", errors="ignore").tolist()
    others = groups.first().drop(columns=numbers)
    others["status"] = others["status"].mask(has_failed, "error")
    table = pd.concat([others, groups[numbers].mean()[~has_failed]], axis=1).reset_index()
    return table.assign(
        trial=pd.factorize(table["scenario"])[0], scenario=f"{n_scenarios} scenarios as trials"
    )


def summarise_points(records: pd.DataFrame) -> pd.DataFrame:
    """Average Hausdorff sum and time of every point of the rows that `timed_rows` picks, and find frontiers.

    Returned is a row for each scenario, SNR, estimator and params, SNRs ascending:

    - ``label`` of the estimator with its params; the counts ``n_trials``, ``n_failed``, ``n_no_detection``;
    - ``hausdorff_sum_m_mean``, ``hausdorff_sum_m_low``, ``hausdorff_sum_m_high`` (Student's t), over the
      trials that did not fail;
    - ``time_s``, the median over the same (`isacbench.bench.statistics.median_times`), ``time_low_s``,
      ``time_high_s`` (order statistics), ``time_slowest_s``, and ``peak_memory_mib``, the median, where the
      rows have it;
    - ``is_limit``; ``is_complete``, whether every trial of the scenario and SNR has a score;
      ``is_on_frontier``, of mean Hausdorff sum and median time among those that are complete and no limit.

    Limits of intervals are NaN where the trials are too few: five are needed of Hausdorff sums, six of times.
    """
    rows, labels = timed_rows(records), estimator_labels(charts.variants_in(records))
    points = summarise_scores(rows).rename(
        columns={"n_cells": "n_trials", "time_estimate_s_median": "time_s"}
    )
    low, high = charts.interval(points, "hausdorff_sum_m_mean", "hausdorff_sum_m")
    all_trials = points.groupby(PANEL)["n_trials"].transform("max")
    points = points.assign(
        label=[labels[one] for one in zip(points["estimator"], points["params"], strict=True)],
        hausdorff_sum_m_low=low,
        hausdorff_sum_m_high=high,
        is_limit=points["estimator"].isin(references_in(records)),
        is_complete=(points["n_failed"] == 0) & (points["n_trials"] == all_trials),
        is_on_frontier=False,
    ).join(_times(rows[~failed(rows)]), on=POINT)
    for _, part in points[points["is_complete"] & ~points["is_limit"]].groupby(PANEL, sort=False):
        is_on_frontier = pareto_frontier(part["time_s"], part["hausdorff_sum_m_mean"])
        points.loc[part.index, "is_on_frontier"] = is_on_frontier
    names = [
        *(*POINT, "label", "n_trials", "n_failed", "n_no_detection"),
        *("hausdorff_sum_m_mean", "hausdorff_sum_m_low", "hausdorff_sum_m_high"),
        *("time_s", "time_low_s", "time_high_s", "time_slowest_s", MEMORY),
        *("is_limit", "is_complete", "is_on_frontier"),
    ]
    points = points[[name for name in names if name in points]]
    order = pd.factorize(points["scenario"])[0], points["snr_db"]
    return points.iloc[np.lexsort(order[::-1])].reset_index(drop=True)


def _times(scored: pd.DataFrame) -> pd.DataFrame:
    """Interval of the median time of every point, its slowest trial, and its peak memory where measured."""
    groups = scored.groupby(POINT, sort=False)
    table = groups[[statistics.TIME]].max().set_axis(["time_slowest_s"], axis=1)
    limits = [statistics.median_interval(times_s.to_numpy()) for _, times_s in groups[statistics.TIME]]
    _, table["time_low_s"], table["time_high_s"] = np.reshape(limits, (-1, 3)).T
    if MEMORY in scored:
        table[MEMORY] = groups[MEMORY].median()
    return table
