"""Style of all figures: canvas, fonts, colours, names and files. Nothing here needs a display or pyplot."""

from __future__ import annotations

import gc
import math
import re
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
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
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from isacbench.bench.plan.labels import Variant
    from isacbench.model.region import Region

LineStyle = Literal["-", "-.", ":", "--"]

DPI = 150
FONT = "DejaVu Sans"
MAX_STEM = 60
PNG_OPTIONS = {"compress_level": 2}
"""A third less time than the usual level takes, for files a tenth larger."""

# Okabe and Ito's palette, told apart with any colour vision; without its yellow, too pale for a line.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
MARKERS = "os^Dvp"
LINES: tuple[LineStyle, ...] = ("-", "-.", ":")
BOUND_COLOUR = "0.15"

CONTEXT = "0.72"
"""Grey of what is shown for comparison: the truth behind an estimate."""

TRUE = "#009E73"
"""Colour of what is true where it lies over data."""

THRESHOLD = "#D55E00"
"""Colour of thresholds."""

# Dark in the middle, so that what stands still is seen on white.
VELOCITY_COLOURS = ("#3FA7E6", "#0072B2", "#333333", "#D55E00", "#F2A900")
SLOW_MPS = 2.0
TICKS_MPS = np.array([-200, -100, -50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50, 100, 200])

RC = {
    "font.family": FONT,
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    # Where it would be placed anyway: finding that out takes the layout of every tick once more.
    "axes.titley": 1.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "figure.titlesize": 11.0,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "lines.markersize": 4.0,
}


@dataclass(frozen=True)
class LineLook:
    """How an estimator is drawn, the same in every figure of a run.

    Attributes
    ----------
    label : str
        Its name for people.
    colour, marker : str
        As matplotlib spells them.
    line : {"-", "-.", ":", "--"}
        Likewise.
    is_bound : bool
        Whether it sees the truth, and does not compete.
    """

    label: str
    colour: str
    marker: str
    line: LineStyle
    is_bound: bool


def assign_looks(labels: Mapping[Variant, str], bounds: Collection[str]) -> dict[Variant, LineLook]:
    """Give every estimator a look of its own.

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
            found[variant] = LineLook(f"{drawable(label)} (sees the truth)", BOUND_COLOUR, "", "--", True)
            continue
        turn, index = divmod(n_competitors, len(COLOURS))
        marker = MARKERS[(index + turn) % len(MARKERS)]
        found[variant] = LineLook(drawable(label), COLOURS[index], marker, LINES[turn % len(LINES)], False)
        n_competitors += 1
    return found


def styled() -> AbstractContextManager[None]:
    """Return a context with this module's fonts and sizes; the user's own settings come back after it."""
    return matplotlib.style.context(["default", RC])


@contextmanager
def older_objects_uncollected() -> Iterator[None]:
    """Spare what is already there the search for garbage, while many objects come and go.

    Figures are made of so many small objects in cycles that Python looks for
    garbage again and again, each time among everything that was ever imported.
    """
    if gc.get_freeze_count():  # somebody else's decision
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


class NotebookFigure(Figure):
    """Figure that a notebook shows where it is the value of a cell, without pyplot."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        with styled():
            self.savefig(content, format="png")
        return content.getvalue()


def new_figure(width_in: float, height_in: float) -> Figure:
    """Make a figure with a canvas that needs no display."""
    figure = NotebookFigure(figsize=(width_in, height_in), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def edges(figure: Figure, left: float, right: float, bottom: float, top: float) -> dict[str, float]:
    """Turn margins in inches into the edges that ``gridspec_kw`` takes.

    A layout engine would find them itself, in more time than the drawing takes.
    """
    width, height = figure.get_size_inches()
    return {
        "left": left / width,
        "right": 1 - right / width,
        "bottom": bottom / height,
        "top": 1 - top / height,
    }


def entitle(figure: Figure, title: str) -> None:
    """Write the title at the top edge of a figure."""
    figure.suptitle(title, y=1 - 0.1 / figure.get_figheight(), va="top")


def save(figure: Figure, path: Path) -> Path:
    """Write a figure in the format that the suffix of its path names.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with replacing(path, afterwards="") as temporary:
        kind = path.suffix.removeprefix(".").lower()
        options: dict[str, Any] = {"pil_kwargs": PNG_OPTIONS} if kind == "png" else {}
        figure.savefig(temporary, format=kind, **options)
    return path


def drawable(text: str) -> str:
    r"""Spell a name as matplotlib draws it: dollars mean no mathematics, what the font lacks is replaced.

    Examples
    --------
    >>> drawable("a\n$b$")
    'a�\\$b\\$'
    """
    font = get_font(findfont(FontProperties(family=[FONT])))
    shown = [char if char.isprintable() and font.get_char_index(ord(char)) else "\ufffd" for char in text]
    return "".join(shown).replace("$", r"\$")


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """Give every name a part of a file name that is safe and its own on every system.

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


def velocity_colours(region: Region) -> ScalarMappable:
    """Map radial velocities to colours: 0 in the middle, slow ones spread to be told from it."""
    return speed_colours(max(map(abs, region.speed_mps)))


def speed_colours(fastest_mps: float) -> ScalarMappable:
    """Map radial velocities up to some speed to colours, as `velocity_colours` does."""
    fastest_mps = max(SLOW_MPS, fastest_mps)
    colours = LinearSegmentedColormap.from_list("velocity", VELOCITY_COLOURS)
    return ScalarMappable(AsinhNorm(SLOW_MPS, -fastest_mps, fastest_mps), colours)


def velocity_bar(figure: Figure, colours: ScalarMappable, axes: Axes, label: str) -> None:
    """Draw the colour bar of `velocity_colours` into axes of its own."""
    bar = figure.colorbar(colours, cax=axes)
    fastest_mps = colours.norm.vmax or 0.0
    ticks = [tick for tick in TICKS_MPS if abs(tick) <= fastest_mps]
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    bar.set_label(label)


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """Put a legend at the bottom of a figure; it is `legend_height_in` high."""
    columns = _legend_columns(figure.get_figwidth(), [str(handle.get_label()) for handle in handles])
    figure.legend(handles=handles, loc="lower center", ncols=columns, frameon=False, borderaxespad=0.2)


def legend_height_in(width_in: float, labels: Sequence[str]) -> float:
    """Height in inches of a legend with these labels below a figure of a width."""
    return 0.15 + 0.175 * math.ceil(len(labels) / _legend_columns(width_in, labels))


def _legend_columns(width_in: float, labels: Sequence[str]) -> int:
    """Columns of a legend that a width has room for; no more than its rows need, so that all are filled."""
    widest_in = 0.55 + 0.06 * max(map(len, labels))
    n_most = max(1, min(len(labels), int(width_in / widest_in)))
    n_rows = math.ceil(len(labels) / n_most)
    return math.ceil(len(labels) / n_rows)
