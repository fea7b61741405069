"""Every reader refuses every hostile file: in one message, soon, in bounded memory, and executes nothing."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

from isacbench.bench.suites import suite
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.cubes import open_cube, read_grid
from isacbench.files import checked_files
from isacbench.files.arrays import zarr_stores
from isacbench.files.checked_files import binary_size
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.point_files import read_points_csv
from isacbench.model.scenes import scenario
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.local_files import PluginFile

from .files import ANY, CLOUDS, CSV, CUBE, CUBES, GRID, TABLE, TOML, bomb

SUFFIXES = {
    PointCloud.read: ".csv",
    read_points_csv: ".csv",
    open_cube: ".npy",
    read_grid: ".npy",
    load_scenario: ".toml",
    load_suite: ".toml",
}


def read_cube(path):
    """Open a cube and load all of it: what is wrong with numbers is told when they are met."""
    with open_cube(path) as cube:
        for tile in cube.tiles(np.argwhere(np.ones(cube.shape[2:], dtype=bool))):
            tile.load()


def cases(files, *anyway):
    """Cases of a table of files by extension, and what is refused whatever the extension."""
    return [
        pytest.param(suffix, write, id=f"{suffix}-{name}")
        for suffix, named in files.items()
        for name, write in {**named, **ANY}.items()
        if name not in anyway
    ]


PLUGINS = ["a pipe", "a device", "a folder", "a link to itself", "a terabyte", "UTF-16"]


@pytest.fixture
def hostile(tmp_path):
    """Return a function that writes a file into a folder of its own."""

    def write(suffix, writer):
        path = tmp_path / "stranger" / f"file{suffix}"
        path.parent.mkdir()
        writer(path)
        return path

    yield write
    assert not list(tmp_path.rglob("UNPICKLED"))


@pytest.mark.parametrize(("suffix", "write"), cases(CLOUDS))
def test_no_hostile_file_is_a_cloud(refused, hostile, suffix, write):
    refused(PointCloud.read, hostile(suffix, write))


@pytest.mark.parametrize(("suffix", "write"), cases({".csv": CSV}))
def test_no_hostile_file_holds_points(refused, hostile, suffix, write):
    refused(read_points_csv, hostile(suffix, write))


@pytest.mark.parametrize(("suffix", "write"), cases(CUBES))
def test_no_hostile_file_is_a_cube_or_a_grid(refused, hostile, suffix, write):
    path = hostile(suffix, write)
    refused(read_cube, path)
    refused(read_grid, path)


@pytest.mark.parametrize(("suffix", "write"), cases({".toml": TOML}))
def test_no_hostile_file_is_a_scenario_or_a_suite(refused, hostile, suffix, write):
    path = hostile(suffix, write)
    refused(load_scenario, path)
    refused(load_suite, path)


@pytest.mark.parametrize(
    "name", ["a pipe", "a device", "a folder", "a link to nothing", "a terabyte", "UTF-16"]
)
def test_no_hostile_file_is_a_plugin(refused, hostile, name):
    refused(PluginFile.read, hostile(".py", ANY[name]))


@pytest.mark.parametrize(
    "reader", [PointCloud.read, read_points_csv, open_cube, read_grid, load_scenario, load_suite]
)
@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "../" * 2000 + "x", "\udcff"])
def test_names_that_no_file_can_have_are_refused(refused, tmp_path, reader, name):
    suffix = {load_scenario: ".toml", load_suite: ".toml", open_cube: ".npy", read_grid: ".npy"}.get(
        reader, ".csv"
    )
    refused(reader, tmp_path / f"{name}{suffix}")


# What looks odd, and is right


@pytest.mark.parametrize("dtype", [">f8", "<f4", ">f4", ">i4", "<u2", "<f2", "<i8", np.longdouble])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numbers_of_any_type_and_order_are_read_right(tmp_path, dtype, order):
    np.save(tmp_path / "cloud.npy", np.asarray(TABLE, dtype=dtype, order=order))
    np.savez(tmp_path / "cloud.npz", cloud=np.asarray(TABLE, dtype=dtype, order=order))
    for name in ("cloud.npy", "cloud.npz"):
        assert np.array_equal(PointCloud.read(tmp_path / name).to_array()[:, :4], TABLE)


@pytest.mark.parametrize("dtype", [">c8", "<c8", ">c16", "<c16"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_cubes_of_any_byte_and_memory_order_are_read_right(tmp_path, dtype, order):
    numbers = np.asarray(np.arange(CUBE.size).reshape(CUBE.shape) * (1 + 2j), dtype=dtype, order=order)
    np.save(tmp_path / "cube.npy", numbers)
    np.savez_compressed(tmp_path / "cube.npz", cube=numbers, transmitted=np.asarray(GRID, dtype=dtype))
    for name in ("cube.npy", "cube.npz"):
        with open_cube(tmp_path / name) as cube:
            (tile,) = cube.tiles(np.argwhere(np.ones(CUBE.shape[2:], dtype=bool)))
            flat = numbers.reshape(*CUBE.shape[:2], -1)
            assert np.array_equal(tile.load(), flat[:, :, tile.elements])
    assert np.array_equal(read_grid(tmp_path / "cube.npz"), GRID)


@pytest.mark.parametrize("suffix", [".csv", ".toml", ".py"])
def test_a_byte_order_mark_is_no_part_of_the_text(tiny, suffix):
    path = tiny.with_suffix(suffix)
    if suffix == ".py":
        path.write_text("x = 1\n")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(load_scenario(tiny).truth) == 3
    if suffix == ".py":
        assert PluginFile.read(path).source == "x = 1\n"


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_lines_end_as_they_do_anywhere(tmp_path, ends):
    path = tmp_path / "cloud.csv"
    path.write_bytes(ends.join(["x,y,z,v", "1,2,3,4", "", "5,6,7,8"]).encode())
    assert PointCloud.read(path).to_array()[:, :4].tolist() == [[1, 2, 3, 4], [5, 6, 7, 8]]


def test_what_is_no_text_is_told_with_its_byte_however_far_into_the_file(tmp_path, refused):
    path = tmp_path / "cloud.csv"
    good = b"x,y,z,v\n" + b"1,2,3,4\n" * 10_000
    path.write_bytes(good + b"\xff")
    assert f"(byte {len(good)})" in refused(PointCloud.read, path)


def test_links_that_the_user_names_are_followed(tmp_path, tiny):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "link.csv").symlink_to(tiny.with_suffix(".csv"))
    (tmp_path / "elsewhere" / "link.toml").symlink_to(tiny)
    assert len(read_points_csv(tmp_path / "elsewhere" / "link.csv").xyz) == 3
    (tmp_path / "elsewhere" / "tiny.csv").write_text("x,y,z,v\n5,5,1,0\n")
    assert len(load_scenario(tmp_path / "elsewhere" / "link.toml").truth) == 1


def test_other_members_of_an_archive_are_not_looked_at(tmp_path, bounded):
    path = tmp_path / "cloud.npz"
    np.savez(path, cloud=TABLE)
    data = path.read_bytes()
    bomb(b"", 300, names=["notes.txt"])(path)
    with zipfile.ZipFile(path, "a") as archive:
        (tmp_path / "other.npz").write_bytes(data)
        with zipfile.ZipFile(tmp_path / "other.npz") as other:
            archive.writestr("cloud.npy", other.read("cloud.npy"))
    with bounded():
        assert len(PointCloud.read(path)) == len(TABLE)


def test_the_documentation_has_the_limits_that_hold():
    text = (Path(__file__).parents[2] / "docs" / "hostile-files.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|", text, flags=re.MULTILINE))
    assert rows["a scenario or a suite"] == binary_size(checked_files.TOML_BYTES)
    assert rows["a name of a scenario or a suite"] == f"{scenario.MAX_NAME} characters"
    assert suite.MAX_NAME == scenario.MAX_NAME
    assert rows["a point cloud, in its file and as arrays"] == binary_size(checked_files.CLOUD_BYTES)
    assert rows["a transmitted grid, as complex128"] == binary_size(checked_files.GRID_BYTES)
    assert rows["a cube or a file that is read as a whole"] == binary_size(checked_files.HELD_BYTES)
    assert rows["chunks of a zarr array"] == f"{zarr_stores.MOST_CHUNKS:,}".replace(",", " ")
    assert rows["the source of a plugin"] == binary_size(checked_files.SOURCE_BYTES)
    assert rows["a manifest"] == binary_size(checked_files.MANIFEST_BYTES)
