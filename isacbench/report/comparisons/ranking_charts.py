"""Charts of a ranking: the rank sets, and the differences from the best estimator."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series, assign_lines
from isacbench.files.escaping import shortened
from isacbench.files.file_names import file_stems
from isacbench.report.comparisons.comparison_charts import FOLDER
from isacbench.report.figures import save_charts

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

    from isacbench.bench.compare.ranking import Ranking

LONGEST_LABEL = 36
FAR = 2.0
"""Largest distance of a reference that is drawn, in widths of all intervals together: to scale, farther ones
would leave no room for the differences."""


def draw_ranking_file(ranking: Ranking, folder: Path) -> Path:
    """Draw a ranking into ``figures/ranks-<metric>.png`` of a run."""
    (path,) = save_charts([ranking_charts(ranking)], folder / FOLDER)
    return path


def ranking_charts(ranking: Ranking) -> ChartGroup:
    """For each group of scenes, rank sets, and mean differences from the best estimator."""
    charts, most = [], 1
    for group, part in ranking.ranks.groupby("group", sort=False):
        own = part[~part["is_reference"]]
        most = max(most, len(own))
        names = [
            shortened(ranking.labels[row["estimator"], row["params"]], LONGEST_LABEL)
            for row in own.to_dict("records")
        ]
        y, low, high = Axis("", categories=names), min(own["change_low"].min(), 0.0), own["change_high"].max()
        sets = Axis("rank", limits=(0.5, len(own) + 0.5))
        title = f"{group}: {part['n_scenes'].iloc[0]} scenes"
        charts.append(Chart(title, sets, y, _series(ranking, own, ("rank", "rank_low", "rank_high"))))
        differences = _series(ranking, own, ("change", "change_low", "change_high"))
        reach = FAR * (max(high, 0.0) - low)
        for row in part[part["is_reference"]].to_dict("records"):
            place = row["mean"] - own["mean"].iloc[0]
            if math.isnan(place):
                continue
            label = f"{ranking.labels[row['estimator'], row['params']]} (ref.)"
            ends = [-0.5, len(own) - 0.5]
            if not low - reach <= place <= max(high, 0.0) + reach:
                label, ends = f"{label} at {place:+.3g}", []
            style = LineStyle("", "dash", "")
            differences.append(Series(label, [place] * len(ends), ends, style=style))
        x = Axis(f"mean {ranking.metric} less that of the best")
        charts.append(Chart("mean difference, 95 % interval", x, y, differences))
    stem = f"ranks-{file_stems([ranking.metric])[ranking.metric]}"
    title = f"Ranks by {ranking.metric}, {ranking.better} is better: ranks of means in their 95 % sets"
    return ChartGroup(stem, title, charts, n_columns=2, panel_in=(4.0, 0.7 + 0.27 * most))


def _series(ranking: Ranking, own: pd.DataFrame, columns: tuple[str, str, str]) -> list[Series]:
    """A point with its interval for every estimator."""
    lines = assign_lines(ranking.labels)
    found = []
    for place, row in enumerate(own.assign(rank=range(1, len(own) + 1)).to_dict("records")):
        x, low, high = ([row[name]] for name in columns)
        style = replace(lines[row["estimator"], row["params"]].style, dash="")
        found.append(Series("", x, [place], x_low=low, x_high=high, mark="points", style=style))
    return found
