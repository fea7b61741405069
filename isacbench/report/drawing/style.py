"""Style of all figures: canvas, fonts, colours, names and files; needs neither a display nor pyplot."""

from __future__ import annotations

import math
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
    from collections.abc import Iterable, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


DPI = 150
FONT = "DejaVu Sans"
ROW_IN = 0.175
"""Height of a row of a legend."""

CONTEXT = "0.72"
"""Grey of the truth behind an estimate."""

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
