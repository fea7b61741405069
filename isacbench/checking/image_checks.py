"""Checks of estimators: of images anywhere, and the contract, which asks for more on a few small scenes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.special import stdtrit
from threadpoolctl import threadpool_limits

from isacbench.bench.cells.images import raw_cloud
from isacbench.checking import checks
from isacbench.checking.checks import ODD, Check, CheckFailedError, NotApplicableError, require, sees_truth
from isacbench.checking.lone_scatterer import require_lone_scatterer
from isacbench.checking.scenes import LONE_VIEWS, SmallScene, contract_scene, lone
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator
from isacbench.model.frame import PanelFrame
from isacbench.model.observation import REGION_TOLERANCE_M, Observation, cross_elements
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.region import Region
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import needs_of
from isacbench.plugins.scoring import score

INVARIANCE = 1e-9
"""Largest difference between numbers of threads, memory orders and orders of elements."""

LIMITS = -126, 126
"""Binary exponents of the largest amplitude of scaled cells: the limits of float32."""

FALSE_POINT_CELLS = 0.1
"""Largest distance, in Rayleigh cells, at which a point belongs to the nearest scatterer."""

POWER_DB = 0.1
"""Largest error of the power of a resolved echo: estimators may use a diagonal loading of 1e-3."""

SINGLE_POINT = 1e-4

ROUNDING_M = 1e-6


@dataclass(frozen=True, eq=False)
class ImageSubject(checks.Subject):
    """An estimator and the scene that it images."""

    scene: SmallScene

    @cached_property
    def cloud(self) -> PointCloud:
        """Image of the scene."""
        return self.image(self.scene.fresh_observation())

    def image(self, observation: Observation) -> PointCloud:
        """Image another observation of the same scene."""
        return raw_cloud(self.plugin, observation, self.scene.scenario.truth)

    def image_of(self, cells: NDArray[np.complexfloating[Any, Any]]) -> PointCloud:
        """Image other cells (n_range, n_doppler, P, Q) of the same gate."""
        return self.image(dataclasses.replace(self.scene.fresh_observation(), cells=cells))

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
    require(len(first) == len(second), f"{len(first)} points, then {len(second)}")
    if not len(first):
        return 0.0
    power = second.power / amplitude_scale**2
    larger = np.maximum(first.power[:, None], power)
    power_apart = np.abs(first.power[:, None] - power) / np.where(larger > 0, larger, 1.0)
    farthest_m = scenario.region.range_limits_m(scenario.base_station_m)[1]
    origin = np.append(scenario.base_station_m, 0.0)
    largest = np.array([farthest_m, farthest_m, farthest_m, scenario.system.unambiguous_speed_mps])
    one, two = ((cloud.to_array()[:, :4] - origin) / largest for cloud in (first, second))
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


# What every image must be.


def _is_in_region(subject: ImageSubject) -> None:
    xyz = subject.cloud.xyz
    outside = ~subject.scene.scenario.region.contains(xyz, REGION_TOLERANCE_M + ROUNDING_M)
    if outside.any() and not sees_truth(subject.plugin):
        x, y, z = xyz[outside.argmax()]
        raise CheckFailedError(
            f"{outside.sum()} of {len(xyz)} points lie more than {REGION_TOLERANCE_M} m outside the region, "
            f"the first at ({x:.3g}, {y:.3g}, {z:.3g}) m: place points in metres, with observation.cloud(...)"
        )


def _has_possible_speeds(subject: ImageSubject) -> None:
    system = subject.scene.scenario.system
    limit_mps = system.unambiguous_speed_mps + system.velocity_bin_mps / 2
    fastest_mps = float(np.abs(subject.cloud.velocity).max(initial=0.0))
    require(
        fastest_mps <= limit_mps or sees_truth(subject.plugin),
        f"velocities reach {fastest_mps:.4g} m/s, the radio tells {limit_mps:.4g} m/s: give them in m/s, "
        "from signed Doppler bins",
    )


def _has_possible_powers(subject: ImageSubject) -> None:
    lowest = float(subject.cloud.power.min(initial=0.0))
    require(
        not lowest < 0,
        f"powers go down to {lowest:.3g}: a power is |G|² relative to a unit scatterer, 0 or more and no dB",
    )


def _is_possible(subject: ImageSubject) -> None:
    for measure in (_is_in_region, _has_possible_speeds, _has_possible_powers):
        measure(subject)


# Where echoes are found.


def _farthest_false_point(subject: ImageSubject) -> float:
    """Largest distance of a point from its nearest scatterer, in Rayleigh cells; refuse too many points."""
    cloud, truth = subject.cloud, subject.scene.scenario.truth
    require(len(cloud) <= len(truth), f"{len(cloud)} points of {len(truth)} scatterers")
    if not len(cloud):
        return 0.0
    return float(cells_apart(subject.scene.scenario, cloud, truth).min(axis=1).max())


def _distances(subject: ImageSubject) -> NDArray[np.float64]:
    """Distances from every scatterer (rows) to every point (columns), in Rayleigh cells."""
    cloud, truth = subject.cloud, subject.scene.scenario.truth
    require(len(cloud), f"no point of {len(truth)} scatterers")
    return cells_apart(subject.scene.scenario, truth, cloud)


def _power_off_db(subject: ImageSubject) -> float:
    """Largest error in dB of the power of the point nearest to a scatterer."""
    nearest = _distances(subject).argmin(axis=1)
    ratio = subject.cloud.power[nearest] / subject.scene.scenario.truth.power
    return float(np.abs(10 * np.log10(ratio)).max())


# What is asked of an estimator that looks at the cells: generators of differences.


def _no_point(subject: ImageSubject) -> Iterator[float]:
    require(not len(subject.cloud), f"{len(subject.cloud)} points of no echo")
    yield 0.0


def _scaled(odd: float, subject: ImageSubject) -> Iterator[float]:
    """Difference after scaling the largest amplitude to either limit, by a power of two times `odd`."""
    cells = subject.scene.observation.cells
    largest = math.frexp(float(np.abs(cells).max()))[1]
    for limit in LIMITS:
        factor = odd * 2.0 ** (limit - largest)
        yield subject.difference(subject.image_of(cells * factor), factor)


def _with_two_threads(subject: ImageSubject) -> Iterator[float]:
    """Difference with two BLAS threads, for an estimator that does not keep to one itself."""
    with threadpool_limits(2):
        image = subject.image(subject.scene.fresh_observation())
    yield subject.difference(image)


def _in_other_layouts(subject: ImageSubject) -> Iterator[float]:
    """Difference for cells in Fortran order, with elements first in memory, and backwards in memory."""
    cells = subject.scene.observation.cells
    elements_first = np.ascontiguousarray(cells.transpose(2, 3, 0, 1)).transpose(2, 3, 0, 1)
    for laid in (np.asfortranarray(cells), elements_first, cells[::-1].copy()[::-1]):
        yield subject.difference(subject.image_of(laid))


def _in_other_element_orders(subject: ImageSubject) -> Iterator[float]:
    """Difference with reversed columns, with reversed rows, and with columns and rows exchanged.

    For a panel without yaw and tilt this mirrors the scene about the base station. Each mirror is its own
    inverse.
    """
    scenario, observation = subject.scene.scenario, subject.scene.fresh_observation()
    if scenario.frame != PanelFrame():
        raise NotApplicableError("its mirrored scenes are known for a panel without yaw and tilt alone")
    cells, array, base_station_m = observation.cells, observation.array, scenario.base_station_m
    swapped = dataclasses.replace(array, tx_shape=array.tx_shape[::-1], rx_shape=array.rx_shape[::-1])
    for seen, counted, mirror in (
        (cells[:, :, ::-1], array, np.diag([-1, 1, 1])),
        (cells[:, :, :, ::-1], array, np.diag([1, 1, -1])),
        (cells.transpose(0, 1, 3, 2), swapped, np.array([[0, 0, -1], [0, 1, 0], [-1, 0, 0]])),
    ):
        corners = base_station_m + (scenario.region.corners_m - base_station_m) @ mirror
        x_m, y_m, z_m = zip(corners.min(axis=0).tolist(), corners.max(axis=0).tolist(), strict=True)
        region = Region(x_m, y_m, z_m, scenario.region.speed_mps)
        mirrored = dataclasses.replace(
            observation, cells=np.ascontiguousarray(seen), array=counted, region=region
        )
        cloud = subject.image(mirrored)
        xyz = base_station_m + (cloud.xyz - base_station_m) @ mirror
        yield subject.difference(PointCloud(xyz, cloud.velocity, cloud.power))


def _in_single_precision(subject: ImageSubject) -> Iterator[float]:
    yield subject.difference(subject.image_of(subject.scene.observation.cells.astype(np.complex64)))


def _of_cells(name: str, differences: Callable[[ImageSubject], Iterator[float]], bound: float = 0.0) -> Check:
    """Check of the largest of some differences; it says nothing about an estimator that sees the truth."""

    def measure(subject: ImageSubject) -> float:
        if sees_truth(subject.plugin):
            raise NotApplicableError("it sees the truth")
        return max(differences(subject))

    return Check(name, measure, bound)


IN_REGION = Check("region", _is_in_region)
SPEEDS = Check("velocity", _has_possible_speeds)
POWERS = Check("power", _has_possible_powers)
FINITE = Check("finite", _is_possible)
REPEAT = Check("repeat", lambda subject: subject.difference(subject.image(subject.scene.fresh_observation())))
NO_FALSE_POINT = Check("no false point", _farthest_false_point, FALSE_POINT_CELLS)
NO_POINT = _of_cells("no point", _no_point)
FOUND = Check("found", lambda subject: float(_distances(subject).min(axis=1).max()), FALSE_POINT_CELLS)
FOUND_FIRST = Check("strongest found", lambda subject: float(_distances(subject)[0].min()), FALSE_POINT_CELLS)
POWER = Check("power", _power_off_db, POWER_DB)
TWO_POWER_SCALE = _of_cells("scale by powers of two", partial(_scaled, 1.0))
ANY_SCALE = _of_cells("scale", partial(_scaled, ODD), 1e-10)
THREADS = _of_cells("threads", _with_two_threads, INVARIANCE)
LAYOUT = _of_cells("memory order", _in_other_layouts, INVARIANCE)
ELEMENT_ORDER = _of_cells("element order", _in_other_element_orders, INVARIANCE)
SINGLE_PRECISION = _of_cells("single precision", _in_single_precision, SINGLE_POINT)

EVERY = FINITE, REPEAT
"""Checks of every image."""

RESOLVED_ECHOES = NO_FALSE_POINT, FOUND
"""Checks of images of which all is known."""

LEAKAGE = THREADS, LAYOUT
"""Checks of images of leakage alone."""

INVARIANT = TWO_POWER_SCALE, ANY_SCALE, THREADS, LAYOUT, ELEMENT_ORDER
"""Checks of images without ties."""


# A ladder of SNRs.

N_TRIALS = 12
LEVEL = 0.01
"""Probability that any step of a ladder that falls is taken for a bump."""


@dataclass(frozen=True, eq=False)
class LadderSubject(checks.Subject):
    """An estimator, and a scene that it images at rising SNR."""

    simulator: Simulator
    snr_db: tuple[float, ...]
    seed: int

    @cached_property
    def errors_bins(self) -> NDArray[np.float64]:
        """Sums (steps, trials) of the Hausdorff distances, in range bins."""
        scenario = self.simulator.scenario

        def error_m(snr_db: float, trial: int) -> float:
            observation = self.simulator.observe(snr_db, trial, self.seed)
            cloud = raw_cloud(self.plugin, observation, scenario.truth)
            return score(scenario, cloud)["hausdorff_sum_m"]

        errors_m = [[error_m(snr_db, trial) for trial in range(N_TRIALS)] for snr_db in self.snr_db]
        return np.array(errors_m) / scenario.system.range_bin_m


def _largest_bump(ladder: LadderSubject) -> float:
    """Largest rise of the mean error, in range bins, beyond its confidence interval."""
    # The noise of a trial is the same on all steps, so that they differ by their level alone.
    rises = np.diff(ladder.errors_bins, axis=0)
    width = -stdtrit(N_TRIALS - 1, LEVEL / len(rises)) / math.sqrt(N_TRIALS)
    unexplained = rises.mean(axis=1) - width * rises.std(axis=1, ddof=1)
    return max(float(unexplained.max()), 0.0)


# Errors below 1e-3 bins are ignored: the bias of superposed echoes moves with the noise.
FALLS = Check("error falls with SNR", _largest_bump, 1e-3)

SMALL_AT_LAST = Check("small error at last", lambda ladder: float(ladder.errors_bins[-1].mean()), 0.3)


# The contract.


class EstimatorSubject(checks.PluginSubject):
    """An estimator under check."""

    def of(self, scene: SmallScene, plugin: Any = None) -> ImageSubject:
        """Let the estimator, or another instance, image a scene."""
        return ImageSubject(plugin or self.plugin, scene)

    @property
    def ordinary(self) -> ImageSubject:
        """Image of three scatterers."""
        return self.of(contract_scene("ordinary"))

    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Image three scatterers: points (n, 5)."""
        return [self.of(contract_scene("other" if other else "ordinary"), plugin).cloud.to_array()]

    def prepare_call(self, *, writable: bool) -> tuple[Callable[[], object], str]:
        """Prepare to image three scatterers."""
        image = self.ordinary
        return partial(image.image, image.scene.fresh_observation(writable=writable)), "a small scene"


