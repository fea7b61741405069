"""Files that can be read in parts are never held as a whole; libraries load with the first file of theirs."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np

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


def test_the_command_line_does_not_load_libraries_of_file_formats():
    code = (
        "import sys; from isacbench.cli import main; sys.argv = ['isacbench', '--help']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "import isacbench.cubes; print({'h5py', 'zarr', 'scipy.io'} & {*sys.modules}, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "set()"
