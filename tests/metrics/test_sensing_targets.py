"""Metrics of 3GPP on drops: plain recounts, invariances, and drops without targets or detections."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench import load_scenario, score
from isacbench.errors import InputError, InputWarning
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.sensing_targets import (
    GATE_M,
    OBJECTIVES,
    NrIsac,
    Ts22137,
    associate,
    targets_of,
)
from isacbench.model.cloud import PointCloud
from isacbench.model.scene import Scatterers
from tests.conftest import refusal

COORDINATES = st.tuples(*3 * [st.integers(-30, 30)], st.integers(-5, 5))
CLOUDS = st.lists(COORDINATES, min_size=1, max_size=5)
SCENARIO = load_scenario("uma-av[seed=3]")


def cloud(rows):
    rows = np.array(rows, dtype=float).reshape(-1, 4)
    return PointCloud(rows[:, :3], rows[:, 3], np.ones(len(rows)))


def recounted(truth, found, gate_m):
    """Pairs of the best association: as many as possible, then least squared distances, by trying all."""
    best = (0, 0.0, [])
    short, long = sorted([range(len(truth)), range(len(found))], key=len)
    swapped = len(found) < len(truth)
    for chosen in itertools.permutations(long, len(short)):
        pairs = [(b, a) if swapped else (a, b) for a, b in zip(short, chosen, strict=True)]
        squares = [(i, j, math.dist(truth[i][:3], found[j][:3]) ** 2) for i, j in pairs]
        kept = [(i, j, d2) for i, j, d2 in squares if d2 <= gate_m**2]
        cost = sum(d2 for *_, d2 in kept)
        if (-len(kept), cost) < (-best[0], best[1]):
            best = len(kept), cost, kept
    return best


@given(CLOUDS, st.lists(COORDINATES, max_size=5))
def test_association_is_the_best_of_all(truth, found):
    pair = CloudPair(cloud(truth), cloud(found))
    made = associate(pair, 20.0)
    n, cost, _ = recounted(truth, found, 20.0)
    assert (made.n_targets, made.n_detections, len(made.errors)) == (len(truth), len(found), n)
    assert np.square(made.errors[:, :2]).sum() == pytest.approx(cost)
    scores = NrIsac(20.0).score(pair)
    assert scores["missed_detection"] == pytest.approx(1 - n / len(truth))
    assert scores["false_alarm_type2"] == pytest.approx(1 - n / len(found) if found else 0)
    assert math.isnan(scores["false_alarm_type1"])
    for place, name in enumerate(list(OBJECTIVES)[3:]):
        expected = np.percentile(made.errors[:, place], 90) if n else math.nan
        assert scores[name] == pytest.approx(expected, nan_ok=True)


@given(CLOUDS, CLOUDS, st.randoms(use_true_random=False), st.tuples(*3 * [st.integers(-99, 99)]))
def test_neither_the_order_nor_a_shift_of_everything_matters(truth, found, random, shift):
    def scores(truth, found):
        return NrIsac(20.0).score(CloudPair(cloud(truth), cloud(found)))

    def moved(rows):
        rows = random.sample(rows, len(rows))
        return [(*np.add(row[:3], shift).tolist(), row[3]) for row in rows]

    # Of associations that are equally good errors may differ: they need not be in the same place.
    shares = [name for name in OBJECTIVES if "error" not in name]
    first, second = scores(truth, found), scores(moved(truth), moved(found))
    for name in shares:
        assert first[name] == pytest.approx(second[name], nan_ok=True), name


@given(st.lists(st.tuples(CLOUDS, CLOUDS), min_size=2, max_size=3))
def test_drops_far_apart_count_as_one_with_the_sum_of_their_counts(drops):
    apart = [
        [[(x + 1000 * number, y, z, v) for x, y, z, v in rows] for rows in drop]
        for number, drop in enumerate(drops)
    ]
    truths, founds = ([row for drop in apart for row in drop[side]] for side in (0, 1))
    whole = associate(CloudPair(cloud(truths), cloud(founds)), 20.0)
    parts = [associate(CloudPair(cloud(truth), cloud(found)), 20.0) for truth, found in drops]
    assert len(whole.errors) == sum(len(part.errors) for part in parts)
    assert whole.n_targets == sum(part.n_targets for part in parts)


def test_objects_of_a_scenario_are_targets_but_for_clutter():
    names = ("uav 1", "uav 1", "clutter car 1", "")
    xyz = np.array([[0, -50, 60], [0, -50, 62], [10, -60, 0.8], [20, -70, 80]], dtype=float)
    scatterers = Scatterers(xyz, np.array([1.0, 3.0, 5.0, 7.0]), np.ones(4), objects=names)
    targets = targets_of(dataclasses.replace(SCENARIO, scatterers=scatterers))
    found = sorted(zip(targets.xyz.tolist(), targets.velocity.tolist(), strict=True))
    assert found == [([0.0, -50.0, 61.0], 2.0), ([20.0, -70.0, 80.0], 7.0)]


def test_points_of_one_echo_are_one_detection_at_their_mean_weighted_by_power():
    truth = SCENARIO.truth
    xyz = np.concatenate([truth.xyz, truth.xyz[:1] + np.array([0.4, 0, 0])])
    image = PointCloud(xyz, np.r_[truth.velocity, truth.velocity[0]], np.r_[np.ones(5), 3.0])
    by_object, by_point = (
        NrIsac(grouping=one).score(CloudPair.of(SCENARIO, image)) for one in ("objects", "points")
    )
    assert by_object["false_alarm_type2"] == 0
    assert by_point["false_alarm_type2"] == pytest.approx(1 / 6)
    errors = associate(CloudPair.of(SCENARIO, image)).errors
    assert errors.max() == pytest.approx(0.3)


def test_a_drop_without_targets_is_scored_by_its_false_alarms_alone():
    scenario = load_scenario("uma-av[seed=3,targets=0]")
    none, some = (score(scenario, one, "nr-isac") for one in (PointCloud.empty(), SCENARIO.truth))
    assert (none["false_alarm_type1"], some["false_alarm_type1"]) == (0.0, 1.0)
    for scores in (none, some):
        others = [name for name in OBJECTIVES if name != "false_alarm_type1"]
        assert all(math.isnan(scores[name]) for name in others)
    assert "[seed=3,targets=0]: it has no scatterers; metric paper" in refusal(
        score, scenario, SCENARIO.truth, "paper"
    )
    assert all(
        math.isnan(one) for name, one in score(scenario, SCENARIO.truth, "ts22137").items() if "cat" in name
    )


def test_an_image_without_points_misses_all_and_has_no_errors():
    scores = score(SCENARIO, PointCloud.empty(), "nr-isac")
    assert (scores["missed_detection"], scores["false_alarm_type2"]) == (1.0, 0.0)
    assert math.isnan(scores["horizontal_error_p90_m"])


@pytest.mark.parametrize("shift_m", [0.0, 0.4, 0.9, 1.5, 4.0, 9.0, 11.0])
def test_categories_are_kept_up_to_their_limits(shift_m):
    truth = SCENARIO.truth
    image = PointCloud(truth.xyz + np.array([shift_m, 0, 0]), truth.velocity, truth.power)
    scores = score(SCENARIO, image, "ts22137")
    kept = [scores[f"category_{number}"] for number in range(1, 5)]
    assert kept == [float(shift_m <= limit) for limit in (10.0, 2.0, 1.0, 0.5)]


@pytest.mark.parametrize(("target", "limit_mps"), [("other", 0.1), ("pedestrian", 1.5), ("vehicle", 15.0)])
def test_the_velocity_of_category_4_depends_on_the_target(target, limit_mps):
    truth = SCENARIO.truth
    for error_mps in (0.9 * limit_mps, 1.1 * limit_mps):
        image = PointCloud(truth.xyz, truth.velocity + error_mps, truth.power)
        kept = Ts22137(target=target, grouping="points").score(CloudPair.of(SCENARIO, image))["category_4"]
        assert kept == float(error_mps < limit_mps)


def test_the_gate_is_that_of_six_metres_at_three_deviations():
    from scipy.stats import chi2

    assert pytest.approx(6 * math.sqrt(chi2.ppf(0.9973, 3)), abs=0.05) == GATE_M


@pytest.mark.parametrize("spec", ["nr-isac[gate_m=0]", "nr-isac[grouping=rows]", "ts22137[target=bird]"])
def test_unknown_parameters_are_refused(spec):
    with pytest.raises(InputError, match=r"gate_m|grouping|target"):
        score(SCENARIO, SCENARIO.truth, spec)


def test_more_pairs_than_can_be_compared_are_refused(monkeypatch):
    monkeypatch.setattr("isacbench.metrics.assignment.MOST_PAIRS", 3)
    with pytest.warns(InputWarning, match="association"):
        message = refusal(score, cloud(4 * [(0, 0, 0, 0)]), cloud(2 * [(0, 0, 0, 0)]), "nr-isac")
    assert message.startswith("4 targets and 2 detections: more than")
