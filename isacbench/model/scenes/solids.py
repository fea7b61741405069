"""Solids of objects: the surfaces that hide what lies behind them, from boxes, cylinders and ellipsoids.

Every function takes the keys of a kind as its outline in
`isacbench.model.scenes.objects` does, and returns the parts of the object. A
part is triangles (n, 3, 3) around the object's foot point, and the numbers of
those points of the outline that it does not hide, because they stand for the
part: thin parts have their points on their axis. All other points lie on
surfaces, and every part hides them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats
from isacbench.model.scenes import objects

SECTIONS = 24
"""Sides of a cylinder."""

SUBDIVISIONS = 2
"""Times that the triangles of an icosahedron are cut into four."""

_BOX_FACES = [
    *([1, 3, 0], [4, 1, 0], [0, 3, 2], [2, 4, 0], [1, 7, 3], [5, 1, 4]),
    *([5, 7, 1], [3, 7, 2], [6, 4, 2], [2, 7, 6], [6, 5, 4], [7, 5, 6]),
]
_GOLDEN = (1 + 5**0.5) / 2
_ICOSAHEDRON = np.array(
    [
        *([-1, _GOLDEN, 0], [1, _GOLDEN, 0], [-1, -_GOLDEN, 0], [1, -_GOLDEN, 0]),
        *([0, -1, _GOLDEN], [0, 1, _GOLDEN], [0, -1, -_GOLDEN], [0, 1, -_GOLDEN]),
        *([_GOLDEN, 0, -1], [_GOLDEN, 0, 1], [-_GOLDEN, 0, -1], [-_GOLDEN, 0, 1]),
    ]
)
_ICOSAHEDRON_FACES = [
    *([0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4], [11, 10, 2]),
    *([10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5]),
    *([2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]),
]

BAR_M, MAST_M, ARM_M = 0.05, 0.08, 0.04
"""Radii of a rail's bars and of a pole, of a mast, and of its arms."""

TYRE_M = 0.2
"""Width of a wheel."""


def cuboid(lower: ArrayLike, upper: ArrayLike) -> Floats:
    """Triangles (12, 3, 3) of a box along the axes, from its lower and upper corner."""
    corners = np.array([*product(*np.transpose([lower, upper]).tolist())], dtype=float)
    return corners[_BOX_FACES]


