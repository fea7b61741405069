"""Images of a cell: an estimator images an observation, and the realisations of a reference are scored.

The realisations of a reference follow from the scenario alone. They are scored once for all SNRs and
trials of a scenario in a process.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from isacbench.bench.suites.scenario_digest import scenario_digest
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.realisations import SPREAD_COLUMNS, score_realisations
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Estimator, ReferenceEstimator, TruthEstimator
from isacbench.plugins.registry import canonical_params
from isacbench.plugins.scoring import PAPER_ALONE, Metrics
from isacbench.process_state import plugin_output

KEPT = 32
"""Scored images of references that a process keeps."""


@dataclass(frozen=True, eq=False)
class ScoredImage:
    """Realisation whose deviation is nearest to the mean, with the scores of all and the times of both.

    Attributes
    ----------
    scores : mapping of str to Any
        Columns of the metrics, means over the realisations.
    spreads : mapping of str to float
        Standard deviations over the realisations, by score.
    time_estimate_s, time_score_s : float
        Of all realisations when they were made.
    """

    cloud: PointCloud
    scores: Mapping[str, Any]
    spreads: Mapping[str, float]
    time_estimate_s: float
    time_score_s: float

    def columns(self) -> dict[str, Any]:
        """Columns of a row with the means and their spreads."""
        return {**self.scores, **{SPREAD_COLUMNS[name]: one for name, one in self.spreads.items()}}


@dataclass(frozen=True)
class _Reference:
    """Reference and scenario, equal to others of the same content."""

    content: tuple[Hashable, ...]
    reference: ReferenceEstimator = field(compare=False)
    scenario: Scenario = field(compare=False)
    metrics: Metrics


def image_reference(
    reference: ReferenceEstimator, scenario: Scenario, metrics: Metrics = PAPER_ALONE
) -> ScoredImage:
    """Score the realisations of a reference against the scenario that they are made from.

    What is returned is remembered for an equal reference and an equal scenario. TypeError if a realisation is
    no `PointCloud`.
    """
    objects = scenario.scatterers.objects
    content = type(reference), canonical_params(reference), scenario_digest(scenario), objects
    return _imaged(_Reference(content, reference, scenario, metrics))


@lru_cache(maxsize=KEPT)
def _imaged(key: _Reference) -> ScoredImage:
    start, scenario = time.process_time(), key.scenario
    clouds = list(key.reference.realisations(scenario, scenario.truth))
    for cloud in clouds:
        if not isinstance(cloud, PointCloud):
            raise TypeError(f"realisations() must return PointClouds, not {type(cloud).__name__}")
    time_s, imaged = time.process_time() - start, time.perf_counter()
    pairs = [CloudPair.of(scenario, cloud) for cloud in clouds]
    scores = score_realisations(pairs, PAPER_ALONE.score, key.metrics.score)
    time_score_s = time.perf_counter() - imaged
    return ScoredImage(clouds[scores.nearest], scores.means, scores.spreads, time_s, time_score_s)


Found = tuple[Mapping[str, Any], PointCloud]
"""Columns that come out of a cell, and its cloud, empty where there is none."""


@dataclass(frozen=True, eq=False)
class Image:
    """Image from which a kind of suite derives columns.

    Attributes
    ----------
    scenario : Scenario
        With the scatterers that were observed.
    observation, estimator : optional
        None for a stored cloud.
    cloud : PointCloud
        Estimate from the observation.
    """

    scenario: Scenario
    observation: Observation | None
    estimator: Estimator | None
    snr_db: float
    cloud: PointCloud


def estimate_cloud(estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation, and check the shapes and values of the cloud.

    `truth` is passed on only to an estimator with `needs_truth`. TypeError if the estimator returns anything
    but a `PointCloud`; ValueError if the cloud has wrong shapes, NaN or infinities.
    """
    cloud = raw_cloud(estimator, observation, truth)
    # The constructor checks shapes and values, also of a cloud that a plugin has changed.
    return PointCloud(cloud.xyz, cloud.velocity, cloud.power)


def raw_cloud(estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation as `estimate_cloud` does, without further checks than its type and velocities."""
    with plugin_output():
        if isinstance(estimator, TruthEstimator) and estimator.needs_truth:
            cloud = estimator.estimate(observation, truth)
        else:
            cloud = estimator.estimate(observation)
    if not isinstance(cloud, PointCloud):
        raise TypeError(f"estimate() must return a PointCloud, not {type(cloud).__name__}")
    if not cloud.has_velocity:
        raise ValueError("estimate() must return a finite velocity of each point, which a row needs, not NaN")
    return cloud
