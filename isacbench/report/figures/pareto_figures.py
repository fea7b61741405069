"""Figures of a timed run: deviation over run time with the Pareto frontier, and what the time goes into."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from isacbench.bench.cells.statuses import failed
from isacbench.instrument.stages import STAGES
from isacbench.report.drawing.label_layout import place_labels
from isacbench.report.drawing.panels import panel_grid
from isacbench.report.drawing.style import (
    COLOURS,
    CONTEXT,
    DPI,
    assign_looks,
    drawable,
    edges,
    entitle,
    legend_below,
    legend_height_in,
    new_figure,
)
from isacbench.report.tables.pareto import MEMORY, POINT
from isacbench.report.tables.run_tables import trials_and_band

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.report.drawing.style import LineLook

MAX_PANELS = 4
MAX_COLUMNS = 2
PANEL_IN = 4.6, 3.6

FRONTIER_COLOUR = "0.45"
DOMINATED_ALPHA = 0.4
ROOM = 0.17, 0.07
"""Of the span of the points, how far axes reach below and above them."""

LEAST_LOG_RATIO = 2.5
"""Deviations that span less are drawn on a linear axis."""

STAGE_COLOURS: dict[str, str] = dict(zip(STAGES, COLOURS, strict=True))

POINTS_AN_INCH = 72.0
NUMBER_SIZES = 9.0, 5.5
"""Font sizes of numbers on the frontier and elsewhere, in points."""
NUMBER_WIDTH, NUMBER_SPACE = 0.7, 0.3
"""Of a digit, and between numbers, over the font size."""
NUMBER_GAP = 4.0
"""Between a point and its number, in points."""
MARKER_SIZES = 6.0, 4.0
MOST_ROWS, MOST_COLUMNS = 3, 12
"""Places that a number on the frontier has: below its point, so many fit above the axis, and left of that."""

REST = "none of these"

BAR_IN = 0.24
BARS_IN = 4.5
NOTE_IN = 1.4
LETTER_IN = 0.068


def shown_snrs(snr_db: Sequence[float]) -> list[float]:
    """SNRs that have a panel: all up to four; of more the lowest, the highest and two between them.

    Examples
    --------
    >>> shown_snrs([-30, -20, -10, 0, 10, 20])
    [-30, -10, 0, 20]
    """
    ordered = sorted(set(snr_db))
    if len(ordered) <= MAX_PANELS:
        return ordered
    places = np.linspace(0, len(ordered) - 1, MAX_PANELS).round().astype(int)
    return [ordered[place] for place in places]


def draw_pareto(points: pd.DataFrame, scenario: str) -> Figure:
    """Draw mean deviation over median time of one scenario, a panel an SNR.

    Every point has both its 95 % intervals. Those on the frontier are
    joined by it, in full colour, others are pale; crosses are what failed or
    was not run in some trials, hollow marks what detected nothing in
    some. Limits are horizontal lines.

    Parameters
    ----------
    points : DataFrame
        As `isacbench.report.tables.pareto.summarise_points` returns it.
    scenario : str
        Its name.

    Returns
    -------
    Figure
        Of more than four SNRs, `shown_snrs`.
    """
    part = points[points["scenario"] == scenario]
    looks = assign_looks(
        {(name, ""): name for name in part["estimator"].unique()},
        set(part.loc[part["is_limit"], "estimator"]),
    )
    by_name = {name: look for (name, _), look in looks.items()}
    snrs_db = shown_snrs(part["snr_db"].tolist())
    figure, panels = panel_grid(
        len(snrs_db), _legend(part, by_name), f"{drawable(scenario)}: {_average(part)}", MAX_COLUMNS, PANEL_IN
    )
    is_shown = part["snr_db"].isin(snrs_db)
    for axes, snr_db in zip(panels, snrs_db, strict=True):
        axes.set_title(f"{snr_db:g} dB")
        _scale(axes, part[is_shown])
        _draw_panel(axes, part[part["snr_db"] == snr_db], by_name, _is_numbered(part))
    return figure


def draw_stages(rows: pd.DataFrame, points: pd.DataFrame, scenario: str) -> Figure | None:
    """Draw which stages take the time of the estimators on the frontier, as shares, a panel an SNR.

    Parameters
    ----------
    rows : DataFrame
        Timed rows of a run, with a column ``time_<stage>_s`` a stage.
    points : DataFrame
        As `isacbench.report.tables.pareto.summarise_points` returns it.
    scenario : str
        Its name.

    Returns
    -------
    Figure or None
        None where no stage was timed, or nothing is on a frontier.
    """
    part = points[(points["scenario"] == scenario) & points["is_on_frontier"]]
    part = part[
        part["snr_db"].isin(shown_snrs(points.loc[points["scenario"] == scenario, "snr_db"].tolist()))
    ]
    shares = _stage_shares(rows, part)
    if shares is None:
        return None
    legend = [Patch(color=_stage_colour(stage), label=stage) for stage in map(str, shares)]
    figure, panels = _bar_panels(part, legend, f"{drawable(scenario)}: share of the stages in the run time")
    for axes, (snr_db, group) in zip(panels, part.groupby("snr_db"), strict=True):
        axes.set_title(f"{snr_db:g} dB")
        _draw_bars(axes, group.sort_values("time_s"), shares)
    panels[-1].set_xlabel("share of the run time [%]")
    return figure


def _average(part: pd.DataFrame) -> str:
    """Say what a point and its bars are."""
    n_trials = int(part["n_trials"].max())
    if n_trials == 1:
        return "one trial"
    return f"mean deviation over median run time of {trials_and_band(n_trials, 'interval')}"


def _is_numbered(part: pd.DataFrame) -> bool:
    """Whether colours alone do not tell who is who."""
    return bool(part.groupby("estimator")["number"].nunique().max() > 1)


def _legend(part: pd.DataFrame, looks: Mapping[str, LineLook]) -> list[Line2D]:
    """Entries of all estimators, by number if they have one, of the frontier, and of the marks that occur."""
    entries = [
        _entry(rows, looks[str(name)], _is_numbered(part))
        for (_, name), rows in part.groupby(["number", "estimator"])
    ]
    entries.append(Line2D([], [], color=FRONTIER_COLOUR, label="Pareto frontier"))
    if part["n_no_detection"].any():
        entries.append(_mark("o", "hollow: nothing detected in some trials"))
    if not part["is_complete"].all():
        entries.append(_mark("x", "failed or missing in some trials"))
    return entries


def _entry(rows: pd.DataFrame, look: LineLook, is_numbered: bool) -> Line2D:
    """Entry of one estimator with its parameters, which says if it has no score."""
    first = rows.iloc[0]
    label = look.label
    if not look.is_bound:
        label = f"{first['number']}  " * is_numbered + drawable(first["label"])
    if rows["deviation_mean"].isna().all():
        label += ": no score"
    line = look.line if look.is_bound else ""
    return Line2D([], [], color=look.colour, marker=look.marker, linestyle=line, label=label)


def _mark(marker: str, label: str) -> Line2D:
    """Entry of a mark that any estimator can have."""
    return Line2D(
        [], [], color=FRONTIER_COLOUR, marker=marker, linestyle="", markerfacecolor="white", label=label
    )


def _scale(axes: Axes, part: pd.DataFrame) -> None:
    """Scale both axes to all points of the figure, so that panels can be compared."""
    competitors = part[~part["is_limit"]]
    times_s = competitors[["time_s", "time_low_s", "time_high_s"]].to_numpy(dtype=np.float64)
    axes.set_xscale("log")
    axes.set_xlim(*_reach(axes, "x", times_s))
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{1e3 * value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("median run time of an image [ms]")
    means = part["deviation_mean"].dropna().to_numpy(dtype=np.float64)
    if means.size and means.max() > LEAST_LOG_RATIO * means.min() > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0, 7.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylim(*_reach(axes, "y", means))
    axes.set_ylabel("imaging deviation")
    axes.grid(True)


def _reach(axes: Axes, axis: Literal["x", "y"], values: NDArray[np.float64]) -> tuple[float, float]:
    """Ends of an axis around values, with room for numbers below; intervals may reach beyond."""
    transform = axes.xaxis.get_transform() if axis == "x" else axes.yaxis.get_transform()
    shown = transform.transform(values[np.isfinite(values)])
    if not shown.size:  # nothing has a score: any scale will do
        return 0.1, 1.0
    span = np.ptp(shown) or 0.1
    low, high = transform.inverted().transform([shown.min() - ROOM[0] * span, shown.max() + ROOM[1] * span])
    return float(low), float(high)


def _draw_panel(axes: Axes, part: pd.DataFrame, looks: Mapping[str, LineLook], is_numbered: bool) -> None:
    """Draw the points of one SNR, the limits and the frontier."""
    for row in part[part["is_limit"] & part["deviation_mean"].notna()].to_dict("records"):
        look = looks[row["estimator"]]
        axes.axhline(row["deviation_mean"], color=look.colour, linestyle=look.line, linewidth=1.0)
        if math.isfinite(row["deviation_low"]):
            axes.axhspan(
                row["deviation_low"], row["deviation_high"], color=look.colour, alpha=0.1, linewidth=0
            )
    drawn = part[~part["is_limit"] & part["deviation_mean"].notna() & part["time_s"].notna()]
    for row in drawn.sort_values("is_on_frontier").to_dict("records"):
        _draw_point(axes, row, looks[row["estimator"]])
    if is_numbered:
        _write_numbers(axes, drawn)
    _draw_frontier(axes, drawn[drawn["is_on_frontier"]].sort_values("time_s"))


def _draw_point(axes: Axes, row: Mapping[Hashable, Any], look: LineLook) -> None:
    """Draw a point and its intervals."""
    time_s, deviation, wins = row["time_s"], row["deviation_mean"], row["is_on_frontier"]
    alpha = 1.0 if wins else DOMINATED_ALPHA
    # What is NaN, the interval of too few trials, is not drawn.
    axes.plot(
        [row["time_low_s"], row["time_high_s"]],
        [deviation] * 2,
        color=look.colour,
        alpha=alpha,
        linewidth=0.9,
    )
    axes.plot(
        [time_s] * 2,
        [row["deviation_low"], row["deviation_high"]],
        color=look.colour,
        alpha=alpha,
        linewidth=0.9,
    )
    axes.plot(
        [time_s],
        [deviation],
        color=look.colour,
        marker=look.marker if row["is_complete"] else "x",
        markerfacecolor="white" if row["n_no_detection"] else look.colour,
        markersize=MARKER_SIZES[0] if wins else MARKER_SIZES[1],
        alpha=alpha,
        zorder=3 if wins else 2,
    )


def _write_numbers(axes: Axes, drawn: pd.DataFrame) -> None:
    """Number the points as the legend does: all on the frontier, of the others those that have room."""
    ordered = drawn.sort_values(["is_on_frontier", "time_s"], ascending=[False, True])
    wins = ordered["is_on_frontier"].to_numpy(dtype=np.bool_)
    anchors = axes.transData.transform(ordered[["time_s", "deviation_mean"]].to_numpy(dtype=np.float64))
    anchors *= POINTS_AN_INCH / DPI
    heights = np.where(wins, *NUMBER_SIZES)
    widths = heights * (NUMBER_WIDTH * ordered["number"].astype(str).str.len() + NUMBER_SPACE)
    sizes = np.column_stack([widths, heights])
    offsets = [
        _offsets_below(size) if win else _offsets_around(size) for size, win in zip(sizes, wins, strict=True)
    ]
    frontier = np.tile(anchors[wins], 2) + np.repeat([-MARKER_SIZES[0] / 2, MARKER_SIZES[0] / 2], 2)
    places = place_labels(anchors, sizes, offsets, frontier)
    for row, offset in zip(ordered.to_dict("records"), places, strict=True):
        if offset is not None:
            _write_number(axes, row, offset)


def _offsets_below(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places left below a point of the frontier, where no other point can lie, the nearest first."""
    right, down = np.divmod(np.arange(MOST_ROWS * MOST_COLUMNS), MOST_ROWS)
    places = np.column_stack([-size[0] * (right + 0.5), -size[1] * (down + 0.5)]) - NUMBER_GAP
    ordered: NDArray[np.float64] = places[np.hypot(*places.T).argsort(kind="stable")]
    return ordered


