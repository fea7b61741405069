"""Rigid motion of an object, with limbs and wheels of their own, seen along the line of sight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from isacbench.checked_arrays import Floats

DECIMALS = 6
"""Of coordinates in m and speeds in m/s: sines differ in the last digits between machines."""


def turned(vectors: Floats, yaw_deg: float) -> Floats:
    """Turn vectors about the vertical, counterclockwise seen from above.

    Parameters
    ----------
    vectors : ndarray of float64, shape (n, 3)

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    x, y, z = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def heading(yaw_deg: float) -> Floats:
    """Direction of an object's front.

    Parameters
    ----------
    yaw_deg : float
        0 faces +y, 90 faces -x.

    Returns
    -------
    ndarray of float64, shape (3,)
    """
    return turned(np.array([[0.0, 1.0, 0.0]]), yaw_deg)[0]


def body_velocities(
    offsets: Floats, velocity_mps: Sequence[float], yaw_rate_dps: float, own: Floats
) -> Floats:
    """Velocities of the points of a turning body: V + ω x r, plus those of limbs and wheels.

    Parameters
    ----------
    offsets : ndarray of float64, shape (n, 3)
        From the object's position, in m.
    velocity_mps : (float, float, float)
        Of that position.
    yaw_rate_dps : float
        In degrees a second, counterclockwise seen from above.
    own : ndarray of float64, shape (n, 3)
        Velocities relative to the body.

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    x, y, _ = offsets.T
    turning = np.radians(yaw_rate_dps) * np.column_stack([-y, x, np.zeros_like(x)])
    return np.array(velocity_mps) + turning + own


def approach_speeds(xyz: Floats, velocities: Floats, base_station_m: Floats) -> Floats:
    """Project velocities on the line of sight.

    Parameters
    ----------
    xyz, velocities : ndarray of float64, shape (n, 3)
    base_station_m : ndarray of float64, shape (3,)

    Returns
    -------
    ndarray of float64, shape (n,)
        In m/s, positive when approaching; 0 at the base station itself.
    """
    sight = xyz - base_station_m
    distance = np.linalg.norm(sight, axis=1)
    return -np.einsum("ij,ij->i", velocities, sight) / np.where(distance > 0, distance, 1.0)
