"""Triangles of boxes, cylinders and ellipsoids; by the right-hand rule their normals point outwards."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats

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
