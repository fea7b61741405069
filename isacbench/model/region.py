"""The region: the box that holds the scatterers of a scene, and their speeds."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from isacbench.checked_arrays import Floats, Mask, checked_array
from isacbench.display import range_text
from isacbench.errors import require
from isacbench.model.number_limits import LARGEST_PLACE_M, require_interval
from isacbench.model.numerology import SPEED_OF_LIGHT_MPS

Interval = tuple[float, float]


@dataclass(frozen=True)
class Region:
    """Axis-parallel box and the radial speeds in it: prior knowledge of every estimator.

    Attributes
    ----------
    x_m, y_m, z_m : (float, float)
        Lower and upper limits in metres.
    speed_mps : (float, float)
        Lowest and highest radial velocity in m/s, positive when approaching.

    Raises
    ------
    InputError
        If limits do not ascend, or are beyond a million kilometres or the
        speed of light.
    """

    x_m: Interval
    y_m: Interval
    z_m: Interval
    speed_mps: Interval

    def __post_init__(self) -> None:
        for name in ("x_m", "y_m", "z_m"):
            require_interval(f"region.{name}", getattr(self, name), LARGEST_PLACE_M)
        require_interval("region.speed_mps", self.speed_mps, SPEED_OF_LIGHT_MPS)

    def __str__(self) -> str:
        """Write the limits with their units."""
        places = ", ".join(f"{axis} {range_text(getattr(self, f'{axis}_m'))}" for axis in "xyz")
        return f"{places} m, {range_text(self.speed_mps, 'm/s')}"

    @property
    def lower_m(self) -> Floats:
        """Lower corner (3,)."""
        return np.array([self.x_m[0], self.y_m[0], self.z_m[0]])

    @property
    def upper_m(self) -> Floats:
        """Upper corner (3,)."""
        return np.array([self.x_m[1], self.y_m[1], self.z_m[1]])

    @property
    def size_m(self) -> Floats:
        """Edge lengths (3,)."""
        return self.upper_m - self.lower_m

    @property
    def corners_m(self) -> Floats:
        """Corners (8, 3)."""
        return np.array([*product(self.x_m, self.y_m, self.z_m)])

    def contains(self, xyz: ArrayLike, tolerance_m: float | Floats = 0.0) -> Mask:
        """Tell which points lie in the box grown by a tolerance on every side; NaN does not.

        Parameters
        ----------
        xyz : array_like, shape (n, 3)
        tolerance_m : float or ndarray of float64, shape (n, 1)

        Returns
        -------
        ndarray of bool, shape (n,)

        Raises
        ------
        InputError
            If the points have another shape.
        """
        xyz, tolerance_m = checked_array("xyz", xyz), checked_array("tolerance_m", tolerance_m)
        require(xyz.ndim == 2 and xyz.shape[1] == 3, "shape of xyz", xyz.shape, "(n, 3)")
        return np.all((xyz >= self.lower_m - tolerance_m) & (xyz <= self.upper_m + tolerance_m), axis=1)

    def range_limits_m(self, base_station_m: ArrayLike) -> Interval:
        """Compute the distances of the nearest and the farthest point of the box.

        Parameters
        ----------
        base_station_m : array_like, shape (3,)
        """
        base = checked_array("base_station_m", base_station_m)
        nearest = np.clip(base, self.lower_m, self.upper_m)
        farthest = np.where(base - self.lower_m > self.upper_m - base, self.lower_m, self.upper_m)
        return float(np.linalg.norm(nearest - base)), float(np.linalg.norm(farthest - base))
