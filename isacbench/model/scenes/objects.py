"""Parametric objects of a street scene, as scatterer positions around their own foot point.

Every function returns offsets (n, 3) in metres from the object's
``position_m``: the centre of its footprint, on the ground. Objects are
outlined by scatterers as a radar sees them, not meshed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

Offsets = NDArray[np.float64]


def _grid(x: Iterable[float], y: Iterable[float], z: Iterable[float]) -> Offsets:
    """Every combination of the given coordinates."""
    axes = np.meshgrid(np.array([*x]), np.array([*y]), np.array([*z]), indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


def _steps(length_m: float, spacing_m: float) -> Offsets:
    """Coordinates centred on 0 that span a length in equal steps of about the spacing."""
    n_steps = max(1, round(length_m / spacing_m))
    return np.linspace(-length_m / 2, length_m / 2, n_steps + 1)


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


def pedestrian(height_m: float = 1.8) -> Offsets:
    """Outline a walking person: head, shoulders, hands, hips, knees, feet, left and right a stride apart.

    Parameters
    ----------
    height_m : float

    Returns
    -------
    ndarray of float64, shape (12, 3)
    """
    left = np.array(
        [
            [0.05, 0.0, 1.0],
            [0.11, 0.0, 0.81],
            [0.16, -0.14, 0.47],
            [0.08, 0.0, 0.53],
            [0.08, 0.11, 0.28],
            [0.08, 0.19, 0.03],
        ]
    )
    right = left * np.array([-1.0, -1.0, 1.0])
    right[0, 2] = 0.92  # the head is one: crown on the left, chin on the right
    return height_m * np.concatenate([left, right])


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
    n_steps = max(1, round((height_m - foot_m) / spacing_m))
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
