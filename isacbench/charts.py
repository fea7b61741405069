"""Charts and tables as data: what kinds of suites, comparisons and rankings give, and writers lay out."""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

Item = TypeVar("Item")

Variant = tuple[str, str]
"""Name and canonical parameters of an estimator."""

SNR_COLUMNS = "snr_db", "snr_gain_db"
"""Columns in dB: of a single SNR, estimators are drawn side by side."""

VARIANT = ["estimator", "params"]
"""Columns that have them."""

# Okabe and Ito's palette without its yellow, too pale for a line, and four of Paul Tol's muted colours.
OKABE_ITO = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
MUTED = "#882255", "#44AA99", "#999933", "#332288"
COLOURS = *OKABE_ITO, *MUTED
DASHES = "solid", "dashdot", "dot"
SYMBOLS = "circle", "square", "triangle-up", "diamond", "triangle-down", "pentagon"
REFERENCE_DASHES = "dash", "dot", "dashdot", "solid"
SHADES = 0.0, 0.35, -0.35
"""Shares of white, or negative of black, in the colours of variants of one estimator."""

ESTIMATORS = (
    *("fft4d", "music2d", "esprit2d", "nomp4d", "sbl4d"),
    *("music2d_joint", "omp4d", "iaa2d", "capon2d", "bartlett2d"),
)
DETECTORS = "osca", "ca", "os", "tm", "goca", "soca", "fixed"
PLACES = {name: number for names in (ESTIMATORS, DETECTORS) for number, name in enumerate(names)}
"""Places in `COLOURS` of estimators and detectors that are often shown together."""

ROLES = {"oracle": "truth merged in cells", "chance": "zero skill", "empty": "no point"}
"""Meaning of the built-in references in legends."""

NO_SCORE = ": no score"
"""End of the label of a series that has none."""

LONGEST_LABEL = 34
SHARE_LIMITS = -0.03, 1.03
"""Ends of an axis of shares and probabilities."""

LARGEST_BAND = 1.5
"""Largest upper end of a linear axis that shows bands, as a multiple of the largest mean."""


@dataclass(frozen=True)
class LineStyle:
    """Colour, dash and symbol of a series, as plotly names them.

    Attributes
    ----------
    colour : str
        Empty: that of text.
    dash : {"solid", "dash", "dot", "dashdot", ""}
        Empty: no line.
    symbol : str
        Empty: none. ``-open`` at the end: not filled.
    """

    colour: str = ""
    dash: str = "solid"
    symbol: str = "circle"


@dataclass(frozen=True)
class Series:
    """Line, points, steps or bars of a chart.

    Attributes
    ----------
    label : str
        In the legend; empty: not there.
    x, y : array_like, shape (n,)
        NaN is not drawn.
    low, high, x_low, x_high : array_like, shape (n,)
        Ends of intervals, or empty. Of a line a band, of points bars.
    mark : {"line", "points", "step", "bar"}
        Bars lie, and those of several series stand in a row.
    style : LineStyle
    tick : float or None
        Place on the x axis that the points stand for, where those of several series stand side by side.
    """

    label: str
    x: ArrayLike
    y: ArrayLike
    low: ArrayLike = ()
    high: ArrayLike = ()
    x_low: ArrayLike = ()
    x_high: ArrayLike = ()
    mark: Literal["line", "points", "step", "bar"] = "line"
    style: LineStyle = LineStyle()
    tick: float | None = None


@dataclass(frozen=True)
class Axis:
    """Axis of a chart.

    Attributes
    ----------
    title : str
    log : bool
    limits : (float, float) or None
        What lies beyond is drawn at the edge.
    categories : sequence of str
        Names of the places 0, 1, ...
    """

    title: str
    log: bool = False
    limits: tuple[float, float] | None = None
    categories: Sequence[str] = ()


