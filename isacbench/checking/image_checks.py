"""Checks of images: what every cloud must be, where echoes must be found, and what must change nothing."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from isacbench.bench.cells.cell import raw_cloud
from isacbench.checking.checks import Check, CheckFailedError, NotApplicableError
from isacbench.checking.scenes import SmallScene
from isacbench.model.cloud import PointCloud
from isacbench.model.frame import PanelFrame
from isacbench.model.observation import REGION_TOLERANCE_M, Observation
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.region import Region
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Estimator

INVARIANCE = 1e-9
"""Largest difference between numbers of threads, memory orders and orders of elements."""

LIMITS = -126, 126
"""Binary exponents of the largest amplitude of scaled cells: the limits of float32."""

ODD = 1.7
"""Scale factor that is not a power of two, so that products round."""

FALSE_POINT_CELLS = 0.1
"""Largest distance, in Rayleigh cells, at which a point belongs to the nearest scatterer."""

POWER_DB = 0.1
"""Largest error of the power of a resolved echo: estimators may use a diagonal loading of 1e-3."""

SINGLE_POINT = 1e-4

ROUNDING_M = 1e-6


@dataclass(frozen=True, eq=False)
class ImageSubject:
    """An estimator and the scene that it images."""

    estimator: Estimator
    scene: SmallScene

    @property
    def plugin_module(self) -> str:
        """Module of the estimator's class."""
        return type(self.estimator).__module__

    @cached_property
    def cloud(self) -> PointCloud:
        """Image of the scene."""
        return self.image(self.scene.observation())

    def image(self, observation: Observation) -> PointCloud:
        """Image another observation of the same scene."""
        return raw_cloud(self.estimator, observation, self.scene.scenario.truth)

    def image_of(self, cells: NDArray[np.complexfloating[Any, Any]]) -> PointCloud:
        """Image other cells (n_range, n_doppler, P, Q) of the same gate."""
        return self.image(dataclasses.replace(self.scene.observation(), cells=cells))

    @property
    def sees_truth(self) -> bool:
        """True for an estimator that returns the truth and ignores the cells."""
        return bool(getattr(self.estimator, "needs_truth", False))

    def difference(self, cloud: PointCloud, amplitude_scale: float = 1.0) -> float:
        """Relative difference of another image of the same scene; see `cloud_difference`."""
        return cloud_difference(self.scene.scenario, self.cloud, cloud, amplitude_scale)


def cloud_difference(
    scenario: Scenario, first: PointCloud, second: PointCloud, amplitude_scale: float = 1.0
) -> float:
    """Largest relative difference of two clouds, whose points may be in any order.

    Positions count relative to the range of the region's farthest corner, velocities to the unambiguous
    speed, powers each to itself, after amplitudes of the second cloud are divided by their scale.
    """
    if len(first) != len(second):
        raise CheckFailedError(f"{len(first)} points, then {len(second)}")
    if not len(first):
        return 0.0
    power = second.power / amplitude_scale**2
    larger = np.maximum(first.power[:, None], power)
    power_apart = np.abs(first.power[:, None] - power) / np.where(larger > 0, larger, 1.0)
    farthest_m = scenario.region.range_limits_m(scenario.base_station_m)[1]
    one, two = (
        np.column_stack(
            [
                (cloud.xyz - scenario.base_station_m) / farthest_m,
                cloud.velocity / scenario.system.unambiguous_speed_mps,
            ]
        )
        for cloud in (first, second)
    )
    apart = np.maximum(cdist(one, two, "chebyshev"), power_apart)
    in_order = float(apart.diagonal().max())
    return min(in_order, float(apart[linear_sum_assignment(apart)].max())) if in_order else 0.0


def cells_apart(scenario: Scenario, cloud: PointCloud, others: PointCloud) -> NDArray[np.float64]:
    """Rayleigh cells between points (rows) and others (columns), the largest over range, velocity, u and w.

    Elements half a wavelength apart cannot tell u = 1 from u = -1, nor the
    radio speeds that lie twice the unambiguous one apart.
    """
    cells, system = rayleigh_cells(scenario), scenario.system
    one, two = radio_places(scenario, cloud), radio_places(scenario, others)
    apart = np.abs(one[:, None] - two)
    period = np.array([system.unambiguous_range_m, 2 * system.unambiguous_speed_mps, 2.0, 2.0])
    return np.asarray(np.max(np.minimum(apart, np.abs(period - apart)) / cells, axis=2))


