"""Pictures of point clouds: in perspective and in projection, coloured by radial velocity."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import AsinhNorm, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from isacbench.charts import Variant, nearest_values
from isacbench.errors import InputError, require
from isacbench.files.checked_files import require_picture
from isacbench.files.escaping import plural
from isacbench.metrics.geometry import RADIUS_M, CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.report import figures

Axes3D = Any  # mpl_toolkits has no types

PANEL_IN, LONE_PANEL_IN = (3.2, 2.7), (5.6, 4.6)
MAX_COLUMNS = 4
ELEVATION_DEG, AZIMUTH_DEG = 27.0, -50.0

TICKS = 5
"""About so many ticks along the longest edge of a box."""

SMALLEST_BOX_M = 2.0
FLATTEST = 0.1
"""Shortest edge of a box over its longest one: the scales of a flatter box would overlap."""

AXES = "xyz"

CONTEXT = "0.72"
"""Grey of the truth behind an estimate."""

# Dark in the middle, so that static points are seen on white.
VELOCITY_COLOURS = ("#3FA7E6", "#0072B2", "#333333", "#D55E00", "#F2A900")
UNKNOWN = "#7A7A7A"
"""Grey of points whose velocity is unknown."""

VELOCITY = "radial velocity [m/s], approaching > 0"
SLOW_MPS = 2.0
TICKS_MPS = np.array([-200, -100, -50, -20, -10, -5, -2, 0, 2, 5, 10, 20, 50, 100, 200])

MOST_CLOUDS = 16
"""Most estimators of which clouds, maps and spectra are shown; of more, those of least mean deviation."""

SHOWN_SNR_DB = 10.0
"""SNR at which a page opens, and of its maps and of pictures of worst scenes."""


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


def velocity_colours(fastest_mps: float) -> ScalarMappable:
    """Map radial velocities to colours: 0 in the middle, slow ones spread to differ visibly from it.

    The fastest speed is at both ends. Unknown velocities, NaN, have a colour of their own.
    """
    fastest_mps = max(SLOW_MPS, fastest_mps)
    colours = LinearSegmentedColormap.from_list("velocity", VELOCITY_COLOURS).with_extremes(bad=UNKNOWN)
    return ScalarMappable(AsinhNorm(SLOW_MPS, -fastest_mps, fastest_mps), colours)


def best_variants(rows: pd.DataFrame, candidates: Sequence[Variant]) -> list[Variant]:
    """Choose the estimators of a scenario whose clouds are drawn: those of least mean deviation."""
    if len(candidates) <= MOST_CLOUDS:
        return list(candidates)
    means = rows.groupby(["estimator", "params"], sort=False)["deviation"].mean()
    # What failed throughout has no mean, and comes last.
    best = set(means.reindex(list(candidates)).sort_values(kind="stable").index[:MOST_CLOUDS])
    return [variant for variant in candidates if variant in best]


def shown_snr_db(rows: pd.DataFrame) -> float:
    """Find the SNR of the rows that is nearest to `SHOWN_SNR_DB`."""
    return nearest_values(sorted(rows["snr_db"].unique()), [SHOWN_SNR_DB])[0]


def image_of_truth(truth: PointCloud) -> Image:
    """Make the image of the truth that stands beside estimates."""
    return Image(truth, plural(len(truth), "scatterer"))


def draw_clouds(
    title: str,
    truth: PointCloud,
    region: Region,
    radius_m: float,
    images: Sequence[tuple[str, Image]],
    n_columns: int = MAX_COLUMNS,
) -> Figure:
    """Draw images of one scenario by their headings, in rows, the truth faintly behind each.

    The speeds of the region span the colours, and a point farther than the radius from the truth is marked
    as false. Without truth no point is marked.
    """
    scene = _scene(truth, [image for _, image in images], region, radius_m)
    n_columns = min(len(images), n_columns)
    n_rows = -(-len(images) // n_columns)
    width_in, height_in = PANEL_IN if len(images) > 1 else LONE_PANEL_IN
    # Panels in perspective have their own margins; to measure their labels takes longer than to draw them.
    size_in = n_columns * width_in + 1.0, n_rows * height_in + 0.5
    figure = figures.new_figure(*size_in, legend=_legend(scene), title=title, layout=None)
    margin = 0.4 / figure.get_figheight()
    figure.subplots_adjust(0.01, margin, 1.0, 1 - margin, wspace=0, hspace=0)
    panels: list[Axes3D] = []
    for number, (heading, image) in enumerate(images, start=1):
        panels.append(figure.add_subplot(n_rows, n_columns, number, projection="3d"))
        _draw_perspective(panels[-1], scene, heading, image)
    _draw_velocity_bar(figure, scene, panels)
    return figure


def draw_comparison(
    title: str, truth: PointCloud, heading: str, image: Image, region: Region, radius_m: float
) -> Figure:
    """Draw one image beside the truth, at least one scatterer, and both over each other in projections."""
    scene = _scene(truth, [image_of_truth(truth), image], region, radius_m)
    figure = figures.new_figure(11.0, 7.0, legend=_legend(scene), title=title)
    places: list[Any] = [["truth"] * 3 + ["estimate"] * 3, ["xy"] * 2 + ["xz"] * 2 + ["yz"] * 2]
    panels = figure.subplot_mosaic(
        places, per_subplot_kw={("truth", "estimate"): {"projection": "3d"}}, height_ratios=(4, 3)
    )
    _draw_perspective(panels["truth"], scene, "truth", image_of_truth(truth))
    _draw_perspective(panels["estimate"], scene, heading, image)
    for plane in ("xy", "xz", "yz"):
        _draw_projection(panels[plane], scene, image.cloud, plane)
    _draw_velocity_bar(figure, scene, [panels["truth"], panels["estimate"]])
    return figure


def _scene(truth: PointCloud, images: Sequence[Image], region: Region, radius_m: float) -> _Scene:
    """Choose a box of whole metres around all points, or around the region where there are none."""
    points = np.concatenate([truth.xyz, *(image.cloud.xyz for image in images)])
    if not len(points):
        points = np.array([region.lower_m, region.upper_m])
    lower_m = np.floor(points.min(axis=0))
    upper_m = np.ceil(points.max(axis=0))
    shortest_m = max(SMALLEST_BOX_M, FLATTEST * float((upper_m - lower_m).max()))
    upper_m = np.maximum(upper_m, np.ceil(lower_m + shortest_m))
    colours = velocity_colours(max(map(abs, region.speed_mps)))
    has_velocities = any(image.cloud.has_velocity for image in images)
    return _Scene(truth, lower_m, upper_m, colours, has_velocities, radius_m)


def _draw_perspective(axes: Axes3D, scene: _Scene, heading: str, image: Image) -> None:
    """Draw an image in perspective, the truth faintly behind it, false points marked."""
    axes.computed_zorder = False
    axes.view_init(ELEVATION_DEG, AZIMUTH_DEG)
    axes.set_box_aspect(scene.upper_m - scene.lower_m, zoom=0.85)
    x_m, y_m, z_m = zip(scene.lower_m, scene.upper_m, strict=True)
    axes.set(xlim=x_m, ylim=y_m, zlim=z_m)
    for name, axis in zip(AXES, (axes.xaxis, axes.yaxis, axes.zaxis), strict=True):
        axis.set_major_locator(_ticks(scene, name))
        axis.set_label_text(f"{name} [m]")
        axis.set_tick_params(pad=-2, labelsize=7)
        axis.labelpad = -5
    centred: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "top"}
    axes.text2D(0.5, 1.0, figures.drawable(heading), weight="bold", **centred)
    axes.text2D(0.5, 0.94, image.note, size=8, **centred)
    style: dict[str, Any] = {"depthshade": False, "clip_on": False}
    axes.scatter(*scene.truth.xyz.T, color=CONTEXT, s=2, linewidths=0, **style)
    for points, marks in _points_with_marks(scene, image.cloud):
        axes.scatter(*points.xyz.T, c=scene.colours.to_rgba(points.velocity), **marks, **style)


def _draw_projection(axes: Axes, scene: _Scene, cloud: PointCloud, plane: str) -> None:
    """Draw truth and estimate over each other, projected on a plane."""
    columns = [AXES.index(name) for name in plane]
    across, up = scene.truth.xyz[:, columns].T
    axes.scatter(across, up, s=22, facecolors="none", edgecolors=CONTEXT)
    for points, marks in _points_with_marks(scene, cloud):
        across, up = points.xyz[:, columns].T
        axes.scatter(across, up, c=scene.colours.to_rgba(points.velocity), **marks)
    margin_m = 0.02 * float((scene.upper_m - scene.lower_m).max())
    x_m, y_m = zip(scene.lower_m[columns] - margin_m, scene.upper_m[columns] + margin_m, strict=True)
    axes.set(xlim=x_m, ylim=y_m, xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]")
    axes.set_aspect("equal")
    axes.xaxis.set_major_locator(_ticks(scene, plane[0]))
    axes.yaxis.set_major_locator(_ticks(scene, plane[1]))
    axes.grid(True)


def _draw_velocity_bar(figure: Figure, scene: _Scene, panels: Sequence[Axes3D]) -> None:
    """Draw the colours of velocities to the right of some panels, if there are any."""
    if scene.has_velocities:
        ticks = TICKS_MPS[np.abs(TICKS_MPS) <= (scene.colours.norm.vmax or 0.0)]
        place: dict[str, Any] = {"fraction": 0.8 / figure.get_figwidth(), "shrink": 0.7}
        figure.colorbar(scene.colours, ax=panels, label=VELOCITY, ticks=ticks, format="%g", **place)


def _ticks(scene: _Scene, name: str) -> MaxNLocator:
    """Ticks along an edge, on a short one in proportion fewer, but three."""
    size_m = scene.upper_m - scene.lower_m
    n_own = round(TICKS * size_m[AXES.index(name)] / size_m.max())
    return MaxNLocator(max(n_own, 2), steps=[1, 2, 5, 10])


def _points_with_marks(scene: _Scene, cloud: PointCloud) -> list[tuple[PointCloud, dict[str, Any]]]:
    """Split a cloud into right and false points, each with its mark; without truth no point is false."""
    is_false = np.zeros(len(cloud), dtype=np.bool_)
    if len(scene.truth):
        is_false = CloudPair(scene.truth, cloud).estimate_to_truth_m > scene.radius_m
    return [
        (cloud.select(~is_false), {"marker": "o", "s": 10, "linewidths": 0}),
        (cloud.select(is_false), {"marker": "x", "s": 20, "linewidths": 1.2}),
    ]


def _legend(scene: _Scene) -> list[Line2D]:
    """Make the entries that explain the marks; none where there is no truth."""
    false = f"false point: farther than {scene.radius_m:g} m from the truth"
    entries = ("o", CONTEXT, "truth"), ("o", "0.2", "estimate"), ("x", "0.2", false)
    return [
        Line2D([], [], marker=marker, linestyle="", color=colour, label=label)
        for marker, colour, label in (entries if len(scene.truth) else ())
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
    for name, cloud in [("truth", truth), *((f"estimate {key!r}", one) for key, one in clouds.items())]:
        if not isinstance(cloud, PointCloud):
            raise InputError(
                f"{name}: allowed is a PointCloud, not {type(cloud).__name__}; "
                "PointCloud.from_array makes one of columns x, y, z, v"
            )
    require(0 < radius_m < math.inf, "radius_m", radius_m, "a positive, finite number of m")
    if out is not None:
        require_picture(Path(out))
    region = _region_of([truth, *clouds.values()]) if region is None else region
    images = [
        (str(name), Image(cloud, plural(len(cloud), "point") if len(cloud) else "no points"))
        for name, cloud in clouds.items()
    ]
    title = figures.drawable(title)
    with figures.styled():
        if len(truth) and len(images) == 1:
            figure = draw_comparison(title, truth, *images[0], region, radius_m)
        else:
            panels = [("truth", image_of_truth(truth))] if len(truth) else []
            figure = draw_clouds(title, truth, region, radius_m, panels + images)
        # Matplotlib makes ticks at their first layout, in the style of that moment.
        figure.draw_without_rendering()
        if out is not None:
            figures.save(figure, Path(out))
    return figure


def _region_of(clouds: Sequence[PointCloud]) -> Region:
    """Compute the smallest region of all points and speeds; an empty one of no points."""
    points = np.concatenate([cloud.to_array()[:, :4] for cloud in clouds])
    points[np.isnan(points)] = 0.0  # velocities that are unknown
    lower, upper = (points.min(axis=0), points.max(axis=0)) if len(points) else np.zeros((2, 4))
    return Region(*zip(lower.tolist(), upper.tolist(), strict=True))
