"""Imaging: an estimator and a shot, what is promised of every image, and how it may move."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from isacbench.bench.cells.cell import raw_cloud
from isacbench.checking.contract.small_scenes import Shot
from isacbench.checking.stress.case import BrokenPromiseError, NotApplicableError, Promise
from isacbench.checking.stress.promises.blas_kernels import other_kernels, process_under
from isacbench.checking.stress.promises.drift import cells_apart, cloud_drift
from isacbench.model.frame import Frame
from isacbench.model.observation import REGION_TOLERANCE_M
from isacbench.plugins.contracts import Diagnoser

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from isacbench.model.cloud import PointCloud
    from isacbench.model.observation import Observation
    from isacbench.plugins.contracts import Diagnosis, Estimator

    Cells = NDArray[np.complexfloating[Any, Any]]

INVARIANCE = 1e-9
"""Bound on the drift with threads, the BLAS kernel, memory and the order of elements."""

LIMITS = 2.0**-490, 2.0**490
"""Amplitudes, about 1e-147 and 1e147, whose squares and sums of squares are still numbers."""

ODD = 1.7
"""A factor that rounds."""

FALSE_POINT_CELLS = 0.1
"""Rayleigh cells from the nearest scatterer within which a point is one of it."""

POWER_DB = 0.1
"""How well the power of a resolved echo is known: amplitudes are loaded by 1e-3."""

SINGLE_MAP = 1e-6
SINGLE_THRESHOLD = 1e-4
SINGLE_DIRECTION = 1e-4
SINGLE_POINT = 1e-4


@dataclass(frozen=True, eq=False)
class Imaging:
    """An estimator and what it images.

    Attributes
    ----------
    estimator : Estimator
    shot : Shot
    """

    estimator: Estimator
    shot: Shot

    @cached_property
    def cloud(self) -> PointCloud:
        """Image of the shot."""
        return self.image(self.shot.observation())

    def image(self, observation: Observation) -> PointCloud:
        """Image of another observation of the same scene."""
        return raw_cloud(self.estimator, observation, self.shot.scenario.truth)

    def image_of(self, cells: Cells) -> PointCloud:
        """Image of other cells of the same gate."""
        return self.image(dataclasses.replace(self.shot.observation(), cells=cells))

    @property
    def sees_truth(self) -> bool:
        """Whether cells do not matter to it."""
        return bool(getattr(self.estimator, "needs_truth", False))

    def drift(self, cloud: PointCloud, amplitude_scale: float = 1.0) -> float:
        """How far another image of the same scene is from its own, whose amplitudes ought to be scaled."""
        return cloud_drift(self.shot.scenario, self.cloud, cloud, amplitude_scale)


def _finite(imaging: Imaging) -> float:
    """Finite, of no negative power, in the region; exceptions and warnings break the promise as well."""
    cloud, scenario = imaging.cloud, imaging.shot.scenario
    for name in ("xyz", "velocity", "power"):
        if not np.isfinite(getattr(cloud, name)).all():
            raise BrokenPromiseError(f"{name} has NaN or infinity")
    if not imaging.sees_truth and not scenario.region.contains(cloud.xyz, 2 * REGION_TOLERANCE_M).all():
        raise BrokenPromiseError("points lie outside the region")
    if (cloud.power < 0).any():
        raise BrokenPromiseError("powers are negative")
    return 0.0


def _repeats(imaging: Imaging) -> float:
    return imaging.drift(imaging.image(imaging.shot.observation()))


def _no_false_point(imaging: Imaging) -> float:
    """No more points than scatterers, each within a Rayleigh cell of one."""
    cloud, truth = imaging.cloud, imaging.shot.scenario.truth
    if len(cloud) > len(truth):
        raise BrokenPromiseError(f"{len(cloud)} points of {len(truth)} scatterers")
    if not len(cloud):
        return 0.0
    return float(cells_apart(imaging.shot.scenario, cloud, truth).min(axis=1).max())


def _no_point(imaging: Imaging) -> float:
    """Nothing is imaged, for nothing is there."""
    if imaging.sees_truth:
        raise NotApplicableError("it sees the truth")
    if len(imaging.cloud):
        raise BrokenPromiseError(f"{len(imaging.cloud)} points of no echo")
    return 0.0


def _found(imaging: Imaging) -> float:
    """Every scatterer has a point near it."""
    return float(_misses(imaging).max())


def _found_first(imaging: Imaging) -> float:
    """The first scatterer, whatever else there is, has a point near it."""
    return float(_misses(imaging)[0])


def _misses(imaging: Imaging) -> NDArray[np.float64]:
    """Rayleigh cells from every scatterer to its nearest point."""
    cloud, truth = imaging.cloud, imaging.shot.scenario.truth
    if not len(cloud):
        raise BrokenPromiseError(f"no point of {len(truth)} scatterers")
    misses: NDArray[np.float64] = cells_apart(imaging.shot.scenario, truth, cloud).min(axis=1)
    return misses


def _power_off_db(imaging: Imaging) -> float:
    """Largest error in dB of the power of the point next to a scatterer."""
    cloud, truth = imaging.cloud, imaging.shot.scenario.truth
    if not len(cloud):
        raise BrokenPromiseError(f"no point of {len(truth)} scatterers")
    nearest = cells_apart(imaging.shot.scenario, truth, cloud).argmin(axis=1)
    # Logarithms apart: the ratio of powers of hostile scenes may not be a number.
    return float(np.abs(10 * (np.log10(cloud.power[nearest]) - np.log10(truth.power))).max())


def _scaled(imaging: Imaging, odd: float) -> float:
    """Drift where the largest amplitude is brought to either limit, by powers of two times an odd factor."""
    cells = imaging.shot.seen.cells
    largest = math.frexp(float(np.abs(cells).max()))[1]
    factors = [odd * math.ldexp(limit, -largest) for limit in LIMITS]
    return max(imaging.drift(imaging.image_of(cells * factor), factor) for factor in factors)


def _two_power_scale(imaging: Imaging) -> float:
    return _scaled(imaging, 1.0)


def _any_scale(imaging: Imaging) -> float:
    return _scaled(imaging, ODD)


def _threads(imaging: Imaging) -> float:
    with threadpool_limits(1):
        one = imaging.image(imaging.shot.observation())
    with threadpool_limits(2):
        two = imaging.image(imaging.shot.observation())
    return max(imaging.drift(one), imaging.drift(two))


def _blas_kernels(imaging: Imaging) -> float:
    """Other kernels that the processor can run, each in a process of its own."""
    kernels = other_kernels()
    if not kernels:
        raise NotApplicableError("the BLAS has no other kernel that this processor runs")
    estimator, truth = imaging.estimator, imaging.shot.scenario.truth
    drifts = []
    for name, core_type in kernels.items():
        try:
            image = process_under(core_type).image(estimator, imaging.shot.observation(), truth)
            drifts.append(imaging.drift(image))
        except (RuntimeError, BrokenPromiseError) as error:
            raise BrokenPromiseError(f"under the BLAS kernel {name}: {error}") from error
    return max(drifts)


def _layout(imaging: Imaging) -> float:
    """Fortran order, elements first in memory, and every second item of a larger array."""
    cells = imaging.shot.seen.cells
    elements_first = np.ascontiguousarray(cells.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    every_second = np.repeat(cells, 2, axis=3)[:, :, :, ::2]
    return max(
        imaging.drift(imaging.image_of(laid))
        for laid in (np.asfortranarray(cells), elements_first, every_second, cells[::-1].copy()[::-1])
    )


@dataclass(frozen=True)
class _TurnedFrame(Frame):
    """A frame whose array counts its elements from the other end, or its columns as rows."""

    frame: Frame
    sign_u: float
    sign_w: float
    is_swapped: bool

    half_space = "of the frame that it turns"

    def direction_cosines(self, offset_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Direction cosines along the axes as they are counted."""
        u, w = self.frame.direction_cosines(offset_m)
        return (self.sign_w * w, self.sign_u * u) if self.is_swapped else (self.sign_u * u, self.sign_w * w)

    def _straight(self, u: ArrayLike, w: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        first, second = np.asarray(u, dtype=np.float64), np.asarray(w, dtype=np.float64)
        along_u, along_w = (second, first) if self.is_swapped else (first, second)
        return self.sign_u * along_u, self.sign_w * along_w

    def offsets(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> NDArray[np.float64]:
        """Offsets (n, 3) in metres."""
        return self.frame.offsets(range_m, *self._straight(u, w))

    def offset_jacobian(self, range_m: ArrayLike, u: ArrayLike, w: ArrayLike) -> NDArray[np.float64]:
        """Derivatives (n, 3, 3)."""
        along_range, along_u, along_w = np.moveaxis(
            self.frame.offset_jacobian(range_m, *self._straight(u, w)), -1, 0
        )
        turned = [self.sign_u * along_u, self.sign_w * along_w]
        return np.stack([along_range, *(turned[::-1] if self.is_swapped else turned)], axis=-1)

    def in_half_space(self, offset_m: ArrayLike) -> NDArray[np.bool_]:
        """Whether each offset (n, 3) lies where the map can be inverted."""
        return self.frame.in_half_space(offset_m)


def _element_order(imaging: Imaging) -> float:
    """Columns counted from the other end, rows likewise, and columns as rows: the same scene."""
    cells, frame = imaging.shot.seen.cells, imaging.shot.scenario.frame
    array = imaging.shot.scenario.array
    swapped = dataclasses.replace(array, tx_shape=array.tx_shape[::-1], rx_shape=array.rx_shape[::-1])
    turned = (
        (cells[:, :, ::-1], _TurnedFrame(frame, -1.0, 1.0, False), array),
        (cells[:, :, :, ::-1], _TurnedFrame(frame, 1.0, -1.0, False), array),
        (cells.transpose(0, 1, 3, 2), _TurnedFrame(frame, 1.0, 1.0, True), swapped),
    )
    observation = imaging.shot.observation()
    return max(
        imaging.drift(
            imaging.image(
                dataclasses.replace(observation, cells=np.ascontiguousarray(seen), frame=turn, array=counted)
            )
        )
        for seen, turn, counted in turned
    )


def _single_precision(imaging: Imaging) -> float:
    return imaging.drift(imaging.image_of(imaging.shot.seen.cells.astype(np.complex64)))


def _single_stage(compare: Callable[[Diagnosis, Diagnosis], float]) -> Callable[[Imaging], float]:
    """Compare what an estimator shows of its work on cells of either precision."""

    def drift(imaging: Imaging) -> float:
        if not isinstance(imaging.estimator, Diagnoser):
            raise NotApplicableError("it does not show its stages")
        double = imaging.shot.observation()
        single = dataclasses.replace(double, cells=double.cells.astype(np.complex64))
        return compare(imaging.estimator.diagnose(double), imaging.estimator.diagnose(single))

    return drift


def _map_drift(double: Diagnosis, single: Diagnosis) -> float:
    return float(np.abs(double.power - single.power).max() / (double.power.max() or 1.0))


def _threshold_drift(double: Diagnosis, single: Diagnosis) -> float:
    one, two = double.detection.threshold, single.detection.threshold
    if not np.array_equal(double.detection.mask, single.detection.mask):
        raise BrokenPromiseError("other cells are detected")
    return float(np.max(np.abs(one - two) / np.where(one > 0, one, 1.0)))


def _direction_drift(double: Diagnosis, single: Diagnosis) -> float:
    if double.cell != single.cell:
        raise BrokenPromiseError(f"the strongest cell is {double.cell}, then {single.cell}")
    if not any(len(spectrum.peaks) for spectrum in double.spectra):
        raise NotApplicableError("it shows no peak")
    drifts = []
    for one, two in zip(double.spectra, single.spectra, strict=True):
        if len(one.peaks) != len(two.peaks):
            raise BrokenPromiseError(f"{len(one.peaks)} peaks along {one.label}, then {len(two.peaks)}")
        drifts += np.abs(np.sort(one.peaks) - np.sort(two.peaks)).tolist()
    return float(max(drifts))


def _of_cells(drift: Callable[[Imaging], float]) -> Callable[[Imaging], float]:
    """Leave out estimators to which cells do not matter."""

    def checked(imaging: Imaging) -> float:
        if imaging.sees_truth:
            raise NotApplicableError("it sees the truth")
        return drift(imaging)

    return checked


FINITE = Promise("finite", 0.0, _finite)
REPEAT = Promise("repeat", 0.0, _repeats)
NO_FALSE_POINT = Promise("no false point", FALSE_POINT_CELLS, _no_false_point)
NO_POINT = Promise("no point", 0.0, _no_point)
FOUND = Promise("found", FALSE_POINT_CELLS, _found)
FOUND_FIRST = Promise("strongest found", FALSE_POINT_CELLS, _found_first)
POWER = Promise("power", POWER_DB, _power_off_db)
RESOLVED_ECHOES = NO_FALSE_POINT, FOUND
TWO_POWER_SCALE = Promise("scale by powers of two", 0.0, _of_cells(_two_power_scale))
ANY_SCALE = Promise("scale", 1e-10, _of_cells(_any_scale))
THREADS = Promise("threads", INVARIANCE, _of_cells(_threads))
BLAS_KERNELS = Promise("BLAS kernels", INVARIANCE, _of_cells(_blas_kernels))
LAYOUT = Promise("memory order", INVARIANCE, _of_cells(_layout))
ELEMENT_ORDER = Promise("element order", INVARIANCE, _of_cells(_element_order))
SINGLE_PRECISION = Promise("single precision", SINGLE_POINT, _of_cells(_single_precision))
SINGLE_STAGES = (
    Promise("single precision: map", SINGLE_MAP, _single_stage(_map_drift)),
    Promise("single precision: thresholds", SINGLE_THRESHOLD, _single_stage(_threshold_drift)),
    Promise("single precision: directions", SINGLE_DIRECTION, _single_stage(_direction_drift)),
    SINGLE_PRECISION,
)

EVERY = FINITE, REPEAT
"""What holds of every image, whatever is imaged."""

INVARIANT = TWO_POWER_SCALE, ANY_SCALE, THREADS, BLAS_KERNELS, LAYOUT, ELEMENT_ORDER
"""What holds where nothing is left to a tie."""
