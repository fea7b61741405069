"""Decimal numbers drawn from raw uniforms, and objects placed where they do not intersect."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from isacbench.checked_arrays import Floats, Mask
from isacbench.errors import InputError
from isacbench.model.scenes.raw_uniforms import raw_uniforms

CLEARANCE_M = 0.3
"""Least distance of two objects' footprints."""

MOST_TRIES = 300
"""Places that are tried for one object."""

AT_ONCE = 1024


class Sampler:
    """Decimal numbers from the uniforms of a key."""

    def __init__(self, key: str) -> None:
        self._key = key
        self._uniforms: list[float] = []
        self._n_used = 0

    def uniform(self) -> float:
        """Draw the next uniform number in [0, 1)."""
        if self._n_used == len(self._uniforms):
            # Longer draws of a key begin as shorter ones do.
            self._uniforms = raw_uniforms(self._key, len(self._uniforms) * 2 or AT_ONCE).tolist()
        self._n_used += 1
        return self._uniforms[self._n_used - 1]

    def between(self, low: float, high: float, decimals: int = 2) -> float:
        """Draw a number of so many decimals between two, both included."""
        return round(low + (high - low) * self.uniform(), decimals) + 0.0

    def whole(self, low: int, high: int) -> int:
        """Draw a whole number between two, both included."""
        return low + int((high - low + 1) * self.uniform())

    def either(self) -> bool:
        """Draw true or false."""
        return self.uniform() < 0.5


class FreeGround:
    """Footprints of objects: rectangles that do not intersect and lie within the limits of the ground."""

    def __init__(self, x_m: Sequence[float], y_m: Sequence[float]) -> None:
        self._limits_m = np.array([x_m, y_m])
        self._centres, self._axes = np.empty((0, 2)), np.empty((0, 2, 2))

    def place(self, footprint_m: tuple[float, float], pose: Callable[[], tuple[float, float, float]]) -> Any:
        """Find a free place for an object: the first free pose, x and y in m and yaw in degrees.

        The footprint is the width across and the length along the object's front.
        """
        for _ in range(MOST_TRIES):
            x, y, yaw_deg = pose()
            centre, axes = np.array([x, y]), _half_axes(footprint_m, yaw_deg)
            reach = np.abs(axes).sum(axis=0)
            fits = (centre - reach >= self._limits_m[:, 0]).all()
            fits &= (centre + reach <= self._limits_m[:, 1]).all()
            if fits and not self._meets(centre, axes):
                self._centres = np.vstack([self._centres, centre])
                self._axes = np.concatenate([self._axes, axes[None]])
                return x, y, yaw_deg
        n = len(self._centres)
        raise InputError(
            f"no room for more than {n} objects on the ground; allowed are fewer (pedestrians, density)"
        )

    def _meets(self, centre: Floats, axes: Floats) -> bool:
        """Tell whether a footprint comes nearer than the clearance to one that is taken."""
        between = self._centres - centre
        reach = np.linalg.norm(self._axes, axis=2).sum(axis=1) + np.linalg.norm(axes, axis=1).sum()
        near = (between**2).sum(axis=1) < reach**2
        return bool(near.any()) and bool(_overlap(between[near], axes, self._axes[near]).any())


def _half_axes(size_m: tuple[float, float], yaw_deg: float) -> Floats:
    """Half axes (2, 2) of a turned rectangle, enlarged by half the clearance."""
    width, length = (side / 2 + CLEARANCE_M / 2 for side in size_m)
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return np.array([[width * cos, width * sin], [-length * sin, length * cos]])


def _overlap(between: Floats, axes: Floats, others: Floats) -> Mask:
    """Tell which rectangles a rectangle meets: two are apart if they are along one of their four axes."""
    apart = np.zeros(len(others), dtype=bool)
    own = np.broadcast_to(axes, others.shape)
    for directions in (own, others):
        units = directions / np.linalg.norm(directions, axis=2, keepdims=True)
        distance = np.abs(np.einsum("nd,nad->na", between, units))
        reach = sum(np.abs(np.einsum("nbd,nad->nab", sides, units)).sum(axis=2) for sides in (own, others))
        apart |= (distance >= reach).any(axis=1)
    return ~apart
