"""References: the limit of resolution does not hang on its lattice, and chance has no skill."""

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from isacbench_algorithms.references import Chance, Oracle, lattice_offsets

from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import Simulator
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.contracts import TruthEstimator, is_reference
from tests.algorithms.scenes import BASE_M, REGION, SYSTEM, simulator
from tests.conftest import few, slow_but
from tests.single_scores import paper_scores

CELL = np.array([SYSTEM.range_bin_m, SYSTEM.velocity_bin_mps, 2 / 8, 2 / 8])

GOLDEN_FIRST = [
    [0.2138857611070425, 0.8979754406638255, 0.9708685685820968, 0.739187623517558],
    [0.6635766554334009, 0.8678422099340068, 0.8103579734335936, 0.4787097951763877],
]
GOLDEN_LAST = [
    [0.5391639303332911, 0.5135828898068575, 0.7027996223424863, 0.7346430387889762],
    [0.30196667861084614, 0.43578586801038277, 0.5005503365630811, 0.10998904630968043],
]

BOTH = pytest.mark.parametrize("reference", [Oracle(), Chance()], ids=["oracle", "chance"])


def scenario_of(xyz, velocity, frame="panel", amplitude=None):
    amplitude = np.ones(len(velocity)) if amplitude is None else amplitude
    return simulator(xyz, velocity, amplitude, frame=frame).scenario


def random_scenario(seed, n=40, frame="panel"):
    """Clusters of scatterers, so that cells hold several."""
    rng = np.random.default_rng(seed)
    centres = REGION.lower_m + REGION.size_m * rng.uniform(0.1, 0.9, (5, 3))
    own = rng.integers(0, 5, n)
    xyz = centres[own] + rng.normal(0, 0.6, (n, 3))
    velocity = rng.uniform(-20, 20, 5)[own] + rng.normal(0, 0.5, n)
    xyz = np.clip(xyz, REGION.lower_m, REGION.upper_m)
    return scenario_of(xyz, np.clip(velocity, -25, 25), frame, rng.uniform(0.5, 2, n))


@dataclass(frozen=True)
class Moved(Oracle):
    """Oracle that sees other coordinates than those of the truth: scaled, and shifted in cells."""

    name: ClassVar[str] = "moved"
    factor: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    shift: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    def _in_cells(self, radio, truth):
        return super()._in_cells(radio, truth) * self.factor + self.shift


def score_of(scenario, cloud):
    return paper_scores(scenario.truth, cloud, scenario.region, scenario.system.velocity_bin_mps)


def numbers(oracle, scenario):
    """Hausdorff sum and number of points of every realisation, shape (64, 2)."""
    clouds = oracle.realisations(scenario, scenario.truth)
    return np.array([(score_of(scenario, cloud).hausdorff_sum_m, len(cloud)) for cloud in clouds])


def assert_same_means(one, other):
    """The means of both columns differ by less than three standard errors, spread / 8."""
    error = np.maximum(one.std(axis=0), other.std(axis=0)) / 8
    difference = np.abs(one.mean(axis=0) - other.mean(axis=0))
    assert (difference <= 3 * error).all(), (difference / error).tolist()


def rows_of(clouds):
    """Places and velocities of all points."""
    return np.vstack([cloud.to_array()[:, :4] for cloud in clouds])


def by_rows(array):
    """Rows in a fixed order."""
    return array[np.lexsort(array.round(9).T)]


def test_each_coordinate_meets_every_place_of_the_borders_once():
    expected = (np.arange(64) + 0.5) / 64
    for column in lattice_offsets().T:
        np.testing.assert_array_equal(np.sort(column), expected)


def test_the_mean_over_the_offsets_scatters_less_than_over_random_ones():
    scenario, rng = random_scenario(5), np.random.default_rng(0)
    means, spreads = [], []
    for _ in range(12):
        found = numbers(Moved(shift=tuple(rng.random(4))), scenario)
        means.append(found.mean(axis=0))
        spreads.append(found.std(axis=0))
    assert (np.std(means, axis=0) < 0.6 * np.mean(spreads, axis=0) / 8).all()


SIGNS = st.sampled_from([-1.0, 1.0])


