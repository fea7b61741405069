"""Files that can be read in parts are never held as a whole."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d

from isacbench import load_scenario, observe, observe_cube
from isacbench.cubes.writing import FrameSimulator, write_cube

from .samples import write_h5, write_mat73, write_npy

ALLOWED_MB = 25
"""Of 33 MB that each file has."""

PROBE = """
import json, resource, sys
from pathlib import Path
import numpy as np
from isacbench.cubes import open_cube, write_cube

def peak_mb():
    try:
        status = open("/proc/self/status").read()
    except FileNotFoundError:
        unit = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e6

def write(path, n):
    shape = n, 128, 4, 4
    write_cube(path, shape, (np.ones((64, *shape[1:]), np.complex64) for _ in range(n // 64)))

def sum_of(path, elements, tile_bytes):
    with open_cube(path, tile_bytes=tile_bytes) as cube:
        return sum(complex(tile.load().sum(dtype=np.complex128)) for tile in cube.tiles(elements)).real

everything = np.argwhere(np.ones((4, 4)))
cross = everything[(everything == 0).any(axis=1)]
grown = {}
for path in map(Path, sys.argv[1:]):
    is_new = not path.exists()
    if is_new:
        write(path.with_stem("small"), 128)  # What the libraries take themselves.
    else:
        sum_of(path, cross[:1], 2**16)
    before = peak_mb()
    if is_new:
        write(path, 2048)
    assert sum_of(path, everything, 2**21) == 2048 * 128 * 16
    assert sum_of(path, cross, 2**21) == 2048 * 128 * 7
    grown[path.name] = peak_mb() - before
print(json.dumps(grown))
"""


def test_files_are_written_and_read_in_bounded_memory(tmp_path):
    ones = np.ones((2048, 128, 4, 4), np.complex64)
    write_npy(tmp_path / "c.npy", cube=ones)
    write_npy(tmp_path / "fortran.npy", cube=np.asfortranarray(ones))
    write_mat73(tmp_path / "matlab.mat", cube=ones)
    write_h5(tmp_path / "compressed.h5", cube=ones, compressed=True)
    paths = [*sorted(tmp_path.iterdir()), tmp_path / "written.npy", tmp_path / "written.zarr"]
    done = subprocess.run([sys.executable, "-c", PROBE, *paths], capture_output=True, text=True, check=True)
    grown_mb = json.loads(done.stdout)
    assert len(grown_mb) == 6
    assert max(grown_mb.values()) < ALLOWED_MB, grown_mb


# A frame at the paper's size

MOST_MIB = 512
"""Of 896 MiB that the frame has: interpreter and libraries take about 150."""

FRESH_PROCESS = """
import json, sys
from isacbench import get_estimator, load_scenario, observe_cube
cloud = get_estimator("music2d").estimate(observe_cube(sys.argv[1], load_scenario("street")))
# Of this process alone: the usage of resources begins with what its parent had.
peak_kib = int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
print(json.dumps({"points": cloud.to_array().tolist(), "peak_mib": peak_kib / 1024}))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="asks /proc for the peak of memory")
@pytest.mark.parametrize("suffix", [".npy", ".zarr"])
def test_a_frame_is_imaged_without_being_held_with_the_image_of_the_closed_form(tmp_path, suffix):
    street, path = load_scenario("street"), tmp_path / f"frame{suffix}"
    simulator = FrameSimulator(street, 10.0)
    write_cube(path, simulator.shape, simulator.blocks())
    made = subprocess.run(
        [sys.executable, "-c", FRESH_PROCESS, str(path)], capture_output=True, text=True, check=True
    )
    found = json.loads(made.stdout)
    assert found["peak_mib"] < MOST_MIB
    for estimator in (Music2d(), Music2d(integration="element"), Fft4d()):
        expected = estimator.estimate(observe(street, 10.0)).to_array()
        cloud = estimator.estimate(observe_cube(path, street)).to_array()
        assert cloud.shape == expected.shape
        assert (np.abs(cloud - expected).max(axis=0) < 1e-6 * np.abs(expected).max(axis=0)).all()
        if estimator == Music2d():
            np.testing.assert_allclose(found["points"], expected, rtol=1e-5, atol=1e-4)