def _of_cells(measure: Callable[[ImageSubject], float]) -> Callable[[ImageSubject], float]:
    """Say nothing about an estimator that sees the truth."""

    def measured(subject: ImageSubject) -> float:
        if subject.sees_truth:
            raise NotApplicableError("it sees the truth")
        return measure(subject)

    return measured


def _is_in_region(subject: ImageSubject) -> float:
    xyz = subject.cloud.xyz
    outside = ~subject.scene.scenario.region.contains(xyz, REGION_TOLERANCE_M + ROUNDING_M)
    if outside.any() and not subject.sees_truth:
        x, y, z = xyz[outside.argmax()]
        raise CheckFailedError(
            f"{outside.sum()} of {len(xyz)} points lie more than {REGION_TOLERANCE_M} m outside the region, "
            f"the first at ({x:.3g}, {y:.3g}, {z:.3g}) m: place points in metres, with observation.cloud(...)"
        )
    return 0.0


def _has_possible_speeds(subject: ImageSubject) -> float:
    system = subject.scene.scenario.system
    limit_mps = system.unambiguous_speed_mps + system.velocity_bin_mps / 2
    fastest_mps = float(np.abs(subject.cloud.velocity).max(initial=0.0))
    if fastest_mps > limit_mps and not subject.sees_truth:
        raise CheckFailedError(
            f"velocities reach {fastest_mps:.4g} m/s, the radio tells {limit_mps:.4g} m/s: give them in m/s, "
            "from signed Doppler bins"
        )
    return 0.0


def _has_possible_powers(subject: ImageSubject) -> float:
    lowest = float(subject.cloud.power.min(initial=0.0))
    if lowest < 0:
        raise CheckFailedError(
            f"powers go down to {lowest:.3g}: a power is |G|² relative to a unit scatterer, 0 or more and "
            "no dB"
        )
    return 0.0


def _is_possible(subject: ImageSubject) -> float:
    return max(measure(subject) for measure in (_is_in_region, _has_possible_speeds, _has_possible_powers))


def _repeats(subject: ImageSubject) -> float:
    return subject.difference(subject.image(subject.scene.observation()))


def _farthest_false_point(subject: ImageSubject) -> float:
    """Largest distance of a point from its nearest scatterer, in Rayleigh cells; refuse too many points."""
    cloud, truth = subject.cloud, subject.scene.scenario.truth
    if len(cloud) > len(truth):
        raise CheckFailedError(f"{len(cloud)} points of {len(truth)} scatterers")
    if not len(cloud):
        return 0.0
    return float(cells_apart(subject.scene.scenario, cloud, truth).min(axis=1).max())


@_of_cells
def _has_no_point(subject: ImageSubject) -> float:
    if len(subject.cloud):
        raise CheckFailedError(f"{len(subject.cloud)} points of no echo")
    return 0.0


def _distances(subject: ImageSubject) -> NDArray[np.float64]:
    """Distances from every scatterer (rows) to every point (columns), in Rayleigh cells."""
    cloud, truth = subject.cloud, subject.scene.scenario.truth
    if not len(cloud):
        raise CheckFailedError(f"no point of {len(truth)} scatterers")
    return cells_apart(subject.scene.scenario, truth, cloud)


def _farthest_miss(subject: ImageSubject) -> float:
    return float(_distances(subject).min(axis=1).max())


def _miss_of_first(subject: ImageSubject) -> float:
    return float(_distances(subject)[0].min())


def _power_off_db(subject: ImageSubject) -> float:
    """Largest error in dB of the power of the point nearest to a scatterer."""
    nearest = _distances(subject).argmin(axis=1)
    ratio = subject.cloud.power[nearest] / subject.scene.scenario.truth.power
    return float(np.abs(10 * np.log10(ratio)).max())


