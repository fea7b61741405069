"""The paper's metric against plain loops, and its edges."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.paper import deviation_scores
from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.model.region import Region
from tests.conftest import refusal
from tests.single_scores import hausdorff_by_loops, paper_scores

PROJECTIONS = {"hausdorff_xy_m": (0, 1), "hausdorff_xz_m": (0, 2), "hausdorff_yz_m": (1, 2)}


def clouds(min_size=1, lattice=False):
    """Clouds of few points; those on a lattice are full of ties and duplicates."""
    number = st.integers(-2, 2) if lattice else st.floats(-100, 100, allow_subnormal=False)
    rows = st.lists(st.tuples(number, number, number, number), min_size=min_size, max_size=8)
    return rows.map(lambda found: PointCloud.from_array(np.array(found, dtype=float).reshape(-1, 4)))


def components(scores):
    return [getattr(scores, name) for name in (*PROJECTIONS, "density", "velocity_nmse")]


any_clouds = clouds() | clouds(lattice=True)


def nmse_by_loops(truth, estimate, bin_mps):
    errors, energy = 0.0, 0.0
    for p, v in zip(truth.xyz, truth.velocity, strict=True):
        nearest = min(math.dist(p, q) for q in estimate.xyz)
        errors += min(
            (w - v) ** 2
            for q, w in zip(estimate.xyz, estimate.velocity, strict=True)
            if math.dist(p, q) <= nearest + 1e-9
        )
        energy += v**2
    return errors / (energy or len(truth) * bin_mps**2)


@given(truth=any_clouds, estimate=any_clouds)
def test_every_component_equals_plain_loops(truth, estimate):
    found = paper_scores(truth, estimate, velocity_bin_mps=2.0)
    for name, axes in PROJECTIONS.items():
        expected = hausdorff_by_loops(truth.xyz[:, axes], estimate.xyz[:, axes])
        assert getattr(found, name) == pytest.approx(expected, abs=1e-9)
    assert found.density == pytest.approx(abs(len(estimate) - len(truth)) / len(truth))
    energy = float(np.square(truth.velocity).sum())
    if energy == 0 or energy > 1e-12:
        assert found.velocity_nmse == pytest.approx(nmse_by_loops(truth, estimate, 2.0))
    assert found.hausdorff_sum_m == pytest.approx(sum(components(found)[:3]))
    assert found.deviation == pytest.approx(sum(components(found)))


def test_an_empty_cloud_scores_the_diagonals_of_the_region():
    truth = PointCloud(xyz=[[1, 1, 1]], velocity=[3], power=[1])
    region = Region(x_m=(0, 3), y_m=(0, 4), z_m=(0, 12), speed_mps=(-9, 9))
    found = paper_scores(truth, PointCloud.empty(), region)
    assert components(found) == [5, math.hypot(3, 12), math.hypot(4, 12), 1, 1]


def test_an_empty_cloud_without_a_region_scores_the_diagonals_of_the_truth_grown_by_the_range_of_table_i():
    truth = PointCloud(xyz=[[0, 0, 0], [3, 4, 0]], velocity=[3, 3], power=[1, 1])
    x, y, z = np.array([3, 4, 0]) + 2 * System().unambiguous_range_m
    expected = [math.hypot(x, y), math.hypot(x, z), math.hypot(y, z), 1, 1]
    assert components(paper_scores(truth, PointCloud.empty())) == pytest.approx(expected)


def test_a_static_scene_measures_the_velocity_in_bins():
    truth, estimate = (PointCloud(np.eye(3), velocity) for velocity in ([0, 0, 0], [2, 0, 0]))
    assert paper_scores(truth, estimate, velocity_bin_mps=4).velocity_nmse == pytest.approx(1 / 12)
    table_i = (2 / System().velocity_bin_mps) ** 2 / 3
    assert paper_scores(truth, estimate).velocity_nmse == pytest.approx(table_i)


def test_a_rounding_residue_of_the_true_velocity_counts_as_static():
    truth, estimate = (PointCloud([[0, 0, 0]], [speed_mps]) for speed_mps in (1e-16, 1))
    assert paper_scores(truth, estimate, velocity_bin_mps=2).velocity_nmse == pytest.approx(1 / 4)


def test_magnitudes_whose_squares_overflow_are_refused_and_the_largest_others_score_finite():
    for row in ([1e60, 0, 0, 0], [0, 0, 0, -1e60], [1e60, 0, 0]):
        message = refusal(paper_scores, [[0, 0, 0, 0]], [row])
        assert "estimate: coordinates and velocities take magnitudes up to 1e+50" in message
    truth = PointCloud.from_array(np.full((2, 4), 1e50))
    for estimate in (PointCloud(-truth.xyz, truth.velocity), PointCloud.empty()):
        assert math.isfinite(paper_scores(truth, estimate).deviation)


def test_many_scatterers_and_points_at_few_places_have_the_nearest_velocity_of_their_place():
    rng = np.random.default_rng(4)
    places, velocities = rng.uniform(size=(5, 3)), rng.standard_normal((2, 4000))
    here = np.arange(4000) % 5
    truth, estimate = (PointCloud(places[here], v) for v in velocities)
    pairs = (velocities[:, here == place] for place in range(5))
    errors = np.concatenate([np.abs(np.subtract.outer(*pair)).min(axis=1) for pair in pairs])
    expected = np.square(errors).sum() / np.square(velocities[0]).sum()
    assert deviation_scores(CloudPair(truth, estimate))["velocity_nmse"] == pytest.approx(expected)