def tube(start: ArrayLike, end: ArrayLike, radius_m: float) -> Floats:
    """Triangles (96, 3, 3) of a closed cylinder, from the ends of its axis."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    turned = _frame_along(end - start) @ _frame_along(np.array([0.0, 0.0, 1.0])).T
    angles = 2 * np.pi * np.arange(SECTIONS) / SECTIONS
    ring = radius_m * (np.cos(angles)[:, None] * turned[:, 0] + np.sin(angles)[:, None] * turned[:, 1])
    below, above = ring + start, ring + end
    next_below, next_above = np.roll(below, -1, axis=0), np.roll(above, -1, axis=0)
    feet, heads = np.broadcast_to(start, ring.shape), np.broadcast_to(end, ring.shape)
    sides = [
        *([below, feet, next_below], [below, next_below, above]),
        *([above, next_below, next_above], [above, next_above, heads]),
    ]
    return np.moveaxis(np.array(sides), 2, 0).reshape(-1, 3, 3)


def globe(centre: ArrayLike, semi_axes_m: ArrayLike) -> Floats:
    """Triangles (320, 3, 3) of an ellipsoid along the axes."""
    triangles = _units(_ICOSAHEDRON)[_ICOSAHEDRON_FACES]
    for _ in range(SUBDIVISIONS):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = (_units(one + other) for one, other in ((a, b), (b, c), (c, a)))
        parts = np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
        triangles = np.moveaxis(parts, 2, 0).reshape(-1, 3, 3)
    return triangles * np.asarray(semi_axes_m, dtype=float) + np.asarray(centre, dtype=float)


def _frame_along(vector: Floats) -> Floats:
    """Right-handed orthonormal frame (3, 3) whose first axis is along a vector, up to its sign."""
    frame: Floats = np.linalg.svd(vector[:, None])[0]
    frame[:, -1] *= np.sign(np.linalg.det(frame))
    return frame


def _units(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


Part = tuple[Floats, Sequence[int]]


def solid_of(kind: str, keys: dict[str, Any]) -> list[Part]:
    """Parts of an object of a kind, whose keys are the sizes that its outline takes."""
    return _SOLIDS[kind](**keys) if kind in _SOLIDS else []


def _car(size_m: Sequence[float]) -> list[Part]:
    width, length, height = size_m
    half = 0.45 * width
    body = cuboid([-half, -length / 2, height / 6], [half, length / 2, height / 2])
    return [(body, ()), (cuboid([-half, -length / 4, height / 2], [half, length / 4, height]), ())]


def _vehicle(size_m: Sequence[float], spacing_m: float) -> list[Part]:
    width, length, height = size_m
    half, rows = width / 2, objects.cabin_rows(length, spacing_m)
    body = cuboid([-half, -length / 2, objects.SILL_M], [half, length / 2, objects.WAIST_M])
    hubs = objects.axle_ends(width, [-0.3 * length, 0.3 * length], objects.WHEEL_RADIUS_M)
    parts: list[Part] = [(body, ()), *_wheels(hubs, objects.WHEEL_RADIUS_M)]
    if len(rows):  # a wide spacing leaves no row of the cabin
        parts.append((cuboid([-half, rows[0], objects.WAIST_M], [half, rows[-1], height]), ()))
    return parts


def _lorry(size_m: Sequence[float], spacing_m: float) -> list[Part]:
    boxes: list[Part] = [(cuboid(*corners), ()) for corners in objects.lorry_boxes(size_m)]
    return [*boxes, *_wheels(objects.lorry_hubs(size_m), objects.LORRY_WHEEL_M)]


def _wheels(hubs: Floats, radius_m: float) -> list[Part]:
    """Wheels whose outer sides have the hubs."""
    return [(tube(hub, hub - [np.copysign(TYRE_M, hub[0]), 0, 0], radius_m), ()) for hub in hubs]


def _pedestrian(height_m: float, stride_phase_deg: float) -> list[Part]:
    return _person(objects.pedestrian(height_m, stride_phase_deg))


def _cyclist(crank_phase_deg: float) -> list[Part]:
    """Rider; spokes and frame hide nothing."""
    return _person(objects.cyclist(crank_phase_deg)[:12])


def _person(points: Floats) -> list[Part]:
    """Trunk, head, arms and legs of a person; the points of each stand for it."""
    head, shoulders, _, hips, _, _ = (points[:6] + points[6:]) / 2
    shoulder_m = float(np.linalg.norm(points[1] - points[7])) / 2
    parts: list[Part] = [
        (tube(hips, shoulders, 0.8 * shoulder_m), (1, 3, 7, 9)),
        (globe(head, np.full(3, 0.6 * shoulder_m)), (0, 6)),
    ]
    for side in (0, 6):
        _, shoulder, hand, hip, knee, foot = points[side : side + 6]
        leg = np.concatenate([tube(hip, knee, 0.4 * shoulder_m), tube(knee, foot, 0.3 * shoulder_m)])
        parts += [(tube(shoulder, hand, 0.25 * shoulder_m), (side + 2,)), (leg, (side + 4, side + 5))]
    return parts


def _lamp_post(height_m: float, foot_m: float, spacing_m: float, arm_m: float) -> list[Part]:
    points = objects.lamp_post(height_m, foot_m, spacing_m, arm_m)
    n_mast, top = len(points) - 4, [0.0, 0.0, height_m]
    arms: list[Part] = [(tube(top, points[tip], ARM_M), (tip,)) for tip in range(n_mast, n_mast + 4)]
    return [(tube(np.zeros(3), top, MAST_M), range(n_mast)), *arms]


def _box(size_m: Sequence[float], spacing_m: float) -> list[Part]:
    width, length, height = size_m
    return [(cuboid([-width / 2, -length / 2, 0.0], [width / 2, length / 2, height]), ())]


def _wall(size_m: Sequence[float], spacing_m: float) -> list[Part]:
    length, height = size_m
    a, b, c, d = [[0.0, y, z] for y, z in ((-0.5, 0), (0.5, 0), (0.5, 1), (-0.5, 1))]
    return [(np.array([[a, b, c], [a, c, d]]) * [1.0, length, height], ())]


def _pole(height_m: float, spacing_m: float) -> list[Part]:
    axis = tube(np.zeros(3), [0.0, 0.0, height_m], BAR_M)
    return [(axis, range(len(objects.pole(height_m, spacing_m))))]


def _rail(length_m: float, spacing_m: float) -> list[Part]:
    n = len(objects.rail(length_m, spacing_m))
    return [
        (tube([0.0, -length_m / 2, z], [0.0, length_m / 2, z], BAR_M), range(bar, n, 2))
        for bar, z in enumerate(objects.RAIL_HEIGHTS_M)
    ]


_SOLIDS: dict[str, Callable[..., list[Part]]] = {
    "car": _car,
    "vehicle": _vehicle,
    "lorry": _lorry,
    "pedestrian": _pedestrian,
    "cyclist": _cyclist,
    "lamp_post": _lamp_post,
    "green_belt": _box,
    "box": _box,
    "wall": _wall,
    "pole": _pole,
    "rail": _rail,
}