def _scaled(odd: float, subject: ImageSubject) -> float:
    """Difference after scaling the largest amplitude to either limit, by a power of two times `odd`."""
    cells = subject.scene.seen.cells
    largest = math.frexp(float(np.abs(cells).max()))[1]
    factors = [odd * 2.0 ** (limit - largest) for limit in LIMITS]
    return max(subject.difference(subject.image_of(cells * factor), factor) for factor in factors)


@_of_cells
def _with_two_threads(subject: ImageSubject) -> float:
    """Difference with two BLAS threads, for an estimator that does not keep to one itself."""
    with threadpool_limits(2):
        image = subject.image(subject.scene.observation())
    return subject.difference(image)


@_of_cells
def _in_other_layouts(subject: ImageSubject) -> float:
    """Difference for cells in Fortran order, with elements first in memory, and backwards in memory."""
    cells = subject.scene.seen.cells
    elements_first = np.ascontiguousarray(cells.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    backwards = cells[::-1].copy()[::-1]
    return max(
        subject.difference(subject.image_of(laid))
        for laid in (np.asfortranarray(cells), elements_first, backwards)
    )


@_of_cells
def _in_other_element_orders(subject: ImageSubject) -> float:
    """Difference with reversed columns, with reversed rows, and with columns and rows exchanged.

    For a panel without yaw and tilt this mirrors the scene about the base station. Each mirror is its own
    inverse.
    """
    scenario, observation = subject.scene.scenario, subject.scene.observation()
    if scenario.frame != PanelFrame():
        raise NotApplicableError("its mirrored scenes are known for a panel without yaw and tilt alone")
    cells, array, base_station_m = observation.cells, observation.array, scenario.base_station_m
    swapped = dataclasses.replace(array, tx_shape=array.tx_shape[::-1], rx_shape=array.rx_shape[::-1])
    differences = []
    for seen, counted, mirror in (
        (cells[:, :, ::-1], array, [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        (cells[:, :, :, ::-1], array, [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        (cells.transpose(0, 1, 3, 2), swapped, [[0, 0, -1], [0, 1, 0], [-1, 0, 0]]),
    ):
        corners = base_station_m + (scenario.region.corners_m - base_station_m) @ mirror
        x_m, y_m, z_m = zip(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), strict=True)
        mirrored = dataclasses.replace(
            observation,
            cells=np.ascontiguousarray(seen),
            array=counted,
            region=Region(x_m, y_m, z_m, scenario.region.speed_mps),
        )
        cloud = subject.image(mirrored)
        xyz = base_station_m + (cloud.xyz - base_station_m) @ mirror
        differences.append(subject.difference(PointCloud(xyz, cloud.velocity, cloud.power)))
    return max(differences)


@_of_cells
def _in_single_precision(subject: ImageSubject) -> float:
    return subject.difference(subject.image_of(subject.scene.seen.cells.astype(np.complex64)))


IN_REGION = Check("region", _is_in_region)
SPEEDS = Check("velocity", _has_possible_speeds)
POWERS = Check("power", _has_possible_powers)
FINITE = Check("finite", _is_possible)
REPEAT = Check("repeat", _repeats)
NO_FALSE_POINT = Check("no false point", _farthest_false_point, FALSE_POINT_CELLS)
NO_POINT = Check("no point", _has_no_point)
FOUND = Check("found", _farthest_miss, FALSE_POINT_CELLS)
FOUND_FIRST = Check("strongest found", _miss_of_first, FALSE_POINT_CELLS)
POWER = Check("power", _power_off_db, POWER_DB)
RESOLVED_ECHOES = NO_FALSE_POINT, FOUND
TWO_POWER_SCALE = Check("scale by powers of two", _of_cells(partial(_scaled, 1.0)))
ANY_SCALE = Check("scale", _of_cells(partial(_scaled, ODD)), 1e-10)
THREADS = Check("threads", _with_two_threads, INVARIANCE)
LAYOUT = Check("memory order", _in_other_layouts, INVARIANCE)
ELEMENT_ORDER = Check("element order", _in_other_element_orders, INVARIANCE)
SINGLE_PRECISION = Check("single precision", _in_single_precision, SINGLE_POINT)

EVERY = FINITE, REPEAT
"""Checks of every image."""

INVARIANT = TWO_POWER_SCALE, ANY_SCALE, THREADS, LAYOUT, ELEMENT_ORDER
"""Checks of images without ties."""
