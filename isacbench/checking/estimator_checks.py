"""Contract of estimators: properties of their images, and the conduct of `estimate`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checking import scenes
from isacbench.checking.checks import Check, CheckFailedError, refuse_warnings
from isacbench.checking.class_checks import (
    CALLABLE,
    CLASS_CHECKS,
    PluginSubject,
    conduct_checks,
    refuse_writes,
    timed_call,
)
from isacbench.checking.image_checks import IN_REGION, POWERS, SPEEDS, ImageSubject
from isacbench.checking.lone_scatterer import require_lone_scatterer
from isacbench.checking.scenes import SmallScene
from isacbench.model.observation import cross_elements
from isacbench.plugins.contracts import needs_of


class EstimatorSubject(PluginSubject):
    """An estimator under check."""

    @property
    def sees_truth(self) -> bool:
        """True for a reference, which returns what it makes of the truth."""
        return bool(getattr(self.plugin_class, "needs_truth", False))

    def of(self, scene: SmallScene, plugin: Any = None) -> ImageSubject:
        """Let the estimator, or another instance, image a scene."""
        return ImageSubject(plugin or self.plugin, scene)

    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Image three scatterers: points (n, 5)."""
        return [self.of(scenes.other() if other else scenes.ordinary(), plugin).cloud.to_array()]


def _sees_no_truth(subject: EstimatorSubject) -> None:
    if subject.sees_truth and not subject.plugin_class.__module__.startswith("isacbench_algorithms."):
        raise CheckFailedError(
            "needs_truth asks for the truth, which only the built-in references may see: remove it, "
            "and estimate from the observation"
        )


def _returns_a_cloud(subject: EstimatorSubject) -> str:
    return f"{len(subject.of(scenes.ordinary()).cloud)} points of 3 scatterers"


def _finds_a_lone_scatterer(subject: EstimatorSubject) -> str:
    if subject.sees_truth:
        return "not asked of what sees the truth"
    return require_lone_scatterer({frame: subject.of(scenes.lone(frame)) for frame in scenes.LONE_VIEWS})


def _reads_what_it_declares(subject: EstimatorSubject) -> str:
    try:
        needs = needs_of(subject.plugin)
    except TypeError as error:
        raise CheckFailedError(f"{error}") from error
    if needs.elements == "plane":
        return "all elements"
    image = subject.of(scenes.ordinary())
    cells = image.scene.seen.cells
    withheld = np.zeros_like(cells)
    if needs.elements == "cross":
        p, q = cross_elements(image.scene.scenario.array.shape).T
        withheld[:, :, p, q] = cells[:, :, p, q]
    if not np.array_equal(image.cloud.to_array(), image.image_of(withheld).to_array()):
        raise CheckFailedError(
            f"its image depends on elements that needs.elements = {needs.elements!r} leaves out, so that "
            "they are not computed for it: declare what it reads"
        )
    return {"cross": "one column and one row", "none": "no echo"}[needs.elements]


def _leaves_the_observation(subject: EstimatorSubject) -> None:
    image = subject.of(scenes.ordinary())
    refuse_writes(lambda: image.image(image.scene.observation(writable=False)), "the observation")


def _images(*chosen: Callable[[], SmallScene]) -> Callable[[EstimatorSubject], None]:
    """Make a measurement that images scenes; it fails where the estimator raises."""

    def measure(subject: EstimatorSubject) -> None:
        for scene in chosen:
            subject.of(scene()).image(scene().observation())

    return measure


def _images_no_echo(scene: Callable[[], SmallScene], subject: EstimatorSubject) -> str:
    """Image a scene without an echo: hardly a point, and no warning."""
    image, n_cells = subject.of(scene()), int(scene().seen.gate.reachable.sum())
    cloud = refuse_warnings(lambda: image.cloud, ": expect input without any echo")
    if len(cloud) > n_cells // 2:
        raise CheckFailedError(
            f"{len(cloud)} points where there is no echo, in {n_cells} cells: test cells against a "
            "threshold that follows from the noise"
        )
    return f"{len(cloud)} points"


def _is_fast(subject: EstimatorSubject) -> str:
    image = subject.of(scenes.ordinary())
    observation = image.scene.observation()
    return timed_call(lambda: image.image(observation), "a small scene")


def _in_every_scene(check: Check[ImageSubject]) -> Check[EstimatorSubject]:
    """Ask for a property of images in both frames, of many echoes and of one."""

    def measure(subject: EstimatorSubject) -> None:
        lone = map(scenes.lone, scenes.LONE_VIEWS)
        for scene in (scenes.ordinary(), scenes.other(), scenes.paper_frame(), *lone):
            check.measure(subject.of(scene))

    return Check(check.name, measure, needs=(IMAGED,))


IMAGED = "image"
ESTIMATOR_CHECKS: tuple[Check[Any], ...] = (
    *CLASS_CHECKS,
    Check("truth", _sees_no_truth, needs=("import",)),
    Check(IMAGED, _returns_a_cloud, needs=(CALLABLE,)),
    *map(_in_every_scene, (IN_REGION, SPEEDS, POWERS)),
    Check("lone scatterer", _finds_a_lone_scatterer, needs=("region", "velocity", "power")),
    Check("needs", _reads_what_it_declares, needs=(IMAGED,)),
    Check("observation unchanged", _leaves_the_observation, needs=(IMAGED,)),
    *conduct_checks(IMAGED),
    Check("minimal gate", _images(scenes.minimal), needs=(IMAGED,)),
    Check("noise alone", partial(_images_no_echo, scenes.noise), needs=(IMAGED,)),
    Check("silence", partial(_images_no_echo, scenes.silence), needs=(IMAGED,)),
    Check("2 x 2 array", _images(partial(scenes.with_array, 2, 2)), needs=(IMAGED,)),
    Check(
        "other arrays",
        _images(partial(scenes.with_array, 7, 3), partial(scenes.with_array, 3, 7)),
        needs=(IMAGED,),
    ),
    Check("time", _is_fast, needs=(IMAGED,)),
)
