"""Style of all figures: canvas, fonts, colours, names and files; needs neither a display nor pyplot."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import matplotlib.style
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import AsinhNorm, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from isacbench.bench.store.run_folder import replacing

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from isacbench.bench.plan.labels import Variant

LineStyle = Literal["-", "-.", ":", "--", ""]

DPI = 150
FONT = "DejaVu Sans"
MAX_STEM = 60
ROW_IN = 0.175
"""Height of a row of a legend."""

# Okabe and Ito's palette, distinguishable with any colour vision; without its yellow, too pale for a line.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = "os^Dvp"
LINES: tuple[LineStyle, ...] = ("-", "-.", ":")
BOUND_COLOUR = "0.15"
BOUND_LINES: tuple[LineStyle, ...] = ("--", ":", "-.", "-")
BOUND_MARKERS = "_x+"

ROLES = {"oracle": "truth merged in cells ± spread", "chance": "zero skill ± spread", "empty": "no point"}
"""Meaning of the built-in references in legends, with that of their band."""

CONTEXT = "0.72"
"""Grey of the truth behind an estimate."""

TRUE = "#009E73"
"""Colour of the truth over data."""

THRESHOLD = "#D55E00"
"""Colour of thresholds."""

# Dark in the middle, so that static points are seen on white.
VELOCITY_COLOURS = ("#3FA7E6", "#0072B2", "#333333", "#D55E00", "#F2A900")
UNKNOWN = "#7A7A7A"
"""Grey of points whose velocity is unknown."""

SLOW_MPS = 2.0
TICKS_MPS = np.array([-200, -100, -50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50, 100, 200])

RC = {
    "font.family": FONT,
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "figure.titlesize": 11.0,
    "figure.constrained_layout.w_pad": 0.1,
    "figure.constrained_layout.h_pad": 0.08,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "lines.markersize": 4.0,
}


@dataclass(frozen=True)
class LineLook:
    """Look of an estimator, the same in every figure of a run.

    Attributes
    ----------
    label : str
        Name in legends.
    colour, marker : str
        As matplotlib writes them.
    line : {"-", "-.", ":", "--", ""}
        Line style.
    is_bound : bool
        True for an estimator that sees the truth.
    """

    label: str
    colour: str
    marker: str
    line: LineStyle
    is_bound: bool


def assign_looks(labels: Mapping[Variant, str], bounds: Collection[str]) -> dict[Variant, LineLook]:
    """Give every estimator its own colour, marker and line style.

    Parameters
    ----------
    labels : mapping of (str, str) to str
        Labels by name and parameters.
    bounds : collection of str
        Names of the estimators that see the truth.

    Returns
    -------
    dict of (str, str) to LineLook
        In the order of the labels.

    Examples
    --------
    >>> found = assign_looks({("a", "{}"): "a", ("limit", "{}"): "limit"}, bounds={"limit"})
    >>> [look.line for look in found.values()]
    ['-', '--']
    """
    found: dict[Variant, LineLook] = {}
    n_competitors = 0
    for variant, label in labels.items():
        if variant[0] in bounds:
            role = ROLES.get(variant[0], "sees the truth")
            line = BOUND_LINES[(len(found) - n_competitors) % len(BOUND_LINES)]
            found[variant] = LineLook(f"{drawable(label)} ({role})", BOUND_COLOUR, "", line, True)
            continue
        turn, index = divmod(n_competitors, len(COLOURS))
        marker = MARKERS[(index + turn) % len(MARKERS)]
        found[variant] = LineLook(drawable(label), COLOURS[index], marker, LINES[turn % len(LINES)], False)
        n_competitors += 1
    return found


def looks_over(x: Iterable[float], looks: Mapping[Variant, LineLook]) -> Mapping[Variant, LineLook]:
    """Select looks of curves, or of points where all stand at one place.

    Parameters
    ----------
    x : iterable of float
        Places of points.
    looks : mapping of (str, str) to LineLook

    Returns
    -------
    mapping of (str, str) to LineLook
        As given for several places. For a single one without lines, and with markers of
        estimators that see the truth, too.

    Examples
    --------
    >>> looks = assign_looks({("a", "{}"): "a", ("limit", "{}"): "limit"}, bounds={"limit"})
    >>> [(look.line, look.marker) for look in looks_over([10.0, 10.0], looks).values()]
    [('', 'o'), ('', '_')]
    >>> [(look.line, look.marker) for look in looks_over([-10.0, 10.0], looks).values()]
    [('-', 'o'), ('--', '')]
    """
    if len(set(x)) > 1:
        return looks
    bounds = [variant for variant, look in looks.items() if look.is_bound]
    markers = {variant: BOUND_MARKERS[place % len(BOUND_MARKERS)] for place, variant in enumerate(bounds)}
    return {
        variant: replace(look, line="", marker=markers.get(variant, look.marker))
        for variant, look in looks.items()
    }


def styled() -> AbstractContextManager[None]:
    """Return a context with the fonts and sizes of this module; it restores the user's own settings."""
    return matplotlib.style.context(["default", RC])