@few
@given(st.integers(0, 3), st.integers(0, 9999), st.floats(-3, 3), SIGNS, st.sampled_from(["panel", "paper"]))
@example(0, 0, 0.0, -1.0, "paper")
@example(1, 1, 1.3, 1.0, "panel")
@example(2, 0, 0.0, -1.0, "panel")
@example(3, 1, 1.3, 1.0, "paper")
def test_a_coordinate_that_is_moved_or_mirrored_changes_the_means_by_less_than_three_standard_errors(
    axis, seed, shift, sign, frame
):
    scenario = random_scenario(seed, 30, frame)
    own = np.arange(4) == axis
    moved = Moved(factor=tuple(np.where(own, sign, 1.0)), shift=tuple(shift * own))
    assert_same_means(numbers(Oracle(), scenario), numbers(moved, scenario))


def rail():
    """Scatterers on a grid around the axis of the array: many with u = 0, v = 0 and pairwise equal ranges."""
    y, z = (axis.ravel() for axis in np.meshgrid(np.arange(2.0, 38.0, 0.5), [0.5, 1.0]))
    xyz = [np.column_stack([np.full(y.size, x), y, z]) for x in (14.0, 15.0, 16.0)]
    return scenario_of(np.vstack(xyz), np.zeros(3 * y.size))


@pytest.mark.parametrize("make", slow_but([rail], [rail, partial(load_scenario, "street")]))
def test_jitter_of_rounding_changes_the_means_by_less_than_a_percent(make):
    scenario = make()
    before = numbers(Oracle(), scenario).mean(axis=0)
    for seed in range(2):
        rng, scatterers = np.random.default_rng(seed), scenario.scatterers
        xyz = scatterers.xyz + rng.uniform(-1e-13, 1e-13, scatterers.xyz.shape)
        inside = np.clip(xyz, scenario.region.lower_m, scenario.region.upper_m)
        jittered = replace(scenario, scatterers=replace(scatterers, xyz=inside))
        np.testing.assert_allclose(numbers(Oracle(), jittered).mean(axis=0), before, rtol=0.01)


def centroids(scenario, offset, cell):
    """Rows of x, y, z, v and power of the cells' centroids, by a plain double loop."""
    cells = {}
    truth = scenario.truth
    for xyz, v, power in zip(truth.xyz, truth.velocity, truth.power, strict=True):
        offset_m = xyz - BASE_M
        u, w = scenario.frame.direction_cosines(offset_m[None])
        places = np.sqrt(offset_m @ offset_m), v, u[0], w[0]
        key = tuple(np.floor(np.divide(places, cell * CELL) + offset).astype(int))
        cells.setdefault(key, []).append([*xyz, v, power])
    return np.array([[*np.mean(rows, axis=0)[:4], np.sum(rows, axis=0)[4]] for rows in cells.values()])


@pytest.mark.parametrize("frame", ["panel", "paper"])
@few
@given(n=st.integers(1, 30), cell=st.sampled_from([0.5, 1.0, 3.7]), seed=st.integers(0, 9999))
def test_every_realisation_is_the_centroid_of_every_cell_as_a_plain_loop_has_it(frame, n, cell, seed):
    scenario = random_scenario(seed, n, frame)
    clouds = Oracle(cell).realisations(scenario, scenario.truth)
    for cloud, offset in zip(clouds, lattice_offsets(), strict=True):
        expected = centroids(scenario, offset, cell)
        assert len(cloud) == len(expected)
        np.testing.assert_allclose(by_rows(cloud.to_array()), by_rows(expected), atol=1e-9)


@few
@given(st.integers(0, 3), st.lists(st.floats(1.0001, 3), min_size=1, max_size=8), st.sampled_from([0.5, 1]))
def test_lone_scatterers_farther_than_a_cell_apart_are_returned_exactly(axis, steps, cell):
    radio = replace(scenario_of(np.empty((0, 3)), []), array=VirtualArray((1, 1), (32, 32)))
    size = [SYSTEM.range_bin_m, SYSTEM.velocity_bin_mps, 2 / 32, 2 / 32][axis]
    places = np.tile([85.0, 0.0, 0.0, 0.0], (len(steps) + 1, 1))
    ascending = np.cumsum([0.0, *steps])
    places[:, axis] += cell * size * (ascending - ascending.mean())
    xyz = BASE_M + radio.frame.offsets(places[:, 0], places[:, 2], places[:, 3])
    truth = PointCloud(xyz, places[:, 1], np.arange(1.0, len(xyz) + 1))
    for cloud in Oracle(cell).realisations(radio, truth):
        np.testing.assert_array_equal(by_rows(cloud.to_array()), by_rows(truth.to_array()))