@dataclass(frozen=True)
class Chart:
    """Chart: series on two axes, and lines across at values of y. Without series it is a gap in a figure."""

    title: str
    x: Axis
    y: Axis
    series: Sequence[Series]
    lines: Sequence[float] = ()


@dataclass(frozen=True)
class ChartGroup:
    """Charts that belong together: panels of one figure with one legend.

    Attributes
    ----------
    stem : str
        Of the file of the figure.
    title : str
    charts : sequence of Chart
    n_columns : int
        Most panels in a row.
    panel_in : (float, float)
        Width and height of a panel in inches.
    """

    stem: str
    title: str
    charts: Sequence[Chart]
    n_columns: int = 4
    panel_in: tuple[float, float] = (2.75, 2.3)


@dataclass(frozen=True)
class Column:
    """Column of a table.

    Attributes
    ----------
    heading : str
        Words after a colon, and units in brackets, stand below in a terminal.
    key : hashable
        Column of the rows. None: the whole row.
    form : str or callable
        Format of a value, or function from it to text. NaN and None are left empty.
    scale : float
        Factor of a number that is formatted.
    optional : int
        0: always shown. A terminal without room leaves out those of the largest number first.
    part : int
        Columns of part 0 name the row. A terminal without room shows the other parts one below the other.
    """

    heading: str
    key: Hashable = None
    form: str | Callable[[Any], str] = "{}"
    scale: float = 1.0
    optional: int = 0
    part: int = 1

    def text(self, row: Mapping[Any, Any]) -> str:
        """Text of a row."""
        value: Any = row if self.key is None else row.get(self.key)
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return ""
        if isinstance(value, str):  # such as a heading in the place of a number
            return value
        if callable(self.form):
            return self.form(value)
        return self.form.format(value if self.scale == 1.0 else self.scale * value)


@dataclass(frozen=True)
class Table:
    """Table: columns of rows.

    Attributes
    ----------
    title : str
    columns : sequence of Column
    rows : DataFrame or sequence of mapping
    is_detail : bool
        Written into files, and not printed.
    """

    title: str
    columns: Sequence[Column]
    rows: pd.DataFrame | Sequence[Mapping[Any, Any]] = field(repr=False)
    is_detail: bool = False

    @property
    def headings(self) -> list[str]:
        """Headings of the columns."""
        return [column.heading for column in self.columns]

    @property
    def texts(self) -> list[list[str]]:
        """Texts of the rows."""
        rows = self.rows.to_dict("records") if isinstance(self.rows, pd.DataFrame) else self.rows
        return [[column.text(row) for column in self.columns] for row in rows]


def text_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    """Make a table of rows of texts."""
    columns = [Column(heading, place, part=min(place, 1)) for place, heading in enumerate(headings)]
    return Table(title, columns, [dict(enumerate(row)) for row in rows])


def spread_rows(table: pd.DataFrame, rows: Sequence[str], columns: Sequence[str]) -> list[dict[Any, Any]]:
    """Turn a summary into rows of a table.

    Each has the values of the columns `rows`, and by the values of the columns `columns`, a tuple, the
    records of the summary.
    """
    by_key: dict[tuple[Any, ...], dict[Any, Any]] = {}
    for record in table.to_dict("records"):
        key = tuple(record[name] for name in rows)
        row = by_key.setdefault(key, dict(zip(rows, key, strict=True)))
        row[tuple(record[name] for name in columns)] = record
    return list(by_key.values())


def spread_columns(headings: Mapping[Any, str], form: Callable[[Any], str]) -> list[Column]:
    """Columns of the records that rows of `spread_rows` have by some keys, with their headings."""
    return [Column(text, key, form, part=part) for part, (key, text) in enumerate(headings.items(), 1)]


def batched(items: Iterable[Item], n: int) -> list[list[Item]]:
    """Cut a list into parts of at most `n`."""
    listed = list(items)
    return [listed[start : start + n] for start in range(0, len(listed), n)]


def number_or_blank(value: float, form: str) -> str:
    """Write a number, nothing for NaN."""
    return "" if math.isnan(value) else form.format(value)


