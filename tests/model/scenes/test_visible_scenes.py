"""Scenes whose objects hide each other: solids that fit their outlines, meshes in place, whole scenes."""

import runpy
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from isacbench import load_scenario
from isacbench.model.scenes.object_tables import AnyObject, MeshTable
from isacbench.model.scenes.objects import turned
from isacbench.model.scenes.placed_objects import Surroundings
from isacbench.model.scenes.scene_families import FAMILIES
from isacbench.model.scenes.solids import solid_of
from tests.conftest import refusal

BASE_M = np.array([20.0, 100.0, 20.0])
OUTLINED = {
    get_args(table.model_fields["kind"].annotation)[0]: table
    for table in get_args(get_args(AnyObject)[0])
    if hasattr(table, "outline")
}
SOLID_KINDS = sorted(OUTLINED.keys() - {"point"})
OF_ALL_KINDS = OUTLINED["point"].model_fields.keys()


@pytest.fixture
def load(load_objects):
    """Return a function that loads a scene of some objects, by default what is seen of it."""
    return lambda objects, visible="seen": load_objects(objects, f'visible = "{visible}"')


def entry(kind, x=20.0, y=10.0, **keys):
    """Object of a scenario file."""
    lines = "".join(f"{key} = {value}\n" for key, value in keys.items())
    return f'[[objects]]\nkind = "{kind}"\nposition_m = [{x}, {y}, 0.0]\n{lines}'


def is_part(some, others):
    """Tell whether points are among others, bit for bit."""
    return {tuple(point) for point in some.tolist()} <= {tuple(point) for point in others.tolist()}


@pytest.mark.parametrize("kind", SOLID_KINDS)
def test_points_of_an_outline_are_on_its_solid_or_outside_it(kind):
    """A point within the solid would be hidden from everywhere, unless it stands for its part."""
    table = OUTLINED[kind]
    defaults = {key: field.default for key, field in table.model_fields.items() if key not in OF_ALL_KINDS}
    points, parts = table.outline(**defaults), solid_of(kind, defaults)
    stands_for = {number for _, own in parts for number in own}
    rest = np.array([number for number in range(len(points)) if number not in stands_for], dtype=int)
    for triangles, own in parts:
        corners = triangles.reshape(-1, 3)
        mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
        if mesh.is_watertight and len(rest):
            assert trimesh.proximity.signed_distance(mesh, points[rest]).max() < 1e-6
        if len(own):
            assert (np.abs(trimesh.proximity.signed_distance(mesh, points[[*own]])) < 0.35).all()


@pytest.mark.parametrize("kind", SOLID_KINDS)
@pytest.mark.parametrize("yaw_deg", [0.0, 37.0, 200.0])
def test_of_an_object_alone_part_is_seen_and_all_of_what_is_seen_is_its_own(load, kind, yaw_deg):
    object_ = entry(kind, yaw_deg=yaw_deg)
    everything, seen = load(object_, "all").scatterers, load(object_).scatterers
    assert is_part(seen.xyz, everything.xyz)
    share = len(seen) / len(everything)
    if kind in ("wall", "pole"):
        assert share == 1
    elif kind in ("rail", "lamp_post", "pedestrian", "cyclist"):
        # A limb, an arm or a bar can stand in line with another.
        assert 0.6 < share <= 1
    else:
        assert 0.3 < share < 1


@pytest.mark.parametrize("kind", SOLID_KINDS)
def test_a_high_wall_before_an_object_hides_it_and_one_behind_it_does_not(load, kind):
    object_ = entry(kind, yaw_deg=30.0)
    alone = len(load(object_).scatterers)
    wall = {"size_m": [39.0, 19.0], "yaw_deg": 90.0}
    before = load(object_ + entry("wall", y=29.0, **wall)).scatterers
    assert (before.xyz[:, 1] > 28).all()
    behind = load(object_ + entry("wall", y=0.0, **wall)).scatterers
    assert (behind.xyz[:, 1] > 0.5).sum() == alone


def test_cylinders_and_ellipsoids_stand_on_the_ground_and_have_points_all_around(load):
    for object_, n_expected in (
        (entry("cylinder", radius_m=2.0, height_m=5.0), (2 * np.pi * 2 * 5 + 2 * np.pi * 4) / 0.5**2),
        (entry("ellipsoid", size_m=[6.0, 6.0, 6.0]), 4 * np.pi * 9 / 0.5**2),
        (entry("cylinder", radius_m=1.0, height_m=3.0, spacing_m=0.25), 2 * np.pi * (3 + 1) / 0.25**2),
    ):
        xyz = load(object_, "all").scatterers.xyz
        assert 0.8 < len(xyz) / n_expected < 1.35, object_
        assert xyz[:, 2].min() < 0.3, object_
        np.testing.assert_allclose(xyz[:, :2].mean(axis=0), [20, 10], atol=0.1)


