"""Pictures of point clouds: in perspective and in projection, coloured by radial velocity."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from isacbench.charts import Variant
from isacbench.errors import InputError, require
from isacbench.files.checked_files import require_picture
from isacbench.files.escaping import counted
from isacbench.metrics.geometry import RADIUS_M, CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.report import figures

Axes3D = Any  # mpl_toolkits has no types

PANEL_IN = 3.2, 2.7
LONE_PANEL_IN = 5.6, 4.6
COMPARISON_IN, PERSPECTIVE_IN = 11.0, 4.0
"""Width of a comparison, and height of its panels in perspective."""

MARGIN_IN, LABELS_IN, MOST_HEIGHT_IN = 1.4, 0.6, 3.4
"""Room beside and below a projection, and its largest height."""

MAX_COLUMNS = 4
ELEVATION_DEG, AZIMUTH_DEG = 27.0, -50.0
ZOOM, COMPARISON_ZOOM = 0.85, 1.1

TICKS, TICKS_IN_PROJECTION = 4, 6
"""About so many ticks along the longest edge of a box."""

SMALLEST_BOX_M = 2.0
FLATTEST = 0.1
"""Shortest edge of a box over its longest one: the scales of a flatter box would overlap."""

AXES = "xyz"

MOST_CLOUDS = 16
"""Most estimators of which clouds, maps and spectra are shown; of more, those of least mean deviation."""


class Image(NamedTuple):
    """An estimated cloud, and a note that says how good it is or why it is empty."""

    cloud: PointCloud
    note: str


class _Scene(NamedTuple):
    """Truth, drawn box and colours that all panels of a figure share."""

    truth: PointCloud
    lower_m: NDArray[np.float64]
    upper_m: NDArray[np.float64]
    colours: ScalarMappable
    has_velocities: bool
    radius_m: float


def best_variants(rows: pd.DataFrame, candidates: Sequence[Variant]) -> list[Variant]:
    """Choose the estimators of a scenario whose clouds are drawn: those of least mean deviation."""
    if len(candidates) <= MOST_CLOUDS:
        return list(candidates)
    means = rows.groupby(["estimator", "params"], sort=False)["deviation"].mean()
    # What failed throughout has no mean, and comes last.
    best = set(means.reindex(list(candidates)).sort_values(kind="stable").index[:MOST_CLOUDS])
    return [variant for variant in candidates if variant in best]


def draw_clouds(
    title: str,
    truth: PointCloud,
    region: Region,
    columns: Sequence[str],
    rows: Mapping[float, Sequence[Image]],
    radius_m: float,
) -> Figure:
    """Draw images of one scenario beside the truth, a column an estimator, a row an SNR.

    The truth, at least one scatterer, stands faintly behind every estimate. The speeds of the region span the
    colours, `columns` are labels of the estimators, `rows` has for each SNR in dB one image an estimator, and
    a point farther than the radius from the truth is marked as false.
    """
    images = [image for row in rows.values() for image in (_image_of_truth(truth), *row)]
    headings = ["truth", *columns, *[""] * (len(images) - len(columns) - 1)]
    scene = _scene(truth, images, region, radius_m)
    figure, panels = _perspectives(title, scene, headings, images, 1 + len(columns), PANEL_IN)
    for snr_db, axes in zip(rows, panels[:: 1 + len(columns)], strict=True):
        style: dict[str, Any] = {"rotation": 90, "va": "center", "weight": "bold"}
        axes.text2D(0.0, 0.5, f"SNR {snr_db:g} dB", transform=axes.transAxes, **style)
    return figure


def draw_images(
    title: str, truth: PointCloud, images: Mapping[str, Image], region: Region, radius_m: float
) -> Figure:
    """Draw images of one scene, by their headings, side by side, after the truth if there is any.

    Without truth no point is marked, and nothing is compared.
    """
    headings, shown = [figures.drawable(heading) for heading in images], list(images.values())
    if len(truth):
        headings, shown = ["truth", *headings], [_image_of_truth(truth), *shown]
    scene = _scene(truth, shown, region, radius_m)
    panel_in = PANEL_IN if len(shown) > 1 else LONE_PANEL_IN
    return _perspectives(title, scene, headings, shown, min(len(shown), MAX_COLUMNS), panel_in)[0]


def draw_comparison(
    title: str, truth: PointCloud, heading: str, image: Image, region: Region, radius_m: float
) -> Figure:
    """Draw one image beside the truth, at least one scatterer, and both over each other in projections."""
    scene = _scene(truth, [_image_of_truth(truth), image], region, radius_m)
    x_m, y_m, z_m = scene.upper_m - scene.lower_m
    # The highest projection fills its width.
    projection_in = (COMPARISON_IN / 3 - MARGIN_IN) * max(y_m / x_m, z_m / x_m, z_m / y_m)
    heights_in = [PERSPECTIVE_IN, min(projection_in, MOST_HEIGHT_IN) + LABELS_IN]
    figure = figures.new_figure(COMPARISON_IN, sum(heights_in), legend=_legend(scene), title=title)
    places: list[Any] = [["truth"] * 3 + ["estimate"] * 3, ["xy"] * 2 + ["xz"] * 2 + ["yz"] * 2]
    panels = figure.subplot_mosaic(
        places, per_subplot_kw={("truth", "estimate"): {"projection": "3d"}}, height_ratios=heights_in
    )
    _draw_perspective(panels["truth"], scene, "truth", _image_of_truth(truth), COMPARISON_ZOOM)
    _draw_perspective(panels["estimate"], scene, figures.drawable(heading), image, COMPARISON_ZOOM)
    for plane in ("xy", "xz", "yz"):
        _draw_projection(panels[plane], scene, image.cloud, plane)
    if scene.has_velocities:
        figures.velocity_bar(figure, scene.colours, [panels["truth"], panels["estimate"]])
    return figure


def _image_of_truth(truth: PointCloud) -> Image:
    return Image(truth, counted(len(truth), "scatterer"))


def _scene(truth: PointCloud, images: Sequence[Image], region: Region, radius_m: float) -> _Scene:
    """Choose a box of whole metres around all points, or around the region where there are none."""
    points = np.concatenate([truth.xyz, *(image.cloud.xyz for image in images)])
    if not len(points):
        points = np.array([region.lower_m, region.upper_m])
    lower_m = np.floor(points.min(axis=0))
    upper_m = np.ceil(points.max(axis=0))
    shortest_m = max(SMALLEST_BOX_M, FLATTEST * float((upper_m - lower_m).max()))
    upper_m = np.maximum(upper_m, np.ceil(lower_m + shortest_m))
    colours = figures.velocity_colours(max(map(abs, region.speed_mps)))
    has_velocities = any(image.cloud.has_velocity for image in images)
    return _Scene(truth, lower_m, upper_m, colours, has_velocities, radius_m)


def _perspectives(
    title: str,
    scene: _Scene,
    headings: Sequence[str],
    images: Sequence[Image],
    n_columns: int,
    panel_in: tuple[float, float],
) -> tuple[Figure, list[Axes3D]]:
    """Draw images in perspective, row by row, with one colour bar and, where there is truth, a legend."""
    n_rows = -(-len(images) // n_columns)
    legend = _legend(scene) if len(scene.truth) else ()
    size_in = n_columns * panel_in[0] + 1.0, n_rows * panel_in[1] + 0.5
    # Panels in perspective have their own margins; to measure their labels takes longer than to draw them.
    figure = figures.new_figure(*size_in, legend=legend, title=title, layout=None)
    height_in = figure.get_figheight()
    bottom_in = height_in - size_in[1]
    figure.subplots_adjust(0.01, bottom_in / height_in, 1.0, 1 - 0.4 / height_in, wspace=0, hspace=0)
    panels: list[Axes3D] = []
    for number, (heading, image) in enumerate(zip(headings, images, strict=True), start=1):
        panels.append(figure.add_subplot(n_rows, n_columns, number, projection="3d"))
        _draw_perspective(panels[-1], scene, heading, image, ZOOM)
    if scene.has_velocities:
        figures.velocity_bar(figure, scene.colours, panels)
    return figure, panels


def _draw_perspective(axes: Axes3D, scene: _Scene, heading: str, image: Image, zoom: float) -> None:
    """Draw an image in perspective, the truth faintly behind it, false points marked."""
    axes.computed_zorder = False
    axes.set_facecolor("none")
    axes.view_init(ELEVATION_DEG, AZIMUTH_DEG)
    axes.set_box_aspect(scene.upper_m - scene.lower_m, zoom=zoom)
    x_m, y_m, z_m = zip(scene.lower_m, scene.upper_m, strict=True)
    axes.set(xlim=x_m, ylim=y_m, zlim=z_m)
    for name, axis in zip(AXES, (axes.xaxis, axes.yaxis, axes.zaxis), strict=True):
        axis.set_major_locator(_ticks(scene, name, TICKS))
        axis.set_pane_color("0.95", alpha=1.0 if name == "z" else 0.0)
        axis.set_label_text(f"{name} [m]")
        axis.set_tick_params(pad=1 if name == "z" else -2, labelsize=7)
        axis.labelpad = -6 if name == "z" else -4
    centred: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "top"}
    axes.text2D(0.5, 1.0, heading, weight="bold", **centred)
    axes.text2D(0.5, 0.94, image.note, size=8, color="0.25", **centred)
    style: dict[str, Any] = {"depthshade": False, "clip_on": False}
    axes.scatter(*scene.truth.xyz.T, color=figures.CONTEXT, s=2, linewidths=0, **style)
    for points, marks in _marked(scene, image.cloud):
        axes.scatter(*points.xyz.T, c=scene.colours.to_rgba(points.velocity), **marks, **style)


def _draw_projection(axes: Axes, scene: _Scene, cloud: PointCloud, plane: str) -> None:
    """Draw truth and estimate over each other, projected on a plane."""
    shown = [AXES.index(name) for name in plane]
    across, up = scene.truth.xyz[:, shown].T
    axes.scatter(across, up, s=22, facecolors="none", edgecolors=figures.CONTEXT, linewidths=0.8)
    for points, marks in _marked(scene, cloud):
        across, up = points.xyz[:, shown].T
        axes.scatter(across, up, c=scene.colours.to_rgba(points.velocity), **marks)
    margin_m = 0.02 * float((scene.upper_m - scene.lower_m).max())
    x_m, y_m = zip(scene.lower_m[shown] - margin_m, scene.upper_m[shown] + margin_m, strict=True)
    axes.set(xlim=x_m, ylim=y_m, xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]")
    axes.set_aspect("equal", anchor="S")
    for name, axis in zip(plane, (axes.xaxis, axes.yaxis), strict=True):
        axis.set_major_locator(_ticks(scene, name, TICKS_IN_PROJECTION))
    axes.grid(True)


def _ticks(scene: _Scene, name: str, n_ticks: int) -> MaxNLocator:
    """Ticks along an edge, on a short one in proportion fewer, but three."""
    size_m = scene.upper_m - scene.lower_m
    n_own = round(n_ticks * size_m[AXES.index(name)] / size_m.max())
    return MaxNLocator(max(n_own, 2), steps=[1, 2, 5, 10])


def _marked(scene: _Scene, cloud: PointCloud) -> list[tuple[PointCloud, dict[str, Any]]]:
    """Split a cloud into right and false points, each with its mark; without truth no point is false."""
    is_false = np.zeros(len(cloud), dtype=np.bool_)
    if len(scene.truth):
        is_false = CloudPair(scene.truth, cloud).estimate_to_truth_m > scene.radius_m
    return [
        (cloud.select(~is_false), {"marker": "o", "s": 10, "linewidths": 0}),
        (cloud.select(is_false), {"marker": "x", "s": 20, "linewidths": 1.2}),
    ]


def _legend(scene: _Scene) -> list[Line2D]:
    """Make the entries that explain the marks."""
    false = f"false point: farther than {scene.radius_m:g} m from the truth"
    entries = ("o", figures.CONTEXT, 3, "truth"), ("o", "0.2", 4, "estimate"), ("x", "0.2", 5, false)
    return [
        Line2D([], [], marker=marker, linestyle="", color=colour, markersize=size, label=label)
        for marker, colour, size, label in entries
    ]


def plot_clouds(
    truth: PointCloud | None,
    estimate: PointCloud | Mapping[str, PointCloud],
    *,
    region: Region | None = None,
    radius_m: float = RADIUS_M,
    title: str = "",
    out: str | Path | None = None,
) -> Figure:
    """Draw estimated point clouds beside the truth, or alone where there is no truth.

    Clouds are shown in perspective, coloured by radial velocity, grey where it
    is unknown. One estimate and the truth are also laid over each other in the
    xy, xz and yz projections. A notebook shows the figure after ``%matplotlib
    inline``.

    Parameters
    ----------
    truth : PointCloud or None
        True scatterers in m. None or an empty cloud: no point is compared with
        anything, and none is marked.
    estimate : PointCloud or mapping of str to PointCloud
        One cloud, or several by the titles of their panels.
    region : Region or None
        Region of the scatterers, such as ``scenario.region``: its speeds span
        the colours, and its box is drawn if no cloud has a point. None takes
        the span of the clouds.
    radius_m : float
        Points farther than this from every true scatterer, in m, are drawn as
        crosses; a scenario has its own, ``scenario.radius_m``.
    title : str
        Written above all panels.
    out : str or Path or None
        Picture to write or to overwrite as well: .png, .pdf or .svg.

    Returns
    -------
    Figure
        Of matplotlib, made without pyplot.

    Raises
    ------
    InputError
        If a cloud is no `PointCloud`, there is none to draw, the radius is not
        positive and finite, or the file cannot be written.

    See Also
    --------
    isacbench.score : Scores of an estimate against the truth.

    Examples
    --------
    >>> from isacbench import PointCloud, plot_clouds
    >>> truth = PointCloud(xyz=[[0, 0, 0], [9, 5, 2]], velocity=[0, 8], power=[1, 1])
    >>> estimate = PointCloud(xyz=[[0, 0.2, 0], [6, 5, 2]], velocity=[0, 8], power=[1, 1])
    >>> figure = plot_clouds(truth, estimate, title="one point right, one false")
    >>> figure.get_suptitle()
    'one point right, one false'
    >>> both = plot_clouds(truth, {"first": estimate, "second": truth})
    >>> alone = plot_clouds(None, estimate)
    """
    truth = PointCloud.empty() if truth is None else truth
    clouds = estimate if isinstance(estimate, Mapping) else {"estimate": estimate}
    if not clouds:
        raise InputError("estimate: a mapping without clouds; allowed is at least one")
    named = {f"estimate {name!r}": cloud for name, cloud in clouds.items()}
    for name, value in {"truth": truth, **(named if clouds is estimate else clouds)}.items():
        if not isinstance(value, PointCloud):
            raise InputError(
                f"{name}: allowed is a PointCloud, not {type(value).__name__}; "
                "PointCloud.from_array makes one of columns x, y, z, v"
            )
    require(0 < radius_m < math.inf, "radius_m", radius_m, "a positive, finite number of m")
    path = None if out is None else Path(out)
    if path is not None:
        require_picture(path)
    region = _region_of([truth, *clouds.values()]) if region is None else region
    images = {
        str(name): Image(cloud, counted(len(cloud), "point") if len(cloud) else "no points")
        for name, cloud in clouds.items()
    }
    with figures.styled():
        if len(truth) and len(images) == 1:
            ((heading, image),) = images.items()
            figure = draw_comparison(figures.drawable(title), truth, heading, image, region, radius_m)
        else:
            figure = draw_images(figures.drawable(title), truth, images, region, radius_m)
        # Matplotlib makes ticks at their first layout, in the style of that moment.
        figure.draw_without_rendering()
        if path is not None:
            figures.save(figure, path)
    return figure


def _region_of(clouds: Sequence[PointCloud]) -> Region:
    """Compute the smallest region of all points and speeds; an empty one of no points."""
    points = np.concatenate([cloud.to_array()[:, :4] for cloud in clouds])
    points[np.isnan(points)] = 0.0  # velocities that are unknown
    lower, upper = (points.min(axis=0), points.max(axis=0)) if len(points) else np.zeros((2, 4))
    return Region(*zip(lower.tolist(), upper.tolist(), strict=True))
