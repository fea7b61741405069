"""Faulty files of points, cubes and transmitted grids, and the words in which each is refused.

A file is its suffix and what writes it. Rules on names and shapes are the same in all formats that name their
arrays: a row takes the format in which its fault is most likely.
"""

from __future__ import annotations

import zipfile

import h5py
import numpy as np
from scipy.sparse import csc_array

from isacbench.cubes import open_cube, read_grid
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.point_files import read_points_csv

from ..cubes.samples import SHAPE, h5, mat, mat73, npz, random_cube, write_zarr, zarr_of

# Points in text

TAKES = "a cloud takes x, y, z and, if there, v (or velocity) and power; it has"
NO_VELOCITY = "allowed is the name velocity for m/s, positive when approaching, or nothing like it"
NO_POWER = "allowed is the name power for powers relative to a unit scatterer, or nothing like it"
FIELDS = "allowed are as many in all rows and in the header, and rows without their numbers (pandas: index="
NUMBERED = "may number the columns or the rows; allowed is a header x, y, z ... and rows without their num"
NUMBER = "expected a number, with a decimal point (or commas in all, where none separates fields)"

CSV = {
    " \n\n": "is empty; at least the header x,y,z is required",
    "# x,y,z\n": "is empty; at least the header",
    "x,y,z,v,amplitude\n1,2,3,4,5\n": f"has no power, but amplitude; {NO_POWER} for points of power 1",
    "\nx,y,z,speed\n1,2,3,4\n": f"has no velocity, but speed; {NO_VELOCITY} for unknown velocities",
    "x,y,z,v [m/s]\n": "has no velocity, but v [m/s]; ",
    "x,y,v,power\n": f"row 1: z is missing; {TAKES} x, y, v, power",
    "x,y,z,v,velocity\n": f"row 1: v appears twice; {TAKES} x, y, z, v, velocity",
    "x,y,z,u,v\n": f"row 1: v beside u is of a texture; {TAKES} x, y, z, u, v",
    "V1,V2,V3,V4\n1,2,3,4\n": f"row 1: x is missing; {TAKES} V1, V2, V3, V4",
    "x,y,z,v\n1,2,3,4\n1,2,3,nan\n": "row 3: column v is nan; expected a finite number",
    "x,y,z,v\n\n1,-inf,3,4\n": "row 3: column y is -inf; expected a finite number",
    "x,y,z,v\n1,2,3\n": f"row 2: 3 fields instead of 4; {FIELDS}",
    "x y z v\n1 2 3\n": f"row 2: 3 fields instead of 4; {FIELDS}",
    "x,y,z,v\n1,2,3,4,\n": "row 2: 5 fields instead of 4",
    "x,y,z,v\n2,2,3,4,5\n": f"row 2: 5 fields instead of 4; {FIELDS}",
    '"x","y","z"\n"1.5","2.5","3.5","4.5"\n': f"row 2: 4 fields instead of 3; {FIELDS}",
    "x y z\n3 1 2 3\n9 4 5 6\n": f"row 2: 4 fields instead of 3; {FIELDS}",
    "x,y,z\n#N/A,5,6\n": f"row 2: column x is '#N/A'; {NUMBER}",
    "x,y,z\n1,2,3\n# end\n": "row 3: 1 fields instead of 3",
    "x,y,z,v\n1,2,3,NA\n": f"row 2: column v is 'NA'; {NUMBER}",
    "x;y;z;v\n1,5;2;3.5;4\n": "row 2: column z is '3.5'; expected a number",
    "x;y;z;v\n1.234,5;2;3;4\n": "row 2: column x is '1.234,5'; expected a number",
    "x\ty\tz\n1,5\t2\t3.5\n": "row 2: column z is '3.5'; expected a number",
    "x\ty\tz\n1,234\t2\t5,678\n": "commas may be decimal or set thousands apart; allowed are decimal points",
    "x y z\n1 ,2 ,3\n": "row 2: column y is ',2'; expected a number",
    "1,5 2,5 3,5\n": "row 1: column y is '5 2'; expected a number",
    "x,y,z,v\n1,2,1_0,4\n": "row 2: column z is '1_0'; expected a number",
    "x,y,z,v\n1,2,3,４\n": "row 2: column v is '４'; expected a number",
    "1,2,0x1p3,4\n": "row 1: column z is '0x1p3'; expected a number",
    "1,2\n": "row 1: 2 fields; without a header a cloud takes 3, 4 or 5 (x, y, z, v, power), in rows without",
    "0,1,2,3,4,5.5\n": "row 1: 6 fields; without a header a cloud takes 3, 4 or 5",
    # What can be read in two ways
    "0,1.5,2,3\n1,4,5,6\n": NUMBERED,
    "1 1.5 2 3\n2 4 5 6\n": NUMBERED,
    "9,1.5,2,3\n4,4,5,6\n": NUMBERED,
    "0,1,2,3\n7,4,5,6\n": NUMBERED,
    "# columns: v x y z\n7,4,5,6\n": "the comment 'columns: v x y z' may name the 4 columns; ",
}

