"""Points that the base station sees past all surfaces of a scene, found by batched ray casting."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

TOLERANCE_M = 0.02
"""Distance before a point up to which a surface does not hide it: it is the one the point lies on."""

BESIDE_M = 3e-4
"""Distance of the rays beside that to a point: beyond the rounding of single precision at 1 km."""

STEP_M = 3e-4
"""Distance behind a surface from which a ray goes on."""

TINY = 1e-300
"""Least length that is divided by."""

MOST_RAYS = 1000
"""Rays that are cast at once: in double precision each looks at hundreds of triangles of a city."""

NO_PART = -1
"""Part of a point that every surface can hide."""


def seen_points(
    base_station_m: Floats, xyz: Floats, point_part: Integers, triangles: Floats, face_part: Integers
) -> NDArray[np.bool_]:
    """Tell which points the base station sees.

    A point is hidden where the ray to it meets a triangle more than
    `TOLERANCE_M` before it that does not belong to the same part as the point.

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
    four around it do not agree, double precision decides. Without Embree, all
    rays are cast in double precision.
    """
    if not len(triangles) or not len(xyz):
        return np.ones(len(xyz), dtype=bool)
    from trimesh import Trimesh
    from trimesh.ray.ray_triangle import RayMeshIntersector

    corners = (triangles - base_station_m).reshape(-1, 3)
    mesh = Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    places = xyz - base_station_m

    def hidden(tracer: Any, which: Integers, beside: Floats) -> NDArray[np.bool_]:
        chunks = np.array_split(which, -(-len(which) // MOST_RAYS))
        offsets = np.broadcast_to(beside, places.shape)
        parts = [_hidden(tracer, places[few] + offsets[few], point_part[few], face_part) for few in chunks]
        return np.concatenate(parts)

    everything = np.arange(len(places))
    is_hidden = hidden(mesh.ray, everything, np.zeros(3))
    if isinstance(mesh.ray, RayMeshIntersector):
        return ~is_hidden
    beside = np.array([hidden(mesh.ray, everything, offset) for offset in _beside(places)])
    disputed = np.flatnonzero((beside != is_hidden).any(axis=0))
    if disputed.size:
        is_hidden[disputed] = hidden(RayMeshIntersector(mesh), disputed, np.zeros(3))
    return ~is_hidden


def _hidden(tracer: Any, targets: Floats, point_part: Integers, face_part: Integers) -> NDArray[np.bool_]:
    """Tell which targets lie behind a triangle of another part, seen from the origin."""
    mesh = tracer.mesh
    distance_m = np.linalg.norm(targets, axis=1)
    directions = targets / np.maximum(distance_m, TINY)[:, None]
    is_hidden = np.zeros(len(targets), dtype=bool)
    # What touches the base station hides nothing.
    live, start_m = np.flatnonzero(distance_m > TOLERANCE_M), np.full(len(targets), TOLERANCE_M)
    while live.size:
        origins = directions[live] * start_m[live, None]
        first = tracer.intersects_first(origins, directions[live])
        live, first = live[first >= 0], first[first >= 0]
        met_m = _distances(mesh, first, directions[live])
        is_before = met_m < distance_m[live] - TOLERANCE_M
        live, first, met_m = live[is_before], first[is_before], met_m[is_before]
        is_own = (point_part[live] != NO_PART) & (face_part[first] == point_part[live])
        is_hidden[live[~is_own]] = True
        # Past a triangle of the point's own part, the ray goes on.
        live = live[is_own]
        start_m[live] = np.maximum(met_m[is_own], start_m[live]) + STEP_M
    return is_hidden


def _distances(mesh: Any, faces: Integers, directions: Floats) -> Floats:
    """Distances from the origin at which rays meet the planes of triangles; infinite within a plane."""
    normals, corners = mesh.face_normals[faces], mesh.triangles[faces, 0]
    towards = np.einsum("ij,ij->i", normals, directions)
    height_m = np.einsum("ij,ij->i", normals, corners)
    distances_m: Floats = np.divide(height_m, towards, out=np.full(len(faces), np.inf), where=towards != 0)
    return distances_m


def _beside(places: Floats) -> list[Floats]:
    """Offsets (n, 3) across the line of sight, to four sides."""
    is_along_x = np.abs(places[:, :1]) > np.abs(places[:, 1:2])
    across = np.cross(places, np.where(is_along_x, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]))
    sides = across, np.cross(places, across)
    units = [side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), TINY) for side in sides]
    return [sign * BESIDE_M * unit for unit in units for sign in (-1.0, 1.0)]
