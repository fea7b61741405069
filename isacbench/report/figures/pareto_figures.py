"""Figures of a timed run: Hausdorff sum over run time with the Pareto frontier, and shares of the stages."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

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
    new_figure,
)
from isacbench.report.tables.pareto import MEMORY, POINT
from isacbench.report.tables.run_tables import trials_and_band

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.bench.plan.labels import Variant
    from isacbench.report.drawing.style import LineLook

MAX_PANELS = 4
MAX_COLUMNS = 2
PANEL_IN = 4.6, 3.6

FRONTIER_COLOUR = "0.45"
DOMINATED_ALPHA = 0.4
MARKER_SIZES = {True: 6.0, False: 4.0}
"""Sizes of marks on the frontier and elsewhere, in points."""

LEAST_LOG_RATIO = 2.5
"""Errors that span less are drawn on a linear axis."""

NUMBER_STYLES: dict[bool, dict[str, Any]] = {
    True: {
        "fontsize": 9.0,
        "fontweight": "bold",
        "color": "0.1",
        "zorder": 4,
        "path_effects": [withStroke(linewidth=2.0, foreground="white")],
        "arrowprops": {"arrowstyle": "-", "color": "0.6", "linewidth": 0.5, "shrinkA": 0, "shrinkB": 3},
    },
    False: {"fontsize": 5.5, "color": "0.45", "zorder": 2},
}
"""Styles of numbers on the frontier and elsewhere; a line ties those on the frontier to their points."""

NUMBER_WIDTH, NUMBER_SPACE = 0.7, 0.3
"""Width of a digit, and space between numbers, over the font size."""

NUMBER_GAP = 4.0
"""Distance between a point and its number, in points."""

MOST_ROWS, MOST_COLUMNS = 3, 12
"""Rows and columns of places for a number of the frontier."""

REST = "none of these"
STAGE_COLOURS: dict[str, str] = {**dict(zip(STAGES, COLOURS, strict=True)), REST: CONTEXT}
BAR_IN, BARS_IN, NOTE_IN, LETTER_IN = 0.24, 4.5, 1.8, 0.068
"""Height of a bar, width of the bars, and widths of the note and of a letter of a label, in inches."""


def shown_snrs(snr_db: Sequence[float]) -> list[float]:
    """Choose the SNRs that have a panel: all up to four; of more the lowest, the highest and two between.

    Parameters
    ----------
    snr_db : sequence of float
        SNRs in dB, possibly repeated.

    Returns
    -------
    list of float
        In ascending order.

    Examples
    --------
    >>> shown_snrs([-30, -20, -10, 0, 10, 20])
    [-30, -10, 0, 20]
    """
    ordered = sorted(set(snr_db))
    places = np.linspace(0, len(ordered) - 1, min(MAX_PANELS, len(ordered))).round().astype(int)
    return [ordered[place] for place in places]


def draw_pareto(points: pd.DataFrame, scenario: str) -> Figure:
    """Draw mean Hausdorff sum over median time of one scenario, a panel an SNR.

    Every point has both its 95 % intervals. Points on the frontier have full
    colour, others are pale. Crosses failed or were not run in some trials;
    hollow marks detected nothing in some. Limits are horizontal lines.

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
    # No point at all takes no time, and its error would be most of the axis.
    part = points[(points["scenario"] == scenario) & (points["estimator"] != "empty")]
    labels = {_look_key(row): row["label"] if row["is_limit"] else row["estimator"] for row in _rows(part)}
    looks = assign_looks(labels, set(part.loc[part["is_limit"], "estimator"]))
    is_numbered = bool(part.groupby("estimator")["number"].nunique().max() > 1)
    snrs_db = shown_snrs(part["snr_db"].tolist())
    legend, title = _legend(part, looks, is_numbered), f"{drawable(scenario)}: {_average(part)}"
    n_columns = 3 if len(snrs_db) == 3 else MAX_COLUMNS
    figure, panels = panel_grid(len(snrs_db), legend, title, n_columns, PANEL_IN)
    for axes in panels[1:]:
        axes.sharex(panels[0])
        axes.sharey(panels[0])
    _scale(panels[0], part["hausdorff_sum_m_mean"].dropna())
    at_snr = {snr_db: part[part["snr_db"] == snr_db] for snr_db in snrs_db}
    for axes, (snr_db, rows) in zip(panels, at_snr.items(), strict=True):
        axes.set_title(f"{snr_db:g} dB")
        axes.set(xlabel="median processor time of an image [ms]", ylabel="Hausdorff sum [m]")
        axes.grid(True)
        _draw_points(axes, rows, looks)
    # Numbers and the end of the frontier take their places from the layout, which stays as it is.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes, rows in zip(panels, at_snr.values(), strict=True):
        drawn = _competitors(rows)
        if is_numbered:
            _write_numbers(axes, drawn)
        _draw_frontier(axes, drawn[drawn["is_on_frontier"]].sort_values("time_s"))
    return figure