SCATTERERS = "takes the columns x, y, z, v and optionally amplitude and object, not"
POINTS = {
    "x,y,z,v\n": "holds no points below its header",
    "x,y,z\n1,2,3\n": f"row 1: {SCATTERERS} x, y, z",
    "x,y,z,v,power\n1,2,3,4,5\n": f"row 1: {SCATTERERS} x, y, z, v, power",
    "x,y,z,v,velocity\n1,2,3,4,5\n": f"row 1: {SCATTERERS} x, y, z, v, velocity",
    "1,2,3,4\n": f"row 1: {SCATTERERS} rows without a header",
}

HEAD = "ply\nformat ascii 1.0\nelement vertex 2\n"
PROPERTIES = "property float x\nproperty float y\nproperty float z\nproperty float v\n"
ROWS = HEAD + PROPERTIES + "end_header\n1 2 3 4\n"
WITH_RCS = HEAD + PROPERTIES + "property float scalar_rcs\nend_header\n"
NO_PLY = "is no PLY file, which starts with 'ply' and has a line 'end_header'"
NO_VERTEX = "takes a line 'format' and the first element 'vertex'; its elements:"
PLY = {
    "x,y,z,v\n": NO_PLY,
    HEAD + PROPERTIES: NO_PLY,
    "ply\nelement vertex 0\nend_header\n": f"{NO_VERTEX} vertex",
    "ply\nformat ascii 1.0\nend_header\n": f"{NO_VERTEX} none",
    "ply\nformat ascii 1.0\nelement a 1\nelement vertex 2\nend_header\n": f"{NO_VERTEX} a, vertex",
    "ply\nformat ascii 2.0\nend_header\n": "row 2: 'format ascii 2.0' does not belong in a PLY 1.0 header",
    HEAD + "property half x\nend_header\n": "row 4: 'property half x' does not belong in a PLY 1.0 header",
    HEAD + "property float x\nproperty float y\nend_header\n": f"element vertex: z is missing; {TAKES} x, y",
    HEAD + "end_header\n": f"element vertex: x is missing; {TAKES} none",
    HEAD + PROPERTIES + "property float velocity\nend_header\n": "element vertex: v appears twice",
    HEAD + PROPERTIES + "property list uchar int ids\nend_header\n": "has a list property; only plain ones",
    WITH_RCS + "1 2 3 4 5\n1 2 3 4 5\n": f"has no power, but scalar_rcs; {NO_POWER}",
    HEAD + "property float u\n" + PROPERTIES + "end_header\n": "v beside u is of a texture",
    ROWS: "is truncated: 1 of 2 vertices",
    ROWS + "1 2 3\n": "row 10: 3 fields instead of 4",
    ROWS + "1 2 x 3\n": "row 10: column z is 'x'; expected a number",
    ROWS + "1 2 3 4\n\n1 2 3 4\n": "row 12: is one too many; the header allows 2",
}


# Points in arrays

TABLE = np.array([[1.0, 2, 3, 4, 0.5], [-0.1, 1 / 3, 1e-7, -3, 2.25]])
XYZ, VELOCITY, POWER = TABLE[:, :3], TABLE[:, 3], TABLE[:, 4]
PARTS = {"xyz": XYZ, "velocity": VELOCITY}
SPEEDS = "Velocity", "doppler", "vel"
POWERS = "Power", "rcs", "RCS_dBsm", "echo_power", "amplitude", "Intensity", "snr_db", "sigma", "pwr", "RCSdB"
ARRAYS = (
    "takes real numbers: xyz (n, 3), optionally velocity (n) and power (n), or exactly one "
    "array of shape (n, 4) or (n, 5), or else (n, 3), and none larger; it holds"
)
ONE_EACH = "takes 2 real numbers, one a row of xyz, not"

