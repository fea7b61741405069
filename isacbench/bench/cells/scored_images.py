"""Images of references with their scores: means over the realisations.

The clouds of a reference follow from the scenario alone. They are scored once for all SNRs and trials
of a scenario in a process.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.realisations import SPREAD_COLUMNS, score_realisations
from isacbench.model.cloud import PointCloud
from isacbench.plugins.parameters import canonical_params
from isacbench.plugins.scoring import Metrics

if TYPE_CHECKING:
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import ReferenceEstimator

PAPER_ALONE = Metrics()

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
class _Task:
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
    parts: tuple[Any, ...] = (scenario.system, scenario.array, scenario.frame, scenario.region)
    content = (
        type(reference),
        canonical_params(reference),
        *((type(part), *dataclasses.astuple(part)) for part in parts),
        scenario.radius_m,
        scenario.base_station_m.tobytes(),
        scenario.truth.to_array().tobytes(),
        scenario.scatterers.objects,
    )
    return _imaged(_Task(content, reference, scenario, metrics))


@lru_cache(maxsize=KEPT)
def _imaged(task: _Task) -> ScoredImage:
    start, scenario = time.process_time(), task.scenario
    clouds = list(task.reference.realisations(scenario, scenario.truth))
    for cloud in clouds:
        if not isinstance(cloud, PointCloud):
            raise TypeError(f"realisations() must return PointClouds, not {type(cloud).__name__}")
    time_s, imaged = time.process_time() - start, time.perf_counter()
    pairs = [CloudPair.of(scenario, cloud) for cloud in clouds]
    scores = score_realisations(pairs, PAPER_ALONE.score, task.metrics.score)
    time_score_s = time.perf_counter() - imaged
    return ScoredImage(clouds[scores.nearest], scores.means, scores.spreads, time_s, time_score_s)