def new_figure(
    width_in: float,
    height_in: float,
    *,
    legend: Sequence[Artist] = (),
    title: str = "",
    layout: Literal["constrained"] | None = "constrained",
) -> Figure:
    """Make a figure on a canvas that needs no display.

    Parameters
    ----------
    width_in, height_in : float
        Size in inches, without the legend.
    legend : sequence of Artist
        Entries of a legend below the panels, with their labels.
    title : str
        Title above the panels.
    layout : {"constrained"} or None
        Layout engine of matplotlib; None leaves the margins to the caller.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout=layout)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, wrap=True)
    if legend:
        _add_legend(figure, legend)
    return figure


def _add_legend(figure: Figure, entries: Sequence[Artist]) -> None:
    """Add a legend at the bottom of a figure, and increase the figure's height by it."""
    width_in, height_in = figure.get_size_inches()
    column_in = 0.55 + 0.06 * max(len(str(entry.get_label())) for entry in entries)
    n_rows = math.ceil(len(entries) / max(1, int(width_in / column_in)))
    figure.set_size_inches(width_in, height_in + ROW_IN * (n_rows + 1))
    n_columns = math.ceil(len(entries) / n_rows)
    figure.legend(handles=list(entries), loc="outside lower center", ncols=n_columns, frameon=False)


def save(figure: Figure, path: Path) -> Path:
    """Write a figure in the format that the suffix of its path names.

    Parameters
    ----------
    figure : Figure
    path : Path
        An older file of that name is replaced.

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with replacing(path, afterwards="") as temporary:
        figure.savefig(temporary, format=path.suffix.removeprefix(".").lower())
    return path


def drawable(text: str) -> str:
    r"""Escape a name for matplotlib: dollar signs as text, a replacement for characters that the font lacks.

    Parameters
    ----------
    text : str

    Returns
    -------
    str

    Examples
    --------
    >>> drawable("a\n$b$")
    'a�\\$b\\$'
    """
    font = get_font(findfont(FontProperties(family=[FONT])))
    shown = [char if char.isprintable() and font.get_char_index(ord(char)) else "\ufffd" for char in text]
    return "".join(shown).replace("$", r"\$")


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Give every name a part of a file name that is safe and unique on every system.

    Parameters
    ----------
    names : iterable of str

    Returns
    -------
    dict of str to str

    Examples
    --------
    >>> file_stems(["street", "../a b", "Street"])
    {'street': 'street', '../a b': 'a-b', 'Street': 'Street-2'}
    """
    stems: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        base = re.sub(r"[^A-Za-z0-9_]+", "-", name)[:MAX_STEM].strip("-") or "unnamed"
        stem, number = base, 1
        while stem.lower() in taken:
            number += 1
            stem = f"{base}-{number}"
        taken.add(stem.lower())
        stems[name] = stem
    return stems


def velocity_colours(fastest_mps: float) -> ScalarMappable:
    """Map radial velocities to colours: 0 in the middle, slow ones spread to differ visibly from it.

    Unknown velocities, NaN, have a colour of their own.

    Parameters
    ----------
    fastest_mps : float
        Speed in m/s at both ends of the colours.

    Returns
    -------
    ScalarMappable
    """
    fastest_mps = max(SLOW_MPS, fastest_mps)
    colours = LinearSegmentedColormap.from_list("velocity", VELOCITY_COLOURS).with_extremes(bad=UNKNOWN)
    return ScalarMappable(AsinhNorm(SLOW_MPS, -fastest_mps, fastest_mps), colours)


def velocity_bar(figure: Figure, colours: ScalarMappable, panels: Iterable[Axes], label: str) -> None:
    """Draw the colour bar of `velocity_colours` to the right of some panels.

    Parameters
    ----------
    figure : Figure
    colours : ScalarMappable
    panels : iterable of Axes
    label : str
    """
    fastest_mps = colours.norm.vmax or 0.0
    ticks = [tick for tick in TICKS_MPS if abs(tick) <= fastest_mps]
    width_in = figure.get_figwidth()
    place: dict[str, Any] = {"fraction": 0.8 / width_in, "pad": 0.5 / width_in, "shrink": 0.7, "aspect": 25}
    bar = figure.colorbar(colours, ax=list(panels), label=label, ticks=ticks, format="%g", **place)
    bar.minorticks_off()
