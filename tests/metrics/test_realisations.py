"""Scores of realisations: means, spreads, and the cloud nearest to the mean."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.paper import Repository
from isacbench.metrics.realisations import EVERY, SPREAD_COLUMNS, nearest_to_mean, score_realisations
from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.plugins.scoring import Metrics, score
from tests.conftest import few
from tests.score_tables import METRICS

REGION = Region((0.0, 9.0), (0.0, 9.0), (0.0, 9.0), (-5.0, 5.0))
STANDARD = Metrics().score


def cloud_of(seed, n):
    rng = np.random.default_rng(seed)
    return PointCloud(rng.uniform(0, 9, (n, 3)), rng.uniform(-5, 5, n), np.ones(n))


def scores_of(pairs, further=STANDARD):
    return score_realisations(pairs, STANDARD, further)


def test_every_score_has_a_column_for_its_spread_and_the_true_number_has_none():
    assert set(SPREAD_COLUMNS) == {"hausdorff_sum_m", *METRICS["paper"]} - {"n_true"}
    assert SPREAD_COLUMNS["gospa_m"] == "gospa_m_spread"


@given(seed=st.integers(0, 999), sizes=st.lists(st.integers(0, 6), min_size=1, max_size=7))
def test_means_and_spreads_are_those_of_single_scores(seed, sizes):
    truth = cloud_of(seed, 5)
    clouds = [cloud_of(seed + 1 + place, size) for place, size in enumerate(sizes)]
    pairs = [CloudPair(truth, cloud, REGION, 1.5, 2.0) for cloud in clouds]
    found = scores_of(pairs)
    rows = [score(truth, cloud, region=REGION, velocity_bin_mps=1.5, radius_m=2.0) for cloud in clouds]
    for name in METRICS["paper"]:
        values = np.array([row[name] for row in rows])
        mean = found.means[name]
        if name in ("n_true", "n_estimated"):
            assert (type(mean), mean) == (int, round(values.mean()))
        else:
            assert mean == pytest.approx(values.mean(), rel=1e-12)
        if name != "n_true":
            assert found.spreads[name] == pytest.approx(values.std(), rel=1e-9, abs=1e-12)
    sums_m = [row["hausdorff_xy_m"] + row["hausdorff_xz_m"] + row["hausdorff_yz_m"] for row in rows]
    assert found.spreads["hausdorff_sum_m"] == pytest.approx(np.std(sums_m), rel=1e-9, abs=1e-12)
    distances = np.abs(np.array([row["deviation"] for row in rows]) - found.means["deviation"])
    assert distances[found.nearest] == distances.min()
    assert nearest_to_mean(truth, clouds, REGION, 1.5) == found.nearest


@few
@given(seed=st.integers(0, 999), n=st.integers(1, 6), copies=st.integers(1, 70))
def test_equal_clouds_have_the_scores_of_one_and_no_spread(seed, n, copies):
    truth, cloud = cloud_of(seed, 4), cloud_of(seed + 1, n)
    found = scores_of([CloudPair(truth, cloud, REGION)] * copies)
    assert found.means == score(truth, cloud, region=REGION)
    assert set(found.spreads.values()) == {0.0}
    assert found.nearest == 0


@pytest.mark.filterwarnings("ignore::isacbench.errors.InputWarning")
def test_a_score_that_one_realisation_lacks_has_neither_mean_nor_spread(monkeypatch):
    monkeypatch.setattr("isacbench.metrics.assignment.MOST_PAIRS", 30)
    truth, clouds = cloud_of(0, 10), (cloud_of(1, 2), cloud_of(2, 10))
    found = scores_of([CloudPair(truth, cloud, radius_m=30.0) for cloud in clouds])
    assert math.isnan(found.means["gospa_m"])
    assert math.isnan(found.spreads["gospa_m"])
    assert math.isfinite(found.spreads["chamfer_m"])


def test_further_metrics_are_averaged_too_and_over_the_realisations_that_have_them():
    truth, clouds = cloud_of(0, 5), [cloud_of(1, 4), cloud_of(2, 5)]
    pairs = [CloudPair(truth, cloud, REGION) for cloud in clouds for _ in range(EVERY)]
    found = scores_of(pairs, Metrics((Repository(),)).score)
    positions = [score(truth, cloud, "repository", region=REGION)["position"] for cloud in clouds]
    assert found.means["position"] == pytest.approx(np.mean(positions))
    assert "position" not in found.spreads
    values = {pairs[0]: math.nan, pairs[EVERY]: 3.0}
    partly = scores_of(pairs, lambda pair: {**STANDARD(pair), "mine": values[pair]})
    assert partly.means["mine"] == 3.0