NPY = [
    (np.zeros((2, 6)), f"{ARRAYS} (float64 of shape (2, 6))"),
    (np.array([["a"] * 4]), f"{ARRAYS} (<U1 of shape (1, 4))"),
    (np.array([[0, 0, 0, 0], [0, 0, np.nan, 0]]), "row 2: column z is nan; expected a finite number"),
    (np.array([[0, 0, 0, 0, -np.inf]]), "row 1: column power is -inf; expected a finite number"),
]

NAMED = [
    *(({**PARTS, name: POWER}, f"has no power, but {name}; {NO_POWER}") for name in POWERS),
    *(({"cloud": TABLE[:, :4], name: POWER}, f"has no power, but {name}; {NO_POWER}") for name in POWERS),
    *(({"xyz": XYZ, name: VELOCITY}, f"has no velocity, but {name}; {NO_VELOCITY}") for name in SPEEDS),
    *(({"points": XYZ, name: VELOCITY}, f"has no velocity, but {name}; {NO_VELOCITY}") for name in SPEEDS),
    ({"pose": np.eye(4), "points": np.ones((50, 3)), "doppler": np.ones(50)}, ARRAYS),
    ({"pose": np.eye(4), **{name: np.ones(50) for name in "xyzv"}}, ARRAYS),
    ({"pose": np.eye(4), "points": np.ones((5, 3))}, f"{ARRAYS} pose (float64 of shape (4, 4)), points ("),
    ({"estimate": TABLE, "truth": TABLE}, f"{ARRAYS} estimate (float64 of shape (2, 5)), truth ("),
    ({"points": np.zeros((2, 6))}, f"{ARRAYS} points (float64 of shape (2, 6))"),
    ({"rotation": np.eye(3)}, f"{ARRAYS} rotation (float64 of shape (3, 3))"),
    ({"normals": XYZ, "points": XYZ}, f"{ARRAYS} normals (float64 of shape (2, 3)), points ("),
    ({}, f"{ARRAYS} nothing"),
    ({"velocity": VELOCITY}, "xyz takes real numbers of shape (n, 3), not nothing"),
    ({"xyz": TABLE}, "xyz takes real numbers of shape (n, 3), not float64 of shape (2, 5)"),
    ({"xyz": XYZ, "velocity": np.zeros((1, 3))}, f"velocity {ONE_EACH} float64 of shape (1, 3)"),
    ({**PARTS, "power": np.zeros((1, 2), complex)}, f"power {ONE_EACH} complex128 of shape (1, 2)"),
    ({"xyz": XYZ, "velocity": [0, np.nan]}, "row 2: column v is nan; expected a finite number"),
]


def cell73(file):
    file.create_dataset("cell", (2, 1), h5py.ref_dtype).attrs["MATLAB_class"] = np.bytes_("cell")


MAT = [
    (mat(truth={"points": np.ones((50, 4))}, estimate=TABLE), f"{ARRAYS} estimate (float64 of shape (2, 5))"),
    (mat(**PARTS, power=csc_array(TABLE[:, 4:])), "power takes 2 real numbers"),
    (mat(**PARTS, power={"linear": POWER}), "has no power, but power/linear"),
    (
        mat73(cell73, label=np.array("street"), phases=np.ones((2, 4), complex)),
        f"{ARRAYS} cell (cell), label (char), phases (complex128 of shape (2, 4))",
    ),
]


# Cubes

N, M = SHAPE[:2]
QPSK = np.exp(0.5j * np.pi * np.random.default_rng(1).integers(4, size=(N, M)))
CUBE = random_cube(dtype=np.complex128) * QPSK[:, :, None, None]
CELL = np.empty((1, 1), object)
CELL[0, 0] = QPSK
RECORDS = QPSK.view([("re", "f8"), ("im", "f8")])


def npy(array):
    return ".npy", lambda path: np.save(path, array, allow_pickle=True)


def updated(**members):
    return h5(lambda file: file.update(members), cube=CUBE)


