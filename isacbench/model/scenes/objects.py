"""Parametric objects of a street scene, as scatterer positions around their own foot point.

Every outline returns offsets (n, 3) in metres from the object's
``position_m``: the centre of its footprint, on the ground. The front of an
object is along +y. Objects are outlined by scatterers as a radar sees them,
not meshed. Lengths are divided into equal steps of about the spacing: those
from 0.8 m on, bar 1.2 to 1.25 m, into steps of 0.5 m ± 20 %.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

Offsets = NDArray[np.float64]

MOST_STEPS, MOST_POINTS = 2000, 100_000
"""Largest numbers of steps along a length, and of points of a surface."""


def _grid(
    x: Sequence[float] | Offsets, y: Sequence[float] | Offsets, z: Sequence[float] | Offsets
) -> Offsets:
    """Every combination of the given coordinates."""
    n_points = len(x) * len(y) * len(z)
    if n_points > MOST_POINTS:
        raise InputError(
            f"its spacing_m makes {n_points} scatterers of one surface; allowed are at most {MOST_POINTS}"
        )
    axes = np.meshgrid(x, y, z, indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


def _steps(length_m: float, spacing_m: float) -> Offsets:
    """Coordinates centred on 0 that span a length in equal steps of about the spacing."""
    return np.linspace(-length_m / 2, length_m / 2, _n_steps(length_m, spacing_m) + 1)


def _n_steps(length_m: float, spacing_m: float) -> int:
    """Number of equal steps of about the spacing in a length."""
    # The quotient may be too large for an integer.
    n_steps = max(1.0, np.round(length_m / spacing_m))
    if n_steps > MOST_STEPS:
        raise InputError(
            f"spacing_m = {spacing_m:g} divides {length_m:g} m into {n_steps:.6g} steps; "
            f"allowed are at most {MOST_STEPS}"
        )
    return int(n_steps)


def car(size_m: Sequence[float] = (2.0, 6.0, 1.8)) -> Offsets:
    """Outline a car: sides, pillars, bonnet and boot, bumpers, roof line, wheels, mirrors.

    Parameters
    ----------
    size_m : (float, float, float)
        Width along x over the mirrors, length along y, height.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        114 points at the default size.
    """
    width, length, height = size_m
    side = 0.45 * width * np.array([-1.0, 1.0])
    ends = length * np.array([-1 / 3, 1 / 3])
    wheel = min(length, height) / 6
    rim = [_grid(side, end + wheel * np.array([-1, 0, 1]), [wheel]) for end in ends]
    crown = [_grid(side, [end], [0.0, 2 * wheel]) for end in ends]
    lids = [_grid(width / 4 * np.array([-1, 0, 1]), length * y, [0.55 * height]) for y in _lid_positions()]
    return np.concatenate(
        [
            _grid(side, _steps(length, 0.5), [height / 4, height / 2]),
            _grid(side, _steps(length / 2, 0.5), [height]),
            _grid(side, ends, [0.75 * height]),
            *lids,
            _grid(width / 4 * np.array([-1, 1]), [-length / 2, length / 2], [height / 3]),
            *rim,
            *crown,
            _grid(width / 2 * np.array([-1, 1]), [length / 5], [0.6 * height]),
        ]
    )


def _lid_positions() -> list[NDArray[np.float64]]:
    """Three places along the boot and the bonnet, as fractions of the car's length."""
    bonnet = np.array([4 / 12, 5 / 12, 6 / 12])
    return [-bonnet[::-1], bonnet]


LEFT_HALF = np.array(
    [
        [0.05, 0.0, 1.0],
        [0.11, 0.0, 0.81],
        [0.16, -0.14, 0.47],
        [0.08, 0.0, 0.53],
        [0.08, 0.11, 0.28],
        [0.08, 0.19, 0.03],
    ]
)
"""Left head, shoulder, hand, hip, knee and foot of a person 1 m tall, the foot a full step ahead."""


def pedestrian(height_m: float = 1.8, stride_phase_deg: float = 0.0) -> Offsets:
    """Outline a walking person: head, shoulders, hands, hips, knees and feet.

    Parameters
    ----------
    height_m : float
    stride_phase_deg : float
        0 where the left foot is a full step ahead, 180 where the right one is,
        90 where the left one passes it backwards.

    Returns
    -------
    ndarray of float64, shape (12, 3)
        The left side, then the right one.
    """
    left = LEFT_HALF * np.array([1.0, np.cos(np.radians(stride_phase_deg)), 1.0])
    right = left * np.array([-1.0, -1.0, 1.0])
    right[0, 2] = 0.92  # the head is one: crown on the left, chin on the right
    return height_m * np.concatenate([left, right])


def limb_swing(stride_phase_deg: float) -> Offsets:
    """Velocities of a pedestrian's points relative to the body, for a walking speed of 1 m/s.

    Limbs swing as pendulums do. The foot that passes the other one backwards
    stands on the ground, which sets the frequency.

    Parameters
    ----------
    stride_phase_deg : float
        As `pedestrian` takes it.

    Returns
    -------
    ndarray of float64, shape (12, 3)
    """
    forwards = -np.sin(np.radians(stride_phase_deg)) * LEFT_HALF[:, 1] / LEFT_HALF[-1, 1]
    swing = np.zeros((2 * len(LEFT_HALF), 3))
    swing[:, 1] = np.concatenate([forwards, -forwards])
    return swing


