"""Figures: their style, and charts as panels of a figure with one legend."""

import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import matplotlib.axis
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from isacbench.bench.store.run_folder import atomic_write
from isacbench.charts import NO_SCORE, Axis, Chart, ChartGroup, LineStyle, Series
from isacbench.files.checked_files import make_own_folder, require_picture
from isacbench.files.escaping import shortened
from isacbench.report.drawing import DrawingProcess

Floats = NDArray[np.float64]

Drawing = tuple[str, Callable[[], Figure]]
"""Stem of the file of a figure, and what draws it, here or in another process."""

FOLDER = "figures"
"""Folder of the figures in that of a run."""

DPI = 150
FONT = "DejaVu Sans"
ROW_IN = 0.175
"""Height of a row of a legend."""

THRESHOLD = "#D55E00"
"""Colour of thresholds."""

RC = {
    "font.family": FONT,
    "font.size": 9.0,
    "axes.titlesize": "medium",
    "xtick.labelsize": "small",
    "ytick.labelsize": "small",
    "legend.fontsize": "small",
    "grid.color": "0.88",
    "axes.axisbelow": True,
    "lines.markersize": 4.0,
}


def styled() -> AbstractContextManager[None]:
    """Return a context with the fonts and sizes of this module; it restores the user's own settings."""
    style: dict[Any, Any] = {**matplotlib.rcParamsDefault, **RC}
    del style["backend"]  # which is the caller's
    return matplotlib.rc_context(style)  # `matplotlib.style` reads all styles that there are


