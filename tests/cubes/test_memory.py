"""Files that can be read in parts are never held as a whole; libraries load with the first file of theirs."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from .samples import write_h5, write_mat73, write_npy

SHAPE = (2048, 128, 4, 4)
FILE_MB = 33
ALLOWED_MB = 25
TILE_BYTES = 2**21

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

def sum_of(path, elements, tile_bytes):
    with open_cube(path, tile_bytes=tile_bytes) as cube:
        return sum(complex(tile.load().sum(dtype=np.complex128)) for tile in cube.tiles(elements))

everything = np.argwhere(np.ones((4, 4)))
cross = everything[(everything == 0).any(axis=1)]
tile_bytes, *paths = json.loads(sys.argv[1])
"""

READ = (
    PROBE
    + """
found = {}
for path in paths:
    sum_of(path, cross[:1], 2**16)  # What the libraries take themselves.
    before = peak_mb()
    sums = sum_of(path, everything, tile_bytes), sum_of(path, cross, tile_bytes)
    found[Path(path).name] = [[value.real for value in sums], peak_mb() - before]
print(json.dumps(found))
"""
)

WRITE = (
    PROBE
    + """
def write(path, n):
    shape = n, 128, 4, 4
    write_cube(path, shape, (np.ones((64, *shape[1:]), np.complex64) for _ in range(n // 64)))

found = {}
for path in paths:
    write(Path(path).with_stem("small"), 128)
    before = peak_mb()
    write(path, 2048)
    found[Path(path).name] = peak_mb() - before
print(json.dumps(found))
"""
)


def answer(code, *paths):
    """What a process of its own prints of some paths."""
    arguments = json.dumps([TILE_BYTES, *map(str, paths)])
    done = subprocess.run([sys.executable, "-c", code, arguments], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("large")


def test_cubes_are_written_in_bounded_memory(folder):
    grown_mb = answer(WRITE, *(folder / name for name in ("written.npy", "written.zarr")))
    assert max(grown_mb.values()) < ALLOWED_MB, grown_mb
    assert (folder / "written.npy").stat().st_size > 1e6 * FILE_MB


def test_files_are_read_in_bounded_memory(folder):
    ones = np.ones(SHAPE, np.complex64)
    write_npy(folder / "c.npy", cube=ones)
    write_npy(folder / "fortran.npy", cube=np.ones(SHAPE, np.complex64, order="F"))
    write_mat73(folder / "matlab.mat", cube=ones)
    write_h5(folder / "compressed.h5", cube=ones, compressed=True)
    found = answer(READ, *sorted(folder.glob("[!s]*.*")))
    assert len(found) == 6
    assert {tuple(sums) for sums, _ in found.values()} == {(2048 * 128 * 16, 2048 * 128 * 7)}
    grown_mb = {name: grown for name, (_, grown) in found.items()}
    assert max(grown_mb.values()) < ALLOWED_MB, grown_mb


def test_the_command_line_does_not_load_libraries_of_file_formats():
    code = (
        "import sys; from isacbench.cli import main; sys.argv = ['isacbench', '--help']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "import isacbench.cubes; print({'h5py', 'zarr', 'scipy.io'} & {*sys.modules}, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "set()"