def rate_text(rate: float, form: str = "{:.1e}") -> str:
    """Write a rate: 0 where nothing occurs in anything one could run, and a dash for NaN.

    Examples
    --------
    >>> rate_text(0.0012), rate_text(1e-30), rate_text(math.nan)
    ('1.2e-3', '0', '-')
    """
    if math.isnan(rate):
        return "-"
    return form.format(rate).replace("e-0", "e-") if rate >= 1e-12 else "0"


def with_failures(text: str, n_failed: int) -> str:
    """Add the number of failed cells to a text, if there are any.

    Examples
    --------
    >>> with_failures("0.12", 0), with_failures("0.12", 2), with_failures("", 2)
    ('0.12', '0.12 (2 failed)', '2 failed')
    """
    if not n_failed:
        return text
    return f"{text} ({n_failed} failed)" if text else f"{n_failed} failed"


class Line(NamedTuple):
    """Label and style of an estimator in charts, and whether it sees the truth."""

    label: str
    style: LineStyle
    is_reference: bool = False


def short_labels(labels: Mapping[Variant, str]) -> dict[Variant, str]:
    """Number the variants whose labels are too long for a legend or the head of a column.

    Examples
    --------
    >>> short_labels({("a", "1"): "a", ("b", "1"): "b[n=1]", ("b", "2"): f"b[{'x' * 40}=2]"})
    {('a', '1'): 'a', ('b', '1'): 'b[n=1]', ('b', '2'): 'b #2'}
    """
    short: dict[Variant, str] = {}
    numbers = Counter[str]()
    for (name, params), label in labels.items():
        numbers[name] += 1
        is_short = len(label) <= LONGEST_LABEL or label == name
        short[name, params] = label if is_short else f"{name} #{numbers[name]}"
    return short


def number_table(labels: Mapping[Variant, str]) -> list[Table]:
    """Tabulate what the numbers of `short_labels` stand for; no table where there are none."""
    short = short_labels(labels)
    rows = [(short[variant], label) for variant, label in labels.items() if short[variant] != label]
    return [text_table("Estimators by number", ["number", "estimator"], rows)] if rows else []


