"""A box in perspective, drawn on plain axes.

With mplot3d a figure of clouds takes half as long again: it lays out every
tick twice, and projects piece by piece what NumPy projects at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

LABEL = "perspective"
"""Label of the axes that show a perspective."""

ELEVATION_DEG, AZIMUTH_DEG = 27.0, -50.0
EYE_DISTANCE = 2.0
"""From the middle of the box, in its diagonals."""

MARGINS_IN = {"left": 0.28, "right": 0.44, "bottom": 0.25, "top": 0.3}
"""What is left around the box for numbers, names and a note."""

N_TICKS = 4
TICK_IN, GAP_IN = 0.03, 0.05
"""Length of a tick, and what is left between it, its number and the name of the axis."""

NUMBER_PT, NAME_PT = 7.0, 8.0
DIGIT_SHARE, HEIGHT_SHARE = 0.64, 0.73
"""Width and height of a digit over the size of the font."""

NUMBERS_BEGIN = ("right", "top"), ("left", "top"), ("left", "center")
"""Corner or side of a number at its tick, for x, y and z: where edges meet, numbers part."""

GRID, FLOOR = "0.88", "0.95"


@dataclass(frozen=True, eq=False)
class Box:
    """What is drawn of space.

    Attributes
    ----------
    lower_m, upper_m : ndarray of float64, shape (3,)
        Corners in metres.
    """

    lower_m: Floats
    upper_m: Floats

    @property
    def size_m(self) -> Floats:
        """Edges (3,) in metres."""
        return self.upper_m - self.lower_m


class View:
    """Projection of a box onto a panel: one scale in all directions, smaller the farther away.

    Parameters
    ----------
    box : Box
    width_in, height_in : float
        Size of the panel, which the box fills within its margins.
    """

    def __init__(self, box: Box, width_in: float, height_in: float) -> None:
        elevation, azimuth = np.deg2rad([ELEVATION_DEG, AZIMUTH_DEG])
        level, high = np.cos(elevation), np.sin(elevation)
        east, north = np.cos(azimuth), np.sin(azimuth)
        # Rows: to the right, upwards, and towards the eye.
        self._rotation = np.array(
            [[-north, east, 0], [-high * east, -high * north, level], [level * east, level * north, high]]
        )
        self._middle_m = (box.lower_m + box.upper_m) / 2
        self._eye_m = EYE_DISTANCE * float(np.linalg.norm(box.size_m))
        self.box = box
        corners = np.array(np.meshgrid(*np.transpose([box.lower_m, box.upper_m]))).reshape(3, 8).T
        flat = self._flat(corners)
        lower, upper = flat.min(axis=0), flat.max(axis=0)
        first = np.array([MARGINS_IN["left"], MARGINS_IN["bottom"]])
        last = np.array([width_in - MARGINS_IN["right"], height_in - MARGINS_IN["top"]])
        self._scale = float(np.min((last - first) / (upper - lower)))
        self._shift_in = (first + last) / 2 - self._scale * (lower + upper) / 2

    def project(self, points_m: ArrayLike) -> Floats:
        """Project points.

        Parameters
        ----------
        points_m : array_like, shape (..., 3)

        Returns
        -------
        ndarray of float64, shape (..., 2)
            Inches from the lower left corner of the panel.
        """
        projected: Floats = self._scale * self._flat(np.asarray(points_m, dtype=np.float64)) + self._shift_in
        return projected

    def nearness_m(self, points_m: Floats) -> Floats:
        """How much nearer to the eye than the middle of the box points (..., 3) are."""
        nearness: Floats = (points_m - self._middle_m) @ self._rotation[2]
        return nearness

    def _flat(self, points_m: Floats) -> Floats:
        turned = (points_m - self._middle_m) @ self._rotation.T
        flat: Floats = turned[..., :2] / (1 - turned[..., 2:] / self._eye_m)
        return flat


def perspective_axes(figure: Figure, place: SubplotSpec, box: Box) -> tuple[Axes, View]:
    """Make axes with an empty box: floor, grid on the far walls, and three scales in metres.

    Parameters
    ----------
    figure : Figure
    place : SubplotSpec
    box : Box

    Returns
    -------
    axes : Axes
        Its units are inches.
    view : View
        Projects points onto it.
    """
    panel = place.get_position(figure)
    width_in, height_in = panel.width * figure.get_figwidth(), panel.height * figure.get_figheight()
    axes = figure.add_axes(
        panel.bounds,
        xlim=(0, width_in),
        ylim=(0, height_in),
        label=LABEL,
        frameon=False,
        xticks=(),
        yticks=(),
    )
    axes.set_axis_off()
    view = View(box, width_in, height_in)
    _draw_walls(axes, view)
    for index in range(3):
        _draw_scale(axes, view, index)
    return axes, view


def scatter(axes: Axes, view: View, points_m: Floats, colours: Floats | str, **style: Any) -> None:
    """Draw points, the nearer over the farther ones.

    Parameters
    ----------
    axes : Axes
    view : View
    points_m : ndarray of float64, shape (n, 3)
    colours : ndarray of float64, shape (n, 4), or str
        Of each, or of all.
    **style
        As `matplotlib.axes.Axes.scatter` takes it.
    """
    order = np.argsort(view.nearness_m(points_m))
    x, y = view.project(points_m[order]).T
    shown = colours if isinstance(colours, str) else colours[order]
    axes.scatter(x, y, c=shown, clip_on=False, **style)


def tick_step(box: Box, n_ticks: int) -> float:
    """Distance in metres of about so many ticks along the longest edge: 1, 2 or 5 times a power of ten."""
    wanted = box.size_m.max() / n_ticks
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * min((step for step in (1, 2, 5) if step * power >= wanted), default=10))


def tick_places(lower: float, upper: float, step: float) -> Floats:
    """Multiples of a step between two ends, both included.

    Examples
    --------
    >>> tick_places(-3.0, 10.0, 5.0).tolist()
    [0.0, 5.0, 10.0]
    """
    # Adding 0 turns -0, which would be written with its sign, into 0.
    places: Floats = np.arange(np.ceil(lower / step), np.floor(upper / step) + 1) * step + 0.0
    return places


def _draw_walls(axes: Axes, view: View) -> None:
    """Draw the floor, and a grid on it and on the two walls that are farthest from the eye."""
    lower, upper, step = view.box.lower_m, view.box.upper_m, tick_step(view.box, N_TICKS)
    # Far walls: the least x, the largest y and the least z.
    far = np.array([lower[0], upper[1], lower[2]])
    lines = []
    for index in range(3):
        for across in {0, 1, 2} - {index}:
            for tick in (lower[index], *tick_places(lower[index], upper[index], step), upper[index]):
                line = np.stack([far, far])
                line[:, index] = tick
                line[:, across] = lower[across], upper[across]
                lines.append(line)
    floor = np.array([lower, lower, upper, upper])
    floor[:, 1] = lower[1], upper[1], upper[1], lower[1]
    floor[:, 2] = lower[2]
    axes.fill(*view.project(floor).T, color=FLOOR, linewidth=0, zorder=0)
    axes.add_collection(LineCollection(list(view.project(lines)), colors=GRID, linewidths=0.6, zorder=0.5))


def _draw_scale(axes: Axes, view: View, index: int) -> None:
    """Draw one of the three scales along the edge of the box where it is outside of everything."""
    lower, upper = view.box.lower_m, view.box.upper_m
    start = np.array([(lower[0], lower[1], lower[2]), (upper[0], lower[1], lower[2]), upper][index])
    start[index] = lower[index]
    end = start.copy()
    end[index] = upper[index]
    edge_in = view.project([start, end])
    outwards = _outwards(edge_in, view.project((lower + upper) / 2))
    ticks = tick_places(lower[index], upper[index], tick_step(view.box, N_TICKS))
    on_edge = np.repeat(start[None], ticks.size, axis=0)
    on_edge[:, index] = ticks
    marks_in = view.project(on_edge)
    lines = [edge_in, *np.stack([marks_in, marks_in + TICK_IN * outwards], axis=1)]
    axes.add_collection(LineCollection(lines, colors="k", linewidths=0.8, zorder=0.6))
    numbers = [f"{tick:g}" for tick in ticks]
    ha, va = NUMBERS_BEGIN[index]
    for number, (x, y) in zip(numbers, marks_in + (TICK_IN + GAP_IN) * outwards, strict=True):
        axes.text(x, y, number, size=NUMBER_PT, ha=ha, va=va)
    along = edge_in[1] - edge_in[0]
    x, y = edge_in.mean(axis=0) + _name_distance_in(numbers, outwards) * outwards
    angle_deg = float(np.rad2deg(np.arctan2(along[1], along[0])))
    axes.text(x, y, f"{'xyz'[index]} [m]", size=NAME_PT, rotation=angle_deg, ha="center", va="center")


def _name_distance_in(numbers: Sequence[str], outwards: Floats) -> float:
    """Distance from an edge to the middle of its axis's name, beyond the largest number."""
    n_digits = max(map(len, numbers), default=0)
    size_in = np.array([DIGIT_SHARE * n_digits, HEIGHT_SHARE]) * NUMBER_PT / 72
    return TICK_IN + 3 * GAP_IN + float(np.abs(outwards) @ size_in) + NAME_PT / 72 / 2


def _outwards(edge_in: Floats, middle_in: Floats) -> Floats:
    """Unit vector (2,) at right angles to an edge, away from the middle."""
    along = edge_in[1] - edge_in[0]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    away: Floats = normal * np.sign(normal @ (edge_in[0] - middle_in))
    return away