def _offsets_around(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places in the four corners about a point."""
    corners = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)])
    return corners * (size / 2 + NUMBER_GAP / 2)


def _write_number(axes: Axes, row: Mapping[Hashable, Any], offset: NDArray[np.float64]) -> None:
    """Write the number of a point at an offset in points, tied to it where it is far."""
    wins = row["is_on_frontier"]
    text = axes.annotate(
        str(row["number"]),
        (row["time_s"], row["deviation_mean"]),
        tuple(offset),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=NUMBER_SIZES[0] if wins else NUMBER_SIZES[1],
        fontweight="bold" if wins else "normal",
        color="0.1" if wins else "0.45",
        zorder=4 if wins else 2,
        arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.5, "shrinkA": 0, "shrinkB": 3}
        if wins
        else None,
    )
    if wins:
        text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])


def _draw_frontier(axes: Axes, frontier: pd.DataFrame) -> None:
    """Draw the least error that can be had within each time."""
    if frontier.empty:
        return
    times_s, means = (frontier[name].to_numpy() for name in ("time_s", "deviation_mean"))
    x = np.concatenate([times_s[:1], times_s, axes.get_xlim()[1:]])
    y = np.concatenate([axes.get_ylim()[1:], means, means[-1:]])
    axes.step(x, y, where="post", color=FRONTIER_COLOUR, linewidth=1.2, zorder=1.5)


def _stage_shares(rows: pd.DataFrame, frontier: pd.DataFrame) -> pd.DataFrame | None:
    """Mean share in % of each stage in the run time, and of what is in none, indexed as the points are."""
    columns = [
        name for name in map("time_{}_s".format, STAGE_COLOURS) if name in rows and rows[name].notna().any()
    ]
    if not columns or frontier.empty:
        return None
    scored = rows[~failed(rows)]
    shares = 100 * scored[columns].fillna(0.0).div(scored["time_estimate_s"], axis=0)
    means = pd.concat([scored[POINT], shares], axis=1).groupby(POINT, sort=False).mean()
    found = means.loc[pd.MultiIndex.from_frame(frontier[POINT])].set_axis(frontier.index)
    found.columns = [name.removeprefix("time_").removesuffix("_s") for name in columns]
    # Medians of stages need not add up to the median of their sum.
    return found.assign(**{REST: (100 - found.sum(axis=1)).clip(lower=0.0)})


def _bar_panels(part: pd.DataFrame, legend: Sequence[Patch], title: str) -> tuple[Figure, list[Axes]]:
    """Panels below each other, each as high as its SNR has bars."""
    n_bars = part.groupby("snr_db").size().to_numpy()
    label_in = 0.3 + LETTER_IN * part["label"].str.len().max()
    width_in = label_in + BARS_IN + NOTE_IN
    legend_in = legend_height_in(width_in, [str(entry.get_label()) for entry in legend])
    gap_in, bars_in = 0.55, BAR_IN * (n_bars + 0.5)
    figure = new_figure(width_in, bars_in.sum() + gap_in * (len(n_bars) - 1) + legend_in + 1.25)
    grid = edges(figure, left=label_in, right=NOTE_IN, bottom=legend_in + 0.55, top=0.7)
    axes = figure.subplots(
        len(n_bars),
        1,
        squeeze=False,
        gridspec_kw={**grid, "height_ratios": n_bars + 0.5, "hspace": gap_in / bars_in.mean()},
    )
    entitle(figure, title)
    legend_below(figure, legend)
    return figure, list(axes.flat)


def _draw_bars(axes: Axes, group: pd.DataFrame, shares: pd.DataFrame) -> None:
    """Draw a bar for each estimator of one SNR, the fastest on top, with its time and memory beside it."""
    places = np.arange(len(group))
    left = np.zeros(len(group))
    for stage in map(str, shares):
        width = shares[stage].loc[group.index].to_numpy()
        axes.barh(places, width, left=left, height=0.7, color=_stage_colour(stage))
        left += width
    for place, row in zip(places, group.to_dict("records"), strict=True):
        axes.text(102, float(place), _cost(row), va="center", fontsize=8.0)
    axes.set_yticks(places, [drawable(label) for label in group["label"]])
    axes.set_ylim(len(group) - 0.25, -0.75)
    axes.set_xlim(0, 100)
    axes.tick_params(axis="y", length=0)


def _cost(row: Mapping[Hashable, Any]) -> str:
    """Median time, and peak memory where it was measured."""
    memory_mib = row.get(MEMORY, math.nan)
    return f"{1e3 * row['time_s']:.3g} ms" + (f", {memory_mib:.3g} MiB" if math.isfinite(memory_mib) else "")


def _stage_colour(stage: str) -> str:
    return STAGE_COLOURS.get(stage, CONTEXT)
