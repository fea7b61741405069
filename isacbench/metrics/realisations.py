"""Scores of many clouds for one truth: their means, their spreads, and the cloud nearest to the mean."""

from __future__ import annotations

import math
from statistics import mean, pstdev
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.metrics.cloud_scores import RADIUS_M
from isacbench.metrics.deviation import HAUSDORFF_COLUMNS, pair_deviation
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.score import METRICS, score

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region

COUNTS = ("n_true", "n_estimated")

SPREAD_COLUMNS = {
    name: f"{name}_spread" for name in ("hausdorff_sum_m", *METRICS["paper"]) if name != "n_true"
}
"""Columns with the spreads of the scores of the metric ``paper``, by score."""


class RealisationScores(NamedTuple):
    """Scores of the realisations of a reference.

    Attributes
    ----------
    means : dict of str to float
        Columns of the metric; ``n_estimated`` is rounded.
    spreads : dict of str to float
        Standard deviations over the realisations, by score.
    nearest : int
        Realisation whose deviation is nearest to the mean.
    """

    means: dict[str, Any]
    spreads: dict[str, float]
    nearest: int


def score_realisations(
    truth: PointCloud,
    clouds: Sequence[PointCloud],
    metric: str = "paper",
    *,
    region: Region | None = None,
    velocity_bin_mps: float | None = None,
    radius_m: float = RADIUS_M,
) -> RealisationScores:
    """Score several clouds of one truth, and average.

    Parameters
    ----------
    truth : PointCloud
    clouds : sequence of PointCloud
        At least one.
    metric : {"paper", "repository"}
    region : Region or None
    velocity_bin_mps : float or None
    radius_m : float
        All four as in `isacbench.metrics.score.score`.

    Returns
    -------
    RealisationScores
        The metric ``paper`` has also the spread of ``hausdorff_sum_m``.
    """
    rows = [
        score(truth, cloud, metric, region=region, velocity_bin_mps=velocity_bin_mps, radius_m=radius_m)
        for cloud in clouds
    ]
    columns = {name: [row[name] for row in rows] for name in METRICS[metric]}
    # Exact arithmetic: equal values have their own mean and no spread, on every machine.
    means: dict[str, Any] = {name: mean(values) for name, values in columns.items()}
    means |= {name: round(means[name]) for name in COUNTS}
    if metric == "paper":
        columns["hausdorff_sum_m"] = [sum(row[name] for name in HAUSDORFF_COLUMNS) for row in rows]
    spreads = {
        name: math.nan if math.isnan(sum(values)) else pstdev(values)  # which takes no NaN
        for name, values in columns.items()
        if name != "n_true"
    }
    return RealisationScores(means, spreads, _nearest(columns["deviation"]))


def nearest_to_mean(
    truth: PointCloud, clouds: Sequence[PointCloud], region: Region, velocity_bin_mps: float
) -> int:
    """Select the cloud whose deviation is nearest to the mean deviation.

    Parameters
    ----------
    truth : PointCloud
    clouds : sequence of PointCloud
    region : Region
    velocity_bin_mps : float

    Returns
    -------
    int
        Index of the cloud; the first one of several.
    """
    pairs = (CloudPair(truth, cloud) for cloud in clouds)
    return _nearest([pair_deviation(pair, region, velocity_bin_mps).deviation for pair in pairs])


def _nearest(values: Sequence[float]) -> int:
    """Index of the value nearest to the mean."""
    centre = mean(values)
    return min(range(len(values)), key=lambda index: abs(values[index] - centre))
