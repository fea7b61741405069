"""Checks of metrics: their columns, and scores of images with the same points, fewer, none and moved ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.bench.kinds.kind import taken_columns
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.checking import checks
from isacbench.checking.checks import Check, CheckFailedError, DoubtfulError, PluginSubject, require
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.scene import Scenario
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.scoring import metric_scores, object_kinds

SCENES = "street[seed=7]", "town[seed=7]"
"""Scenes whose images are scored."""

PUBLISHED = "position", "velocity"
"""Columns of the metric ``repository``, named as in the code published with the paper."""

SUFFIXES = {"m": "_m", "m/s": "_mps", "dB": "_db", "s": "_s"}
"""Ends of the names of columns by their units."""

JITTER_M = 0.2
MOVED_M = 30.0
ROUNDING = 1e-9


class MetricSubject(PluginSubject):
    """A metric under check."""

    @cached_property
    def scenario(self) -> Scenario:
        """Scene with objects of several kinds."""
        return load_scenario(SCENES[0])

    def scores(self, cloud: PointCloud) -> dict[str, float]:
        """Score an image of the scene."""
        return metric_scores(self.plugin, CloudPair.of(self.scenario, cloud))

    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Score an image of one of two scenes."""
        scores = metric_scores(plugin or self.plugin, _pair(load_scenario(SCENES[other])))
        return [np.nan_to_num([*scores.values()], nan=-1.0)]

    def prepare_call(self, *, writable: bool) -> tuple[Callable[[], object], str]:
        """Prepare to score an image; all clouds are read-only."""
        pair = _pair(self.scenario)
        return partial(self.plugin.score, pair), f"{len(pair.truth)} and {len(pair.estimate)} points"


def _pair(scenario: Scenario) -> CloudPair:
    """Pair a scene with an image of every third scatterer, a little beside its place."""
    truth = scenario.truth.select(np.arange(0, len(scenario.truth), 3))
    rng = np.random.default_rng(len(scenario.truth))
    xyz = truth.xyz + rng.normal(0, JITTER_M, truth.xyz.shape)
    return CloudPair.of(scenario, PointCloud(xyz, truth.velocity, truth.power))


def _describes_its_columns(subject: MetricSubject) -> str:
    checks.require_no_mistake("columns", subject)
    columns = subject.plugin_class.columns
    if bare := [column.name for column in columns if not column.description]:
        raise CheckFailedError(f"column {bare[0]} has no description: say in a line what it is")
    of_kinds = [name for kind in KINDS.values() for name in kind.columns]
    if taken := taken_columns(subject.plugin_class, of_kinds):
        raise CheckFailedError(f"rows of a run have a column {taken[0]} already: give the score another name")
    for column in columns:
        suffix = SUFFIXES.get(column.unit, "")
        others = tuple(end for unit, end in SUFFIXES.items() if unit != column.unit)
        if not column.name.endswith((suffix, *PUBLISHED)) or (not suffix and column.name.endswith(others)):
            raise DoubtfulError(
                f"column {column.name} has the unit {column.unit!r}: let the name end in that of the unit; "
                f"{', '.join(f'{unit!r} ends in {end}' for unit, end in SUFFIXES.items())}"
            )
    return ", ".join(column.name for column in columns)


def _scores_an_image(subject: MetricSubject) -> str:
    with checks.input_errors_fail():
        scores = metric_scores(subject.plugin, _pair(subject.scenario))
    infinite = ", ".join(name for name, value in scores.items() if math.isinf(value))
    require(not infinite, f"{infinite} is infinite: score it finite, or NaN where it has no value")
    return f"{len(scores)} scores, with {', '.join(object_kinds(subject.scenario))}"


def _knows_no_order(subject: MetricSubject) -> None:
    image = _pair(subject.scenario).estimate
    mixed = subject.scores(image.select(np.random.default_rng(1).permutation(len(image))))
    for name, value in subject.scores(image).items():
        require(
            np.isclose(value, mixed[name], rtol=ROUNDING, atol=ROUNDING, equal_nan=True),
            f"{name} depends on the order of points ({value:.6g} or {mixed[name]:.6g}): sort them, or do "
            "without an order",
        )


def _scores_nothing(subject: MetricSubject) -> str:
    scores = subject.scores(PointCloud.empty())
    described = {column.name: column.empty for column in subject.plugin.columns}
    for name, value in scores.items():
        empty = described.get(name)
        if empty is not None and not (math.isnan(empty) and math.isnan(value)) and value != empty:
            raise CheckFailedError(
                f"{name} of an image without points is {value:g}, but its column says {empty:g}: make them "
                "equal"
            )
    values = ", ".join(f"{name} {value:.4g}" for name, value in scores.items() if not math.isnan(value))
    return f"an image without points: {values}"


def _is_worse_far_off(subject: MetricSubject) -> None:
    """Whatever is measured, the truth itself is no worse than the truth somewhere else."""
    truth = subject.scenario.truth
    here = subject.scores(truth)
    there = subject.scores(PointCloud(truth.xyz + np.array([MOVED_M, 0, 0]), truth.velocity, truth.power))
    directions = {"lower": -1, "neither": 0, "higher": 1}
    for column in (one for one in subject.plugin.columns if one.name in here):
        gain = directions[column.better] * (there[column.name] - here[column.name])
        require(
            not gain > ROUNDING,  # of NaN as well
            f"{column.name} of the truth is {here[column.name]:.4g}, and {there[column.name]:.4g} where all "
            f"of it is moved by {MOVED_M:g} m, but {column.better} is better: correct the score or the "
            "direction",
        )


SCORED = "scores"
METRIC_CHECKS = (
    *checks.CLASS_CHECKS,
    Check("columns", _describes_its_columns, needs=(checks.BUILT,)),
    Check(SCORED, _scores_an_image, needs=(checks.CALLABLE, "columns")),
    *checks.conduct_checks(SCORED, "clouds"),
    Check("order of points", _knows_no_order, needs=(SCORED,)),
    Check("no points", _scores_nothing, needs=(SCORED,)),
    Check("moved image", _is_worse_far_off, needs=(SCORED,)),
    Check("time", checks.is_fast, needs=(SCORED,)),
)