def test_points_and_csv_files_hide_nothing_and_can_be_hidden(load, tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,v\n20,5,1,0\n20,5,15,0\n")
    csv = '[[objects]]\nkind = "points"\nfile = "a.csv"\n'
    wall = entry("wall", y=29.0, size_m=[39.0, 10.0], yaw_deg=90.0)
    assert len(load(csv + entry("point", y=2.0)).scatterers) == 3
    behind = load(csv + entry("point", y=2.0) + wall).scatterers
    assert behind.xyz[behind.xyz[:, 1] < 20].tolist() == [[20, 5, 15]]


def test_a_scene_of_which_nothing_is_seen_is_refused(load, tmp_path):
    trimesh.creation.box([60.0, 200.0, 60.0]).export(tmp_path / "hall.stl")
    trimesh.creation.box([2.0, 2.0, 2.0]).export(tmp_path / "shell.stl")
    shell = mesh_entry("shell.stl", 20.0, 100.0).replace("0.0]", "20.0]")
    for scene in (mesh_entry("hall.stl", 20.0, 50.0, scale=1), shell + entry("vehicle")):
        assert "no part of its surface lies in the region" in refusal(load, scene)


def test_a_bar_behind_a_wall_is_hidden_though_the_ray_meets_the_bar_first(load):
    bar = entry("rail", length_m=20.0)
    wall = entry("wall", y=15.0, size_m=[10.0, 12.0], yaw_deg=90.0)
    behind = load(bar + wall).scatterers.xyz
    assert not ((behind[:, 1] < 14) & (behind[:, 2] < 1)).any()


@pytest.mark.parametrize("keys", [{"spacing_m": 5.0}, {"size_m": [1.8, 0.5, 1.5]}])
def test_a_vehicle_without_a_row_of_its_cabin_has_a_body(load, keys):
    vehicle = entry("vehicle", **keys)
    assert 0 < len(load(vehicle).scatterers) < len(load(vehicle, "all").scatterers)


@pytest.mark.parametrize("length", ["radius_m", "height_m"])
def test_a_cylinder_of_an_absurd_size_is_refused(load, length):
    message = refusal(load, entry("cylinder", **{length: 1e200}))
    assert f"objects[0].{length} = 1e+200: input should be less than or equal" in message


def test_without_objects_there_is_nothing_to_hide(load):
    assert len(load("").scatterers) == 0


@pytest.mark.parametrize("family", [name for name in FAMILIES if name != "uma-av"])
def test_what_is_seen_of_a_family_is_part_of_its_objects(family):
    everything, seen = (
        load_scenario(f"{family}[seed=4,visible={which}]").scatterers for which in ("all", "seen")
    )
    assert is_part(*(np.column_stack([each.xyz, each.velocity]) for each in (seen, everything)))
    assert (len(seen) == len(everything)) == (family == "sparse")


def test_lorries_hide_others_in_traffic():
    """Of the objects that are not lorries, some are hidden as a whole in some scenes."""
    lost = 0
    for seed in range(30):
        everything = load_scenario(f"traffic[seed={seed},visible=all]").scatterers.xyz
        seen = load_scenario(f"traffic[seed={seed}]").scatterers.xyz
        groups = cKDTree(seen).query(everything)[0]
        lost += bool((groups > 1.5).any())
        if lost == 3:
            return
    pytest.fail(f"in {lost} scenes alone")


# --- meshes -------------------------------------------------------------------------------------------------


def mesh_entry(file="box.ply", x=20.0, y=10.0, **keys):
    """Mesh of a scenario file."""
    return entry("mesh", x, y, **keys) + f'file = "{file}"\n'


@pytest.fixture
def box_file(tmp_path):
    """File of a box of 2 x 5 x 1.5 m on the ground."""
    trimesh.creation.box(bounds=[[-1, -2.5, 0], [1, 2.5, 1.5]]).export(tmp_path / "box.ply")
    return tmp_path / "box.ply"


@pytest.mark.parametrize("yaw_deg", [0.0, 25.0, -90.0])
def test_a_mesh_is_turned_and_put_where_the_file_says(load, box_file, yaw_deg):
    xyz = load(mesh_entry(yaw_deg=yaw_deg), "all").scatterers.xyz
    own = turned(xyz - [20, 10, 0], -yaw_deg)
    assert len(own) == 2 * (4 * 10 + 4 * 3 + 10 * 3)
    np.testing.assert_allclose(np.abs(own).max(axis=0), [1, 2.5, 1.5], atol=1e-9)


def test_of_a_mesh_the_faces_towards_the_base_station_and_the_roof_are_seen(load, box_file):
    xyz = load(mesh_entry()).scatterers.xyz
    assert len(xyz) == 4 * 10 + 4 * 3
    assert ((xyz[:, 2] == 1.5) | (xyz[:, 1] == 12.5)).all()


def test_a_mesh_moves_as_a_rigid_body(load, box_file):
    object_ = mesh_entry(velocity_mps=[3.0, -4.0, 0.0], yaw_rate_dps=20.0)
    scatterers = load(object_, "all").scatterers
    velocities = [3.0, -4.0, 0.0] + np.radians(20) * np.cross([0, 0, 1], scatterers.xyz - [20, 10, 0])
    sight = BASE_M - scatterers.xyz
    expected = (velocities * sight).sum(axis=1) / np.linalg.norm(sight, axis=1)
    np.testing.assert_allclose(scatterers.velocity, expected, atol=1e-6)


@pytest.mark.parametrize(("x", "y", "yaw_deg"), [(0.3, 10.0, 20.0), (39.0, 29.0, 45.0), (20.0, 0.0, 0.0)])
def test_a_mesh_across_the_edge_of_the_region_is_sampled_within_it(load, box_file, x, y, yaw_deg):
    scenario = load(mesh_entry(x=x, y=y, yaw_deg=yaw_deg), "all")
    assert scenario.region.contains(scenario.scatterers.xyz, 2e-9).all()
    assert 10 < len(scenario.scatterers) < 164


MISTAKES = {
    "objects[0]: box.ply: no part of its surface lies in the region, x 0 to": {"x": 100.0},
    "its bounding box is x 99 to 101, y 7.5 to 12.5, z 0 to 1.5 m": {"x": 100.0},
    "missing.ply: does not exist": {"file": "missing.ply"},
    "leads out of the folder": {"file": "../box.ply"},
    "objects[0].scale = 0": {"scale": 0},
    "objects[0].up = 'x'": {"up": '"x"'},
    "allowed are at most 200000, a spacing_m of": {"spacing_m": 0.001},
}


@pytest.mark.parametrize(("message", "keys"), MISTAKES.items())
def test_a_mistake_with_a_mesh_is_told_in_one_line(load, box_file, message, keys):
    assert message in refusal(load, mesh_entry(**keys))


def test_an_open_sheet_hides_and_is_seen_from_both_sides(load, tmp_path):
    corners = np.array([[-15, 0, 0], [15, 0, 0], [15, 0, 10], [-15, 0, 10]], dtype=float)
    for faces in ([[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [3, 2, 0]]):
        trimesh.Trimesh(corners, faces, process=False).export(tmp_path / "box.ply")
        scatterers = load(mesh_entry(y=20.0) + entry("vehicle")).scatterers
        assert len(scatterers) == 60 * 20
        assert (scatterers.xyz[:, 1] == 20).all()


def test_a_city_of_12000_faces_has_its_points_in_the_region_on_its_surface(load, tmp_path):
    random = np.random.default_rng(0)
    places = np.column_stack([random.uniform(-600, 600, (1000, 2)), np.zeros(1000)])
    corners = zip(places, places + random.uniform([4, 4, 4], [12, 12, 19], (1000, 3)), strict=True)
    city = trimesh.util.concatenate([trimesh.creation.box(bounds=bounds) for bounds in corners])
    city.export(tmp_path / "city.glb")
    assert len(city.faces) == 12_000
    around = Surroundings(tmp_path / "scene.toml", BASE_M, load("").region, with_solids=True)
    placed = MeshTable(kind="mesh", file="city.glb").placed(around)
    assert sum(len(triangles) for triangles, _ in placed.parts) == len(city.faces)
    xyz = placed.scatterers.xyz
    assert around.region.contains(xyz).all()
    is_near = (np.abs(city.triangles_center[:, :2]) < 80).all(axis=1)
    near = city.submesh([np.flatnonzero(is_near)], append=True)
    assert np.abs(trimesh.proximity.closest_point(near, xyz[::50])[1]).max() < 1e-3


def test_the_meshes_that_ship_are_those_that_the_script_writes():
    root = Path(__file__).resolve().parents[3]
    made = runpy.run_path(str(root / "docs" / "scripts" / "mesh_street.py"))["meshes"]()
    files = {path.stem: path for path in (root / "scenarios" / "meshes").glob("*.ply")}
    assert files.keys() == made.keys()
    for name, mesh in made.items():
        stored = trimesh.load_mesh(files[name], process=False)
        np.testing.assert_allclose(stored.triangles, mesh.triangles, atol=1e-6)


def test_the_street_of_meshes_hides_half_of_its_points():
    scenario = load_scenario("mesh-street")
    assert scenario.region.contains(scenario.scatterers.xyz).all()
    assert 500 < len(scenario.scatterers) < 1500
    assert len(np.unique(scenario.scatterers.velocity)) > 50
