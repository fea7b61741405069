"""Drift: relative difference of two clouds of one scene, and distances in Rayleigh cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from isacbench.checking.promises.promise import BrokenPromiseError
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.scene import Scenario


def cloud_drift(
    scenario: Scenario, first: PointCloud, second: PointCloud, amplitude_scale: float = 1.0
) -> float:
    """Largest relative difference of two clouds.

    Parameters
    ----------
    first, second : PointCloud
        In any order.
    amplitude_scale : float
        Amplitudes of the second cloud over those of the first.

    Returns
    -------
    float
        Largest of the differences of positions over the range of the region's
        farthest corner, of velocities over the unambiguous speed, and of
        powers, each over itself.

    Raises
    ------
    BrokenPromiseError
        If they have different numbers of points.
    """
    if len(first) != len(second):
        raise BrokenPromiseError(f"{len(first)} points, then {len(second)}")
    if not len(first):
        return 0.0
    power = second.power / amplitude_scale**2
    larger = np.maximum(first.power[:, None], power)
    power_apart = np.abs(first.power[:, None] - power) / np.where(larger > 0, larger, 1.0)
    one, two = _relative(scenario, first), _relative(scenario, second)
    apart = np.maximum(cdist(one, two, "chebyshev"), power_apart)
    in_order = float(apart.diagonal().max())
    return min(in_order, float(apart[linear_sum_assignment(apart)].max())) if in_order else 0.0


def _relative(scenario: Scenario, cloud: PointCloud) -> NDArray[np.float64]:
    """Points (n, 4) in units of the range of the farthest corner and of the unambiguous speed."""
    farthest_m = scenario.region.range_limits_m(scenario.base_station_m)[1]
    xyz = (cloud.xyz - scenario.base_station_m) / farthest_m
    return np.column_stack([xyz, cloud.velocity / scenario.system.unambiguous_speed_mps])


def cells_apart(scenario: Scenario, cloud: PointCloud, others: PointCloud) -> NDArray[np.float64]:
    """Rayleigh cells between points, the largest over range, velocity, u and w.

    Elements half a wavelength apart cannot tell u = 1 from u = -1, nor the
    radio speeds that lie twice the unambiguous one apart.

    Returns
    -------
    ndarray of float64, shape (len(cloud), len(others))
    """
    cells, system = rayleigh_cells(scenario), scenario.system
    one, two = radio_places(scenario, cloud), radio_places(scenario, others)
    apart = np.abs(one[:, None] - two)
    period = np.array([system.unambiguous_range_m, 2 * system.unambiguous_speed_mps, 2.0, 2.0])
    return np.asarray(np.max(np.minimum(apart, np.abs(period - apart)) / cells, axis=2))
