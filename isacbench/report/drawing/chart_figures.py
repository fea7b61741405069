"""Writer of charts: the panels of a figure, with one legend."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from isacbench.charts import NO_SCORE
from isacbench.files.checked_files import make_own_folder
from isacbench.files.escaping import shortened
from isacbench.report.drawing.style import drawable, new_figure, save, styled

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis as FigureAxis
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.charts import Axis, Chart, ChartGroup, LineStyle, Series

MARKERS = {
    "circle": "o",
    "square": "s",
    "triangle-up": "^",
    "diamond": "D",
    "triangle-down": "v",
    "pentagon": "p",
    "x": "x",
    "line-ns": "|",
    "": "",
}
LINES: dict[str, Any] = {"solid": "-", "dashdot": "-.", "dot": ":", "dash": "--", "": ""}
TEXT_COLOUR = "0.15"
MIXED_COLOUR = "0.4"
"""Of a legend entry whose series have several colours."""

MOST_TICKS = 5
LEAST_WIDTH_IN = 6.0
TITLE_LETTERS_AN_INCH = 14
LONGEST_LEGEND = 80
FEW_POINTS = 40
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def save_charts(groups: Iterable[ChartGroup], folder: Path, extension: str = "png") -> list[Path]:
    """Draw groups of charts into files of a folder, which is made; they are drawn one after the other."""
    make_own_folder(folder)
    with styled():
        return [save(draw_charts(group), folder / f"{group.stem}.{extension}") for group in groups]


def draw_charts(group: ChartGroup) -> Figure:
    """Draw a group of charts as panels of a figure, with the legend below them."""
    width_in, height_in = group.panel_in
    n_columns = min(len(group.charts), group.n_columns)
    n_rows = -(-len(group.charts) // n_columns)
    figure = new_figure(
        max(n_columns * (width_in + 0.55), LEAST_WIDTH_IN),
        n_rows * (height_in + 0.65) + 0.3,
        legend=_legend(group),
        title="\n".join(map(drawable, group.title.split("\n"))),
    )
    panels = list(figure.subplots(n_rows, n_columns, squeeze=False).flat)
    for unused in panels[len(group.charts) :]:
        unused.remove()
    for place, (panel, chart) in enumerate(zip(panels, group.charts, strict=False)):
        _draw_chart(panel, chart, int(width_in * TITLE_LETTERS_AN_INCH))
        if place % n_columns and chart.y == group.charts[place - 1].y and chart.y.categories:
            panel.set_yticklabels([])
    return figure


def _legend(group: ChartGroup) -> list[Artist]:
    """One entry a label, grey where its series have several colours."""
    by_label: dict[str, list[Series]] = {}
    for chart in group.charts:
        for series in chart.series:
            if series.label:
                by_label.setdefault(series.label, []).append(series)
    # What has a score in one of the charts has it.
    by_label = {
        label: found
        for label, found in by_label.items()
        if not label.endswith(NO_SCORE) or label.removesuffix(NO_SCORE) not in by_label
    }
    entries: list[Artist] = []
    for label, found in by_label.items():
        first, text = found[0], drawable(shortened(label, LONGEST_LEGEND))
        colour = _colour(first.style) if len({one.style.colour for one in found}) == 1 else MIXED_COLOUR
        if first.mark == "bar":
            entries.append(Patch(color=colour, label=text))
            continue
        symbols = {one.style.symbol.removesuffix("-open") for one in found if one.style.symbol != "x"}
        marker = _marker(first.style, colour)
        if len(symbols) == 1 and first.style.symbol == "x":
            marker["marker"] = MARKERS[symbols.pop()]
        line: Any = "" if first.mark == "points" else LINES[first.style.dash]
        entries.append(Line2D([], [], color=colour, linestyle=line, label=text, **marker))
    return entries


def _draw_chart(axes: Axes, chart: Chart, letters: int) -> None:
    """Draw a chart, its title broken to so many letters a line."""
    axes.set_title("\n".join(textwrap.fill(drawable(line), letters) for line in chart.title.split("\n")))
    axes.set(xlabel=chart.x.title, ylabel=drawable(chart.y.title))
    alpha = min(0.22, 0.6 / max(len(chart.series), 1))  # bands of many lines lie over each other
    n_points = sum(np.size(series.x) for series in chart.series if series.mark == "points")
    size = 6.0 if n_points <= FEW_POINTS else 3.0
    left: NDArray[np.float64] | float = 0.0
    for series in chart.series:
        x, y = (np.asarray(values, dtype=np.float64) for values in (series.x, series.y))
        if series.mark == "bar":
            axes.barh(y, x, left=left, height=0.7, color=_colour(series.style))
            left = left + x
        elif x.size:
            _draw_series(axes, series, _inside(x, chart.x), _inside(y, chart.y), chart.y, alpha, size)
    for value in chart.lines:
        axes.axhline(value, color=TEXT_COLOUR, linestyle="--", linewidth=1.0)
    _scale(axes, "x", chart.x)
    _scale(axes, "y", chart.y)
    _tick_places(axes, chart)
    axes.grid(True, axis="x" if chart.y.categories else "both")


def _draw_series(
    axes: Axes,
    series: Series,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    y_axis: Axis,
    alpha: float,
    size: float,
) -> None:
    """Draw a line in its band, points with bars, or steps."""
    colour, style = _colour(series.style), series.style
    if series.mark == "step":
        axes.step(x, y, where="post", color=colour, linestyle=LINES[style.dash], zorder=1.5)
        return
    low, high = (_inside(np.asarray(end, dtype=np.float64), y_axis, y) for end in (series.low, series.high))
    marker = _marker(style, colour)
    if series.mark == "points":
        x_low, x_high = (np.asarray(end, dtype=np.float64) for end in (series.x_low, series.x_high))
        bars: dict[str, Any] = {}
        if x_low.size:
            bars["xerr"] = [x - x_low, x_high - x]
        if low.size:
            bars["yerr"] = [y - low, high - y]
        axes.errorbar(x, y, **bars, color=colour, linestyle="", elinewidth=1.2, markersize=size, **marker)
    elif np.isfinite(x).sum() == 1:
        marker["marker"] = marker["marker"] or "_"
        axes.plot(x, y, color=colour, linestyle="", **marker)
        if low.size:
            axes.vlines(x, low, high, color=colour, alpha=0.4, linewidth=3)
    else:
        axes.plot(x, y, color=colour, linestyle=LINES[style.dash], **marker)
        if low.size:
            axes.fill_between(x, low, high, color=colour, alpha=alpha, linewidth=0.0)
    for text, place in zip(series.texts, zip(x, y, strict=True), strict=False):
        if np.isfinite(place).all():
            offset: dict[str, Any] = {"xytext": (0, 4), "textcoords": "offset points"}
            axes.annotate(text, place, color=colour, ha="center", fontsize=6.0, **offset)


def _inside(
    values: NDArray[np.float64], axis: Axis, instead: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Clip values to the ends of an axis; on a logarithmic one without, what is not positive is not drawn.

    An end of an interval that is not positive there is a tenth of the value `instead`.
    """
    if axis.limits is not None:
        return np.clip(values, *axis.limits)
    if axis.log and values.size:
        return np.where(values > 0, values, np.nan if instead is None else instead / 10)
    return values


