"""Objects: grouping, assignment against plain loops, and what is said where there are none."""

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isacbench import load_scenario, score
from isacbench.errors import InputWarning
from isacbench.metrics.descriptions import object_kind
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.object_scores import Objects, described, group_points, true_objects
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import space_places
from tests.conftest import few, refusal
from tests.single_scores import all_matchings

TOWN, STREET = load_scenario("town[seed=7]"), load_scenario("street")


def scores(scenario, cloud, **gates):
    return Objects(**gates).score(CloudPair.of(scenario, cloud))


def test_true_objects_are_boxes_around_their_scatterers():
    found, names = true_objects(TOWN), np.array(TOWN.scatterers.objects)
    assert len(found) == len(set(names))
    for place, name in enumerate(np.unique(names)):
        xyz = TOWN.scatterers.xyz[names == name]
        np.testing.assert_allclose(found.centre_m[place], (xyz.min(axis=0) + xyz.max(axis=0)) / 2)
        np.testing.assert_allclose(found.extent_m[place], np.ptp(xyz, axis=0))
        assert found.velocity_mps[place] == pytest.approx(TOWN.scatterers.velocity[names == name].mean())
        assert found.kinds[place] == object_kind(name)


def test_the_scatterers_themselves_are_grouped_into_nearly_all_objects():
    """Over families; objects that touch at one speed are one to a radio."""
    families = ("street", "town", "crowd", "weak", "traffic", "crossing")
    scenes = [load_scenario(f"{family}[seed=31]") for family in families]
    found = pd.DataFrame([scores(scene, scene.truth) for scene in scenes]).sum()
    assert found["n_objects_missed"] <= 0.15 * found["n_objects"]
    assert found["n_objects_false"] <= 0.1 * found["n_objects"]


def test_an_empty_image_detects_nothing_and_has_no_errors():
    found = scores(TOWN, PointCloud.empty())
    assert (found["objects_detected"], found["n_objects_false"], found["objects_f_score"]) == (0, 0, 0)
    assert found["n_objects_missed"] == found["n_objects"]
    assert math.isnan(found["objects_horizontal_m"])


def test_what_is_moved_too_far_or_has_another_speed_is_another_object():
    scene = load_scenario("sparse[seed=7,scatterers=4]")
    truth = scene.truth
    assert scores(scene, truth)["objects_detected"] == 1
    off = PointCloud(truth.xyz + np.array([0.6, 0.8, 0.5]), truth.velocity + 1.0)
    found = scores(scene, off)
    assert found["objects_detected"] == 1
    assert found["objects_horizontal_m"] == pytest.approx(1.0)
    assert found["objects_vertical_m"] == pytest.approx(0.5)
    assert found["objects_velocity_mps"] == pytest.approx(1.0)
    assert found["objects_extent_m"] == pytest.approx(0.0, abs=1e-9)
    assert scores(scene, off, gate_m=1.0)["objects_detected"] == 0
    assert scores(scene, off, gate_mps=0.5)["objects_detected"] == 0


@settings(max_examples=40)
@given(seed=st.integers(0, 1000), n=st.integers(1, 5), m=st.integers(0, 5))
def test_the_assignment_is_the_best_of_all(seed, n, m):
    """As many pairs as the gate allows, of these the nearest; lone points are objects."""
    rng = np.random.default_rng(seed)
    scene = load_scenario(f"sparse[seed={seed % 50},scatterers={n}]")
    near = scene.truth.xyz[rng.integers(0, n, m)] + rng.normal(0, 1.5, (m, 3))
    image = PointCloud(near, scene.truth.velocity[rng.integers(0, n, m)])
    found = Objects().matches(scene, image)
    distance = np.linalg.norm(found.truth.centre_m[:, None] - found.found.centre_m, axis=2)
    inside = (distance <= 2) & (np.abs(found.truth.velocity_mps[:, None] - found.found.velocity_mps) <= 5)
    best = max(
        (len(pairs), -sum(distance[pair] for pair in pairs))
        for pairs in all_matchings(*distance.shape)
        if all(inside[pair] for pair in pairs)
    )
    assert (found.i.size, -distance[found.i, found.j].sum()) == pytest.approx(best)


@few
@given(seed=st.integers(0, 1000))
def test_groups_do_not_depend_on_the_order_of_points_or_on_copies(seed):
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(TOWN.truth))
    plain, mixed = group_points(TOWN, TOWN.truth), group_points(TOWN, TOWN.truth.select(order))
    # The same partition, whatever the numbers of its groups.
    pairs = np.unique(np.column_stack([plain[order], mixed]), axis=0)
    assert len(pairs) == plain.max() == mixed.max()
    image = TOWN.truth.select(order[:100])
    doubled = image.select(np.r_[np.arange(100), np.arange(100)])
    assert scores(TOWN, doubled) == pytest.approx(scores(TOWN, image), nan_ok=True)


@few
@given(seed=st.integers(0, 1000))
def test_last_digits_of_points_in_the_middle_of_their_bins_decide_no_group(seed):
    rng = np.random.default_rng(seed)
    cells = np.column_stack(
        [rng.integers(260, 290, 80), rng.integers(-4, 5, 80), rng.uniform(-0.1, 0.1, 80), np.full(80, 0.2)]
    )
    system = TOWN.system
    xyz, velocity = space_places(TOWN, cells * [system.range_bin_m, system.velocity_bin_mps, 1, 1])
    group = group_points(TOWN, PointCloud(xyz, velocity))
    moved = xyz + 1e-9 * rng.uniform(-1, 1, xyz.shape)
    np.testing.assert_array_equal(group, group_points(TOWN, PointCloud(moved, velocity)))


