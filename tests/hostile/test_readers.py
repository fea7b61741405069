"""Every reader refuses every hostile file: in one message, soon, in bounded memory, and executes nothing."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from isacbench.bench.suites import suite
from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.cubes import open_cube, read_grid, tiles
from isacbench.files import arrays, checked_files
from isacbench.files.checked_files import binary_size
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files import point_files
from isacbench.model.cloud_files.point_files import read_points_csv
from isacbench.model.scenes import scenario
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.discovery import PluginFile

from .faults import FAULTS
from .files import ANY, CLOUDS, CSV, CUBES, LIMIT_MIB, TABLE, TOML, load_cube

AS_PLUGIN = ["a folder", "a link to nothing", "a terabyte", "UTF-16"]

KINDS = {
    **{f"cloud{suffix}": (suffix, files | ANY, [PointCloud.read]) for suffix, files in CLOUDS.items()},
    **{f"cube{suffix}": (suffix, files | ANY, [load_cube]) for suffix, files in CUBES.items()},
    # Of MATLAB's, a file of a cell and a table has what can be a grid; its reader is that of cubes.
    **{f"grid{suffix}": (suffix, CUBES[suffix] | ANY, [read_grid]) for suffix in CUBES if suffix != ".mat"},
    "points.csv": (".csv", CSV | ANY, [read_points_csv]),
    "scenario.toml": (".toml", TOML | ANY, [load_scenario, load_suite]),
    "plugin.py": (".py", {name: ANY[name] for name in AS_PLUGIN}, [PluginFile.read]),
}
"""Extension, hostile files and readers."""

OF_READER = {}
for row in FAULTS:
    OF_READER.setdefault(f"{row[0].__name__}{row[1][0]}", []).append(row)


@pytest.mark.parametrize(("suffix", "files", "readers"), KINDS.values(), ids=KINDS)
def test_every_hostile_file_is_refused(refused, tmp_path, monkeypatch, suffix, files, readers):
    monkeypatch.setattr(point_files, "CLOUD_BYTES", LIMIT_MIB * 2**20)
    monkeypatch.setattr(tiles, "GRID_BYTES", LIMIT_MIB * 2**20)
    for name, write in files.items():
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.chdir(folder)
        write(folder / f"file{suffix}")
        for reader in readers:
            refused(reader, folder / f"file{suffix}")
        assert not list(folder.rglob("UNPICKLED")), name


@pytest.mark.parametrize("rows", OF_READER.values(), ids=OF_READER)
def test_faulty_files_are_refused_in_words(refused, tmp_path, rows):
    for number, (reader, (suffix, write), *words) in enumerate(rows):
        path = tmp_path / f"{number}{suffix}"
        write(path)
        message = refused(reader, path)
        assert message.startswith(str(path))
        assert all(part in message for part in words), (message, words)


@pytest.mark.parametrize("reader", [open_cube, read_grid, PointCloud.read])
def test_paths_of_no_file_of_a_known_format_are_refused(refused, tmp_path, reader):
    allowed = ".csv, .npy, .npz, .mat, .ply" if reader == PointCloud.read else ", ".join(arrays.FORMATS)
    for name in ("file.txt", "file"):
        found = "suffix '.txt'" if "." in name else "no suffix"
        message = refused(reader, tmp_path / name)
        assert message.startswith(f"{tmp_path / name}: has {found}; ")
        assert message.endswith(allowed)
    assert refused(reader, tmp_path / "file.npy") == f"{tmp_path / 'file.npy'}: does not exist"


def test_a_name_that_no_file_can_have_is_refused(refused, tmp_path):
    for suffix, _, readers in KINDS.values():
        for reader in readers if suffix != ".zarr" else ():
            refused(reader, tmp_path / f"{'x' * 300}{suffix}")


# What looks odd, and is right


@pytest.mark.parametrize("dtype", [">f8", "<f4", ">f4", ">i4", "<u2", "<f2", "<i8", np.longdouble])
def test_numbers_of_any_type_and_order_are_read_right(tmp_path, dtype):
    for order in "CF":
        np.save(tmp_path / "cloud.npy", np.asarray(TABLE, dtype=dtype, order=order))
        np.savez(tmp_path / "cloud.npz", cloud=np.asarray(TABLE, dtype=dtype, order=order))
        for name in ("cloud.npy", "cloud.npz"):
            assert np.array_equal(PointCloud.read(tmp_path / name).to_array()[:, :4], TABLE), (name, order)


def test_a_byte_order_mark_is_no_part_of_the_text(tiny):
    plugin = tiny.with_suffix(".py")
    plugin.write_text("x = 1\n")
    for path in (plugin, tiny, tiny.with_suffix(".csv")):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(load_scenario(tiny).truth) == 3
    assert PluginFile.read(plugin).source == "x = 1\n"


def test_links_that_the_user_names_are_followed(tmp_path, tiny):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "link.csv").symlink_to(tiny.with_suffix(".csv"))
    (tmp_path / "elsewhere" / "link.toml").symlink_to(tiny)
    assert len(read_points_csv(tmp_path / "elsewhere" / "link.csv").xyz) == 3
    (tmp_path / "elsewhere" / "tiny.csv").write_text("x,y,z,v\n5,5,1,0\n")
    assert len(load_scenario(tmp_path / "elsewhere" / "link.toml").truth) == 1


def test_the_documentation_has_the_limits_that_hold():
    text = (Path(__file__).parents[2] / "docs" / "hostile-files.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|", text, flags=re.MULTILINE))
    assert rows["a scenario or a suite"] == binary_size(checked_files.TOML_BYTES)
    assert rows["a name of a scenario or a suite"] == f"{scenario.MAX_NAME} characters"
    assert suite.MAX_NAME == scenario.MAX_NAME
    assert rows["a point cloud, in its file and as arrays"] == binary_size(checked_files.CLOUD_BYTES)
    assert rows["a transmitted grid, as complex128"] == binary_size(checked_files.GRID_BYTES)
    assert rows["a cube or a file that is read as a whole"] == binary_size(checked_files.HELD_BYTES)
    assert rows["chunks of a zarr array"] == f"{arrays.MOST_CHUNKS:,}".replace(",", " ")
    assert rows["the source of a plugin"] == binary_size(checked_files.SOURCE_BYTES)
    assert rows["a manifest"] == binary_size(checked_files.MANIFEST_BYTES)
