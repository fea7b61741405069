"""Checks of estimators: properties of their images, and the conduct of `estimate`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checking.contract.class_checks import (
    CALLABLE,
    CLASS_CHECKS,
    PluginSubject,
    conduct_checks,
    keeps,
    refuse_writes,
    timed_call,
)
from isacbench.checking.contract.findings import Check
from isacbench.checking.contract.lone_scatterer import require_lone_scatterer
from isacbench.checking.promises import image_promises as promises
from isacbench.checking.promises import small_scenes
from isacbench.checking.promises.image_promises import Imaging
from isacbench.checking.promises.promise import BrokenPromiseError, Promise, refuse_warnings
from isacbench.checking.promises.small_scenes import Shot
from isacbench.model.observation import cross_elements
from isacbench.plugins.contracts import needs_of


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
        plugin : Estimator, optional
            Estimator to ask instead of the one under check.
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
    if subject.sees_truth and not subject.plugin_class.__module__.startswith("isacbench_algorithms."):
        raise BrokenPromiseError(
            "needs_truth asks for the truth, which only the built-in references may see: remove it, "
            "and estimate from the observation"
        )
    return ""


def _returns_a_cloud(subject: EstimatorSubject) -> str:
    cloud = subject.imaging(small_scenes.ordinary()).cloud
    return f"{len(cloud)} points of 3 scatterers"


def _finds_a_lone_scatterer(subject: EstimatorSubject) -> str:
    if subject.sees_truth:
        return "not asked of what sees the truth"
    views = {name: subject.imaging(small_scenes.lone(name)) for name in small_scenes.LONE_VIEWS}
    return require_lone_scatterer(views)


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
    Check(IMAGED, _returns_a_cloud, (CALLABLE,)),
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
