"""Figure of a ranking: the rank sets, and the differences from the best estimator."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from matplotlib.lines import Line2D

from isacbench.files.checked_files import make_own_folder
from isacbench.files.escaping import shortened
from isacbench.report.comparisons.comparison_figure import FOLDER
from isacbench.report.drawing.style import (
    BOUND_COLOUR,
    assign_looks,
    drawable,
    file_stems,
    new_figure,
    save,
    styled,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Transform

    from isacbench.bench.compare.ranking import Ranking
    from isacbench.bench.plan.labels import Variant
    from isacbench.report.drawing.style import LineLook

ROW_IN, GROUP_IN, WIDTH_IN = 0.27, 0.95, 8.0
LABEL_WIDTH = 36

FAR = 2.0
"""Largest distance of a reference that is drawn, in widths of all intervals together. Farther ones are named
at the edge: to scale they would leave no room for the differences."""


def draw_ranking_file(ranking: Ranking, folder: Path) -> Path:
    """Draw a ranking into ``figures/ranks-<metric>.png`` of a run.

    Parameters
    ----------
    ranking : Ranking
    folder : Path
        Of the run.

    Returns
    -------
    Path
        Written file.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    path = folder / FOLDER / f"ranks-{file_stems([ranking.metric])[ranking.metric]}.png"
    make_own_folder(path.parent)
    with styled():
        return save(draw_ranking(ranking), path)


def draw_ranking(ranking: Ranking) -> Figure:
    """Draw a row of two panels for each group: rank sets, and mean differences from the best estimator.

    Parameters
    ----------
    ranking : Ranking

    Returns
    -------
    Figure
    """
    groups = dict(list(ranking.ranks.groupby("group", sort=False)))
    is_reference = ranking.ranks["is_reference"]
    references = ranking.ranks.loc[is_reference, "estimator"]
    looks = assign_looks(ranking.labels, set(references))
    heights = [GROUP_IN + ROW_IN * (~part["is_reference"]).sum() for part in groups.values()]
    grey: dict[str, Any] = {"color": "0.3", "marker": "o"}
    marks = [
        Line2D([], [], linewidth=4, alpha=0.6, label="rank of the mean, in its 95 % set", **grey),
        Line2D([], [], label="mean difference, 95 % interval", **grey),
    ]
    if len(references):
        marks.append(Line2D([], [], color=BOUND_COLOUR, linestyle="--", label="reference (sees the truth)"))
    title = f"Ranks by {drawable(ranking.metric)}, {ranking.better} is better"
    figure = new_figure(WIDTH_IN, sum(heights) + 0.3, legend=marks, title=title)
    grid = figure.subplots(len(groups), 2, squeeze=False, height_ratios=heights, width_ratios=[1, 1.3])
    for (left, right), (group, part) in zip(grid, groups.items(), strict=True):
        own = part[~part["is_reference"]]
        _draw_sets(left, own, looks)
        left.set_title(f"{drawable(str(group))}: {part['n_scenes'].iloc[0]} scenes")
        _draw_differences(right, own, looks)
        _draw_references(right, part[part["is_reference"]], own, ranking.labels)
        right.set_xlabel(f"mean {drawable(ranking.metric)} less that of the best")
    return figure


def _draw_sets(axes: Axes, own: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> None:
    """Draw the set of every estimator as a bar, with its rank by the mean."""
    names = []
    for place, row in enumerate(own.to_dict("records")):
        look = looks[row["estimator"], row["params"]]
        names.append(drawable(shortened(look.label.replace("\\$", "$"), LABEL_WIDTH)))
        axes.plot(
            [row["rank_low"], row["rank_high"]],
            [place, place],
            color=look.colour,
            linewidth=6,
            alpha=0.45,
            solid_capstyle="round",
        )
        axes.plot([place + 1], [place], color=look.colour, marker=look.marker)
    axes.set_xticks(range(1, len(own) + 1))
    axes.set_xlim(0.5, len(own) + 0.5)
    axes.set_yticks(range(len(own)), names)
    axes.set_ylim(len(own) - 0.5, -0.5)
    axes.set_xlabel("rank")
    axes.grid(True, axis="x")


def _draw_differences(axes: Axes, own: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> None:
    """Draw every estimator's mean difference from the best with its interval."""
    for place, row in enumerate(own.to_dict("records")):
        look = looks[row["estimator"], row["params"]]
        axes.plot([row["change_low"], row["change_high"]], [place, place], color=look.colour)
        axes.plot([row["change"]], [place], color=look.colour, marker=look.marker)
    axes.set_yticks([])
    axes.set_ylim(len(own) - 0.5, -0.5)
    axes.grid(True, axis="x")


def _draw_references(
    axes: Axes, references: pd.DataFrame, own: pd.DataFrame, labels: Mapping[Variant, str]
) -> None:
    """Draw the mean of every reference as a line, named above the panel; name far ones at the lower edge."""
    best = own["mean"].iloc[0]
    low, high = min(own["change_low"].min(), 0.0), max(own["change_high"].max(), 0.0)
    reach = FAR * (high - low)
    for row in references.to_dict("records"):
        place = row["mean"] - best
        if math.isnan(place):
            continue
        name = drawable(shortened(labels[row["estimator"], row["params"]], LABEL_WIDTH))
        if low - reach <= place <= high + reach:
            axes.axvline(place, color=BOUND_COLOUR, linestyle="--", linewidth=1.0)
            _annotate(axes, name, (place, 1.0), axes.get_xaxis_transform(), rotation=35)
        elif place > high:
            _annotate(axes, f"{name} at {place:+.3g} →", (0.99, 0.0), axes.transAxes, ha="right")
        else:
            _annotate(axes, f"← {name} at {place:+.3g}", (0.01, 0.0), axes.transAxes, ha="left")


def _annotate(
    axes: Axes, name: str, place: tuple[float, float], coordinates: Transform, **options: Any
) -> None:
    """Write a name just above a place."""
    axes.annotate(
        name,
        place,
        xycoords=coordinates,
        xytext=(0, 2),
        textcoords="offset points",
        fontsize=7.0,
        color=BOUND_COLOUR,
        **options,
    )
