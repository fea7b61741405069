"""A ranking in tables, charts and terms of JSON."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from isacbench import charts
from isacbench.bench.compare.ranking import Ranking, rank_text
from isacbench.bench.compare.scenes import MIN_FAMILY_SCENES
from isacbench.charts import (
    VARIANT,
    Axis,
    Chart,
    ChartGroup,
    Column,
    Line,
    Series,
    Table,
    Variant,
    variants_in,
)
from isacbench.files.escaping import file_stems, plural
from isacbench.report.figures import FOLDER, drawings_of, save_figures
from isacbench.report.tables import json_rows, signed

HEADINGS = {
    "f_score": "F-score",
    "velocity_error_mps": "velocity: error [m/s]",
    "objects_f_score": "objects: F-score",
}
"""Headings of the columns `isacbench.bench.compare.ranking.BESIDE`."""


def ranking_tables(ranking: Ranking) -> list[Table]:
    """Lay out the ranks and the win probabilities of every group, and the worst scenes."""
    tables = charts.number_table(ranking.labels)
    ranking = replace(ranking, labels=charts.short_labels(ranking.labels))
    for group, ranks in ranking.ranks.groupby("group", sort=False):
        tables.append(_rank_table(ranking, str(group), ranks))
        if not ranking.is_descriptive:
            tables.append(_win_table(ranking, str(group), ranks))
    columns = [
        _estimator_column(ranking),
        Column("scene", "scenario"),
        Column(ranking.metric, "score", "{:.4g}"),
        Column("worst image", form=_worst_image),
    ]
    return [*tables, Table(f"worst scenes by {ranking.metric}", columns, ranking.worst)]


def ranking_lines(ranking: Ranking) -> list[str]:
    """Write what the tables do not show: what was left out, and what sets are."""
    return [
        *ranking.notes,
        "of fewer than six scenes, nothing can be said of unseen ones"
        if ranking.is_descriptive
        else "rank sets hold for all estimators of a table at once with 95 % confidence (less with rare "
        "failures), other intervals each by itself; families with fewer than "
        f"{MIN_FAMILY_SCENES} scenes have no table of their own",
    ]


def ranking_content(ranking: Ranking) -> dict[str, Any]:
    """Describe a ranking in terms of JSON: its tables, with ``scores`` a row for each scene and estimator."""
    scores = ranking.scores.rename_axis("scenario").stack(VARIANT, future_stack=True)
    return {
        "run": {"folder": ranking.run, "version": ranking.version},
        "metric": ranking.metric,
        "better": ranking.better,
        "ranks": json_rows(ranking.ranks),
        "wins": json_rows(ranking.wins),
        "worst": json_rows(ranking.worst),
        "scores": json_rows(pd.DataFrame({"score": scores}).reset_index()),
        "notes": list(ranking.notes),
    }


def _rank_table(ranking: Ranking, group: str, ranks: pd.DataFrame) -> Table:
    """One row an estimator, references last."""
    n_scenes = plural(int(ranks["n_scenes"].iloc[0]), "scene")
    what = f"descriptive: {n_scenes}, means" if ranking.is_descriptive else f"{n_scenes}, ranks"
    columns = [
        _estimator_column(ranking),
        Column("rank", form=_rank_text),
        Column(f"mean {ranking.metric}", "mean", "{:.4g}"),
        *(Column(heading, name, "{:.2f}", part=2) for name, heading in HEADINGS.items() if name in ranks),
        Column("from the best", form=lambda row: "" if row["is_reference"] else signed(row["change"])),
        Column("95 % interval", form=_interval_text),
    ]
    if ranking.is_descriptive:
        columns = [column for column in columns if column.form not in (_rank_text, _interval_text)]
    return Table(f"{group}: {what} by {ranking.metric}, {ranking.better} is better", columns, ranks)


def _estimator_column(ranking: Ranking, heading: str = "estimator") -> Column:
    return Column(heading, form=lambda row: ranking.labels[row["estimator"], row["params"]], part=0)


def _rank_text(row: Mapping[str, Any]) -> str:
    return "reference" if row["is_reference"] else rank_text(row["rank_low"], row["rank_high"])


def _interval_text(row: Mapping[str, Any]) -> str:
    if row["is_reference"] or not row["change"]:
        return ""
    return f"{signed(row['change_low'])} to {signed(row['change_high'])}"


def _win_table(ranking: Ranking, group: str, ranks: pd.DataFrame) -> Table:
    """One row an estimator, one column each that it is compared with."""
    variants = variants_in(ranks[~ranks["is_reference"]])
    title = f"{group}: probability that the row is better than the column on an unseen scene, 95 % interval"
    headings = {variant: ranking.labels[variant] for variant in variants}
    columns = [_estimator_column(ranking, "better"), *charts.spread_columns(headings, _win_text)]
    wins = ranking.wins[ranking.wins["group"] == group]
    rows = charts.spread_rows(wins, VARIANT, ["other", "other_params"])
    rows.sort(key=lambda row: variants.index((row["estimator"], row["params"])))
    return Table(title, columns, rows)


def _win_text(row: Mapping[str, Any]) -> str:
    return f"{row['probability']:.2f} ({row['low']:.2f}-{row['high']:.2f})"


def _worst_image(row: Mapping[str, Any]) -> str:
    return f"{row['cell_score']:.4g}{'' if row['status'] == 'ok' else ' (' + row['status'] + ')'}"


def draw_ranking_file(ranking: Ranking, folder: Path) -> Path:
    """Draw a ranking into ``figures/ranks-<metric>.png`` of a run."""
    (path,) = save_figures(drawings_of([ranking_charts(ranking)]), folder / FOLDER)
    return path


def ranking_charts(ranking: Ranking) -> ChartGroup:
    """For each group of scenes, rank sets, and mean differences from the best estimator."""
    panels, most = [], 1
    lines = charts.assign_lines(ranking.labels)
    for group, part in ranking.ranks.groupby("group", sort=False):
        own = part[~part["is_reference"]]
        own = own.assign(rank=range(1, len(own) + 1))
        most = max(most, len(own))
        y = Axis("", categories=[lines[variant].label for variant in variants_in(own)])
        sets = Axis("rank", limits=(0.5, len(own) + 0.5))
        differences = Axis(f"mean {ranking.metric} less that of the best")
        title = f"{group}: {part['n_scenes'].iloc[0]} scenes"
        panels.append(Chart(title, sets, y, _points(lines, own, "rank")))
        panels.append(Chart("95 % interval", differences, y, _points(lines, own, "change")))
    stem = f"ranks-{file_stems([ranking.metric])[ranking.metric]}"
    title = f"Ranks by {ranking.metric}, {ranking.better} is better: ranks of means in their 95 % sets"
    return ChartGroup(stem, title, panels, n_columns=2, panel_in=(4.0, 0.7 + 0.27 * most))


def _points(lines: Mapping[Variant, Line], own: pd.DataFrame, column: str) -> list[Series]:
    """A point with its interval for every estimator."""
    series = []
    for place, row in enumerate(own.to_dict("records")):
        x, low, high = ([row[name]] for name in (column, f"{column}_low", f"{column}_high"))
        style = replace(lines[row["estimator"], row["params"]].style, dash="")
        series.append(Series("", x, [place], x_low=low, x_high=high, mark="points", style=style))
    return series