def draw_stages(rows: pd.DataFrame, points: pd.DataFrame, scenario: str) -> Figure | None:
    """Draw the shares of the stages in the run time of the estimators on the frontier, a panel an SNR.

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
    legend = [Patch(color=STAGE_COLOURS[stage], label=stage) for stage in map(str, shares)]
    title = f"{drawable(scenario)}: share of the stages in the processor time"
    n_bars = part.groupby("snr_db").size().to_numpy()
    size_in = (
        BARS_IN + NOTE_IN + LETTER_IN * part["label"].str.len().max(),
        (BAR_IN * (n_bars + 0.5) + 0.5).sum() + 0.5,
    )
    figure = new_figure(*size_in, legend=legend, title=title)
    panels = figure.subplots(len(n_bars), 1, squeeze=False, gridspec_kw={"height_ratios": n_bars + 0.5})[:, 0]
    for axes, (snr_db, group) in zip(panels, part.groupby("snr_db"), strict=True):
        axes.set_title(f"{snr_db:g} dB")
        _draw_bars(axes, group.sort_values("time_s"), shares)
    panels[-1].set_xlabel("share of the processor time [%]")
    return figure


def _average(part: pd.DataFrame) -> str:
    """Describe a point and its bars."""
    n_trials = int(part["n_trials"].max())
    if n_trials == 1:
        return "one trial"
    return f"mean Hausdorff sum over median processor time of {trials_and_band(n_trials, 'interval')}"


def _legend(part: pd.DataFrame, looks: Mapping[Variant, LineLook], is_numbered: bool) -> list[Line2D]:
    """Make entries of all estimators, by number if they have one, of the frontier, and of the marks."""
    entries = [
        _entry(rows, looks[_look_key(rows.iloc[0])], is_numbered) for _, rows in part.groupby("number")
    ]
    entries.append(Line2D([], [], color=FRONTIER_COLOUR, label="Pareto frontier"))
    mark: dict[str, Any] = {"color": FRONTIER_COLOUR, "linestyle": "", "markerfacecolor": "white"}
    if part["n_no_detection"].any():
        label = "hollow: nothing detected in some trials"
        entries.append(Line2D([], [], marker="o", label=label, **mark))
    if not part["is_complete"].all():
        entries.append(Line2D([], [], marker="x", label="failed or missing in some trials", **mark))
    return entries


def _entry(rows: pd.DataFrame, look: LineLook, is_numbered: bool) -> Line2D:
    """Make the entry of one estimator with its parameters, which says if it has no score."""
    first = rows.iloc[0]
    label = look.label
    if not look.is_bound:
        label = f"{first['number']}  " * is_numbered + drawable(first["label"])
    if rows["hausdorff_sum_m_mean"].isna().all():
        label += ": no score"
    line = look.line if look.is_bound else ""
    return Line2D([], [], color=look.colour, marker=look.marker, linestyle=line, label=label)


def _scale(axes: Axes, means: pd.Series[float]) -> None:
    """Scale the axes that all panels share, so that panels can be compared."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    if means.size and means.max() > LEAST_LOG_RATIO * means.min() > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0, 7.0)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_locator(NullLocator())
    axes.margins(0.08, 0.12)


