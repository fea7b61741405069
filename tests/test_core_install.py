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


def test_scenes_of_the_small_suites_are_imaged_and_a_file_that_takes_an_extra_names_it(tmp_path):
    names = [name for suite in ("population-quick", "quick") for name in load_suite(suite).scenarios]
    (tmp_path / "cube.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "cube.zarr").mkdir()
    command = [sys.executable, "-c", WITHOUT_EXTRAS + IMAGE + REFUSED, *names]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    imaged, *refused = done.stdout.splitlines()
    assert imaged == f"{len(names)} True"
    libraries = (("h5py", "cubes"), ("zarr", "cubes"), ("zarr", "cubes"), ("trimesh", "meshes"))
    for line, (library, extra) in zip(refused, libraries, strict=True):
        assert line.endswith(f"needs {library}: pip install 'isacbench[{extra}]'")
