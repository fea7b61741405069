"""Figures of several panels with one legend, and the curves in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from isacbench.report.drawing.style import new_figure

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from isacbench.report.drawing.style import LineLook

PANEL_IN = 2.75, 2.3
MAX_COLUMNS = 4
MAX_SNR_TICKS = 5


def panel_grid(
    n_panels: int,
    legend: Sequence[Line2D],
    title: str,
    max_columns: int = MAX_COLUMNS,
    panel_in: tuple[float, float] = PANEL_IN,
) -> tuple[Figure, list[Axes]]:
    """Make a figure with a grid of panels and the legend below them.

    Parameters
    ----------
    n_panels : int
    legend : sequence of Line2D
        Entries with their labels.
    title : str
    max_columns : int
        Number of panels in a full row.
    panel_in : (float, float)
        Width and height of a panel in inches.

    Returns
    -------
    figure : Figure
    panels : list of Axes
        Row by row.
    """
    n_columns = min(n_panels, max_columns)
    n_rows = -(-n_panels // n_columns)
    # A single panel must be wide enough for title and legend.
    width_in = max(n_columns * (panel_in[0] + 0.55), 6.0)
    figure = new_figure(width_in, n_rows * (panel_in[1] + 0.65) + 0.3, legend=legend, title=title)
    panels = list(figure.subplots(n_rows, n_columns, squeeze=False).flat)
    for unused in panels[n_panels:]:
        unused.remove()
    return figure, panels[:n_panels]


def legend_lines(looks: Iterable[LineLook]) -> list[Line2D]:
    """Make legend entries of some looks.

    Parameters
    ----------
    looks : iterable of LineLook

    Returns
    -------
    list of Line2D
    """
    return [
        Line2D([], [], color=look.colour, linestyle=look.line, marker=look.marker, label=look.label)
        for look in looks
    ]


def draw_line(
    axes: Axes,
    look: LineLook,
    x: ArrayLike,
    y: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    alpha: float = 0.15,
) -> None:
    """Draw a curve inside its confidence band; a single point stands on a bar.

    Parameters
    ----------
    axes : Axes
    look : LineLook
    x, y : array_like, shape (n,)
    low, high : array_like, shape (n,)
        Ends of the band.
    alpha : float
        Opacity of the band.
    """
    axes.plot(x, y, color=look.colour, linestyle=look.line, marker=look.marker)
    if np.size(x) == 1:
        axes.vlines(x, low, high, color=look.colour, alpha=0.4, linewidth=3)
    else:
        axes.fill_between(x, low, high, color=look.colour, alpha=alpha, linewidth=0.0)
