"""What all metrics of clouds have in common: the truth is perfect, and neither order nor place counts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.cloud import PointCloud
from isacbench.model.region import Region
from isacbench.plugins.scoring import score
from tests.conftest import refusal

METRICS = ["paper", "repository", "points"]
EVERY = pytest.mark.parametrize("metric", METRICS)
pytestmark = pytest.mark.filterwarnings("ignore:the truth is not merged")

WIDE, LATTICE = st.floats(-100, 100, allow_subnormal=False), st.integers(-2, 2).map(lambda n: n / 2)
"""Coordinates: any, or with many ties, duplicates and distances at the cut-off exactly."""


def clouds(number):
    rows = st.lists(st.tuples(*[number] * 4), min_size=1, max_size=8)
    return rows.map(lambda found: PointCloud.from_array(np.array(found, dtype=float)))


CLOUDS = clouds(WIDE) | clouds(LATTICE)
WORST = {"precision": 0, "recall": 0, "f_score": 0, "velocity_nmse": 1, "density": 1}


@EVERY
@given(truth=CLOUDS)
def test_the_truth_scores_perfectly_against_itself(metric, truth):
    found = score(truth, truth, metric)
    perfect = {name for name in found if name.endswith(("precision", "recall", "skill")) or "f_score" in name}
    for name in found.keys() - {"n_true", "n_estimated"}:
        assert found[name] == pytest.approx(float(name in perfect), rel=1e-15, abs=0, nan_ok=True), name


@EVERY
@given(truth=CLOUDS, estimate=CLOUDS, seed=st.integers(0, 99))
def test_the_order_of_points_does_not_matter(metric, truth, estimate, seed):
    rng = np.random.default_rng(seed)
    truth_, estimate_ = (one.select(rng.permutation(len(one))) for one in (truth, estimate))
    exact = {"rel": 0, "abs": 0} if metric == "repository" else {}
    plain, mixed = score(truth, estimate, metric), score(truth_, estimate_, metric)
    assert mixed == pytest.approx(plain, nan_ok=True, **exact)


@EVERY
@given(truth=clouds(LATTICE), estimate=clouds(LATTICE), shift=st.tuples(*[st.integers(-1000, 1000)] * 3))
def test_translation_does_not_matter_even_where_points_are_equally_near(metric, truth, estimate, shift):
    moved = [PointCloud(one.xyz + shift, one.velocity, one.power) for one in (truth, estimate)]
    assert score(*moved, metric) == pytest.approx(score(truth, estimate, metric), abs=1e-9, nan_ok=True)


@given(truth=CLOUDS, estimate=CLOUDS)
def test_swapping_swaps_precision_and_recall_and_leaves_distances(truth, estimate):
    forth, back = score(truth, estimate), score(estimate, truth)
    assert (forth["precision"], forth["recall"]) == (back["recall"], back["precision"])
    for name in ("hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m"):
        assert forth[name] == back[name]
    for name in ("chamfer_m", "gospa_m"):
        assert forth[name] == pytest.approx(back[name])


@pytest.mark.parametrize("metric", ["paper", "repository"])
@given(
    truth=CLOUDS,
    corner=st.tuples(*[st.floats(-200, 200)] * 3),
    size=st.tuples(*[st.floats(0, 200)] * 3),
    places=st.lists(st.tuples(*[st.floats(0, 1)] * 3), min_size=1, max_size=4),
    speed_mps=st.floats(-1, 1),
)
def test_an_empty_cloud_is_never_better_than_points_inside_the_region(
    metric, truth, corner, size, places, speed_mps
):
    limits = [(low, low + length) for low, length in zip(corner, size, strict=True)]
    region = Region(*limits, speed_mps=(-100, 100))
    inside = np.clip(region.lower_m + np.array(places) * region.size_m, region.lower_m, region.upper_m)
    estimate = PointCloud(inside, np.full(len(inside), speed_mps), np.ones(len(inside)))
    empty, found = (score(truth, cloud, metric, region=region) for cloud in (PointCloud.empty(), estimate))
    assert all(map(math.isfinite, empty.values()))
    for name in empty.keys() & {"hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m", "position", "velocity"}:
        assert empty[name] >= found[name], name
    # A mean of equal distances can round up by a last digit.
    assert empty.get("chamfer_m", 0) >= found.get("chamfer_m", 0) - 1e-12
    for name in WORST.keys() & empty.keys():
        assert empty[name] == WORST[name]


@EVERY
def test_an_empty_truth_is_refused(metric):
    for estimate in (PointCloud.empty(), [[0, 0, 0, 0]]):
        message = refusal(score, PointCloud.empty(), estimate, metric)
        assert "truth: the cloud is empty; a score takes at least one" in message
