"""The one call that scores, and the table that describes its answer."""

import math

import numpy as np
import pandas as pd
import pytest

from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.plugins.registry import metric_names
from isacbench.plugins.scoring import score
from tests.conftest import refusal
from tests.score_tables import METRICS


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    truth = PointCloud.from_array(rng.normal(size=(40, 5)))
    return truth, PointCloud.from_array(rng.normal(size=(30, 5)))


@pytest.mark.parametrize("metric", METRICS)
def test_the_answer_has_the_columns_of_the_table(pair, metric):
    found = score(*pair, metric)
    assert list(found) == list(METRICS[metric])
    assert (found["n_true"], found["n_estimated"]) == (40, 30)
    assert all(type(found[name]) is (int if name.startswith("n_") else float) for name in found)


DISTANCES = [
    *("hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m", "chamfer_m", "density", "velocity_nmse"),
    *("deviation", "position", "velocity"),
]


# Points, and by what their coordinates are scaled: one, on a line, in a plane, close together, in a box.
@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize(
    ("n", "scales"), [(1, [1, 1, 1]), (4, [1, 0, 0]), (4, [1, 1, 0]), (4, [1e-9] * 3), (4, [1, 1, 1])]
)
@pytest.mark.parametrize("speed_mps", [0.0, 1.0])
def test_without_a_region_no_image_that_table_i_can_deliver_scores_worse_than_an_empty_one(
    metric, n, scales, speed_mps
):
    rng = np.random.default_rng(5)
    reach_m = System().unambiguous_range_m / math.sqrt(3)
    xyz = rng.uniform(-reach_m, reach_m, (4, 3))[:n] * scales
    truth = np.column_stack([xyz, np.full(len(xyz), speed_mps)])
    empty = score(truth, np.empty((0, 4)), metric)
    for size_m in (2, 30, reach_m):
        shift = rng.choice([-size_m, size_m], xyz.shape)
        poor = score(truth, np.column_stack([np.clip(xyz + shift, -reach_m, reach_m), truth[:, 3]]), metric)
        assert all(empty[name] > poor[name] for name in DISTANCES if name in empty)
        assert empty.get("recall", 0) <= poor.get("recall", 0)
    fast = score(truth, np.column_stack([xyz, np.full(len(xyz), -205.0)]), "repository")
    assert metric == "paper" or empty["velocity"] > fast["velocity"] > 0


def test_without_a_region_the_score_of_an_empty_image_grows_continuously_with_the_truth():
    alone, apart = (score([[0, 0, 0, 1], [x_m, 0, 0, 1]], np.empty((0, 4))) for x_m in (0, 1e-6))
    assert 0 < apart["deviation"] - alone["deviation"] < 1e-5


@pytest.mark.parametrize("metric", METRICS)
def test_an_empty_image_has_no_distance_of_zero_in_a_region_without_extent(metric):
    region = Region(x_m=(3, 3), y_m=(3, 3), z_m=(3, 3), speed_mps=(0, 0))
    found = score([[3, 3, 3, 0]], np.empty((0, 4)), metric, region=region)
    assert all(found[name] > 0 for name in DISTANCES if name in found)


def test_an_empty_image_is_as_far_as_the_region_is_wide():
    region = Region((-10, 10), (-10, 10), (-10, 10), speed_mps=(-5, 5))
    assert score([[0, 0, 0, 0]], np.empty((0, 4)), region=region)["chamfer_m"] == pytest.approx(1200**0.5)


def test_arrays_with_and_without_power_and_clouds_score_alike(pair):
    truth, estimate = pair
    expected = score(truth, estimate)
    assert score(truth.to_array(), estimate.to_array()[:, :4].tolist()) == expected


POINT = [[0, 0, 0, 0]]


@pytest.mark.parametrize(("metric", "hint"), [("papr", "did you mean 'paper'? "), ("zzz", "")])
def test_an_unknown_metric_is_refused_with_a_suggestion(metric, hint):
    message = f"unknown metric {metric!r}: {hint}allowed are {', '.join(metric_names())}"
    assert refusal(score, POINT, POINT, metric) == message


SHAPES = "a point array takes shape (n, 3), (n, 4) or (n, 5), not"


def test_a_malformed_array_is_refused_by_name():
    for values, message in (
        ([[0, 0]], f"{SHAPES} (1, 2)"),
        ([], f"{SHAPES} (0,)"),
        ([[0, 0, 0, math.nan]], "a point cloud takes finite values; velocity has NaN"),
        ([["a", 0, 0, 0]], "a point array holds <U"),
        ([[1j, 0, 0, 0]], "a point array holds complex128; allowed are real numbers"),
        ([[0, 0, 0, 0], [0]], ""),
    ):
        assert f"estimate: {message}" in refusal(score, POINT, values)


WITHOUT = {"paper": {"velocity_nmse", "deviation"}, "repository": {"velocity", "deviation"}}


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("alone", [0, 1])
def test_a_cloud_without_velocities_has_all_scores_that_need_none(metric, alone):
    """An array, a table and a cloud; a truth as well as an estimate."""
    pair = [[[0, 0, 0, 2.0], [5, 5, 5, 0]], [[0, 0, 1, 1.0], [5, 6, 5, 0]]]
    expected = {**score(*pair, metric), **dict.fromkeys(WITHOUT[metric], math.nan)}
    points = np.array(pair[alone])[:, :3]
    table = pd.DataFrame(points, columns=list("xyz"))
    for one in (points, table, PointCloud(points), PointCloud(points, None, [1, 2])):
        pair[alone] = one
        np.testing.assert_equal(score(*pair, metric), expected)


@pytest.mark.parametrize("metric", METRICS)
def test_an_empty_estimate_of_a_truth_without_velocities_has_no_velocity_score(metric):
    found = score([[0, 0, 0]], np.empty((0, 4)), metric)
    assert {name for name, value in found.items() if math.isnan(value)} == WITHOUT[metric]
