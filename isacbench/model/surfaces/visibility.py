"""Points that the base station sees past all surfaces of a scene, found by batched ray casting."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

TOLERANCE_M = 0.02
"""Distance before a point up to which a surface does not hide it: it is the one the point lies on."""

BESIDE_M = 3e-4
"""Distance of the rays beside that to a point: beyond the rounding of single precision at 1 km."""

NO_PART = -1
"""Part of a point that every surface can hide."""


def seen_points(
    base_station_m: Floats, xyz: Floats, point_part: Integers, triangles: Floats, face_part: Integers
) -> NDArray[np.bool_]:
    """Tell which points the base station sees.

    A point is hidden where the first triangle on the ray to it is more than
    `TOLERANCE_M` nearer, and does not belong to the same part as the point.

    Parameters
    ----------
    base_station_m : ndarray of float64, shape (3,)
    xyz : ndarray of float64, shape (n, 3)
    point_part : ndarray of int, shape (n,)
        Part that does not hide the point, or `NO_PART`.
    triangles : ndarray of float64, shape (m, 3, 3)
        Corners. Both sides hide; nothing need be closed.
    face_part : ndarray of int, shape (m,)

    Returns
    -------
    ndarray of bool, shape (n,)

    Notes
    -----
    Embree casts rays in single precision, which misses or leaks within 0.1 mm
    of an edge, and not alike on all processors. Where the ray to a point and
    four around it do not agree, double precision decides.
    """
    if not len(triangles) or not len(xyz):
        return np.ones(len(xyz), dtype=bool)
    from trimesh import Trimesh
    from trimesh.ray.ray_triangle import RayMeshIntersector

    corners = (triangles - base_station_m).reshape(-1, 3)
    mesh = Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    places = xyz - base_station_m

    def hidden(
        cast: Callable[..., Any], which: NDArray[Any], beside: Floats | float = 0.0
    ) -> NDArray[np.bool_]:
        targets = places[which] + beside
        first = cast(np.zeros_like(targets), targets)
        return _is_hidden(first, targets, point_part[which], mesh, face_part)

    everything = np.arange(len(places))
    by_embree = mesh.ray.intersects_first
    votes = [hidden(by_embree, everything, offset) for offset in [np.zeros((1, 3)), *_beside(places)]]
    is_hidden = votes[0].copy()
    disputed = np.flatnonzero((np.array(votes) != is_hidden).any(axis=0))
    if disputed.size:
        is_hidden[disputed] = hidden(RayMeshIntersector(mesh).intersects_first, disputed)
    return ~is_hidden


def _is_hidden(
    first: Integers, targets: Floats, point_part: Integers, mesh: Any, face_part: Integers
) -> NDArray[np.bool_]:
    """Tell which targets lie behind the first triangle on their ray; -1 is none."""
    normals, corners = mesh.face_normals[first], mesh.triangles[first, 0]
    towards = np.einsum("ij,ij->i", normals, targets)
    # The plane is met at this share of the way; a ray within its plane is not stopped by it.
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.einsum("ij,ij->i", normals, corners) / towards
    before_m = (1 - share) * np.linalg.norm(targets, axis=1)
    is_own = (point_part != NO_PART) & (face_part[first] == point_part)
    is_hidden: NDArray[np.bool_] = (first >= 0) & ~is_own & (share > 0) & (before_m > TOLERANCE_M)
    return is_hidden


def _beside(places: Floats) -> list[Floats]:
    """Offsets (n, 3) across the line of sight, to four sides."""
    across = np.cross(places, np.where(np.abs(places[:, :1]) > np.abs(places[:, 1:2]), [0, 1, 0], [1, 0, 0]))
    units = [
        side / np.linalg.norm(side, axis=1, keepdims=True) for side in (across, np.cross(places, across))
    ]
    return [sign * BESIDE_M * unit for unit in units for sign in (-1.0, 1.0)]
