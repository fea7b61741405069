"""Drift: how far two clouds of one scene are apart, relative to what the scene and the radio span."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from isacbench.bench.cells.radio_coordinates import radio_places, rayleigh_cells
from isacbench.checking.stress.case import BrokenPromiseError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.model.cloud import PointCloud
    from isacbench.model.scene import Scenario


def cloud_drift(
    scenario: Scenario, first: PointCloud, second: PointCloud, amplitude_scale: float = 1.0
) -> float:
    """Largest relative difference of two clouds.

    Parameters
    ----------
    scenario : Scenario
    first, second : PointCloud
        In any order.
    amplitude_scale : float
        Times which the second's amplitudes ought to be the first's.

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
    # In turn: the square of the scale may not be a number.
    power = second.power / amplitude_scale / amplitude_scale
    one, two = _relative(scenario, first), _relative(scenario, second)
    apart = np.maximum(cdist(one, two, "chebyshev"), _power_apart(first.power[:, None], power))
    in_order = float(apart.diagonal().max())
    return min(in_order, float(apart[linear_sum_assignment(apart)].max())) if in_order else 0.0


def _relative(scenario: Scenario, cloud: PointCloud) -> NDArray[np.float64]:
    """Points (n, 4) in units of what the scene and the radio span."""
    farthest_m = scenario.region.range_limits_m(scenario.base_station_m)[1]
    xyz = (cloud.xyz - scenario.base_station_m) / farthest_m
    return np.column_stack([xyz, cloud.velocity / scenario.system.unambiguous_speed_mps])


def _power_apart(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Relative differences of powers, 0 of two zeros."""
    larger = np.maximum(one, two)
    return np.divide(np.abs(one - two), larger, out=np.zeros_like(larger), where=larger > 0)


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
