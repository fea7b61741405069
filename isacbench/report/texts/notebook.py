"""Objects as a notebook shows them: a table, and a picture of clouds and maps."""

from __future__ import annotations

import base64
import io
from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from isacbench.files.escaping import visible
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.plugins.contracts import Detection
from isacbench.report.drawing.style import THRESHOLD, new_figure, styled, velocity_bar, velocity_colours
from isacbench.report.figures.map_figures import outer

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from isacbench.display import Description

PICTURE_DPI = 100
"""A picture then takes some ten kilobytes of the notebook's file."""

MOST_POINTS = 3000
"""Points of a cloud that are drawn: more take seconds, and cover each other."""

MARGIN_M = 0.5
"""Around the points: a single one has a scale, too."""

LOWEST_DB = 60.0
"""Level below the strongest cell from which on a map has one colour, so that noise-free maps show echoes."""

CELL = "text-align: left"


def page(shown: object, description: Description) -> str:
    """Write an object as HTML.

    Parameters
    ----------
    shown : object
    description : Description

    Returns
    -------
    str
        Title, table, and a picture where `draw` has one, its PNG inline.
    """
    title, facts = description
    rows = "".join(
        f'<tr><th style="{CELL}">{_text(name)}</th><td style="{CELL}">{_text(value)}</td></tr>'
        for name, value in facts.items()
    )
    table = f"<table>{rows}</table>" if rows else ""
    return f"<div><strong>{_text(title)}</strong>{table}{_picture(shown, title)}</div>"


@singledispatch
def draw(shown: object) -> Figure | None:
    """Draw a small picture of an object.

    Parameters
    ----------
    shown : object

    Returns
    -------
    Figure or None
        None for an object that is no cloud and no map, or holds nothing to draw.
    """
    return None


@draw.register(PointCloud)
def _(cloud: PointCloud) -> Figure | None:
    """Draw the points from above and from the side, coloured by velocity."""
    if not len(cloud):
        return None
    stride = -(-len(cloud) // MOST_POINTS)
    points = cloud.select(np.arange(0, len(cloud), stride))
    colours = velocity_colours(float(np.abs(cloud.velocity).max()) if cloud.has_velocity else 0.0)
    figure = new_figure(7.0, 3.0)
    panels = figure.subplots(1, 2)
    for axes, up, name in zip(panels, (1, 2), ("from above", "from the side"), strict=True):
        shown = points.xyz[:, [0, up]]
        axes.scatter(*shown.T, c=colours.to_rgba(points.velocity), s=8, linewidths=0)
        axes.update_datalim([shown.min(axis=0) - MARGIN_M, shown.max(axis=0) + MARGIN_M])
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(name if stride == 1 else f"{name}, one point in {stride}")
        axes.set(xlabel="x [m]", ylabel=f"{'xyz'[up]} [m]")
        axes.grid(True)
    if cloud.has_velocity:
        velocity_bar(figure, colours, panels, "radial velocity [m/s]")
    return figure


@draw.register(Observation)
def _(observation: Observation) -> Figure | None:
    """Draw the power of the range-Doppler cells; those of a recorded frame once something has read them."""
    if not observation.has_cells:
        return None
    cells, system, gate = observation.cells, observation.system, observation.gate
    power = np.mean(cells.real**2 + cells.imag**2, axis=(2, 3))
    velocity_mps = outer(gate.doppler_bins * system.velocity_bin_mps)
    range_m = outer(gate.range_bins * system.range_bin_m)
    names = {"label": "mean power of an element [dB]", "x": "radial velocity [m/s]", "y": "range [m]"}
    return _draw_map(power, names, (*velocity_mps, *range_m))


@draw.register(Detection)
def _(detection: Detection) -> Figure | None:
    """Draw the thresholds of a map, and mark the cells that were detected."""
    mask, threshold = np.asarray(detection.mask), np.asarray(detection.threshold)
    if mask.ndim != 2 or mask.shape != threshold.shape or threshold.dtype.kind not in "iuf":
        return None
    names = {"label": "threshold [dB], detected cells dotted", "x": "Doppler cell", "y": "range cell"}
    figure = _draw_map(threshold, names)
    if figure is not None:
        rows, columns = np.nonzero(mask)
        figure.axes[0].scatter(columns, rows, s=9, color=THRESHOLD, linewidths=0)
    return figure


def _draw_map(
    power: NDArray[np.number],
    names: dict[str, str],
    extent: tuple[float, float, float, float] | None = None,
) -> Figure | None:
    """Draw powers (n_range, n_doppler) in dB, borders at an extent if there is one; None of no power."""
    is_power = np.isfinite(power) & (power > 0)
    if not is_power.any():
        return None
    decibels = 10 * np.log10(np.where(is_power, power, np.nan))
    figure = new_figure(5.0, 3.2)
    axes = figure.subplots()
    image = axes.imshow(
        np.maximum(decibels, np.nanmax(decibels) - LOWEST_DB),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
        extent=extent,
    )
    figure.colorbar(image, ax=axes, label=names["label"])
    axes.set(xlabel=names["x"], ylabel=names["y"])
    return figure


def _picture(shown: object, title: str) -> str:
    with styled():
        figure = draw(shown)
        if figure is None:
            return ""
        png = io.BytesIO()
        figure.savefig(png, format="png", dpi=PICTURE_DPI)
    text = base64.b64encode(png.getvalue()).decode("ascii")
    return f'<img alt="{_text(title)}" src="data:image/png;base64,{text}">'


def _text(text: str) -> str:
    return escape(visible(text))
