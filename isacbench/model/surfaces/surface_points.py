"""Points on triangles, about one for each square of a spacing, and those that the base station sees."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Floats, Integers, Mask, parts_of
from isacbench.errors import InputError, import_extra
from isacbench.model.number_limits import require_places

MOST_SURFACE_POINTS = 200_000
"""Largest number of points that a mesh is sampled at."""

SLACK_M = 1e-6
"""Distance up to which a surface outside a box counts as on it: beyond the rounding of what cuts."""

SAME_M = 0.02
"""Distance of points at one place, such as the two faces of a thin sheet: both are seen from one side."""

MOST_CANDIDATES = 20_000_000
"""Largest number of places of which points are chosen."""

SAMPLED = "the surface of a mesh, a cylinder or an ellipsoid"
"""What is sampled, in messages."""

CANDIDATES = 3
"""Candidates along a side of a cell."""

NEAREST = 0.6
"""Least distance of two points on surfaces that face alike, in spacings."""

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


def surface_points(triangles: Floats, spacing_m: float) -> Floats:
    """Sample triangles (m, 3, 3), whose outer side the right-hand rule gives, at points (n, 3).

    Space is divided into cubic cells of about the spacing, from the lower corner of the bounding box on. In
    every cell, each of the six sides towards which surfaces face has one point: the one nearest to the
    middle of the cell. So a box has points in equal steps along its faces, thin parts have points, and both
    sides of a wall thicker than 2 cm. Of two points nearer than 0.6 spacings, on surfaces that face alike,
    one is left out.
    """
    trimesh: Any = import_extra("trimesh.triangles", "meshes", SAMPLED)
    require_places("surface", triangles)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area_m2 = np.linalg.norm(normals, axis=1) / 2
    has_area = area_m2 > 0
    if not has_area.any():
        return np.empty((0, 3))
    n_expected = area_m2.sum() / spacing_m / spacing_m
    if n_expected > MOST_SURFACE_POINTS:
        fits = np.sqrt(area_m2.sum() / MOST_SURFACE_POINTS)
        raise InputError(
            f"spacing_m = {spacing_m:g} gives {n_expected:.3g} points on {area_m2.sum():.3g} m² of surface; "
            f"allowed are at most {MOST_SURFACE_POINTS}, a spacing_m of {np.ceil(100 * fits) / 100:g}"
        )
    triangles, normals = triangles[has_area], normals[has_area]
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    lower, upper = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    n_cells = np.maximum(1.0, np.round((upper - lower) / spacing_m))
    pitch = np.where(upper > lower, (upper - lower) / n_cells, spacing_m)

    candidates, face = _candidates(triangles, spacing_m / CANDIDATES)
    cell = np.floor((candidates - lower) / pitch).clip(0, n_cells - 1)
    cell, face = _distinct(np.column_stack([side[face], cell, face]).astype(int))
    middle = lower + (cell[:, 1:] + 0.5) * pitch
    points = trimesh.closest_point(triangles[face], middle)
    off_middle_m = np.linalg.norm(points - middle, axis=1).round(6)
    order = np.lexsort([face, off_middle_m, *cell.T])
    is_first = np.append(True, (cell[order][1:] != cell[order][:-1]).any(axis=1))
    chosen = order[is_first]
    outwards = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return _apart(points[chosen], outwards[face[chosen]], NEAREST * spacing_m)


def clipped(triangles: Floats, lower: Floats, upper: Floats) -> Floats:
    """Cut off what lies outside a box; return the same triangles (n, 3, 3) if nothing does.

    What lies up to 1 µm outside is moved into it.
    """
    if (triangles >= lower).all() and (triangles <= upper).all():
        return triangles
    trimesh: Any = import_extra("trimesh.intersections", "meshes", SAMPLED)
    for axis in range(3):
        for corner, sign in ((lower, 1.0), (upper, -1.0)):
            is_near = (sign * (triangles[:, :, axis] - corner[axis]) >= -SLACK_M).any(axis=1)
            triangles = triangles[is_near]
            if len(triangles):
                corners = triangles.reshape(-1, 3)
                faces = np.arange(len(corners)).reshape(-1, 3)
                inwards = sign * np.eye(3)[axis]
                vertices, faces, _ = trimesh.slice_faces_plane(
                    corners, faces, inwards, corner - SLACK_M * inwards
                )
                triangles = vertices[faces]
    return np.clip(triangles, lower, upper)


def _distinct(rows: Integers) -> tuple[Integers, Integers]:
    """Distinct rows of whole numbers, and their last column apart."""
    rows = rows[np.lexsort(rows.T)]
    rows = rows[np.append(True, (rows[1:] != rows[:-1]).any(axis=1))]
    return rows[:, :-1], rows[:, -1]


def _candidates(triangles: Floats, step_m: float) -> tuple[Floats, Integers]:
    """Points on each triangle no farther apart than a step, and the triangles that they lie on."""
    sides = np.roll(triangles, -1, axis=1) - triangles
    longest = np.linalg.norm(sides, axis=2).argmax(axis=1)
    turn = (longest[:, None] + np.arange(3)) % 3
    start, end, apex = np.moveaxis(np.take_along_axis(triangles, turn[:, :, None], axis=1), 1, 0)
    base, base_m = end - start, np.linalg.norm(end - start, axis=1)
    # The foot of the height, as a share of the base, divides the chords across the base.
    foot = np.einsum("ij,ij->i", apex - start, base) / base_m**2
    height = apex - start - foot[:, None] * base
    steps = [
        np.maximum(1.0, np.ceil(sides_m / step_m)) for sides_m in (np.linalg.norm(height, axis=1), base_m)
    ]
    n_candidates = (steps[0] * steps[1]).sum()
    if n_candidates > MOST_CANDIDATES:
        raise InputError(
            f"spacing_m = {CANDIDATES * step_m:g} asks for {n_candidates:.3g} places on its surface; allowed "
            f"are at most {MOST_CANDIDATES}: a larger spacing_m, or fewer and less thin triangles"
        )
    rows, columns = (along.astype(int) for along in steps)
    face = np.repeat(np.arange(len(triangles)), rows * columns)
    number = np.arange(len(face)) - np.repeat(np.cumsum(rows * columns) - rows * columns, rows * columns)
    along = (number % columns[face] + 0.5) / columns[face]
    is_before = along < foot[face]
    chord = np.where(is_before, along, 1 - along) / np.where(is_before, foot[face], 1 - foot[face])
    up = chord * (number // columns[face] + 0.5) / rows[face]
    return start[face] + along[:, None] * base[face] + up[:, None] * height[face], face


def _apart(points: Floats, outwards: Floats, nearest_m: float) -> Floats:
    """Leave out points at the place of an earlier one, then those too near to one that faces alike."""
    twins = _pairs(points, SAME_M)
    is_kept = _without_second(twins, len(points))
    points, outwards = points[is_kept], outwards[is_kept]
    pairs = _pairs(points, nearest_m)
    are_alike = np.einsum("ij,ij->i", outwards[pairs[:, 0]], outwards[pairs[:, 1]]) > 0.5
    return points[_without_second(pairs[are_alike], len(points))]


def _pairs(points: Floats, nearest_m: float) -> Integers:
    """Pairs of points within a distance, in order."""
    pairs = np.sort(cKDTree(points).query_pairs(nearest_m, output_type="ndarray"), axis=1)
    return pairs[np.lexsort(pairs.T[::-1])]


def _without_second(pairs: Integers, n: int) -> Mask:
    """Mask (n,) of what is left if every pair whose first is left loses its second."""
    is_kept = np.ones(n, dtype=bool)
    for first, second in pairs.tolist():
        if is_kept[first]:
            is_kept[second] = False
    return is_kept


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
    for some in parts_of(len(corners), MOST_PAIRS // len(xyz)):
        near = tree.query_ball_point(middles[some], chords[some])
        face = np.repeat(np.arange(some.start, some.stop), [len(rays) for rays in near])
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
