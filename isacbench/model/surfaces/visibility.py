"""Points that the base station sees past all surfaces of a scene."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Floats, Integers, Mask

TOLERANCE_M = 0.02
"""Distance before a point up to which a surface does not hide it: it is the one the point lies on."""

TINY = 1e-300
"""Least length that is divided by."""

MOST_PAIRS = 2**20
"""Rays and triangles that are looked at together."""

MARGIN = 1e-6
"""Width around a triangle, as a chord of the unit sphere, in which rays are looked at: beyond rounding."""

WIDEST = np.sqrt(2)
"""Chord of a hemisphere: of wider triangles all rays are looked at."""

NO_PART = -1
"""Part of a point that every surface can hide."""


def seen_points(
    base_station_m: Floats, xyz: Floats, point_part: Integers, triangles: Floats, face_part: Integers
) -> Mask:
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
        Corners. Both sides hide; nothing need be closed. What touches the base
        station hides nothing.
    face_part : ndarray of int, shape (m,)

    Returns
    -------
    ndarray of bool, shape (n,)

    Notes
    -----
    All rays start at the base station. One meets a triangle if it lies on the
    same side of the three planes through the station and an edge; two triangles
    share the plane of a common edge to the last digit, so that no ray leaks
    between them. A tree of the rays' directions finds those near a triangle.
    """
    is_hidden = np.zeros(len(xyz), dtype=bool)
    if not len(triangles) or not len(xyz):
        return ~is_hidden
    places, corners = xyz - base_station_m, triangles - base_station_m
    distance_m = np.linalg.norm(places, axis=1)
    directions = places / np.maximum(distance_m, TINY)[:, None]
    planes = np.cross(corners, np.roll(corners, -1, axis=1))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    heights = np.einsum("ij,ij->i", normals, corners[:, 0])
    tree, (middles, chords) = cKDTree(directions), _caps(corners)
    step = max(1, MOST_PAIRS // len(xyz))
    for faces in (
        np.arange(first, min(first + step, len(corners))) for first in range(0, len(corners), step)
    ):
        near = tree.query_ball_point(middles[faces], chords[faces])
        face = np.repeat(faces, [len(rays) for rays in near])
        ray = np.concatenate([np.array(rays, dtype=np.intp) for rays in near])
        is_other = (point_part[ray] == NO_PART) | (face_part[face] != point_part[ray])
        ray, face = ray[is_other], face[is_other]
        sides = np.einsum("ik,ijk->ij", directions[ray], planes[face])
        is_within = (sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)
        towards = np.einsum("ij,ij->i", directions[ray], normals[face])
        met_m = np.divide(heights[face], towards, out=np.full(len(face), np.inf), where=towards != 0)
        is_hidden[ray[is_within & (met_m > TOLERANCE_M) & (met_m < distance_m[ray] - TOLERANCE_M)]] = True
    return ~is_hidden


def _caps(corners: Floats) -> tuple[Floats, Floats]:
    """Caps of the unit sphere around triangles seen from its centre: middles (m, 3), and chords (m,)."""
    distances_m = np.linalg.norm(corners, axis=2, keepdims=True)
    units = corners / np.maximum(distances_m, TINY)
    middles = units.mean(axis=1)
    middles /= np.maximum(np.linalg.norm(middles, axis=1, keepdims=True), TINY)
    chords = np.linalg.norm(units - middles[:, None], axis=2).max(axis=1) + MARGIN
    is_wide = (chords > WIDEST) | (distances_m <= TINY).any(axis=(1, 2))
    return middles, np.where(is_wide, 2 + MARGIN, chords)
