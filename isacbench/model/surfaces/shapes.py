"""Triangles of boxes, cylinders and ellipsoids."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

SECTIONS = 24
"""Sides of a cylinder."""


def cuboid(lower: ArrayLike, upper: ArrayLike) -> Floats:
    """Triangles of a box along the axes.

    Parameters
    ----------
    lower, upper : array_like, shape (3,)
        Corners.

    Returns
    -------
    ndarray of float64, shape (12, 3, 3)
    """
    from trimesh.creation import box

    return np.array(box(bounds=np.array([lower, upper], dtype=float)).triangles)


def tube(start: ArrayLike, end: ArrayLike, radius_m: float) -> Floats:
    """Triangles of a closed cylinder.

    Parameters
    ----------
    start, end : array_like, shape (3,)
        Ends of its axis.
    radius_m : float

    Returns
    -------
    ndarray of float64, shape (n, 3, 3)
    """
    from trimesh.creation import cylinder

    return np.array(cylinder(radius_m, sections=SECTIONS, segment=np.array([start, end])).triangles)


def globe(centre: ArrayLike, semi_axes_m: ArrayLike) -> Floats:
    """Triangles of an ellipsoid along the axes.

    Parameters
    ----------
    centre, semi_axes_m : array_like, shape (3,)

    Returns
    -------
    ndarray of float64, shape (320, 3, 3)
    """
    from trimesh.creation import icosphere

    unit = np.array(icosphere(subdivisions=2).triangles)
    placed: Floats = unit * np.asarray(semi_axes_m, dtype=float) + np.asarray(centre, dtype=float)
    return placed