def _competitors(part: pd.DataFrame) -> pd.DataFrame:
    """Select the points that are drawn: all but limits and what has no score or no time."""
    return part[~part["is_limit"] & part["hausdorff_sum_m_mean"].notna() & part["time_s"].notna()]


def _draw_points(axes: Axes, part: pd.DataFrame, looks: Mapping[Variant, LineLook]) -> None:
    """Draw the limits and the points of one SNR."""
    for row in _rows(part[part["is_limit"] & part["hausdorff_sum_m_mean"].notna()]):
        look = looks[_look_key(row)]
        axes.axhline(row["hausdorff_sum_m_mean"], color=look.colour, linestyle=look.line, linewidth=1.0)
        if math.isfinite(row["hausdorff_sum_m_low"]):
            band = row["hausdorff_sum_m_low"], row["hausdorff_sum_m_high"]
            axes.axhspan(*band, color=look.colour, alpha=0.1, linewidth=0)
    for row in _rows(_competitors(part)):
        _draw_point(axes, row, looks[_look_key(row)])


def _rows(part: pd.DataFrame) -> list[dict[Hashable, Any]]:
    return part.to_dict("records")


def _look_key(row: Mapping[Hashable, Any] | pd.Series[Any]) -> Variant:
    """Key of the look of a point: limits differ by parameters, others share the look of their estimator."""
    return row["estimator"], row["params"] if row["is_limit"] else ""


def _draw_point(axes: Axes, row: Mapping[Hashable, Any], look: LineLook) -> None:
    """Draw a point and its intervals; the NaN interval of too few trials is not drawn."""
    time_s, error, wins = row["time_s"], row["hausdorff_sum_m_mean"], row["is_on_frontier"]
    # A point alone, of equal times, has a scale, too.
    axes.update_datalim([(0.8e3 * time_s, error), (1.25e3 * time_s, error)])
    axes.errorbar(
        1e3 * time_s,
        error,
        xerr=[[1e3 * (time_s - row["time_low_s"])], [1e3 * (row["time_high_s"] - time_s)]],
        yerr=[[error - row["hausdorff_sum_m_low"]], [row["hausdorff_sum_m_high"] - error]],
        color=look.colour,
        elinewidth=0.9,
        marker=look.marker if row["is_complete"] else "x",
        markerfacecolor="white" if row["n_no_detection"] else look.colour,
        markersize=MARKER_SIZES[wins],
        alpha=1.0 if wins else DOMINATED_ALPHA,
        zorder=3 if wins else 2,
    )


def _write_numbers(axes: Axes, drawn: pd.DataFrame) -> None:
    """Number the points as the legend does: all on the frontier, of the others those that have room."""
    ordered = drawn.sort_values(["is_on_frontier", "time_s"], ascending=[False, True])
    wins = ordered["is_on_frontier"].to_numpy(dtype=np.bool_)
    points = np.column_stack([1e3 * ordered["time_s"], ordered["hausdorff_sum_m_mean"]])
    anchors = axes.transData.transform(points) * 72 / DPI
    heights = np.array([NUMBER_STYLES[win]["fontsize"] for win in wins.tolist()])
    widths = heights * (NUMBER_WIDTH * ordered["number"].astype(str).str.len() + NUMBER_SPACE)
    sizes = np.column_stack([widths, heights])
    offsets = [
        _offsets_below(size) if win else _offsets_around(size) for size, win in zip(sizes, wins, strict=True)
    ]
    frontier = np.tile(anchors[wins], 2) + np.repeat([-MARKER_SIZES[True] / 2, MARKER_SIZES[True] / 2], 2)
    places = place_labels(anchors, sizes, offsets, frontier)
    for number, win, point, place in zip(ordered["number"], wins.tolist(), points, places, strict=True):
        if place is not None:
            style = {"textcoords": "offset points", "ha": "center", "va": "center", **NUMBER_STYLES[win]}
            axes.annotate(str(number), tuple(point), tuple(place), **style)


