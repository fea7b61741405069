"""Scores of many clouds for one truth: their means, their spreads, and the cloud nearest to the mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from statistics import mean, pstdev
from typing import Any, NamedTuple

from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.paper import Paper, deviation_scores
from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region

COUNTS = ("n_true", "n_estimated")

EVERY = 4
"""Of the realisations, every fourth one is scored by all metrics: 16 of 64, which are a lattice, too."""

SPREAD_COLUMNS = {
    name: f"{name}_spread" for name in ("n_estimated", *(column.name for column in Paper.columns))
}
"""Columns with the spreads of the scores of the metric ``paper``, by score."""


class RealisationScores(NamedTuple):
    """Scores of the realisations of a reference.

    Attributes
    ----------
    means : dict of str to float
        Columns of the metrics; ``n_estimated`` is rounded. A column of ``paper`` needs a value in every
        realisation; others are averaged over those that have one, such as errors of detected objects.
    spreads : dict of str to float
        Standard deviations over the realisations, by score of `SPREAD_COLUMNS`.
    nearest : int
        Realisation whose deviation is nearest to the mean.
    """

    means: dict[str, Any]
    spreads: dict[str, float]
    nearest: int


def score_realisations(
    pairs: Sequence[CloudPair],
    paper: Callable[[CloudPair], Mapping[str, float]],
    score: Callable[[CloudPair], Mapping[str, float]],
) -> RealisationScores:
    """Score several clouds of one truth, and average.

    `paper` gives counts and the columns of ``paper``, `score` those of all metrics. Every fourth pair is
    scored by all.
    """
    rows = [(score if number % EVERY == 0 else paper)(pair) for number, pair in enumerate(pairs)]
    columns = {name: [row[name] for row in rows if name in row] for name in rows[0]}
    means: dict[str, Any] = {
        # Exact arithmetic: equal values have their own mean and no spread, on every machine.
        name: mean(values) if name in (*COUNTS, *SPREAD_COLUMNS) else _mean_of_known(values)
        for name, values in columns.items()
    }
    means |= {name: round(means[name]) for name in COUNTS}
    spreads = {
        name: math.nan if math.isnan(sum(columns[name])) else pstdev(columns[name])  # which takes no NaN
        for name in SPREAD_COLUMNS
    }
    return RealisationScores(means, spreads, _nearest(columns["deviation"]))


def nearest_to_mean(
    truth: PointCloud, clouds: Sequence[PointCloud], region: Region, velocity_bin_mps: float
) -> int:
    """Select the cloud whose deviation is nearest to the mean deviation.

    Returns
    -------
    int
        Index of the cloud; the first one of several.
    """
    pairs = (CloudPair(truth, cloud, region, velocity_bin_mps) for cloud in clouds)
    return _nearest([deviation_scores(pair)["deviation"] for pair in pairs])


def _mean_of_known(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return mean(known) if known else math.nan


def _nearest(values: Sequence[float]) -> int:
    """Index of the value nearest to the mean."""
    centre = mean(values)
    return min(range(len(values)), key=lambda index: abs(values[index] - centre))