def new_figure(
    width_in: float,
    height_in: float,
    *,
    legend: Sequence[Artist] = (),
    title: str = "",
    layout: Literal["constrained"] | None = "constrained",
) -> Figure:
    """Make a figure on a canvas that needs no display, of a size without the legend below the panels.

    A layout of None leaves the margins to the caller.
    """
    column_in = 0.55 + 0.06 * max((len(str(entry.get_label())) for entry in legend), default=0)
    n_rows = math.ceil(len(legend) / max(1, int(width_in / column_in)))
    height_in += ROW_IN * (n_rows + 1) if legend else 0.0
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout=layout)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, wrap=True)
    if legend:
        n_columns = math.ceil(len(legend) / n_rows)
        figure.legend(handles=list(legend), loc="outside lower center", ncols=n_columns, frameon=False)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a figure, or replace an older one, in the format that the suffix names; return the path."""
    with atomic_write(path, afterwards="") as temporary:
        if path.suffix.lower() == ".png":
            canvas: Any = FigureCanvasAgg(figure)
            canvas.print_png(temporary, pil_kwargs={"compress_level": 3})  # `savefig` draws twice
        else:
            figure.savefig(temporary, format=path.suffix.removeprefix(".").lower())
    return path


def drawable(text: str) -> str:
    r"""Escape a name for matplotlib: dollar signs as text, a replacement for characters that the font lacks.

    Examples
    --------
    >>> drawable("a\n$b$")
    'a�\\$b\\$'
    """
    font = get_font(findfont(FontProperties(family=[FONT])))
    characters = [
        char if char.isprintable() and font.get_char_index(ord(char)) else "\ufffd" for char in text
    ]
    return "".join(characters).replace("$", r"\$")


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

LEAST_WIDTH_IN = 6.0
TITLE_LETTERS_AN_INCH = 14
LINE_IN, LETTER_IN = 0.16, 0.068
"""Height of a line of text, and width of a letter at a tick."""

LEFT_IN, RIGHT_IN, BELOW_IN, ABOVE_IN = 0.25, 0.22, 0.27, 0.1
"""Room around a panel, without the letters of its ticks and the lines of its titles."""

LONGEST_LEGEND = 80


def save_figures(
    drawings: Iterable[Drawing], folder: Path, extension: str = "png", helper: DrawingProcess | None = None
) -> list[Path]:
    """Draw figures and save them into a folder, which is made; a process that helps draws some of them."""
    require_picture(Path(f"figure.{extension}"))
    make_own_folder(folder)
    calls = [(draw, folder / f"{stem}.{extension}") for stem, draw in drawings]
    if helper is None:
        for draw, path in calls:
            draw_and_save(draw, path)
    else:
        helper.share(draw_and_save, calls)
    return [path for _, path in calls]


def draw_and_save(draw: Callable[[], Figure], path: Path) -> None:
    """Draw a figure in the style of this module, and save it."""
    with styled():
        save(draw(), path)


def drawings_of(groups: Iterable[ChartGroup]) -> Iterator[Drawing]:
    """Drawings of groups of charts."""
    return ((group.stem, partial(draw_charts, group)) for group in groups)


def draw_charts(group: ChartGroup) -> Figure:
    """Draw a group of charts as panels of a figure, with the legend below them."""
    width_in, height_in = group.panel_in
    n_columns = min(len(group.charts), group.n_columns)
    n_rows = -(-len(group.charts) // n_columns)
    size_in = max(n_columns * (width_in + 0.55), LEAST_WIDTH_IN), n_rows * (height_in + 0.65) + 0.3
    figure = new_figure(*size_in, legend=_legend(group), layout=None)
    title = "\n".join(map(drawable, group.title.split("\n")))
    heading = figure.suptitle(title, y=1 - LINE_IN / 3 / figure.get_figheight(), wrap=True)
    panels: dict[tuple[int, int], Axes] = {}
    for place, chart in enumerate(group.charts):
        if not chart.series:
            continue
        panel = panels[divmod(place, n_columns)] = figure.add_subplot(n_rows, n_columns, place + 1)
        _draw_chart(panel, chart, int(width_in * TITLE_LETTERS_AN_INCH))
        if place % n_columns and chart.y == group.charts[place - 1].y and chart.y.categories:
            panel.set_yticklabels([])
    top_in = LINE_IN / 2 + heading.get_window_extent().height / DPI
    _lay_out(figure, panels, (n_rows, n_columns), (top_in, figure.get_figheight() - size_in[1]))
    return figure


def _lay_out(
    figure: Figure,
    panels: Mapping[tuple[int, int], Axes],
    shape: tuple[int, int],
    margins_in: tuple[float, float],
) -> None:
    """Place panels of one size by the letters around them, which takes longer to measure than to draw."""
    (n_rows, n_columns), (top_in, bottom_in), size_in = shape, margins_in, figure.get_size_inches()
    left_in, above_in, below_in = np.zeros(n_columns), np.zeros(n_rows), np.zeros(n_rows)
    for (row, column), panel in panels.items():
        low, high = sorted(panel.get_ylim())
        shown = [tick for tick in panel.yaxis.get_majorticklocs() if low <= tick <= high]
        letters = max(map(len, panel.yaxis.get_major_formatter().format_ticks(shown)), default=0)
        width_in = LEFT_IN + LETTER_IN * letters + LINE_IN * _n_lines(panel.get_ylabel())
        left_in[column] = max(left_in[column], width_in)
        above_in[row] = max(above_in[row], ABOVE_IN + LINE_IN * _n_lines(panel.get_title()))
        below_in[row] = max(below_in[row], BELOW_IN + LINE_IN * _n_lines(panel.get_xlabel()))
    width_in = (size_in[0] - left_in.sum()) / n_columns - RIGHT_IN
    height_in = (size_in[1] - bottom_in - top_in - above_in.sum() - below_in.sum()) / n_rows
    for (row, column), panel in panels.items():
        x_in = left_in[: column + 1].sum() + column * (width_in + RIGHT_IN)
        y_in = size_in[1] - top_in - above_in[: row + 1].sum() - below_in[:row].sum() - (row + 1) * height_in
        place = np.array([x_in, y_in, width_in, height_in]) / [*size_in, *size_in]
        panel.set_position(place.tolist())
        # Labels without a place of their own have all ticks measured.
        panel.xaxis.set_label_coords(0.5, -BELOW_IN / height_in)
        label_in = left_in[column] - 0.4 * LEFT_IN - LINE_IN * _n_lines(panel.get_ylabel())
        panel.yaxis.set_label_coords(-label_in / width_in, 0.5)


def _n_lines(text: str) -> int:
    return text.count("\n") + 1 if text else 0


def _legend(group: ChartGroup) -> list[Artist]:
    """One entry a label, grey where its series have several colours."""
    by_label: dict[str, list[Series]] = {}
    for series in (series for chart in group.charts for series in chart.series if series.label):
        by_label.setdefault(series.label, []).append(series)
    entries: list[Artist] = []
    for label, own in by_label.items():
        if label.endswith(NO_SCORE) and label.removesuffix(NO_SCORE) in by_label:
            continue  # what has a score in one of the charts has it
        # A closed symbol stands for all, where some points have an open one.
        first = min(own, key=lambda one: one.style.symbol.endswith("-open"))
        text = drawable(shortened(label, LONGEST_LEGEND))
        colour = _colour(first.style) if len({one.style.colour for one in own}) == 1 else MIXED_COLOUR
        if first.mark == "bar":
            entries.append(Patch(color=colour, label=text))
        else:
            line: Any = "" if first.mark == "points" else LINES[first.style.dash]
            entries.append(Line2D([], [], linestyle=line, label=text, **_marker(first.style, colour)))
    return entries


def _draw_chart(axes: Axes, chart: Chart, letters: int) -> None:
    """Draw a chart, its title broken to so many letters a line."""
    title = "\n".join(textwrap.fill(drawable(line), letters) for line in chart.title.split("\n"))
    axes.set_title(title, y=1.0)  # without y all ticks are measured
    axes.set(xlabel=chart.x.title, ylabel=drawable(chart.y.title))
    left: Floats | float = 0.0
    for series in chart.series:
        x, y = (np.asarray(values, dtype=np.float64) for values in (series.x, series.y))
        if series.mark == "bar":
            axes.barh(y, x, left=left, height=0.7, color=_colour(series.style))
            left = left + x
        elif x.size:
            _draw_series(axes, series, _inside(x, chart.x), _inside(y, chart.y), chart.y)
    for value in chart.lines:
        axes.axhline(value, color=TEXT_COLOUR, linestyle="--", linewidth=1.0)
    _scale(axes, "x", chart.x)
    _scale(axes, "y", chart.y)
    if ticks := {one.tick for one in chart.series if one.tick is not None}:
        axes.set_xticks(sorted(ticks))
    axes.grid(True, axis="x" if chart.y.categories else "both")


def _draw_series(axes: Axes, series: Series, x: Floats, y: Floats, y_axis: Axis) -> None:
    """Draw a line in its band, points with bars, or steps; a line of a single place is a point."""
    marker, dash = _marker(series.style, _colour(series.style)), LINES[series.style.dash]
    low, high = (_inside(np.asarray(end, dtype=np.float64), y_axis, y) for end in (series.low, series.high))
    if series.mark == "step":
        axes.step(x, y, where="post", color=marker["color"], linestyle=dash)
    elif series.mark == "points" or np.isfinite(x).sum() == 1:
        x_low, x_high = (np.asarray(end, dtype=np.float64) for end in (series.x_low, series.x_high))
        x_bars = [x - x_low, x_high - x] if x_low.size else None
        y_bars = [y - low, high - y] if low.size else None
        marker["marker"] = marker["marker"] or "_"
        axes.errorbar(x, y, y_bars, x_bars, linestyle="", **marker)
    else:
        axes.plot(x, y, linestyle=dash, **marker)
        if low.size:
            axes.fill_between(x, low, high, color=marker["color"], alpha=0.15, linewidth=0.0)


def _inside(values: Floats, axis: Axis, instead: Floats | None = None) -> Floats:
    """Clip values to the ends of an axis; on a logarithmic one without, what is not positive is not drawn.

    An end of an interval that is not positive there is a tenth of the value `instead`.
    """
    if axis.limits is not None:
        return np.clip(values, *axis.limits)
    if axis.log and values.size:
        return np.where(values <= 0, np.nan if instead is None else instead / 10, values)
    return values


def _scale(axes: Axes, name: str, axis: Axis) -> None:
    own: matplotlib.axis.Axis = getattr(axes, f"{name}axis")
    if axis.log:
        axes.set(**{f"{name}scale": "log"})
    if axis.limits is not None:
        low, high = axis.limits
        axes.set(**{f"{name}lim": (0.9 * low, 1.1 * high) if axis.log else (low, high)})
    if axis.log:
        low, high = sorted(own.get_view_interval())
        if high < 300 * low:
            own.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        own.set_major_formatter("{x:g}")  # faster than mathematical text
        own.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        own.set_minor_formatter(NullFormatter())
    if axis.categories:
        own.set_ticks(range(len(axis.categories)), [drawable(text) for text in axis.categories])
        axes.set(**{f"{name}lim": (len(axis.categories) - 0.4, -0.6)})


def _colour(style: LineStyle) -> str:
    return style.colour or TEXT_COLOUR


def _marker(style: LineStyle, colour: str) -> dict[str, Any]:
    symbol = style.symbol.removesuffix("-open")
    face = "white" if style.symbol.endswith("-open") else colour
    return {"color": colour, "marker": MARKERS[symbol], "markerfacecolor": face}
