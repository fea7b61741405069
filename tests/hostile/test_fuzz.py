"""Valid files with bytes changed, lost and repeated: they are read, or refused in words, and nothing else."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from isacbench.bench.suites.suite_kinds import load_suite
from isacbench.cubes import read_grid
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.point_files import read_points_csv
from isacbench.model.scenes.scenario import load_scenario

from ..cubes.samples import write_mat73
from .files import CUBE, GRID, TABLE, load_cube

EXAMPLES = settings.default.max_examples // 3
"""Of each format: with the others they are many."""

SUITE = b"""name = "mine"
scenarios = ["street"]
estimators = ["music2d[pfa=1e-3]"]
snr_db = {start = -10, stop = 10, step = 5}
trials = 2
"""


def write_cloud(path):
    PointCloud.from_array(TABLE).write(path)


def big_endian_ply(path):
    header = "ply\nformat binary_big_endian 1.0\nelement vertex 3\n"
    header += "".join(f"property float {name}\n" for name in "xyzv") + "end_header\n"
    path.write_bytes(header.encode() + TABLE.astype(">f4").tobytes())


def cube_npz(save):
    return lambda path: save(path, cube=CUBE, transmitted=GRID)


SEEDS = {
    **{
        f"cloud{suffix}": (PointCloud.read, suffix, write_cloud)
        for suffix in (".csv", ".npy", ".npz", ".ply")
    },
    "cloud, mat 7.3": (PointCloud.read, ".mat", lambda path: write_mat73(path, p=TABLE, compressed=True)),
    "cloud, compressed npz": (PointCloud.read, ".npz", lambda path: np.savez_compressed(path, p=TABLE)),
    "cloud, binary ply": (PointCloud.read, ".ply", big_endian_ply),
    "points": (read_points_csv, ".csv", lambda path: path.write_text("x,y,z,v,amplitude\n1,2,3,4,5\n")),
    "suite": (load_suite, ".toml", lambda path: path.write_bytes(SUITE)),
    "grid npy": (read_grid, ".npy", lambda path: np.save(path, GRID)),
    "cube npy": (load_cube, ".npy", lambda path: np.save(path, CUBE)),
    "cube npz": (load_cube, ".npz", cube_npz(np.savez)),
    "cube npz, compressed": (load_cube, ".npz", cube_npz(np.savez_compressed)),
}
"""Reader, extension, and what writes a valid file. SciPy's reader of older mat files ends with some."""


PLACES, VALUES = st.floats(0, 1, exclude_max=True), st.integers(0, 2**32 - 1)
KINDS = st.sampled_from(["set", "flip", "cut", "drop", "repeat", "number"])
CHANGES = st.lists(st.tuples(KINDS, PLACES, VALUES), min_size=1, max_size=4)


def damaged(data, changes):
    """Bytes with changes in a few places."""
    data = bytearray(data)
    for kind, where, value in changes:
        at = int(where * len(data))
        match kind:
            case "set":
                data[at : at + 1] = [value % 256]
            case "flip":
                data[at : at + 1] = bytes(byte ^ (1 << value % 8) for byte in data[at : at + 1])
            case "cut":
                del data[at:]
            case "drop":
                del data[at : at + value % 9]
            case "repeat":
                data[at:at] = data[at : at + value % 99]
            case "number":
                data[at : at + 4] = value.to_bytes(4, "little")
    return bytes(data)


def read_or_refuse(bounded, reader, path):
    told = str(path)
    with bounded(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            reader(path)
        except InputError as error:
            told = str(error)
    assert str(path) in told


@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=CHANGES)
def test_a_damaged_file_is_read_or_refused(tmp_path, bounded, name, changes):
    reader, suffix, write = SEEDS[name]
    path, valid = tmp_path / f"damaged{suffix}", tmp_path / f"valid{suffix}"
    if not valid.exists():
        write(valid)
        reader(valid)
    path.write_bytes(damaged(valid.read_bytes(), changes))
    read_or_refuse(bounded, reader, path)


@pytest.mark.parametrize("name", SEEDS)
def test_a_file_that_ends_anywhere_is_read_or_refused(tmp_path, bounded, name):
    reader, suffix, write = SEEDS[name]
    path = tmp_path / f"cut{suffix}"
    write(path)
    data = path.read_bytes()
    for size in [*range(0, len(data), max(1, len(data) // 60)), len(data) - 1]:
        path.write_bytes(data[:size])
        read_or_refuse(bounded, reader, path)


@settings(max_examples=EXAMPLES, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes=CHANGES)
def test_a_damaged_scenario_is_read_or_refused(tiny, bounded, changes):
    path = tiny.with_name("damaged.toml")
    path.write_bytes(damaged(tiny.read_bytes(), changes))
    read_or_refuse(bounded, load_scenario, path)