def _returns_a_cloud(subject: EstimatorSubject) -> str:
    return f"{len(subject.ordinary.cloud)} points of 3 scatterers"


def _sees_no_truth(subject: EstimatorSubject) -> None:
    is_built_in = subject.plugin_module.startswith("isacbench_algorithms.")
    require(
        is_built_in or not sees_truth(subject.plugin_class),
        "needs_truth asks for the truth, which only the built-in references may see: remove it, and estimate "
        "from the observation",
    )


def _finds_a_lone_scatterer(subject: EstimatorSubject) -> str:
    if sees_truth(subject.plugin):
        return "not asked of what sees the truth"
    return require_lone_scatterer(subject.plugin)


def _reads_what_it_declares(subject: EstimatorSubject) -> str:
    try:
        needs = needs_of(subject.plugin)
    except TypeError as error:
        raise CheckFailedError(f"{error}") from error
    if needs.elements == "plane":
        return "all elements"
    image = subject.ordinary
    cells = image.scene.observation.cells
    withheld = np.zeros_like(cells)
    if needs.elements == "cross":
        p, q = cross_elements(image.scene.scenario.array.shape).T
        withheld[:, :, p, q] = cells[:, :, p, q]
    require(
        np.array_equal(image.cloud.to_array(), image.image_of(withheld).to_array()),
        f"its image depends on elements that needs.elements = {needs.elements!r} leaves out, so that they "
        "are not computed for it: declare what it reads",
    )
    return {"cross": "one column and one row", "none": "no echo"}[needs.elements]