def _offsets_below(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """List places left below a point of the frontier, where no other point can lie, the nearest first."""
    right, down = np.divmod(np.arange(MOST_ROWS * MOST_COLUMNS), MOST_ROWS)
    places = np.column_stack([-size[0] * (right + 0.5), -size[1] * (down + 0.5)]) - NUMBER_GAP
    ordered: NDArray[np.float64] = places[np.hypot(*places.T).argsort(kind="stable")]
    return ordered


def _offsets_around(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """List places in the four corners about a point."""
    corners = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)])
    return corners * (size / 2 + NUMBER_GAP / 2)


def _draw_frontier(axes: Axes, frontier: pd.DataFrame) -> None:
    """Draw the least error that can be had within each time, in the present limits of the axes."""
    if frontier.empty:
        return
    axes.autoscale(False)
    times_ms, means = 1e3 * frontier["time_s"].to_numpy(), frontier["hausdorff_sum_m_mean"].to_numpy()
    x = np.concatenate([times_ms[:1], times_ms, axes.get_xlim()[1:]])
    y = np.concatenate([axes.get_ylim()[1:], means, means[-1:]])
    axes.step(x, y, where="post", color=FRONTIER_COLOUR, linewidth=1.2, zorder=1.5)


def _stage_shares(rows: pd.DataFrame, frontier: pd.DataFrame) -> pd.DataFrame | None:
    """Compute mean shares in % of the stages and of the rest in the run time, indexed as the points are."""
    columns = [name for name in map("time_{}_s".format, STAGES) if name in rows and rows[name].notna().any()]
    if not columns or frontier.empty:
        return None
    scored = rows[~failed(rows)]
    shares = 100 * scored[columns].fillna(0.0).div(scored["time_estimate_s"], axis=0)
    means = pd.concat([scored[POINT], shares], axis=1).groupby(POINT, sort=False).mean()
    found = means.loc[pd.MultiIndex.from_frame(frontier[POINT])].set_axis(frontier.index)
    found.columns = [name.removeprefix("time_").removesuffix("_s") for name in columns]
    # Medians of stages need not add up to the median of their sum.
    return found.assign(**{REST: (100 - found.sum(axis=1)).clip(lower=0.0)})


def _draw_bars(axes: Axes, group: pd.DataFrame, shares: pd.DataFrame) -> None:
    """Draw a bar for each estimator of one SNR, the fastest on top, and its time and memory."""
    places = np.arange(len(group))
    left = np.zeros(len(group))
    for stage in map(str, shares):
        width = shares[stage].loc[group.index].to_numpy()
        axes.barh(places, width, left=left, height=0.7, color=STAGE_COLOURS[stage])
        left += width
    for place, row in zip(places, group.to_dict("records"), strict=True):
        axes.text(102, float(place), _cost(row), va="center", fontsize=8.0)
    axes.set_yticks(places, [drawable(label) for label in group["label"]])
    axes.set_ylim(len(group) - 0.25, -0.75)
    axes.set_xlim(0, 100)
    axes.tick_params(axis="y", length=0)


def _cost(row: Mapping[Hashable, Any]) -> str:
    """Write the median time, and the peak memory where it was measured."""
    memory_mib = row.get(MEMORY, math.nan)
    return f"{1e3 * row['time_s']:.3g} ms" + (f", {memory_mib:.3g} MiB" if math.isfinite(memory_mib) else "")
