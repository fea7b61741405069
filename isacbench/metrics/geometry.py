"""Distances between two sets of points, on which every metric is based."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Floats, checked_array
from isacbench.errors import InputError, require
from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scenario

T = TypeVar("T")

LARGEST = 1e50
"""Largest coordinate (m) and speed (m/s) that is scored: squares and their ratios stay finite."""

SMALLEST_DIAGONAL_M = 1.0
"""Estimators report points up to half a metre outside a region, also of one without extent."""

RADIUS_M = 1.0
"""Distance, where no scenario says another: up to it a point counts as right for precision and recall; from
it a true scatterer counts as missed and an estimated point as false in GOSPA, whose cut-off c it is."""

MANY_POINTS = 10_000
"""From here on, sorting points is a small part of searching them."""


@dataclass(frozen=True, eq=False)
class CloudPair:
    """A truth and an estimate with what scores depend on besides; searches are made once for all metrics.

    Attributes
    ----------
    truth : PointCloud
        True scatterers, at least one unless the scenario has none.
    estimate : PointCloud
        Estimated points, possibly none.
    region : Region or None
        Where scatterers can be; None takes the reach of the paper's Table I.
    velocity_bin_mps : float
        Velocity bin in m/s; by default that of Table I.
    radius_m : float
        Distance in m within which a point counts as one of a scatterer.
    scenario : Scenario or None
        Scenario of the truth, if it is known: its radio and the objects of its scatterers.

    Raises
    ------
    InputError
        If the truth is empty and no scenario says so, a coordinate or velocity is beyond 1e50, or the radius
        or the velocity bin is no positive number.
    """

    truth: PointCloud
    estimate: PointCloud
    region: Region | None = None
    velocity_bin_mps: float = System().velocity_bin_mps
    radius_m: float = RADIUS_M
    scenario: Scenario | None = None

    @classmethod
    def of(cls, scenario: Scenario, estimate: PointCloud) -> CloudPair:
        """Pair an image of a scenario with its truth."""
        bin_mps = scenario.system.velocity_bin_mps
        return cls(scenario.truth, estimate, scenario.region, bin_mps, scenario.radius_m, scenario)

    @property
    def has_velocities(self) -> bool:
        """True if the velocities of both clouds are known."""
        return self.truth.has_velocity and self.estimate.has_velocity

    def __post_init__(self) -> None:
        if not len(self.truth) and self.scenario is None:
            raise InputError("truth: the cloud is empty; a score takes at least one true scatterer")
        for name, unit in (("velocity_bin_mps", "m/s"), ("radius_m", "m")):
            number = checked_array(name, getattr(self, name)).item()
            require(1 / LARGEST <= number <= LARGEST, name, number, f"a positive number of {unit}")
            object.__setattr__(self, name, number)
        for name, cloud in (("truth", self.truth), ("estimate", self.estimate)):
            # Unknown velocities, NaN, are beyond nothing.
            if (np.abs(cloud.xyz) > LARGEST).any() or (np.abs(cloud.velocity) > LARGEST).any():
                raise InputError(f"{name}: coordinates and velocities take magnitudes up to {LARGEST:g}")

    def remembered(self, make: Callable[[CloudPair], T]) -> T:
        """Call a function on the pair once for all metrics."""
        if make not in self._cache:
            self._cache[make] = make(self)
        return self._cache[make]

    @cached_property
    def _cache(self) -> dict[Callable[[CloudPair], Any], Any]:
        return {}

    @cached_property
    def truth_tree(self) -> cKDTree:
        """Search tree of the true positions."""
        return cKDTree(self.truth.xyz)

    @cached_property
    def estimate_tree(self) -> cKDTree:
        """Search tree of the estimated positions."""
        return cKDTree(self.estimate.xyz)

    @cached_property
    def two_nearest_estimates(self) -> tuple[Floats, NDArray[np.intp]]:
        """Distances (n_true, 2) in metres and indices of the two estimated points nearest to each scatterer.

        If there is no second (or first) point, its distance is infinite.
        """
        distance_m, index = self.estimate_tree.query(self.truth.xyz, k=2)
        return np.asarray(distance_m), np.asarray(index)

    @property
    def truth_to_estimate_m(self) -> Floats:
        """Distance (n_true,) from each true scatterer to the nearest estimated point."""
        return self.two_nearest_estimates[0][:, 0]

    @cached_property
    def estimate_to_truth_m(self) -> Floats:
        """Distance (n_estimated,) from each estimated point to the nearest true scatterer."""
        return _nearest_m(self.truth_tree, self.estimate.xyz)


def _nearest_m(tree: cKDTree, points: Floats) -> Floats:
    """Distance (n,) from each point (n, k) to the nearest of a tree."""
    return np.asarray(tree.query(points)[0])


def hausdorff_m(a: Floats, b: Floats) -> float:
    """Symmetric Hausdorff distance of two sets of points.

    Parameters
    ----------
    a, b : ndarray of float64, shapes (n, k) and (m, k)
        Points in metres, at least one each.

    Returns
    -------
    float
        Largest distance from a point of either set to the nearest of the other, in metres.

    Notes
    -----
    From 450 points on, two search trees are faster than the full distance
    matrix, and they do not take its memory.

    Examples
    --------
    >>> hausdorff_m(np.array([[0.0], [1.0]]), np.array([[0.0], [3.0]]))
    2.0
    """
    # A search tree takes time in squares for many points at one place, as projections of walls have.
    a, b = (np.unique(points, axis=0) if len(points) > MANY_POINTS else points for points in (a, b))
    return float(max(_nearest_m(cKDTree(b), a).max(), _nearest_m(cKDTree(a), b).max()))


def box_diagonal_m(xyz: Floats, region: Region | None, axes: Sequence[int] = (0, 1, 2)) -> float:
    """Diagonal in m, at least 1, of the box that holds the region and points (n, 3), along some axes.

    It bounds the distance from each of the points to any other of them, and to any place in the region. An
    empty cloud scores it in place of a distance. Without a region, the box is that of the points, grown on
    every side by the unambiguous range of Table I, 624.6 m: from a base station with that radar, truth and
    estimates are no farther apart.
    """
    if region is None:
        size_m = np.ptp(xyz, axis=0) + 2 * System().unambiguous_range_m
    else:
        size_m = np.ptp(np.vstack([xyz, region.lower_m, region.upper_m]), axis=0)
    return max(float(np.sqrt(np.square(size_m[list(axes)]).sum())), SMALLEST_DIAGONAL_M)


def projected_hausdorff_m(pair: CloudPair, axes: Sequence[int]) -> float:
    """Symmetric Hausdorff distance in m of the clouds on some axes; of an empty estimate `box_diagonal_m`."""
    truth, estimate = pair.truth.xyz, pair.estimate.xyz
    if not len(estimate):
        return box_diagonal_m(truth, pair.region, axes)
    return hausdorff_m(truth[:, list(axes)], estimate[:, list(axes)])
