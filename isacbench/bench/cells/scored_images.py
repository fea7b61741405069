"""Images with their scores: of one cloud, or means over the realisations of a reference.

The clouds of a reference follow from the scenario alone. They are scored once for all SNRs and trials
of a scenario in a process.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.realisations import SPREAD_COLUMNS, score_realisations
from isacbench.model.cloud import PointCloud
from isacbench.plugins.registry import canonical_params
from isacbench.plugins.scoring import Metrics

if TYPE_CHECKING:
    from collections.abc import Hashable

    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import ReferenceEstimator

PAPER_ALONE = Metrics()

KEPT = 32
"""Scored images of references that a process keeps."""


@dataclass(frozen=True, eq=False)
class ScoredImage:
    """Cloud with its scores and the times of both.

    Attributes
    ----------
    cloud : PointCloud
        Of a reference, the realisation whose deviation is nearest to the mean.
    scores : mapping of str to Any
        Columns of the metric; of a reference, means over its realisations.
    time_estimate_s, time_score_s : float
        Of a reference, of all its realisations when they were made.
    spreads : mapping of str to float
        Standard deviations over the realisations of a reference, by score.
    """

    cloud: PointCloud
    scores: Mapping[str, Any]
    time_estimate_s: float
    time_score_s: float
    spreads: Mapping[str, float] = field(default_factory=dict)

    def spread_columns(self) -> dict[str, float]:
        """Columns of the spreads; none of an estimator that is no reference."""
        return {SPREAD_COLUMNS[name]: spread for name, spread in self.spreads.items()}


def image_reference(
    reference: ReferenceEstimator, scenario: Scenario, metrics: Metrics = PAPER_ALONE
) -> ScoredImage:
    """Score the realisations of a reference against the scenario that they are made from.

    Returns
    -------
    ScoredImage
        Remembered for an equal reference and an equal scenario.

    Raises
    ------
    TypeError
        If a realisation is no `PointCloud`.
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
        metrics,
    )
    return _imaged(_Task(content, reference, scenario, metrics))


@dataclass(frozen=True)
class _Task:
    """Reference and scenario, equal to others of the same content."""

    content: tuple[Hashable, ...]
    reference: ReferenceEstimator = field(compare=False)
    scenario: Scenario = field(compare=False)
    metrics: Metrics = field(compare=False)


@lru_cache(maxsize=KEPT)
def _imaged(task: _Task) -> ScoredImage:
    start = time.process_time()
    scenario = task.scenario
    clouds = list(task.reference.realisations(scenario, scenario.truth))
    for cloud in clouds:
        if not isinstance(cloud, PointCloud):
            raise TypeError(f"realisations() must return PointClouds, not {type(cloud).__name__}")
    made_s, made = time.process_time() - start, time.perf_counter()
    pairs = [CloudPair.of(scenario, cloud) for cloud in clouds]
    scores = score_realisations(pairs, PAPER_ALONE.score, task.metrics.score)
    scored = time.perf_counter()
    return ScoredImage(clouds[scores.nearest], scores.means, made_s, scored - made, scores.spreads)