def _without_echo(name: str, subject: EstimatorSubject) -> str:
    """Image a scene without an echo: hardly a point, and no warning."""
    image = subject.of(contract_scene(name))
    n_cells = int(image.scene.observation.gate.reachable.sum())
    with checks.warnings_fail(": expect input without any echo"):
        n_points = len(image.cloud)
    require(
        n_points <= n_cells // 2,
        f"{n_points} points where there is no echo, in {n_cells} cells: test cells against a threshold that "
        "follows from the noise",
    )
    return f"{n_points} points"


def _in_every_scene(subject: EstimatorSubject) -> Iterator[ImageSubject]:
    """Let the estimator image scenes in both frames, of many echoes and of one."""
    several = map(contract_scene, ("ordinary", "other", "paper frame"))
    return map(subject.of, (*several, *map(lone, LONE_VIEWS)))


def _images_of(name: str, *scenes: str) -> Check:
    """Check that images scenes, by default that of its name; it fails where the estimator raises."""

    def measure(subject: EstimatorSubject) -> None:
        for scene in scenes or (name,):
            subject.of(contract_scene(scene)).cloud  # noqa: B018  imaged here first

    return Check(name, measure, needs=(IMAGED,))


IMAGED = "image"
ESTIMATOR_CHECKS = (
    *checks.CLASS_CHECKS,
    Check("truth", _sees_no_truth, needs=("import",)),
    Check(IMAGED, _returns_a_cloud, needs=(checks.CALLABLE,)),
    *(check.of(_in_every_scene, IMAGED) for check in (IN_REGION, SPEEDS, POWERS)),
    Check("lone scatterer", _finds_a_lone_scatterer, needs=("region", "velocity", "power")),
    Check("needs", _reads_what_it_declares, needs=(IMAGED,)),
    *checks.conduct_checks(IMAGED, "observation"),
    _images_of("minimal gate"),
    *(Check(name, partial(_without_echo, name), needs=(IMAGED,)) for name in ("noise alone", "silence")),
    _images_of("2 x 2 array"),
    _images_of("other arrays", "7 x 3 array", "3 x 7 array"),
    Check("time", checks.is_fast, needs=(IMAGED,)),
)