def assign_lines(labels: Mapping[Variant, str], references: Iterable[str] = ()) -> dict[Variant, Line]:
    """Give every estimator a line: the colour follows from its name, the rest from the variants before it.

    Parameters
    ----------
    labels : mapping of (str, str) to str
        By name and parameters.
    references : iterable of str
        Names of the estimators that see the truth: they have the colour of text, and no symbol.

    Examples
    --------
    >>> found = assign_lines({("fft4d", "{}"): "fft4d", ("oracle", "{}"): "oracle"}, ["oracle"])
    >>> [(line.style.colour, line.style.dash) for line in found.values()]
    [('#0072B2', 'solid'), ('', 'dash')]
    """
    lines: dict[Variant, Line] = {}
    turns, bounds = Counter[int](), set(references)
    for variant, label in short_labels(labels).items():
        name = variant[0]
        if name in bounds:
            dash = REFERENCE_DASHES[sum(line.is_reference for line in lines.values()) % len(REFERENCE_DASHES)]
            role = ROLES.get(name, "sees the truth")
            lines[variant] = Line(f"{label} ({role})", LineStyle("", dash, ""), is_reference=True)
            continue
        bare = name.partition(" (")[0]  # of several runs, estimators are named after theirs
        place = PLACES.get(bare, zlib.crc32(bare.encode()) % len(COLOURS))
        turn = turns[place]
        colour = shaded(COLOURS[place], SHADES[turn % len(SHADES)])
        dash = DASHES[(turn + turn // len(SYMBOLS)) % len(DASHES)]
        lines[variant] = Line(label, LineStyle(colour, dash, SYMBOLS[(place + turn) % len(SYMBOLS)]))
        turns[place] += 1
    return lines


def shaded(colour: str, share: float) -> str:
    """Mix a colour with a share of white, or of black where the share is negative."""
    if not share:
        return colour
    goal = 255 if share > 0 else 0
    parts = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    return "#" + "".join(f"{round(part + abs(share) * (goal - part)):02X}" for part in parts)


def interval(table: pd.DataFrame, column: str, stem: str = "") -> tuple[pd.Series[float], pd.Series[float]]:
    """Interval of a column: ``<stem>_low`` to ``<stem>_high``, or its value less and more ``<stem>_band``."""
    stem = stem or column
    if f"{stem}_band" in table:
        return table[column] - table[f"{stem}_band"], table[column] + table[f"{stem}_band"]
    return table[f"{stem}_low"], table[f"{stem}_high"]


def line_series(
    table: pd.DataFrame, lines: Mapping[Variant, Line], x: str, y: str, stem: str | None = None
) -> list[Series]:
    """Draw a column of a summary over another, a line for each estimator that the table has.

    The stem names the columns of the interval, see `interval`; without it there is none. At a single SNR
    estimators stand side by side, and what sees the truth is a level line.
    """
    series = []
    is_single = x in SNR_COLUMNS and table[x].nunique() == 1
    used = {*VARIANT, x, y, *(f"{stem or y}_{end}" for end in ("band", "low", "high"))}
    table = table[[name for name in table if name in used]].sort_values(x, kind="stable")
    own = [variant for variant, line in lines.items() if not line.is_reference]
    half = 0.05 * max(len(own), 2)
    tick = float(table[x].iloc[0]) if is_single else None
    for variant, line in lines.items():
        rows = rows_of(table, variant)
        if rows.empty:
            continue
        at = rows[x]
        if is_single and line.is_reference:
            rows = pd.concat([rows, rows])
            at = rows[x] + [-half, half]
        elif is_single:
            at = at + 0.1 * (own.index(variant) - (len(own) - 1) / 2)
        low, high = interval(rows, y, stem) if stem is not None else ((), ())
        label = line.label if rows[y].notna().any() else line.label + NO_SCORE
        series.append(Series(label, at, rows[y], low, high, style=line.style, tick=tick))
    return series


def rows_of(table: pd.DataFrame, variant: Variant) -> pd.DataFrame:
    """Rows of one estimator in a table with the columns estimator and params."""
    return table[(table["estimator"] == variant[0]) & (table["params"] == variant[1])]


def linear_limits(table: pd.DataFrame, column: str, stem: str) -> tuple[float, float]:
    """Ends of a linear axis from 0: with all means, and bands as far as they do not dwarf the means."""
    mean = max(0.0, float(table[column].fillna(0.0).max()))
    upper = max(mean, float(interval(table, column, stem)[1].fillna(0.0).max()))
    top = 1.06 * min(upper, LARGEST_BAND * mean) or 1.0
    return -0.03 * top, top


def decades(values: pd.Series[float], least: float = 0.0) -> tuple[float, float]:
    """Ends of a logarithmic axis: whole decades around the values above a least one.

    Examples
    --------
    >>> decades(pd.Series([0.0, 0.02, 3.0]))
    (0.01, 10.0)
    """
    values = values[values > least]
    if values.empty:
        return (least or 0.1), 1.0
    low, high = np.floor(np.log10(values.min() / 1.5)), np.ceil(np.log10(1.5 * values.max()))
    return float(10.0**low), float(10.0**high)


def variants_in(table: pd.DataFrame) -> list[Variant]:
    """Names and canonical parameters in the columns estimator and params, each pair once, in order."""
    return list(dict.fromkeys(zip(table["estimator"], table["params"], strict=True)))


def nearest_values(available: Sequence[float], wanted: Sequence[float]) -> list[float]:
    """Select the values nearest to wanted ones, each once, in the order of the wanted ones."""
    return list(dict.fromkeys(min(available, key=lambda value: abs(value - goal)) for goal in wanted))
