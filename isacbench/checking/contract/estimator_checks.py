"""Checks of estimators: what an image must be, and what taking it must leave alone."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.cells.cell import raw_cloud
from isacbench.bench.cells.radio_coordinates import radio_places, rayleigh_cells
from isacbench.checking.contract import small_scenes
from isacbench.checking.contract.class_checks import BUILT, CLASS_CHECKS, PluginSubject
from isacbench.checking.contract.conduct import (
    pickled,
    refuse_global_random_numbers,
    refuse_prints,
    refuse_warnings,
    refuse_writes,
    timed_call,
)
from isacbench.checking.contract.findings import BrokenContractError, Check, DoubtfulError
from isacbench.checking.contract.small_scenes import Shot
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import REGION_TOLERANCE_M, Observation, cross_elements
from isacbench.plugins.contracts import needs_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from isacbench.model.frame import FrameName

    Floats = NDArray[np.float64]

BOUND = "isacbench_algorithms.oracle"
"""Module of the one estimator that may see the truth: a bound, and no competitor."""

ROUNDING_M = 1e-6
MISS_CELLS = 2.0
"""Rayleigh cells beyond which a lone strong echo counts as missed."""

FOUND_CELLS = 1.0
"""Rayleigh cells within which a point is where a mistake would put it."""

POWER_FACTOR = 10.0
WITHOUT_ECHO = ": expect input without any echo"


class EstimatorSubject(PluginSubject):
    """An estimator under check."""

    def image(self, shot: Shot, *, writable: bool = True, plugin: Any = None) -> PointCloud:
        """Image a scene, on an observation of its own."""
        return self.look(shot, shot.observation(writable=writable), plugin)

    def look(self, shot: Shot, observation: Observation, plugin: Any = None) -> PointCloud:
        """Image a given observation of a scene."""
        return raw_cloud(self.plugin if plugin is None else plugin, observation, shot.scenario.truth)


def _sees_no_truth(subject: EstimatorSubject) -> str:
    sees = bool(getattr(subject.plugin_class, "needs_truth", False))
    if sees and subject.plugin_class.__module__ != BOUND:
        raise BrokenContractError(
            "needs_truth asks for the truth, which the built-in oracle alone may see: remove it, and "
            "estimate from the observation"
        )
    return ""


def _returns_a_cloud(subject: EstimatorSubject) -> str:
    try:
        cloud = subject.image(small_scenes.ordinary())
    except TypeError as error:
        if "must return a PointCloud" not in str(error):
            raise
        raise BrokenContractError(f"{error}: build one with observation.cloud(...)") from error
    return f"{len(cloud)} points of 3 scatterers"


def _has_shapes(subject: EstimatorSubject) -> str:
    cloud = subject.image(small_scenes.ordinary())
    n = np.size(cloud.velocity)
    for name, shape in (("xyz", (n, 3)), ("velocity", (n,)), ("power", (n,))):
        array = getattr(cloud, name)
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != np.float64:
            raise BrokenContractError(
                f"{name} of its cloud is {_described(array)}, not float64 {shape}: let PointCloud make the "
                "arrays"
            )
        if not np.isfinite(array).all():
            raise BrokenContractError(f"{name} of its cloud has NaN or infinity: drop such points")
    return ""


def _described(array: object) -> str:
    return f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__


def _stays_in_the_region(subject: EstimatorSubject) -> str:
    for shot in (
        small_scenes.ordinary(),
        small_scenes.ordinary(paper_frame=True),
        small_scenes.lone(),
        small_scenes.lone("paper"),
    ):
        xyz = subject.image(shot).xyz
        outside = ~shot.scenario.region.contains(xyz, REGION_TOLERANCE_M + ROUNDING_M)
        if outside.any():
            x, y, z = xyz[outside.argmax()]
            raise BrokenContractError(
                f"{outside.sum()} of {len(xyz)} points lie more than {REGION_TOLERANCE_M} m outside the "
                f"region, the first at ({x:.3g}, {y:.3g}, {z:.3g}) m: place points in metres, with "
                "observation.cloud(...)"
            )
    return ""


def _has_possible_speeds(subject: EstimatorSubject) -> str:
    system = small_scenes.ordinary().scenario.system
    limit_mps = system.unambiguous_speed_mps + system.velocity_bin_mps / 2
    for shot in (small_scenes.ordinary(), small_scenes.other(), small_scenes.lone()):
        velocity = subject.image(shot).velocity
        if (np.abs(velocity) > limit_mps).any():
            raise BrokenContractError(
                f"velocities reach {np.abs(velocity).max():.4g} m/s, the radio tells {limit_mps:.4g} m/s: "
                "give them in m/s, from signed Doppler bins"
            )
    return ""


def _has_possible_powers(subject: EstimatorSubject) -> str:
    for shot in (small_scenes.ordinary(), small_scenes.other(), small_scenes.lone()):
        power = subject.image(shot).power
        if (power < 0).any():
            raise BrokenContractError(
                f"powers go down to {power.min():.3g}: a power is |G|² relative to a unit scatterer, 0 or "
                "more and no dB"
            )
    return ""


def _finds_a_lone_scatterer(subject: EstimatorSubject) -> str:
    return ", ".join(
        f"{_miss_m(subject, name):.2g} m off in the {name} frame" for name in small_scenes.LONE_VIEWS
    )


def _miss_m(subject: EstimatorSubject, frame: FrameName) -> float:
    """Measure the distance in m between a lone scatterer and its image; a miss is told with its cause."""
    shot = small_scenes.lone(frame)
    observation = _CountingObservation.of(shot.observation())
    cloud, truth = subject.look(shot, observation), shot.scenario.truth
    if not len(cloud) and observation.n_placed:
        raise DoubtfulError(
            f"all detections of a lone scatterer ({sum(observation.n_placed)}) fell outside the region and "
            "were dropped: look at the signs of u and w, and at units (bins, direction cosines)"
        )
    if not len(cloud):
        raise DoubtfulError("detects nothing where one scatterer stands far above the noise")
    places, true = radio_places(shot.scenario, cloud), radio_places(shot.scenario, truth)[0]
    cells = rayleigh_cells(shot.scenario)
    off_cells = np.abs(places - true) / cells
    nearest = int(off_cells.max(axis=1).argmin())
    if off_cells[nearest].max() > MISS_CELLS:
        mistake = _likeliest_mistake(places / cells, true / cells)
        if mistake is not None:
            raise DoubtfulError(
                f"images a lone scatterer where it would be if {mistake} ({frame} frame): look at the signs "
                "and the order of u and w; the phase of element (p, q) is -π (p u + q w), and v > 0 "
                "approaches. In a scene whose region does not reach that place, all detections fall outside "
                "the region"
            )
        axis = ("range", "velocity", "u", "w")[int(off_cells[nearest].argmax())]
        raise DoubtfulError(
            f"the nearest point to a lone scatterer far above the noise is {off_cells[nearest].max():.3g} "
            f"Rayleigh cells off in {axis}: look at units (m, m/s) and signs"
        )
    power = float(cloud.power[nearest])
    if not 1 / POWER_FACTOR < power < POWER_FACTOR:
        raise DoubtfulError(
            f"the power of a lone unit scatterer comes out as {power:.3g}, not about 1: divide by "
            "observation.system.processing_gain"
        )
    return float(np.linalg.norm(cloud.xyz[nearest] - truth.xyz[0]))


@dataclass(frozen=True, eq=False)
class _CountingObservation(Observation):
    """Observation that counts the detections which it places, dropped ones included.

    Attributes
    ----------
    n_placed : list of int
        Of each call of `cloud` that placed any.
    """

    n_placed: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, observation: Observation) -> _CountingObservation:
        return cls(**{one.name: getattr(observation, one.name) for one in dataclasses.fields(observation)})

    def cloud(
        self, range_bin: ArrayLike, doppler_bin: ArrayLike, u: ArrayLike, w: ArrayLike, power: ArrayLike
    ) -> PointCloud:
        """Count detections and place them in space."""
        if np.size(range_bin):
            self.n_placed.append(np.size(range_bin))
        return super().cloud(range_bin, doppler_bin, u, w, power)


def _likeliest_mistake(places: Floats, true: Floats) -> str | None:
    """Name the mistake of signs or of order that puts a scatterer where an image has it.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 4)
        Points of the image: range, velocity, u and w in Rayleigh cells.
    true : ndarray of float64, shape (4,)
        The scatterer.

    Returns
    -------
    str or None
        None where no such mistake does.
    """
    misses = {}
    for swapped, *signs in product((False, True), (1, -1), (1, -1), (1, -1)):
        seen = true[[0, 1, 3, 2]] if swapped else true
        off_cells = np.abs(places - seen * [1, *signs]).max(axis=1).min()
        misses[off_cells] = swapped, signs
    swapped, signs = misses[min(misses)]
    if min(misses) > FOUND_CELLS:
        return None
    wrong = [name for name, sign in zip(("velocity", "u", "w"), signs, strict=True) if sign < 0]
    parts = ["u and w were swapped"] if swapped else []
    if wrong:
        parts.append(f"{' and '.join(wrong)} had the wrong sign{'s' if len(wrong) > 1 else ''}")
    return " and ".join(parts)


def _reads_what_it_declares(subject: EstimatorSubject) -> str:
    try:
        needs = needs_of(subject.plugin)
    except TypeError as error:
        raise BrokenContractError(f"{error}") from error
    if needs.elements == "plane":
        return "all elements"
    shot = small_scenes.ordinary()
    seen = shot.observation()
    withheld = np.zeros_like(seen.cells)
    if needs.elements == "cross":
        p, q = cross_elements(seen.array.shape).T
        withheld[:, :, p, q] = seen.cells[:, :, p, q]
    _require_equal(
        subject.look(shot, seen),
        subject.look(shot, dataclasses.replace(seen, cells=withheld)),
        f"its image hangs on elements that needs.elements = {needs.elements!r} leaves out, so that nobody "
        "transforms them for it: declare what it reads",
    )
    return {"cross": "one column and one row", "none": "no echo"}[needs.elements]


def _leaves_the_observation(subject: EstimatorSubject) -> str:
    shot = small_scenes.ordinary()
    observation = shot.observation()
    subject.look(shot, observation)
    for name, array, original in (
        ("cells", observation.cells, shot.seen.cells),
        ("gate.range_bins", observation.gate.range_bins, shot.seen.gate.range_bins),
        ("gate.doppler_bins", observation.gate.doppler_bins, shot.seen.gate.doppler_bins),
        ("base_station_m", observation.base_station_m, shot.seen.base_station_m),
    ):
        if not np.array_equal(array, original):
            raise BrokenContractError(
                f"writes to observation.{name}, which the next estimator sees: copy before changing"
            )
    refuse_writes(lambda: subject.image(shot, writable=False), "the observation")
    return ""


def _repeats(subject: EstimatorSubject) -> str:
    shot = small_scenes.ordinary()
    subject.image(shot)  # so that what came before counts for `_forgets` alone
    _require_equal(
        subject.image(shot),
        subject.image(shot),
        "two images of one observation differ: draw random numbers from a generator with a fixed seed",
    )
    return ""


def _forgets(subject: EstimatorSubject) -> str:
    shot = small_scenes.ordinary()
    subject.image(shot)
    before = subject.image(shot)
    subject.image(small_scenes.other())
    _require_equal(
        before,
        subject.image(shot),
        "another observation in between changes the image: keep nothing from one call to the next",
    )
    return ""


def _is_pickled(subject: EstimatorSubject) -> str:
    twin, shot = pickled(subject.plugin), small_scenes.ordinary()
    subject.image(shot)
    _require_equal(
        subject.image(shot),
        subject.image(shot, plugin=twin),
        "its image differs after pickling: keep all that it needs in its parameters",
    )
    return ""


def _require_equal(first: PointCloud, second: PointCloud, complaint: str) -> None:
    one, two = first.to_array(), second.to_array()
    if not np.array_equal(one, two):
        how = (
            f"by up to {np.abs(one - two).max():.2g}"
            if one.shape == two.shape
            else f"{len(one)}, {len(two)} points"
        )
        raise BrokenContractError(f"{complaint} ({how})")


def _leaves_random_numbers(subject: EstimatorSubject) -> str:
    refuse_global_random_numbers(lambda: subject.image(small_scenes.ordinary()))
    return ""


def _is_quiet(subject: EstimatorSubject) -> str:
    refuse_prints(lambda: subject.image(small_scenes.ordinary()))
    return ""


def _takes_a_minimal_gate(subject: EstimatorSubject) -> str:
    subject.image(small_scenes.minimal())
    return ""


def _takes_a_single_cell(subject: EstimatorSubject) -> str:
    try:
        subject.image(small_scenes.single_cell())
    except InputError as error:
        return f"refused in words: {error}"
    return ""


def _takes_noise(subject: EstimatorSubject) -> str:
    return _seen_calmly(subject, small_scenes.noise())


def _takes_silence(subject: EstimatorSubject) -> str:
    return _seen_calmly(subject, small_scenes.silence())


def _seen_calmly(subject: EstimatorSubject, shot: Shot) -> str:
    """Image a scene without an echo: hardly a point, and no warning."""
    cloud = refuse_warnings(lambda: subject.image(shot), WITHOUT_ECHO)
    if len(cloud) > shot.n_reachable // 2:
        raise BrokenContractError(
            f"{len(cloud)} points where there is no echo, in {shot.n_reachable} cells: test cells against a "
            "threshold that follows from the noise"
        )
    return f"{len(cloud)} points"


def _takes_small_arrays(subject: EstimatorSubject) -> str:
    subject.image(small_scenes.arrays()[0])
    return ""


def _takes_other_arrays(subject: EstimatorSubject) -> str:
    for shot in small_scenes.arrays()[1:]:
        try:
            subject.image(shot)
        except Exception as error:
            n_p, n_q = shot.scenario.array.shape
            raise BrokenContractError(
                f"fails on {n_p} x {n_q} elements, {type(error).__name__}: {error}: take sizes from "
                "observation.cells.shape, P and Q apart"
            ) from error
    return ""


def _is_fast(subject: EstimatorSubject) -> str:
    shot = small_scenes.ordinary()
    observation = shot.observation()
    return timed_call(lambda: subject.look(shot, observation), "a small scene")


IMAGED = "image"
ESTIMATOR_CHECKS: tuple[Check[Any], ...] = (
    *CLASS_CHECKS,
    Check("truth", _sees_no_truth, ("import",)),
    Check(IMAGED, _returns_a_cloud, (BUILT,)),
    Check("shapes", _has_shapes, (IMAGED,)),
    Check("region", _stays_in_the_region, ("shapes",)),
    Check("velocity", _has_possible_speeds, ("shapes",)),
    Check("power", _has_possible_powers, ("shapes",)),
    Check("lone scatterer", _finds_a_lone_scatterer, ("region", "velocity", "power")),
    Check("needs", _reads_what_it_declares, ("shapes",)),
    Check("observation unchanged", _leaves_the_observation, (IMAGED,)),
    Check("repeatable", _repeats, ("shapes",)),
    Check("no memory", _forgets, ("repeatable",)),
    Check("pickling", _is_pickled, ("canonical parameters", "repeatable")),
    Check("random numbers", _leaves_random_numbers, (IMAGED,)),
    Check("stdout", _is_quiet, (IMAGED,)),
    Check("minimal gate", _takes_a_minimal_gate, (IMAGED,)),
    Check("single cell", _takes_a_single_cell, (IMAGED,)),
    Check("noise alone", _takes_noise, (IMAGED,)),
    Check("silence", _takes_silence, (IMAGED,)),
    Check("2 x 2 array", _takes_small_arrays, (IMAGED,)),
    Check("other arrays", _takes_other_arrays, (IMAGED,)),
    Check("time", _is_fast, (IMAGED,)),
)
