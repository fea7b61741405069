"""Checks of estimators: properties of their images, and the conduct of `estimate`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.bench.cells.radio_coordinates import radio_places, rayleigh_cells
from isacbench.checking.contract.class_checks import (
    BUILT,
    CLASS_CHECKS,
    PluginSubject,
    conduct_checks,
    keeps,
    refuse_writes,
    timed_call,
)
from isacbench.checking.contract.findings import Check, DoubtfulError
from isacbench.checking.promises import image_promises as promises
from isacbench.checking.promises import small_scenes
from isacbench.checking.promises.image_promises import Imaging
from isacbench.checking.promises.promise import BrokenPromiseError, Promise, refuse_warnings
from isacbench.checking.promises.small_scenes import Shot
from isacbench.model.frame import FrameName
from isacbench.model.observation import cross_elements
from isacbench.plugins.contracts import needs_of

REFERENCES = ("isacbench_algorithms.oracle", "isacbench_algorithms.chance")
"""Modules of the estimators that may see the truth: references, which do not compete."""

MISS_CELLS = 2.0
"""Rayleigh cells beyond which a lone strong echo counts as missed."""

FOUND_CELLS = 1.0
"""Rayleigh cells within which a point confirms a mistake."""

POWER_FACTOR = 10.0


class EstimatorSubject(PluginSubject):
    """An estimator under check."""

    @property
    def sees_truth(self) -> bool:
        """True for a reference, which returns what it makes of the truth."""
        return bool(getattr(self.plugin_class, "needs_truth", False))

    def imaging(self, shot: Shot, plugin: Any = None) -> Imaging:
        """Image a scene.

        Parameters
        ----------
        shot : Shot
        plugin : Estimator, optional
            Estimator to ask instead of the one under check.

        Returns
        -------
        Imaging
        """
        return Imaging(plugin or self.plugin, shot)

    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Image three scatterers.

        Parameters
        ----------
        plugin : Estimator, optional
            Estimator to ask instead of the one under check.
        other : bool
            Whether to image another observation.

        Returns
        -------
        list of ndarray
            Points (n, 5).
        """
        shot = small_scenes.other() if other else small_scenes.ordinary()
        return [self.imaging(shot, plugin).cloud.to_array()]


def _sees_no_truth(subject: EstimatorSubject) -> str:
    if subject.sees_truth and subject.plugin_class.__module__ not in REFERENCES:
        raise BrokenPromiseError(
            "needs_truth asks for the truth, which only the built-in oracle and chance may see: remove it, "
            "and estimate from the observation"
        )
    return ""


def _returns_a_cloud(subject: EstimatorSubject) -> str:
    cloud = subject.imaging(small_scenes.ordinary()).cloud
    return f"{len(cloud)} points of 3 scatterers"


def _finds_a_lone_scatterer(subject: EstimatorSubject) -> str:
    if subject.sees_truth:
        return "not asked of what sees the truth"
    return ", ".join(
        f"{_miss_m(subject, name):.2g} m off in the {name} frame" for name in small_scenes.LONE_VIEWS
    )


def _miss_m(subject: EstimatorSubject, frame: FrameName) -> float:
    """Distance in m between a lone scatterer and its image; a miss is warned of with its likely cause."""
    shot = small_scenes.lone(frame)
    cloud, truth = subject.imaging(shot).cloud, shot.scenario.truth
    if not len(cloud):
        raise DoubtfulError(
            "images nothing where one scatterer stands far above the noise: it is not detected, or all "
            "detections fall outside the region (look at signs and units)"
        )
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


def _likeliest_mistake(places: NDArray[np.float64], true: NDArray[np.float64]) -> str | None:
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
        raise BrokenPromiseError(f"{error}") from error
    if needs.elements == "plane":
        return "all elements"
    imaging = subject.imaging(small_scenes.ordinary())
    cells = imaging.shot.seen.cells
    withheld = np.zeros_like(cells)
    if needs.elements == "cross":
        p, q = cross_elements(imaging.shot.scenario.array.shape).T
        withheld[:, :, p, q] = cells[:, :, p, q]
    if not np.array_equal(imaging.cloud.to_array(), imaging.image_of(withheld).to_array()):
        raise BrokenPromiseError(
            f"its image depends on elements that needs.elements = {needs.elements!r} leaves out, so that "
            "they are not computed for it: declare what it reads"
        )
    return {"cross": "one column and one row", "none": "no echo"}[needs.elements]


def _leaves_the_observation(subject: EstimatorSubject) -> str:
    imaging = subject.imaging(small_scenes.ordinary())
    refuse_writes(lambda: imaging.image(imaging.shot.observation(writable=False)), "the observation")
    return ""


def _images(*shots: Callable[[], Shot]) -> Callable[[EstimatorSubject], str]:
    """Make a check that images scenes; it fails where the estimator raises."""

    def look(subject: EstimatorSubject) -> str:
        for shot in shots:
            subject.imaging(shot()).image(shot().observation())
        return ""

    return look


def _images_no_echo(shot: Callable[[], Shot], subject: EstimatorSubject) -> str:
    """Image a scene without an echo: hardly a point, and no warning."""
    imaging, n_cells = subject.imaging(shot()), shot().n_reachable
    cloud = refuse_warnings(lambda: imaging.cloud, ": expect input without any echo")
    if len(cloud) > n_cells // 2:
        raise BrokenPromiseError(
            f"{len(cloud)} points where there is no echo, in {n_cells} cells: test cells against a "
            "threshold that follows from the noise"
        )
    return f"{len(cloud)} points"


def _is_fast(subject: EstimatorSubject) -> str:
    imaging = subject.imaging(small_scenes.ordinary())
    observation = imaging.shot.observation()
    return timed_call(lambda: imaging.image(observation), "a small scene")


def _in_every_scene(promise: Promise[Imaging]) -> Callable[[Any], str]:
    """Make a check of a promise in both frames, of many echoes and of one."""
    return keeps(
        promise,
        lambda subject: subject.imaging(small_scenes.ordinary()),
        lambda subject: subject.imaging(small_scenes.other()),
        lambda subject: subject.imaging(small_scenes.paper_frame()),
        lambda subject: subject.imaging(small_scenes.lone()),
        lambda subject: subject.imaging(small_scenes.lone("paper")),
    )


IMAGED = "image"
ESTIMATOR_CHECKS: tuple[Check[Any], ...] = (
    *CLASS_CHECKS,
    Check("truth", _sees_no_truth, ("import",)),
    Check(IMAGED, _returns_a_cloud, (BUILT,)),
    Check("region", _in_every_scene(promises.IN_REGION), (IMAGED,)),
    Check("velocity", _in_every_scene(promises.SPEEDS), (IMAGED,)),
    Check("power", _in_every_scene(promises.POWERS), (IMAGED,)),
    Check("lone scatterer", _finds_a_lone_scatterer, ("region", "velocity", "power")),
    Check("needs", _reads_what_it_declares, (IMAGED,)),
    Check("observation unchanged", _leaves_the_observation, (IMAGED,)),
    *conduct_checks(IMAGED),
    Check("minimal gate", _images(small_scenes.minimal), (IMAGED,)),
    Check("noise alone", partial(_images_no_echo, small_scenes.noise), (IMAGED,)),
    Check("silence", partial(_images_no_echo, small_scenes.silence), (IMAGED,)),
    Check("2 x 2 array", _images(small_scenes.small_array), (IMAGED,)),
    Check("other arrays", _images(small_scenes.wide_array, small_scenes.high_array), (IMAGED,)),
    Check("time", _is_fast, (IMAGED,)),
)
