"""Chamfer, GOSPA, precision and recall against plain loops."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from isacbench.errors import InputWarning
from isacbench.metrics.assignment import gospa_m
from isacbench.metrics.geometry import hausdorff_m
from isacbench.model.cloud import PointCloud
from isacbench.plugins.scoring import score
from tests.conftest import refusal
from tests.single_scores import paper_scores


def clouds(min_size=0):
    """Clouds about as wide as the cut-off, some on a lattice with pairs at it exactly."""
    number = st.floats(-1.5, 1.5, allow_subnormal=False) | st.integers(-2, 2).map(lambda n: n / 2)
    rows = st.lists(st.tuples(number, number, number), min_size=min_size, max_size=5)
    return rows.map(cloud_at)


def cloud_at(xyz):
    positions = np.asarray(xyz, dtype=float).reshape(-1, 3)
    return PointCloud(positions, np.zeros(len(positions)))


@given(truth=clouds(min_size=1), estimate=clouds(), unit=st.sampled_from([0.25, 2.0, 4.0]))
def test_scores_with_another_radius_are_those_of_clouds_in_another_unit(truth, estimate, unit):
    one = paper_scores(truth, estimate)
    scaled = paper_scores(cloud_at(unit * truth.xyz), cloud_at(unit * estimate.xyz), radius_m=unit)
    assert scaled.gospa_m == pytest.approx(unit * one.gospa_m, abs=1e-12)
    assert (scaled.precision, scaled.recall) == (one.precision, one.recall)


@pytest.mark.parametrize("width_m", [0, 0.4, 2, 20])
def test_gospa_equals_a_dense_assignment_in_crowds(width_m):
    rng = np.random.default_rng(7)
    truth, estimate = (cloud_at(rng.uniform(0, width_m, (n, 3))) for n in (120, 90))
    cost = np.minimum(cdist(truth.xyz, estimate.xyz, "sqeuclidean"), 1)
    expected = math.sqrt(cost[linear_sum_assignment(cost)].sum() + 30 / 2)
    assert gospa_m(truth, estimate) == pytest.approx(expected)
    assert gospa_m(estimate, truth) == pytest.approx(expected)


@pytest.mark.parametrize("radius_m", [1e3, 1e8, 1e9, 1e40])
def test_without_a_cut_off_gospa_is_the_best_matching_to_rounding(radius_m):
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(50, 3))
    estimate = rng.permutation(truth) + 0.3 * rng.normal(size=(50, 3))
    cost = cdist(truth, estimate, "sqeuclidean")
    expected = math.sqrt(cost[linear_sum_assignment(cost)].sum())
    assert gospa_m(cloud_at(truth), cloud_at(estimate), radius_m) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("name", "unit"), [("radius_m", "m"), ("velocity_bin_mps", "m/s")])
def test_a_unit_of_any_real_type_is_taken_and_another_refused(name, unit):
    table = np.arange(8.0).reshape(2, 4)
    assert score(table, table, **{name: np.float32(2)}) == score(table, table, **{name: 2.0})
    assert f"{name} holds <U1" in refusal(score, table, table, **{name: "2"})
    for value in (0.0, -1.0, math.inf, math.nan, 1e-200):
        message = refusal(score, table, table, **{name: value})
        assert message.startswith(f"{name} = {value}: allowed is a positive number of {unit}")


def test_clouds_too_dense_for_a_matching_have_all_other_scores_and_one_warning(monkeypatch):
    monkeypatch.setattr("isacbench.metrics.assignment.MOST_PAIRS", 1000)
    rng = np.random.default_rng(2)
    truth, estimate = cloud_at(rng.uniform(size=(300, 3))), cloud_at(rng.uniform(size=(200, 3)))
    with pytest.warns(InputWarning, match="GOSPA of 300 true and 200 estimated points is left out") as warned:
        found = paper_scores(truth, estimate)
    assert len(warned) == 1
    assert math.isnan(found.gospa_m)
    assert math.isfinite(found.chamfer_m)
    assert found.precision == found.recall == 1


def test_clouds_too_dense_for_a_matching_take_no_memory_for_their_pairs():
    cloud = cloud_at(np.random.default_rng(2).uniform(size=(10_000, 3)))
    tracemalloc.start()
    try:
        with pytest.warns(InputWarning, match="pairs are within 1 m, more than 4194304; thin the clouds"):
            assert math.isnan(gospa_m(cloud, cloud))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 10e6


def test_many_points_at_few_places_have_the_hausdorff_distance_of_the_places():
    rng = np.random.default_rng(2)
    places, others = rng.uniform(size=(2, 7, 2))
    many, more = places[np.arange(20_000) % 7], others[np.arange(15_000) % 7]
    assert hausdorff_m(many, more) == hausdorff_m(places, others)


@given(truth=clouds(min_size=1), estimate=clouds(min_size=1))
def test_chamfer_precision_and_recall_equal_plain_loops(truth, estimate):
    forward = [min(math.dist(p, q) for q in estimate.xyz) for p in truth.xyz]
    backward = [min(math.dist(p, q) for p in truth.xyz) for q in estimate.xyz]
    found = paper_scores(truth, estimate)
    assert found.chamfer_m == pytest.approx((np.mean(forward) + np.mean(backward)) / 2, abs=1e-12)
    if not any(abs(distance - 1) < 1e-12 for distance in (*forward, *backward)):
        shares = [np.mean(np.less_equal(distances, 1)) for distances in (backward, forward)]
        assert [found.precision, found.recall] == pytest.approx(shares)
    assert found.gospa_m == gospa_m(truth, estimate)


def test_a_point_at_one_metre_counts_as_found():
    found = paper_scores(cloud_at([[0, 0, 0]]), cloud_at([[1, 0, 0], [0, 1.001, 0]]))
    assert (found.precision, found.recall) == (0.5, 1)