def test_objects_far_from_each_other_are_groups_of_their_own_and_a_chain_is_one():
    cells = np.array([[260, 0, 0, 0.2], [263, 0, 0, 0.2], [400, 0, 0, 0.2], [400, 9, 0, 0.2]])
    system = STREET.system
    xyz, velocity = space_places(TOWN, cells * [system.range_bin_m, system.velocity_bin_mps, 1, 1])
    group = group_points(TOWN, PointCloud(xyz, velocity))
    assert group[0] == group[1]
    assert len(set(group.tolist())) == 3


def test_two_blobs_that_touch_are_two_objects():
    """A square beside another, with a thin bridge between them."""
    side = np.linspace(-2.5, 2.5, 11)
    square = np.stack(np.meshgrid(side, side, [1.0]), axis=-1).reshape(-1, 3) + np.array([20, 8, 0])
    bridge = np.column_stack([np.full(9, 20.0), 10.5 + 0.5 * np.arange(1, 10), np.ones(9)])
    xyz = np.vstack([square, square + np.array([0, 10, 0]), bridge])
    group = group_points(TOWN, PointCloud(xyz, np.zeros(len(xyz))))
    first, second = set(group[:121].tolist()), set(group[121:242].tolist())
    assert len(first) == len(second) == 1
    assert first != second


def test_points_that_belong_to_no_object_are_told_and_all_other_scores_remain():
    bare = dataclasses.replace(STREET, scatterers=dataclasses.replace(STREET.scatterers, objects=()))
    with pytest.warns(InputWarning, match="metric objects: scenario street: 466 of 466 points belong to no"):
        found = score(bare, STREET.truth, "objects")
    assert all(math.isnan(value) for name, value in found.items() if name not in ("n_true", "n_estimated"))
    assert score(bare, STREET.truth)["deviation"] == 0
    with pytest.warns(InputWarning, match="it needs a scenario as truth"):
        score(STREET.truth, STREET.truth, "objects")


def test_a_cloud_without_velocities_has_no_objects():
    assert math.isnan(scores(STREET, PointCloud(STREET.truth.xyz))["objects_detected"])


HEAD = (
    'name = "own"\n[array]\nframe = "panel"\n[base_station]\nposition_m = [15.0, 100.0, 20.0]\n'
    "[region]\nx_m = [0.0, 30.0]\ny_m = [0.0, 20.0]\nz_m = [0.0, 20.0]\nspeed_mps = [-15.0, 15.0]\n"
)
POINTS = '[[objects]]\nkind = "points"\nfile = "{}"\n'


@pytest.fixture
def own_scene(tmp_path):
    """Return a function that loads a scene of csv files by name, and of further objects."""

    def load(further="", **files):
        for name, rows in files.items():
            (tmp_path / f"{name}.csv").write_text(f"x,y,z,v,object\n{rows}")
        objects = "".join(POINTS.format(f"{name}.csv") for name in files)
        (tmp_path / "own.toml").write_text(HEAD + objects + further)
        return load_scenario(tmp_path / "own.toml")

    return load


def test_a_csv_may_name_the_object_of_each_point(own_scene):
    scenario = own_scene(points="1,2,0.5,0,Drone 1\n1.2,2,0.5,0,Drone 1\n20,9,0,1,car 2\n")
    assert scenario.scatterers.objects == ("Drone 1", "Drone 1", "car 2")
    found = scores(scenario, scenario.truth)
    assert (found["detected_drone"], found["detected_car"]) == (1, 1)


def test_objects_of_one_name_in_several_entries_of_a_file_are_several_objects(own_scene):
    car = '[[objects]]\nkind = "car"\nposition_m = [6, 10, 0]\n'
    first, second = "1,2,1,0,car 1\n1.5,2,1,0,car 1\n", "20,18,1,0,car 1\n20.5,18,1,0,car 2\n"
    scenario = own_scene(car, first=first, second=second)
    names = scenario.scatterers.objects
    assert names[:4] == ("car 1", "car 1", "car 3", "car 2")
    assert len(true_objects(scenario)) == len(set(names)) == 4


def test_a_point_at_the_base_station_is_a_point_like_others():
    there = PointCloud([STREET.base_station_m, STREET.truth.xyz[0]], [0.0, STREET.truth.velocity[0]])
    alone = there.select([1])
    assert scores(STREET, there)["n_objects_false"] == scores(STREET, alone)["n_objects_false"] + 1


def test_of_equally_near_objects_the_same_one_is_matched_in_every_order_of_points():
    centre = true_objects(TOWN).centre_m[0]
    sides = np.array([[-1.5, 0, 0], [1.5, 0, 0]])
    cloud = PointCloud(centre + sides, true_objects(TOWN).velocity_mps[0] + np.array([0.0, 4.0]))
    np.testing.assert_equal(scores(TOWN, cloud.select([1, 0])), scores(TOWN, cloud))


@pytest.mark.parametrize("name", ["gate_m", "gate_mps", "voxel"])
def test_parameters_are_positive_numbers(name):
    for value in (0, -1.0, math.inf, math.nan):
        assert f"{name} = {value}: allowed is a positive number" in refusal(Objects, **{name: value})


def test_an_image_without_points_has_no_groups():
    assert group_points(TOWN, PointCloud.empty()).size == 0
    assert len(described(PointCloud.empty(), np.empty(0, dtype=int))) == 0