def _scale(axes: Axes, name: str, axis: Axis) -> None:
    own: FigureAxis = getattr(axes, f"{name}axis")
    if axis.log:
        axes.set(**{f"{name}scale": "log"})
    if axis.limits is not None:
        low, high = axis.limits
        axes.set(**{f"{name}lim": (0.9 * low, 1.1 * high) if axis.log else (low, high)})
    if axis.log:
        low, high = sorted(own.get_view_interval())
        if high < 300 * low:
            own.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        own.set_major_formatter(FuncFormatter(_plain_number))
        own.set_minor_formatter(NullFormatter())
    if axis.categories:
        own.set_ticks(range(len(axis.categories)), [drawable(text) for text in axis.categories])
        axes.set(**{f"{name}lim": (len(axis.categories) - 0.4, -0.6)})


def _tick_places(axes: Axes, chart: Chart) -> None:
    """Put ticks at the places of the points, where these are few."""
    places = np.unique([x for one in chart.series if one.mark == "line" for x in np.asarray(one.x).tolist()])
    is_even = places.size and np.array_equal(places, np.round(places, 6))
    if 1 < places.size <= MOST_TICKS and is_even:
        axes.set_xticks(places, minor=False)
        if chart.x.log:
            axes.xaxis.set_major_formatter(FuncFormatter(_plain_number))


def _plain_number(value: float, _: int | None = None) -> str:
    """Write a number; far from 1 a power of ten with Unicode superscripts, faster than mathematical text.

    Examples
    --------
    >>> _plain_number(0.02), _plain_number(1e-5)
    ('0.02', '10⁻⁵')
    """
    if 1e-3 <= abs(value) < 1e5 or value <= 0:
        return f"{value:g}"
    exponent = round(float(np.log10(value)))
    factor = value / 10.0**exponent
    power = "10" + f"{exponent}".translate(SUPERSCRIPTS)
    return power if abs(factor - 1) < 1e-6 else f"{factor:.2g}·{power}"


def _colour(style: LineStyle) -> str:
    return style.colour or TEXT_COLOUR


def _marker(style: LineStyle, colour: str) -> dict[str, Any]:
    symbol = style.symbol.removesuffix("-open")
    face = "white" if style.symbol.endswith("-open") else colour
    return {"marker": MARKERS[symbol], "markerfacecolor": face, "markeredgewidth": 0.8}