NEEDS_GRID = "needs an array named 'transmitted'; it holds "
WHICH_GRID = ", which may be the transmitted grid; allowed is one array named 'transmitted'"

NOT_THE_GRID = [
    (mat(cube=CUBE, transmitted=csc_array(QPSK)), f"{NEEDS_GRID}transmitted (sparse matrix)"),
    (mat(cube=CUBE, transmitted=CELL), f"{NEEDS_GRID}transmitted (cell)"),
    (mat(cube=CUBE, transmitted="grid.mat"), f"{NEEDS_GRID}transmitted (char)"),
    (mat(cube=CUBE, transmitted=np.zeros((2, 1), [("grid", object)])), f"{NEEDS_GRID}transmitted (struct"),
    (mat(cube=CUBE, transmitted={"re": QPSK.real, "im": QPSK.imag}), f"{NEEDS_GRID}transmitted/re (float64"),
    (mat73(cube=CUBE, transmitted=np.array("grid.mat")), f"{NEEDS_GRID}transmitted (char)"),
    (npz(cube=CUBE, transmitted=QPSK.astype(object)), "transmitted: holds object; a transmitted grid takes"),
    (npz(cube=CUBE, transmitted=QPSK, Transmitted=QPSK), f"{NEEDS_GRID}transmitted (complex128"),
    (h5(cube=CUBE, **{"a/transmitted": QPSK, "b/transmitted": QPSK}), f"{NEEDS_GRID}a/transmitted (complex"),
    (updated(transmitted=h5py.SoftLink("/gone")), f"{NEEDS_GRID}transmitted (link)"),
    (updated(transmitted=h5py.ExternalLink("grid.h5", "/x")), f"{NEEDS_GRID}transmitted (link)"),
]

MAY_BE_THE_GRID = [
    npz(cube=CUBE, tx=QPSK),
    mat(cube=CUBE, setup={"tx": QPSK}),
    h5(cube=CUBE, **{"tx/grid": QPSK}),
    zarr_of(cube=CUBE, grid=QPSK),
    npz(cube=CUBE, symbols=np.stack([QPSK, QPSK], axis=-1)),
    npz(cube=CUBE, symbols=QPSK.T),
    npz(cube=CUBE, symbols=QPSK.ravel()),
    npz(cube=CUBE, symbols=RECORDS),
    npz(cube=CUBE, re=QPSK.real, im=QPSK.imag),
    npz(cube=CUBE, used=np.ones((N, M), bool)),
    npz(cube=CUBE, transmitted=QPSK.real, transmitted_im=QPSK.imag),
    npz(cube=CUBE, bpsk=np.ones(N * M)),
    npz(cube=CUBE, transmitted_preamble=np.sign(QPSK[:, 0].real)),
    npz(echo=CUBE, t=QPSK),
    *(kind(cube=CUBE[:, :1], symbols=QPSK[:, :1]) for kind in (npz, mat, mat73, h5)),
]

MAY_BE_OTHER_GRIDS = [
    npz(tx=QPSK.ravel(), mask=np.ones((N, M))),
    npz(re=QPSK.real, im=QPSK.imag.ravel()),
    npz(tx=np.stack([QPSK, QPSK]), used=np.ones((N, M))),
]

MAY_BE_THE_CUBE = [
    npz(cube=CUBE, Cube=CUBE),
    h5(**{"first/cube": CUBE, "second/cube": CUBE}),
    mat(cube=CELL, echo=CUBE),
    h5(lambda file: file.update(cube=h5py.SoftLink("/echo")), echo=CUBE),
    npz(cube_re=CUBE.real, cube_im=CUBE.imag),
    h5(**{"cube/re": CUBE.real, "cube/im": CUBE.imag}),
    h5(calibration=np.ones_like(CUBE), **{"rx/data": CUBE}),
]

NO_CUBE = [
    (CUBE.real.astype(np.float32), "holds float32; a cube takes complex64 or complex128"),
    (np.ones(SHAPE, ">i2"), "holds int16; a cube takes complex64 or complex128"),
    (np.ones(SHAPE, np.clongdouble), "holds complex256; a cube takes complex64 or complex128"),
    (CUBE[0], "has shape (10, 3, 4); a cube takes four axes, none empty: (subcarriers, symbols, P, Q)"),
    (CUBE[:, :0], "has shape (24, 0, 3, 4); a cube takes four axes, none empty"),
]

