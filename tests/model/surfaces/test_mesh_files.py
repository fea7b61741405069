"""Meshes and cities from files: every format, units and axes, and one clear message for what is wrong."""

import re

import numpy as np
import pytest
import trimesh

from isacbench.model.surfaces.mesh_files import read_mesh
from tests.conftest import refusal

SPAN_M = 54.0
SIZE_M = np.array([1.8, 4.4, 1.5])
FORMATS = ["obj", "ply", "stl", "glb", "gltf"]
DRACO = "KHR_draco_mesh_compression"


def box(size_m=SIZE_M):
    """Box that stands on the ground around the origin."""
    return trimesh.creation.box(size_m, trimesh.transformations.translation_matrix(size_m * [0, 0, 0.5]))


def read(path, scale=None, up=None):
    return read_mesh(path, scale, up, SPAN_M)


def saved(folder, kind, mesh=None):
    """File of a mesh, with its buffers where the format has them."""
    path, mesh = folder / f"thing.{kind}", mesh or box()
    if kind != "gltf":
        mesh.export(path)
        return path
    for name, content in trimesh.exchange.gltf.export_gltf(mesh.scene()).items():
        (folder / name.replace("model", "thing")).write_bytes(content)
    return path


def limits(triangles):
    """Corners of the bounding box."""
    return np.array([triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))])


@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_the_same_triangles_whether_z_is_up_or_y(tmp_path, kind):
    lying = box().apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    for mesh, up in ((box(), None), (lying, "y")):
        triangles = read(saved(tmp_path, kind, mesh), up=up)
        assert triangles.shape == (12, 3, 3)
        expected = [SIZE_M * [-0.5, -0.5, 0], SIZE_M * [0.5, 0.5, 1]]
        np.testing.assert_allclose(limits(triangles), expected, atol=1e-6)


def test_gltf_of_others_has_y_up_as_its_standard_says(tmp_path):
    path = saved(tmp_path, "gltf")
    path.write_text(path.read_text().replace("https://github.com/mikedh/trimesh", "another exporter"))
    assert limits(read(path))[1, 2] == pytest.approx(SIZE_M[1] / 2)
    assert limits(read(path, up="z"))[1, 2] == pytest.approx(SIZE_M[2])


def test_a_mesh_in_another_unit_is_refused_with_its_bounding_box_and_read_with_a_scale(tmp_path):
    for kind, factor in (("obj", 1000.0), ("stl", 100.0), ("ply", 1 / 0.0254), ("obj", 0.001)):
        path = saved(tmp_path, kind, box(SIZE_M * factor))
        height = re.escape(f"{SIZE_M[2] * factor:g} m")
        message = f"bounding box is x .* to .*, z .* {height}, which is no size in metres"
        assert re.search(message, refusal(read, path))
        np.testing.assert_allclose(np.ptp(limits(read(path, 1 / factor)), axis=0), SIZE_M, rtol=1e-4)