def lamp_post(
    height_m: float = 10.0, foot_m: float = 2.0, spacing_m: float = 1.0, arm_m: float = 1.0
) -> Offsets:
    """Outline a mast, from the top of its shielded foot upwards, and four arm tips around its top.

    Parameters
    ----------
    height_m : float
        Height of the mast.
    foot_m : float
        Height of its foot, which returns no echo.
    spacing_m : float
        Distance of neighbours along the mast.
    arm_m : float
        Length of the arms.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        13 points at the default sizes.

    Raises
    ------
    InputError
        If the foot reaches the top.
    """
    if foot_m >= height_m:
        raise InputError(f"lamp_post: foot_m = {foot_m:g} must lie below height_m = {height_m:g}")
    n_steps = _n_steps(height_m - foot_m, spacing_m)
    mast = _grid([0.0], [0.0], np.linspace(foot_m, height_m, n_steps + 1))
    arms = arm_m * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    return np.concatenate([mast, arms + np.array([0.0, 0.0, height_m])])


def green_belt(size_m: Sequence[float] = (1.0, 20.0, 1.0), spacing_m: float = 0.5) -> Offsets:
    """Outline a hedge by its four long edges.

    Parameters
    ----------
    size_m : (float, float, float)
        Width along x, length along y, height.
    spacing_m : float
        Distance of neighbours along an edge.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        164 points at the default size.
    """
    width, length, height = size_m
    return _grid([-width / 2, width / 2], _steps(length, spacing_m), [0.0, height])


def box(size_m: Sequence[float] = (1.0, 6.0, 1.0), spacing_m: float = 0.5) -> Offsets:
    """Sample the sides and the top of a box.

    Parameters
    ----------
    size_m : (float, float, float)
        Width along x, length along y, height.
    spacing_m : float
        Distance of neighbours.

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    width, length, height = size_m
    x, y = _steps(width, spacing_m), _steps(length, spacing_m)
    levels = _steps(height, spacing_m) + height / 2
    sides = [_rim(_grid(x, y, [level])) for level in levels[:-1]]
    return np.concatenate([*sides, _grid(x, y, levels[-1:])])


def wall(size_m: Sequence[float] = (12.0, 6.0), spacing_m: float = 0.5) -> Offsets:
    """Sample an upright wall along y.

    Parameters
    ----------
    size_m : (float, float)
        Length along y, height.
    spacing_m : float
        Distance of neighbours.

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    length, height = size_m
    return _grid([0.0], _steps(length, spacing_m), _steps(height, spacing_m) + height / 2)


def pole(height_m: float = 6.0, spacing_m: float = 0.5) -> Offsets:
    """Sample an upright pole from the ground to its top.

    Parameters
    ----------
    height_m : float
    spacing_m : float
        Distance of neighbours.

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    return _grid([0.0], [0.0], _steps(height_m, spacing_m) + height_m / 2)


RAIL_HEIGHTS_M = 0.4, 0.9


def rail(length_m: float = 8.0, spacing_m: float = 0.5) -> Offsets:
    """Sample the two bars of a guard rail along y, 0.4 m and 0.9 m above the ground.

    Parameters
    ----------
    length_m : float
    spacing_m : float
        Distance of neighbours.

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    return _grid([0.0], _steps(length_m, spacing_m), RAIL_HEIGHTS_M)


WAIST_M = 0.9
SILL_M = 0.4
WHEEL_RADIUS_M = 0.3
RIM = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Points of a rim around its hub, forwards and up, in radii."""


def vehicle(size_m: Sequence[float] = (1.8, 4.5, 1.5), spacing_m: float = 0.5) -> Offsets:
    """Sample a vehicle: a body up to the waist, a cabin over its middle half, and four wheels.

    Parameters
    ----------
    size_m : (float, float, float)
        Width along x, length along y, height; higher than 0.9 m, the waist.
    spacing_m : float
        Distance of neighbours on body and cabin.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        The 16 points of the rims come last.

    Raises
    ------
    InputError
        If it is not higher than its waist.
    """
    width, length, height = size_m
    if height <= WAIST_M:
        raise InputError(f"vehicle: its height {height:g} m must be above its waist, {WAIST_M:g} m")
    x, y = _steps(width, spacing_m), _steps(length, spacing_m)
    of_cabin = y[np.abs(y) <= length / 4]
    levels = _steps(height - WAIST_M, spacing_m) + (height + WAIST_M) / 2
    waist = _grid(x, y, [WAIST_M])
    is_inside = np.isin(waist[:, 1], of_cabin[1:-1]) & ~np.isin(waist[:, 0], x[[0, -1]])
    shells = [_grid(x, y, [SILL_M]), *(_grid(x, of_cabin, [level]) for level in levels[1:-1])]
    hubs = _grid([-width / 2, width / 2], [-0.3 * length, 0.3 * length], [WHEEL_RADIUS_M])
    rims = hubs[:, None, :] + WHEEL_RADIUS_M * np.pad(RIM, ((0, 0), (1, 0)))
    surfaces = [waist[~is_inside], _grid(x, of_cabin, levels[-1:])]
    return np.concatenate([*map(_rim, shells), *surfaces, rims.reshape(-1, 3)])


def _rim(layer: Offsets) -> Offsets:
    """Outer points of a level grid."""
    outer: Offsets = layer[(np.abs(layer[:, :2]) == np.abs(layer[:, :2]).max(axis=0)).any(axis=1)]
    return outer


def wheel_roll() -> Offsets:
    """Velocities of a vehicle's 16 rim points relative to the body, for a speed of 1 m/s.

    A wheel rolls: its lowest point stands still, its highest has twice the speed.

    Returns
    -------
    ndarray of float64, shape (16, 3)
    """
    forwards_and_up = np.column_stack([RIM[:, 1], -RIM[:, 0]])
    return np.tile(np.pad(forwards_and_up, ((0, 0), (1, 0))), (4, 1))