@few
@given(seed=st.integers(0, 9999), n=st.integers(20, 80))
def test_half_cells_are_never_coarser_on_average(seed, n):
    scenario = random_scenario(seed, n)
    clouds = (Oracle(cell).realisations(scenario, scenario.truth) for cell in (1.0, 0.5))
    one, half = (np.mean([len(cloud) for cloud in of]) for of in clouds)
    assert one <= half <= n


@few
@given(seed=st.integers(0, 9999), n=st.integers(2, 40))
def test_chance_fills_the_box_of_the_truth_with_as_many_points_as_half_cells(seed, n):
    scenario = random_scenario(seed, n)
    truth = scenario.truth
    clouds = Chance().realisations(scenario, truth)
    n_points = round(np.mean([len(cloud) for cloud in Oracle(cell=0.5).realisations(scenario, truth)]))
    assert [len(cloud) for cloud in clouds] == [n_points] * 64
    box, drawn = truth.to_array()[:, :4], rows_of(clouds)
    assert ((drawn >= box.min(axis=0)) & (drawn <= box.max(axis=0))).all()
    assert clouds[3].power.sum() == pytest.approx(truth.power.sum())


def test_chance_is_uniform_in_the_box():
    scenario = random_scenario(1, 60)
    box = scenario.truth.to_array()[:, :4]
    drawn = rows_of(Chance().realisations(scenario, scenario.truth))
    shares = np.sort((drawn - box.min(axis=0)) / np.ptp(box, axis=0), axis=0)
    expected = (np.arange(len(shares)) + 0.5) / len(shares)
    # Kolmogorov and Smirnov: exceeded once in a million uniform samples.
    assert np.abs(shares - expected[:, None]).max() < 2.7 / np.sqrt(len(shares))


@pytest.mark.parametrize("n", [1, 3])
def test_chance_does_not_know_where_a_lone_place_is(n):
    scenario = scenario_of([[3.0, 20.0, 1.0]] * n, [2.0] * n)
    drawn = rows_of(Chance().realisations(scenario, scenario.truth))
    limits = np.array([REGION.x_m, REGION.y_m, REGION.z_m, REGION.speed_mps])
    assert ((drawn >= limits[:, 0]) & (drawn <= limits[:, 1])).all()
    assert (np.ptp(drawn, axis=0) > 0.8 * np.ptp(limits, axis=1)).all()


def test_chance_draws_the_same_numbers_everywhere():
    truth = PointCloud([[0, 0, 0], [1, 1, 1]], [0, 1], [1, 1])
    scenario = scenario_of(np.empty((0, 3)), [])
    clouds = Chance().realisations(replace(scenario, base_station_m=np.array([0.5, 9.0, 5.0])), truth)
    assert len(clouds[0]) == 2
    np.testing.assert_allclose(clouds[0].to_array()[:, :4], GOLDEN_FIRST, atol=1e-12)
    np.testing.assert_allclose(clouds[63].to_array()[:, :4], GOLDEN_LAST, atol=1e-12)


@BOTH
def test_the_estimate_is_the_realisation_nearest_to_the_mean_deviation(reference):
    scenario = random_scenario(2)
    cloud = reference.estimate(Simulator(scenario).observe(0.0), scenario.truth)
    clouds = reference.realisations(scenario, scenario.truth)
    deviations = np.array([score_of(scenario, other).deviation for other in clouds])
    nearest = clouds[np.abs(deviations - deviations.mean()).argmin()]
    np.testing.assert_array_equal(cloud.to_array(), nearest.to_array())


@BOTH
def test_a_truth_without_points_gives_clouds_without_points(reference):
    scenario = scenario_of(np.empty((0, 3)), [])
    assert {len(cloud) for cloud in reference.realisations(scenario, PointCloud.empty())} == {0}
    assert len(reference.estimate(Simulator(scenario).observe(0.0), PointCloud.empty())) == 0


@BOTH
def test_a_reference_cannot_be_called_without_the_truth(reference):
    assert isinstance(reference, TruthEstimator)
    assert is_reference(reference)
    with pytest.raises(InputError, match=r"needs the truth: call estimate\(observation, scenario"):
        reference.estimate(Simulator(random_scenario(0)).observe(0.0))
