"""The published code's metric against hand-worked examples and plain loops."""

import statistics
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.model.cloud import PointCloud
from isacbench.model.numerology import System
from isacbench.model.region import Region
from tests.single_scores import hausdorff_by_loops, repository_scores

coordinate = st.floats(-50, 50, allow_subnormal=False) | st.integers(-2, 2).map(float)
speed = st.integers(-3, 3).map(float)
clouds = st.lists(st.tuples(coordinate, coordinate, coordinate, speed), min_size=1, max_size=10).map(
    lambda rows: PointCloud.from_array(np.array(rows))
)


def at_origin(velocities):
    n = len(velocities)
    return PointCloud(xyz=np.zeros((n, 3)), velocity=velocities, power=np.ones(n))


def velocity_by_loops(true, estimated):
    distinct = sorted(set(true), reverse=True)
    ranked = sorted(Counter(estimated).items(), key=lambda item: (-item[1], item[0]))
    kept = sorted((velocity for velocity, _ in ranked[: len(distinct)]), reverse=True)
    return statistics.mean(statistics.pstdev(pair) for pair in zip(distinct, kept, strict=False))


@given(truth=clouds, estimate=clouds)
def test_every_component_equals_plain_loops(truth, estimate):
    found = repository_scores(truth, estimate)
    parts = (
        hausdorff_by_loops(*(one.xyz[:, axes] for one in (truth, estimate))) for axes in ([0], [1], [0, 2])
    )
    assert found.position == pytest.approx(sum(parts), abs=1e-9)
    velocity = velocity_by_loops(truth.velocity.tolist(), estimate.velocity.tolist())
    assert found.velocity == pytest.approx(velocity)
    assert found.density == pytest.approx(abs(len(estimate) - len(truth)) / len(truth))
    assert found.deviation == pytest.approx(found.position + found.velocity + found.density)


@pytest.mark.parametrize(
    ("true", "estimated", "expected"),
    [
        pytest.param([5, 5, -5], [5, -5, -5], 0.0, id="counts of true velocities do not matter"),
        pytest.param([10, 0], [9, 9, 1, 1, 30], (0.5 + 0.5) / 2, id="the most frequent are kept"),
        pytest.param([4], [7, 2], 1.0, id="of equally frequent ones the lower is kept"),
        pytest.param([4, 0], [8, 8, 6, 2], (2.0 + 1.0) / 2, id="a tie at the last place goes to the lower"),
        pytest.param([10, 4, 0], [8], 1.0, id="a single estimate pairs with the highest true velocity"),
        pytest.param([10, 4, 0], [1, 5], (2.5 + 1.5) / 2, id="missing velocities are not paired"),
        pytest.param([0.0], [-0.0, 0.0], 0.0, id="zero has one sign"),
    ],
)
def test_hand_worked_velocities(true, estimated, expected):
    assert repository_scores(at_origin(true), at_origin(estimated)).velocity == pytest.approx(expected)


def test_an_empty_cloud_scores_the_extent_of_region_and_truth():
    region = Region(x_m=(0, 3), y_m=(0, 5), z_m=(0, 4), speed_mps=(-10, 20))
    truth = PointCloud(xyz=[[1, 7, 1]], velocity=[30], power=[1])
    found = repository_scores(truth, PointCloud.empty(), region)
    assert (found.position, found.velocity, found.density) == (3 + 7 + 5, 20, 1)


def test_an_empty_cloud_without_a_region_scores_half_the_width_of_the_unambiguous_and_true_speeds():
    largest_mps = System().unambiguous_speed_mps
    assert repository_scores(at_origin([8]), PointCloud.empty()).velocity == largest_mps
    assert repository_scores(at_origin([300]), PointCloud.empty()).velocity == (largest_mps + 300) / 2
