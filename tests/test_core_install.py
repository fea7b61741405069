"""What an installation without extras does: built-in suites run, and one line names a missing extra."""

import subprocess
import sys

from isacbench.bench.suites.suite_kinds import load_suite

WITHOUT_EXTRAS = """
import sys
for name in ("trimesh", "h5py", "zarr", "dask", "distributed", "hypothesis"):
    sys.modules[name] = None  # as if it was not installed
from isacbench import get_estimator, load_scenario, observe, score
from isacbench.checking import stress
"""

IMAGE = """
from isacbench.model.cloud import PointCloud
scenes = [load_scenario(name) for name in sys.argv[1:]]
get_estimator("fft4d").estimate(observe(scenes[0], 10)).write("cloud.ply")
print(len(scenes), score(scenes[0], PointCloud.read("cloud.ply"))["n_estimated"] > 0)
"""

REFUSED = """
from isacbench.cubes import open_cube, write_cube
for take in (
    lambda: open_cube("cube.h5"),
    lambda: open_cube("cube.zarr"),
    lambda: write_cube("new.zarr", (1, 1, 1, 1), []),
    lambda: load_scenario("mesh-street"),
):
    try:
        take()
    except ValueError as error:
        print(error)
"""


def said_without_extras(folder, code, *arguments):
    """Lines that code prints in a process that finds no extra."""
    command = [sys.executable, "-c", WITHOUT_EXTRAS + code, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_all_scenes_of_the_small_suites_are_made_and_imaged(tmp_path):
    names = [name for suite in ("population-quick", "quick") for name in load_suite(suite).scenarios]
    assert said_without_extras(tmp_path, IMAGE, *names) == [f"{len(names)} True"]


def test_a_file_that_takes_an_extra_names_it(tmp_path):
    (tmp_path / "cube.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "cube.zarr").mkdir()
    lines = said_without_extras(tmp_path, REFUSED)
    libraries = (("h5py", "cubes"), ("zarr", "cubes"), ("zarr", "cubes"), ("trimesh", "meshes"))
    assert len(lines) == len(libraries)
    for line, (library, extra) in zip(lines, libraries, strict=True):
        assert line.endswith(f"needs {library}: pip install 'isacbench[{extra}]'")