def test_parts_of_a_scene_are_in_their_places(tmp_path):
    scene = trimesh.Scene()
    for x in (0.0, 10.0):
        scene.add_geometry(box(), transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    scene.export(tmp_path / "two.glb")
    np.testing.assert_allclose(limits(read(tmp_path / "two.glb"))[:, 0], [-0.9, 10.9], atol=1e-6)


def scene_list(*shapes):
    """Scene list of Mitsuba."""
    return "<scene version='2.1.0'><integrator type='path'/>" + "".join(shapes) + "</scene>"


def shape(name, steps=""):
    """Shape of a file, moved by steps."""
    moved = f"<transform name='to_world'>{steps}</transform>" if steps else ""
    return f"<shape type='ply' id='a'><string name='filename' value='{name}'/>{moved}<ref id='wall'/></shape>"


STEPS = {
    "": [[-0.9, -2.2, 0], [0.9, 2.2, 1.5]],
    "<translate x='5' z='1'/>": [[4.1, -2.2, 1], [5.9, 2.2, 2.5]],
    "<translate value='5, 0, 1'/>": [[4.1, -2.2, 1], [5.9, 2.2, 2.5]],
    "<scale value='2 2 2'/><translate x='1'/>": [[-0.8, -4.4, 0], [2.8, 4.4, 3]],
    "<scale value='2'/>": [[-1.8, -4.4, 0], [1.8, 4.4, 3]],
    "<translate x='1'/><scale x='2'/>": [[0.2, -2.2, 0], [3.8, 2.2, 1.5]],
    "<rotate z='1' angle='90'/>": [[-2.2, -0.9, 0], [2.2, 0.9, 1.5]],
    "<matrix value='0 -1 0 7  1 0 0 0  0 0 1 0  0 0 0 1'/>": [[4.8, -0.9, 0], [9.2, 0.9, 1.5]],
}


@pytest.mark.parametrize(("steps", "expected"), STEPS.items())
def test_a_scene_list_moves_its_shapes(tmp_path, steps, expected):
    saved(tmp_path, "ply")
    (tmp_path / "city.xml").write_text(scene_list(shape("thing.ply", steps)))
    for path in (tmp_path, tmp_path / "city.xml"):
        np.testing.assert_allclose(limits(read(path)), expected, atol=1e-6)


def test_a_city_may_be_larger_than_a_mesh(tmp_path):
    thing = saved(tmp_path, "ply", box(SIZE_M * 200))
    (tmp_path / "city.xml").write_text(scene_list(shape("thing.ply")))
    assert len(read(tmp_path)) == 12
    assert "bounding box" in refusal(read, thing)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.dae", "", "allowed are a folder with one .xml, .xml, .glb, .gltf, .obj, .ply, .stl"),
        ("a.obj", "v 0 0 0\n", "has no triangles; allowed is a mesh with at least one"),
        ("a.obj", "", "has no triangles"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "cannot be read as ply"),
        ("a.stl", "solid", "a.stl: "),
        ("a.glb", "glTF", "cannot be read as glb"),
        ("a.gltf", "{}", "a.gltf: "),
        ("a.gltf", "no json", "cannot be read as gltf: 'Expecting value"),
        ("a.gltf", "[]", "cannot be read as gltf"),
        ("a.gltf", f'{{"extensionsRequired": ["{DRACO}"]}}', f"uses {DRACO}; allowed is glTF with plain tri"),
        ("a.gltf", '{"meshes": [{"primitives": [{"mode": 6}]}]}', "uses TRIANGLE_FAN"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "has vertices that are no finite numbers"),
        ("a.xml", "<scene>", "cannot be read as xml"),
        ("a.xml", '<?xml version="1.0" encoding="big5"?><scene/>', "cannot be read as xml"),
        ("a.xml", "<scene/>", "has no triangles"),
        ("a.xml", "<scene><shape type='sphere'/></scene>", "a shape of type 'sphere' has no filename"),
        ("a.xml", scene_list(shape("missing.ply")), "missing.ply: does not exist"),
        ("a.xml", scene_list(shape("../secret.ply")), "leads out of the folder"),
    ],
)
def test_a_broken_file_gets_one_message(tmp_path, name, content, told):
    (tmp_path / "in").mkdir()
    saved(tmp_path, "ply").rename(tmp_path / "secret.ply")
    (tmp_path / "in" / name).write_text(content)
    assert told in refusal(read, tmp_path / "in" / name)


def test_a_transform_that_is_not_understood_is_refused(tmp_path):
    saved(tmp_path, "ply")
    for step in (
        *("lookat origin='0,0,1'", "scale value='a'", "scale value='1 2'"),
        *("matrix value='1 0 0'", "rotate angle='9'"),
    ):
        (tmp_path / "city.xml").write_text(scene_list(shape("thing.ply", f"<{step}/>")))
        assert re.search(r"city\.xml: .* of a to_world transform", refusal(read, tmp_path)), step


def test_a_folder_has_one_scene_list(tmp_path):
    assert "has 0 scene lists; allowed is a folder with one .xml" in refusal(read, tmp_path)


def test_a_scene_list_that_is_a_link_to_elsewhere_is_not_read(tmp_path):
    (tmp_path / "secret.xml").write_text("<scene><shape type='SECRET'/></scene>")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "city.xml").symlink_to(tmp_path / "secret.xml")
    assert "leads out of the folder" in refusal(read, tmp_path / "in")


def test_buffers_of_gltf_outside_its_folder_are_not_read(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    path = saved(folder, "gltf")
    for buffer in folder.glob("*.bin"):
        buffer.rename(tmp_path / buffer.name)
        path.write_text(path.read_text().replace(buffer.name, f"../{buffer.name}"))
    assert "cannot be read as gltf" in refusal(read, path)
