"""Promises of images: properties of every cloud, and invariances of the estimator."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from isacbench.bench.cells.cell import raw_cloud
from isacbench.checking.promises.drift import cells_apart, cloud_drift
from isacbench.checking.promises.promise import BrokenPromiseError, NotApplicableError, Promise
from isacbench.checking.promises.small_scenes import Shot
from isacbench.model.cloud import PointCloud
from isacbench.model.frame import PanelFrame
from isacbench.model.observation import REGION_TOLERANCE_M, Observation
from isacbench.model.region import Region
from isacbench.plugins.contracts import Estimator

INVARIANCE = 1e-9
"""Largest drift between numbers of threads, memory orders and orders of elements."""

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
class Imaging:
    """An estimator and the shot that it images."""

    estimator: Estimator
    shot: Shot

    @cached_property
    def cloud(self) -> PointCloud:
        """Image of the shot."""
        return self.image(self.shot.observation())

    def image(self, observation: Observation) -> PointCloud:
        """Image another observation of the same scene."""
        return raw_cloud(self.estimator, observation, self.shot.scenario.truth)

    def image_of(self, cells: NDArray[np.complexfloating[Any, Any]]) -> PointCloud:
        """Image other cells of the same gate.

        Parameters
        ----------
        cells : ndarray of complex, shape (n_range, n_doppler, P, Q)
        """
        return self.image(dataclasses.replace(self.shot.observation(), cells=cells))

    @property
    def sees_truth(self) -> bool:
        """True for an estimator that returns the truth and ignores the cells."""
        return bool(getattr(self.estimator, "needs_truth", False))

    def drift(self, cloud: PointCloud, amplitude_scale: float = 1.0) -> float:
        """Relative difference of another image of the same scene; see `cloud_drift`.

        Parameters
        ----------
        amplitude_scale : float
            Amplitudes of the other image over those of this one.
        """
        return cloud_drift(self.shot.scenario, self.cloud, cloud, amplitude_scale)


def _is_in_region(imaging: Imaging) -> float:
    xyz = imaging.cloud.xyz
    outside = ~imaging.shot.scenario.region.contains(xyz, REGION_TOLERANCE_M + ROUNDING_M)
    if outside.any() and not imaging.sees_truth:
        x, y, z = xyz[outside.argmax()]
        raise BrokenPromiseError(
            f"{outside.sum()} of {len(xyz)} points lie more than {REGION_TOLERANCE_M} m outside the region, "
            f"the first at ({x:.3g}, {y:.3g}, {z:.3g}) m: place points in metres, with observation.cloud(...)"
        )
    return 0.0


def _has_possible_speeds(imaging: Imaging) -> float:
    system = imaging.shot.scenario.system
    limit_mps = system.unambiguous_speed_mps + system.velocity_bin_mps / 2
    fastest_mps = float(np.abs(imaging.cloud.velocity).max(initial=0.0))
    if fastest_mps > limit_mps and not imaging.sees_truth:
        raise BrokenPromiseError(
            f"velocities reach {fastest_mps:.4g} m/s, the radio tells {limit_mps:.4g} m/s: give them in m/s, "
            "from signed Doppler bins"
        )
    return 0.0


def _has_possible_powers(imaging: Imaging) -> float:
    lowest = float(imaging.cloud.power.min(initial=0.0))
    if lowest < 0:
        raise BrokenPromiseError(
            f"powers go down to {lowest:.3g}: a power is |G|² relative to a unit scatterer, 0 or more and "
            "no dB"
        )
    return 0.0


def _finite(imaging: Imaging) -> float:
    return max(promise.drift(imaging) for promise in (IN_REGION, SPEEDS, POWERS))


def _repeats(imaging: Imaging) -> float:
    return imaging.drift(imaging.image(imaging.shot.observation()))


def _no_false_point(imaging: Imaging) -> float:
    """Largest distance of a point from its nearest scatterer, in Rayleigh cells; refuse too many points."""
    cloud, truth = imaging.cloud, imaging.shot.scenario.truth
    if len(cloud) > len(truth):
        raise BrokenPromiseError(f"{len(cloud)} points of {len(truth)} scatterers")
    if not len(cloud):
        return 0.0
    return float(cells_apart(imaging.shot.scenario, cloud, truth).min(axis=1).max())


def _no_point(imaging: Imaging) -> float:
    if len(imaging.cloud):
        raise BrokenPromiseError(f"{len(imaging.cloud)} points of no echo")
    return 0.0


def _apart(imaging: Imaging) -> NDArray[np.float64]:
    """Distances from every scatterer (rows) to every point (columns), in Rayleigh cells."""
    cloud, truth = imaging.cloud, imaging.shot.scenario.truth
    if not len(cloud):
        raise BrokenPromiseError(f"no point of {len(truth)} scatterers")
    return cells_apart(imaging.shot.scenario, truth, cloud)


def _found(imaging: Imaging) -> float:
    return float(_apart(imaging).min(axis=1).max())


def _found_first(imaging: Imaging) -> float:
    return float(_apart(imaging)[0].min())


def _power_off_db(imaging: Imaging) -> float:
    """Largest error in dB of the power of the point nearest to a scatterer."""
    nearest = _apart(imaging).argmin(axis=1)
    ratio = imaging.cloud.power[nearest] / imaging.shot.scenario.truth.power
    return float(np.abs(10 * np.log10(ratio)).max())


def _scaled(imaging: Imaging, odd: float) -> float:
    """Drift after scaling the largest amplitude to either limit, by a power of two times `odd`."""
    cells = imaging.shot.seen.cells
    largest = math.frexp(float(np.abs(cells).max()))[1]
    factors = [odd * 2.0 ** (limit - largest) for limit in LIMITS]
    return max(imaging.drift(imaging.image_of(cells * factor), factor) for factor in factors)


def _threads(imaging: Imaging) -> float:
    """Drift with two BLAS threads, for an estimator that does not keep to one itself."""
    with threadpool_limits(2):
        image = imaging.image(imaging.shot.observation())
    return imaging.drift(image)


def _layout(imaging: Imaging) -> float:
    """Drift for cells in Fortran order, with elements first in memory, and backwards in memory."""
    cells = imaging.shot.seen.cells
    elements_first = np.ascontiguousarray(cells.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    backwards = cells[::-1].copy()[::-1]
    return max(
        imaging.drift(imaging.image_of(laid))
        for laid in (np.asfortranarray(cells), elements_first, backwards)
    )


def _element_order(imaging: Imaging) -> float:
    """Drift with reversed columns, with reversed rows, and with columns and rows exchanged.

    For a panel without yaw and tilt this mirrors the scene about the base station. Each mirror is its own
    inverse.
    """
    scenario, observation = imaging.shot.scenario, imaging.shot.observation()
    if scenario.frame != PanelFrame():
        raise NotApplicableError("its mirrored scenes are known for a panel without yaw and tilt alone")
    cells, array, base_station_m = observation.cells, observation.array, scenario.base_station_m
    swapped = dataclasses.replace(array, tx_shape=array.tx_shape[::-1], rx_shape=array.rx_shape[::-1])
    drifts = []
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
        cloud = imaging.image(mirrored)
        xyz = base_station_m + (cloud.xyz - base_station_m) @ mirror
        drifts.append(imaging.drift(PointCloud(xyz, cloud.velocity, cloud.power)))
    return max(drifts)


def _single_precision(imaging: Imaging) -> float:
    return imaging.drift(imaging.image_of(imaging.shot.seen.cells.astype(np.complex64)))


def _of_cells(drift: Callable[[Imaging], float]) -> Callable[[Imaging], float]:
    """Restrict a promise to estimators that use the cells."""

    def checked(imaging: Imaging) -> float:
        if imaging.sees_truth:
            raise NotApplicableError("it sees the truth")
        return drift(imaging)

    return checked


IN_REGION = Promise("region", 0.0, _is_in_region)
SPEEDS = Promise("velocity", 0.0, _has_possible_speeds)
POWERS = Promise("power", 0.0, _has_possible_powers)
FINITE = Promise("finite", 0.0, _finite)
REPEAT = Promise("repeat", 0.0, _repeats)
NO_FALSE_POINT = Promise("no false point", FALSE_POINT_CELLS, _no_false_point)
NO_POINT = Promise("no point", 0.0, _of_cells(_no_point))
FOUND = Promise("found", FALSE_POINT_CELLS, _found)
FOUND_FIRST = Promise("strongest found", FALSE_POINT_CELLS, _found_first)
POWER = Promise("power", POWER_DB, _power_off_db)
RESOLVED_ECHOES = NO_FALSE_POINT, FOUND
TWO_POWER_SCALE = Promise("scale by powers of two", 0.0, _of_cells(lambda imaging: _scaled(imaging, 1.0)))
ANY_SCALE = Promise("scale", 1e-10, _of_cells(lambda imaging: _scaled(imaging, ODD)))
THREADS = Promise("threads", INVARIANCE, _of_cells(_threads))
LAYOUT = Promise("memory order", INVARIANCE, _of_cells(_layout))
ELEMENT_ORDER = Promise("element order", INVARIANCE, _of_cells(_element_order))
SINGLE_PRECISION = Promise("single precision", SINGLE_POINT, _of_cells(_single_precision))

EVERY = FINITE, REPEAT
"""Promises of every image."""

INVARIANT = TWO_POWER_SCALE, ANY_SCALE, THREADS, LAYOUT, ELEMENT_ORDER
"""Promises of images without ties."""
