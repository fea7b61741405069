"""Pictures of point clouds, for notebooks and for the command ``isacbench image``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from isacbench.errors import InputError, require
from isacbench.files.checked_files import require_picture
from isacbench.files.escaping import counted
from isacbench.metrics.geometry import RADIUS_M
from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.report.drawing.style import drawable, save, styled
from isacbench.report.figures.cloud_figures import Image, draw_comparison, draw_images

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure


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
    is unknown. One estimate
    and the truth are also laid over each other in the xy, xz and yz
    projections. A notebook shows the figure after ``%matplotlib inline``.

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
    truth = PointCloud.empty() if truth is None else _cloud("truth", truth)
    clouds = _named(estimate)
    require(0 < radius_m < math.inf, "radius_m", radius_m, "a positive, finite number of m")
    path = None if out is None else Path(out)
    if path is not None:
        require_picture(path)
    region = _span([truth, *clouds.values()]) if region is None else region
    images = {name: Image(cloud, _note(cloud)) for name, cloud in clouds.items()}
    with styled():
        if len(truth) and len(images) == 1:
            ((heading, image),) = images.items()
            figure = draw_comparison(drawable(title), truth, heading, image, region, radius_m)
        else:
            figure = draw_images(drawable(title), truth, images, region, radius_m)
        # Matplotlib makes ticks at their first layout, in the style of that moment.
        figure.draw_without_rendering()
        if path is not None:
            save(figure, path)
    return figure


def _named(estimate: PointCloud | Mapping[str, PointCloud]) -> dict[str, PointCloud]:
    """Key clouds by the titles of their panels."""
    if not isinstance(estimate, Mapping):
        return {"estimate": _cloud("estimate", estimate)}
    if not estimate:
        raise InputError("estimate: a mapping without clouds; allowed is at least one")
    return {str(name): _cloud(f"estimate {name!r}", cloud) for name, cloud in estimate.items()}


def _cloud(name: str, value: object) -> PointCloud:
    """Refuse values that are no cloud."""
    if not isinstance(value, PointCloud):
        raise InputError(
            f"{name}: allowed is a PointCloud, not {type(value).__name__}; "
            "PointCloud.from_array makes one of columns x, y, z, v"
        )
    return value


def _span(clouds: Sequence[PointCloud]) -> Region:
    """Compute the smallest region of all points and speeds; an empty one of no points."""
    points = np.concatenate([cloud.to_array()[:, :4] for cloud in clouds])
    points[np.isnan(points)] = 0.0  # velocities that are unknown
    lower, upper = (points.min(axis=0), points.max(axis=0)) if len(points) else np.zeros((2, 4))
    return Region(*zip(lower.tolist(), upper.tolist(), strict=True))


def _note(cloud: PointCloud) -> str:
    return counted(len(cloud), "point") if len(cloud) else "no points"