GRID_TAKES = "a transmitted grid takes"
NO_GRID = [
    (QPSK.astype(str), f"{GRID_TAKES} complex64, complex128 or real numbers"),
    (RECORDS, f"{GRID_TAKES} complex64, complex128 or real numbers"),
    (1.0, f"has shape (); {GRID_TAKES} two axes: (subcarriers, symbols)"),
    (QPSK.ravel(), f"has shape (240,); {GRID_TAKES} two axes: (subcarriers, symbols)"),
    (QPSK[:, :, None], f"has shape (24, 10, 1); {GRID_TAKES} two axes"),
    (np.empty((0, M)), f"has shape (0, 10); {GRID_TAKES} two axes"),
]
OTHER_SHAPE = "allowed is (24, 10), subcarriers by symbols as in the cube"


def not_filled(**options):
    def change(file):
        file.create_dataset("cube", SHAPE, np.complex64, **options)[:12] = 1

    return h5(change)


def without_chunk(chunk, **options):
    def write(path):
        write_zarr(path, cube=CUBE, chunks=(10, 10, 2, 1), **options)
        (path / chunk).unlink()

    return ".zarr", write


def short_npy(path):
    """An array that has fewer bytes than its header says."""
    np.save(path, CUBE)
    path.write_bytes(path.read_bytes()[:-1])


def short_member(method):
    """An archive of such an array."""

    def write(path):
        short_npy(path.with_name("cube.npy"))
        with zipfile.ZipFile(path, "w", method) as archive:
            archive.write(path.with_name("cube.npy"), "cube.npy")

    return ".npz", write


SHORT = f"cube: is truncated: has less than complex128 of shape {SHAPE}"
LACKS = "cube: lacks 1 of 24 chunks; if they hold zeros, "

DAMAGED = [
    ((".npy", short_npy), "cannot be read as npy: mmap length is greater than file"),
    *((short_member(method), SHORT) for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)),
    (h5(lambda file: file.create_dataset("cube", SHAPE, "c8")), "not complete: the file has 0 of 1 chunks"),
    (not_filled(chunks=(12, 10, 3, 2)), "cube: is not complete: the file has 2 of 4 chunks"),
    (without_chunk("cube/1.0.1.3", zarr_format=2), LACKS),
    (without_chunk("cube/c/1/0/1/3"), LACKS),
    ((".zip", lambda path: path.write_text("junk")), "not a zip file"),
    (npz(cube=CUBE.real, cube_im=CUBE.imag), "cube: holds float64; a cube takes complex64"),
]


def text(suffix, content):
    return suffix, lambda path: path.write_text(content, encoding="utf-8")


FAULTS = [
    *((PointCloud.read, text(".csv", content), words) for content, words in CSV.items()),
    *((PointCloud.read, text(".ply", content), words) for content, words in PLY.items()),
    *((read_points_csv, text(".csv", content), words) for content, words in POINTS.items()),
    *((PointCloud.read, npy(array), words) for array, words in NPY),
    *((PointCloud.read, kind(**named), words) for named, words in NAMED for kind in (npz, mat, mat73)),
    *((PointCloud.read, file, words) for file, words in MAT),
    *((opening, *row) for row in NOT_THE_GRID for opening in (open_cube, read_grid)),
    *((open_cube, file, WHICH_GRID) for file in MAY_BE_THE_GRID),
    *((read_grid, file, WHICH_GRID) for file in MAY_BE_OTHER_GRIDS),
    *((open_cube, file, "needs an array named 'cube'") for file in MAY_BE_THE_CUBE),
    *((open_cube, npy(array), words) for array, words in NO_CUBE),
    *((open_cube, npz(cube=array), "cube: " + words) for array, words in NO_CUBE),
    *((read_grid, npy(grid), words) for grid, words in NO_GRID),
    *((open_cube, npz(cube=CUBE, transmitted=grid), words) for grid, words in NO_GRID),
    *((open_cube, kind(cube=CUBE, transmitted=QPSK[:, 1:]), OTHER_SHAPE) for kind in (npz, mat, mat73, h5)),
    (open_cube, npz(cube=CUBE, transmitted=QPSK.T), OTHER_SHAPE),
    *((open_cube, file, words) for file, words in DAMAGED),
]
"""Reader, file, and words of the error."""
