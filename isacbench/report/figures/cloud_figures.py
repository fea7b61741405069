"""Point clouds in perspective and in projection, coloured by radial velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from isacbench.files.escaping import counted
from isacbench.metrics.geometry import CloudPair
from isacbench.report.drawing.perspective import Box, perspective_axes, scatter, tick_step
from isacbench.report.drawing.style import (
    CONTEXT,
    drawable,
    edges,
    entitle,
    new_figure,
    velocity_bar,
    velocity_colours,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from numpy.typing import NDArray

    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region
    from isacbench.report.drawing.perspective import View

PANEL_IN = 3.5, 2.6
LONE_PANEL_IN = 6.0, 4.6
MAX_COLUMNS = 4
NOTE_IN = 0.08
"""From the upper edge of a panel to its note."""

TICKS_IN_PROJECTION = 6
SMALLEST_BOX_M = 2.0
AXES = "xyz"
PLANES = ((0, 1), (0, 2), (1, 2))


class Image(NamedTuple):
    """An estimated cloud, and a note that says how good it is or why it is empty."""

    cloud: PointCloud
    note: str


def draw_clouds(
    title: str,
    truth: PointCloud,
    region: Region,
    columns: Sequence[str],
    rows: Mapping[float, Sequence[Image]],
    radius_m: float,
) -> Figure:
    """Draw images of one scenario beside the truth, a column an estimator, a row an SNR.

    Parameters
    ----------
    title : str
    truth : PointCloud
        At least one scatterer; it stands faintly behind every estimate.
    region : Region
        Whose speeds span the colours.
    columns : sequence of str
        Labels of the estimators.
    rows : mapping of float to sequence of Image
        For each SNR in dB one image an estimator.
    radius_m : float
        Distance from the truth in m beyond which a point is marked as false.

    Returns
    -------
    Figure
    """
    box = _box([truth, *(image.cloud for images in rows.values() for image in images)], region)
    colours = velocity_colours(region)
    figure = new_figure((1 + len(columns)) * PANEL_IN[0] + 1.4, len(rows) * PANEL_IN[1] + 1.1)
    margins = edges(figure, left=0.35, right=1.05, bottom=0.45, top=0.6)
    grid = figure.add_gridspec(len(rows), 1 + len(columns), wspace=0, hspace=0.03, **margins)
    for row, (snr_db, images) in enumerate(rows.items()):
        axes, view = perspective_axes(figure, grid[row, 0], box)
        place = grid[row, 0].get_position(figure)
        left, middle = 0.12 / figure.get_figwidth(), (place.y0 + place.y1) / 2
        figure.text(left, middle, f"SNR {snr_db:g} dB", rotation=90, va="center", weight="bold")
        _scatter_truth(axes, view, truth, colours)
        for column, image in enumerate(images, start=1):
            axes, view = perspective_axes(figure, grid[row, column], box)
            _scatter_estimate(axes, view, truth, image, colours, radius_m)
    for column, label in enumerate(["truth", *columns]):
        _heading(figure, grid[0, column], label)
    entitle(figure, title)
    _velocity_bar(figure, colours)
    _legend(figure, radius_m)
    return figure


def draw_images(
    title: str, truth: PointCloud, images: Mapping[str, Image], region: Region, radius_m: float
) -> Figure:
    """Draw images of one scene side by side, after the truth if there is any.

    Without truth no point is marked, and nothing is compared.

    Parameters
    ----------
    title : str
    truth : PointCloud
        True scatterers, possibly none.
    images : mapping of str to Image
        At least one, by its heading.
    region : Region
        Whose speeds span the colours.
    radius_m : float
        Distance from the truth in m beyond which a point is marked as false.

    Returns
    -------
    Figure
    """
    box = _box([truth, *(image.cloud for image in images.values())], region)
    colours = velocity_colours(region)
    has_truth = len(truth) > 0
    panels: list[tuple[str, Image | None]] = [("truth", None)] if has_truth else []
    panels += images.items()
    n_columns = min(len(panels), MAX_COLUMNS)
    n_rows = -(-len(panels) // n_columns)
    width_in, height_in = PANEL_IN if len(panels) > 1 else LONE_PANEL_IN
    below_in = 0.45 if has_truth else 0.1
    figure = new_figure(n_columns * width_in + 1.2, n_rows * (height_in + 0.3) + below_in + 0.4)
    margins = edges(figure, left=0.15, right=1.05, bottom=below_in, top=0.6)
    grid = figure.add_gridspec(n_rows, n_columns, wspace=0, hspace=0.3 / height_in, **margins)
    for number, (heading, image) in enumerate(panels):
        place = grid[divmod(number, n_columns)]
        axes, view = perspective_axes(figure, place, box)
        if image is None:
            _scatter_truth(axes, view, truth, colours)
        else:
            _scatter_estimate(axes, view, truth, image, colours, radius_m)
        _heading(figure, place, drawable(heading))
    entitle(figure, title)
    _velocity_bar(figure, colours)
    if has_truth:
        _legend(figure, radius_m)
    return figure


def draw_comparison(
    title: str, truth: PointCloud, heading: str, image: Image, region: Region, radius_m: float
) -> Figure:
    """Draw one image beside the truth, and both over each other in the three projections.

    Parameters
    ----------
    title : str
    truth : PointCloud
        True scatterers, at least one.
    heading : str
        Of the image.
    image : Image
    region : Region
        Whose speeds span the colours.
    radius_m : float
        Distance from the truth in m beyond which a point is marked as false.

    Returns
    -------
    Figure
    """
    box, colours = _box([truth, image.cloud], region), velocity_colours(region)
    figure = new_figure(11.0, 7.9)
    upper = figure.add_gridspec(1, 2, wspace=0, **edges(figure, left=0.2, right=1.0, bottom=3.45, top=0.6))
    axes, view = perspective_axes(figure, upper[0, 0], box)
    _scatter_truth(axes, view, truth, colours)
    _heading(figure, upper[0, 0], "truth")
    axes, view = perspective_axes(figure, upper[0, 1], box)
    _scatter_estimate(axes, view, truth, image, colours, radius_m)
    _heading(figure, upper[0, 1], drawable(heading))
    margins = edges(figure, left=0.7, right=0.85, bottom=0.85, top=4.65)
    lower = figure.add_gridspec(
        1, 3, wspace=0.2, width_ratios=[box.size_m[across] for across, _ in PLANES], **margins
    )
    for column, plane in enumerate(PLANES):
        axes = figure.add_subplot(lower[0, column])
        _draw_projection(axes, truth, image.cloud, box, plane, colours, radius_m)
    entitle(figure, title)
    _velocity_bar(figure, colours)
    _legend(figure, radius_m)
    return figure


def _box(clouds: Iterable[PointCloud], region: Region) -> Box:
    """Smallest box of whole metres that holds all points, or the region where there are none."""
    points = np.concatenate([cloud.xyz for cloud in clouds])
    if not len(points):
        points = np.array([region.lower_m, region.upper_m])
    lower_m = np.floor(points.min(axis=0))
    return Box(lower_m, np.maximum(np.ceil(points.max(axis=0)), lower_m + SMALLEST_BOX_M))


def _heading(figure: Figure, place: SubplotSpec, text: str) -> None:
    """Write over a place for axes."""
    box = place.get_position(figure)
    figure.text((box.x0 + box.x1) / 2, box.y1, text, ha="center", va="bottom", weight="bold")


def _scatter_truth(axes: Axes, view: View, truth: PointCloud, colours: ScalarMappable) -> None:
    """Draw the true scatterers in perspective."""
    _scatter(axes, view, truth, colours, marker="o", size=6)
    _note(axes, counted(len(truth), "scatterer"))


def _scatter_estimate(
    axes: Axes, view: View, truth: PointCloud, image: Image, colours: ScalarMappable, radius_m: float
) -> None:
    """Draw an estimate in perspective, the truth faintly behind it, false points marked."""
    scatter(axes, view, truth.xyz, CONTEXT, s=2, linewidths=0)
    false = _is_false(truth, image.cloud, radius_m)
    _scatter(axes, view, image.cloud.select(~false), colours, marker="o", size=10)
    _scatter(axes, view, image.cloud.select(false), colours, marker="x", size=20)
    _note(axes, image.note)


def _scatter(
    axes: Axes, view: View, cloud: PointCloud, colours: ScalarMappable, marker: str, size: float
) -> None:
    """Draw points in perspective, coloured by velocity."""
    width = 1.2 if marker == "x" else 0
    colour = colours.to_rgba(cloud.velocity)
    scatter(axes, view, cloud.xyz, colour, marker=marker, s=size, linewidths=width)


def _is_false(truth: PointCloud, cloud: PointCloud, radius_m: float) -> NDArray[np.bool_]:
    """Mask of the points that no true scatterer is near; without truth no point is false."""
    if not len(truth):
        return np.zeros(len(cloud), dtype=np.bool_)
    false: NDArray[np.bool_] = CloudPair(truth, cloud).estimate_to_truth_m > radius_m
    return false


def _note(axes: Axes, note: str) -> None:
    """Write at the upper edge of a panel, whose units are inches."""
    x, y = np.mean(axes.get_xlim()), axes.get_ylim()[1] - NOTE_IN
    axes.text(float(x), y, note, ha="center", va="top", size=8, color="0.25")


def _draw_projection(
    axes: Axes,
    truth: PointCloud,
    cloud: PointCloud,
    box: Box,
    plane: tuple[int, int],
    colours: ScalarMappable,
    radius_m: float,
) -> None:
    """Draw truth and estimate over each other, projected on a plane."""
    across, up = plane
    axes.scatter(
        truth.xyz[:, across], truth.xyz[:, up], s=22, facecolors="none", edgecolors=CONTEXT, linewidths=0.8
    )
    false = _is_false(truth, cloud, radius_m)
    for keep, marker, width in ((~false, "o", 0.0), (false, "x", 1.2)):
        points = cloud.select(keep)
        axes.scatter(
            points.xyz[:, across],
            points.xyz[:, up],
            c=colours.to_rgba(points.velocity),
            s=12 if marker == "o" else 24,
            marker=marker,
            linewidths=width,
        )
    margin_m = 0.02 * float(box.size_m.max())
    axes.set_xlim(box.lower_m[across] - margin_m, box.upper_m[across] + margin_m)
    axes.set_ylim(box.lower_m[up] - margin_m, box.upper_m[up] + margin_m)
    axes.set_aspect("equal", anchor="S")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(tick_step(box, TICKS_IN_PROJECTION)))
    axes.set_xlabel(f"{AXES[across]} [m]")
    axes.set_ylabel(f"{AXES[up]} [m]", labelpad=1)
    axes.grid(True)


def _velocity_bar(figure: Figure, colours: ScalarMappable) -> None:
    """Put the one colour bar of all panels at the right edge of a figure."""
    width, height = figure.get_size_inches()
    axes = figure.add_axes((1 - 0.72 / width, 0.5 - 1.2 / height, 0.13 / width, 2.4 / height))
    velocity_bar(figure, colours, axes, "radial velocity [m/s], approaching > 0")


def _legend(figure: Figure, radius_m: float) -> None:
    """Explain the marks at the bottom of a figure."""
    style: dict[str, Any] = {"linestyle": "", "color": "0.2"}
    figure.legend(
        handles=[
            Line2D([], [], marker="o", linestyle="", color=CONTEXT, markersize=3, label="truth"),
            Line2D([], [], marker="o", markersize=4, label="estimate", **style),
            Line2D(
                [],
                [],
                marker="x",
                markersize=5,
                label=f"false point: farther than {radius_m:g} m from the truth",
                **style,
            ),
        ],
        loc="lower center",
        ncols=3,
        frameon=False,
    )
