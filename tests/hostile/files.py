"""Hostile files, each written by a function of its path: what a mistake or a stranger may leave on a disk."""

from __future__ import annotations

import json
import pickle
import struct
import zipfile
from pathlib import Path

import h5py
import numpy as np
import zarr
from scipy.io import savemat

from isacbench.cubes import open_cube

from ..cubes.samples import mat73

HUGE = 10**18
LIMIT_MIB = 16
"""Largest cloud and grid while these files are read: a sixteenth of what users have."""
BOMB_MIB = 18
TABLE = np.arange(12.0).reshape(3, 4)
CUBE = np.ones((4, 3, 2, 2), np.complex64)
GRID = np.ones((4, 3), np.complex64)


def load_cube(path):
    """Open a cube and load all of it: what is wrong with numbers is told when they are met."""
    with open_cube(path) as cube:
        for tile in cube.tiles(np.argwhere(np.ones(cube.shape[2:], dtype=bool))):
            tile.load()


class Trap:
    """What creates a file where it is unpickled."""

    def __init__(self, folder):
        self.bait = str(folder / "UNPICKLED")

    def __reduce__(self):
        return (open, (self.bait, "w"))


# Not of any format


def sparse(n_bytes):
    """So many bytes that take no room."""

    def write(path):
        with path.open("wb") as file:
            file.truncate(n_bytes)

    return write


def content(data):
    return lambda path: path.write_bytes(data)


ANY = {
    "a folder": Path.mkdir,
    "a link to nothing": lambda path: path.symlink_to(path.with_name("nothing")),
    "nothing in it": Path.touch,
    "a terabyte": sparse(2**40),
    "a page of zeros": sparse(4096),
    "pickled": lambda path: path.write_bytes(pickle.dumps(Trap(path.parent))),
    "UTF-16": content("x,y,z,v\n1,2,3,4\n".encode("utf-16")),
    "no text": content(bytes(range(256)) * 16),
    "zip signature": content(b"PK\x03\x04" + bytes(200)),
    "HDF5 signature": content(b"\x89HDF\r\n\x1a\n" + bytes(200)),
    "npy signature": content(b"\x93NUMPY\x01\x00"),
    "mat signature": content(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + bytes(200)),
}
"""What no reader of whatever format takes."""


# npy


def npy_of(header, data=b""):
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def npy_bytes(shape, descr="<f8", data=b""):
    """An npy file whose header says what it likes."""
    header = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape!r}}}\n"
    return npy_of(header.encode(), data)


def npy(*args, **options):
    return content(npy_bytes(*args, **options))


def saved(array):
    return lambda path: np.save(path, array)


NPY = {
    "1e18 rows": npy((HUGE, 4)),
    "1e18 cells": npy((HUGE, 1, 1, 1), "<c8"),
    "product beyond 64 bits": npy((2**40, 2**40, 2, 2), "<c8"),
    "negative cells": npy((-4, -3, 2, 2), "<c8", data=bytes(4000)),
    "one number short": npy((2, 4), data=bytes(63)),
    "a shape of text": npy("ab"),
    "a header of code": content(npy_of(b"__import__('os').mkdir('UNPICKLED')".ljust(40))),
    "a header of brackets": content(npy_of(b"(" * 1000)),
    "Python objects": lambda path: np.save(path, np.array([[Trap(path.parent)] * 4], dtype=object)),
    "Python objects by header": npy((2, 4), "|O", data=bytes(64)),
    "times": saved(np.zeros((2, 4), "datetime64[s]")),
    "records": saved(np.zeros(4, [("x", "f8"), ("y", "f8")])),
    "nothing a number": npy((HUGE, 4), "|V0"),
    "an unknown type": npy((2, 4), "<q9"),
}


# npz


def npz(members):
    """An npz file of members by name, their bytes given."""

    def write(path):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in members.items():
                archive.writestr(name, data)

    return write


def bomb(header, n_mib, names=("xyz.npy",)):
    """Zeros that take a thousandth of their size."""

    def write(path):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for name in names:
                with archive.open(name, "w", force_zip64=True) as member:
                    member.write(header)
                    for _ in range(n_mib):
                        member.write(bytes(2**20))

    return write


def pickled_npz(path):
    np.savez(path, xyz=np.array([[Trap(path.parent)] * 3], dtype=object), velocity=np.ones(1))


NPZ = {
    "pickled": pickled_npz,
    "1e18 rows": npz({"xyz.npy": npy_bytes((HUGE, 3)), "velocity.npy": npy_bytes((HUGE,))}),
    "a bomb of one": bomb(npy_bytes((BOMB_MIB * 2**20 // 24, 3)), BOMB_MIB),
    "a bomb of many": bomb(npy_bytes((2**16, 3)), 2, names=[f"a{index}.npy" for index in range(12)]),
    "a bomb of a header": bomb(b"\x93NUMPY\x02\x00" + struct.pack("<I", 10 * 2**20), 10),
    "no member": npz({}),
    "no array": npz({"xyz.npy": b"neither"}),
}


# mat


def mat_of(**arrays):
    return lambda path: savemat(path, arrays)


def unknown_filter73(file):
    """A chunk that went through a filter that nobody has."""
    unknown = {"compression": 32700, "allow_unknown_filter": True}
    dataset73(file, (3, 4), chunks=(3, 4), **unknown).id.write_direct_chunk((0, 0), bytes(100))


def dataset73(file, shape, **options):
    dataset = file.create_dataset("xyz", shape, "f8", **options)
    dataset.attrs["MATLAB_class"] = np.bytes_("double")
    return dataset


MAT = {
    "7.3, an unknown filter": mat73(unknown_filter73)[1],
    "7.3, 1e9 rows": mat73(lambda file: dataset73(file, (3, 10**9), chunks=(3, 10**6)))[1],
    "7.3, nothing written": mat73(lambda file: dataset73(file, (3, 10**6)))[1],
    "7.3, a structure": mat73(lambda file: file.create_group("xyz/velocity"))[1],
    "cells": mat_of(xyz=np.array([TABLE, "a"], dtype=object), velocity=TABLE[:, 3]),
}


# ply


def ply(count, body, form="ascii"):
    header = f"ply\nformat {form} 1.0\nelement vertex {count}\n"
    header += "".join(f"property double {name}\n" for name in "xyzv") + "end_header\n"
    return content(header.encode() + body)


PLY = {
    "1e18, ascii": ply(HUGE, b"1 2 3 4\n"),
    "1e18, binary": ply(HUGE, bytes(32), "binary_little_endian"),
    "negative": ply(-1, b"1 2 3 4\n"),
    "a header without end": content(b"ply\n" + b"comment\n" * 10**5),
}


# csv

CSV = {
    "100 000 columns": content(b"x," * 10**5 + b"\n"),
    "100 000 fields": content(b"x,y,z,v\n" + b"1," * 10**5 + b"\n"),
    "an open quote": content(b'x,y,z,v\n"1,2,3,4\n'),
    "an open quote in the header": content(b'"x,y,z,v\n1,2,3,4\n'),
    "zeros": content(b"x,y,z,v\n1,2,3,4\n\0\0\0\0"),
    "one long field": content(b"x,y,z,v\n1,2,3," + b"a" * 10**6 + b"\n"),
    "passwords": content(b"root:x:0:0:root:/root:/bin/bash\n"),
}

CLOUDS = {".csv": CSV, ".npy": NPY, ".npz": NPZ, ".mat": MAT, ".ply": PLY}
"""By extension: what `PointCloud.read` refuses beside `ANY`."""


# toml

TOML = {
    "arrays in arrays": content(b"name = " + b"[" * 100_000),
    "tables in tables": content(b"name = " + b"{a=" * 100_000),
    "a number of many digits": content(b"name = " + b"9" * 5000 + b"\n"),
    "twice": content(b'name = "a"\nname = "b"\n'),
}


# Cubes


def h5(change):
    def write(path):
        with h5py.File(path, "w") as file:
            change(file, path)

    return write


def virtual(file, path):
    layout = h5py.VirtualLayout(CUBE.shape, CUBE.dtype)
    layout[:] = h5py.VirtualSource(str(path.with_name("gone.h5")), "cube", CUBE.shape)
    file.create_virtual_dataset("cube", layout)


def linked(file, path):
    with h5py.File(path.with_name("other.h5"), "w") as other:
        other["cube"] = CUBE
    file["cube"] = h5py.ExternalLink("other.h5", "cube")
    file["again"] = h5py.SoftLink("/cube")


def unlimited(file, _path):
    file.create_dataset("cube", (HUGE, 1, 1, 1), "c8", chunks=(2**20, 1, 1, 1), maxshape=(None, 1, 1, 1))


def huge_grid(file, _path):
    file["cube"] = CUBE
    file.create_dataset("transmitted", (2**20, 2**20), "c8", chunks=(2**10, 2**10), compression="gzip")


H5 = {
    "numbers of others": h5(virtual),
    "a link to another file": h5(linked),
    "1e18 cells": h5(unlimited),
    "a huge grid": h5(huge_grid),
}


def zarr_store(change):
    def write(path):
        zarr.open_group(path, mode="w", zarr_format=2).create_array("cube", data=CUBE, chunks=CUBE.shape)
        change(path)

    return write


def with_metadata(**changes):
    def change(path):
        place = path / "cube" / ".zarray"
        place.write_text(json.dumps({**json.loads(place.read_text()), **changes}))

    return zarr_store(change)


def unpickling(place):
    """A chunk that is to be unpickled, in one of the places where a store can say so."""

    def write(path):
        with_metadata(**place)(path)
        (path / "cube" / "0.0.0.0").write_bytes(pickle.dumps(Trap(path.parent)))

    return write


ZARR = {
    "1e18 cells": with_metadata(shape=[HUGE, 1, 1, 1]),
    "negative cells": with_metadata(shape=[-4, -3, 2, 2]),
    "no chunks": with_metadata(chunks=[0, 0, 0, 0]),
    "deep metadata": zarr_store(lambda path: content(b"[" * 100_000)(path / "cube" / ".zarray")),
    "unpickling compressor": unpickling({"compressor": {"id": "pickle"}}),
    "unpickling filter": unpickling({"filters": [{"id": "pickle"}]}),
    "unpickling objects": unpickling({"dtype": "|O", "filters": [{"id": "pickle"}]}),
}


CUBES = {
    ".npy": NPY,
    ".npz": NPZ,
    ".mat": {
        **MAT,
        "cells of a cube": mat_of(cube=np.full((4, 3, 2, 2), {}), transmitted=np.full((4, 3), {})),
    },
    ".h5": H5,
    ".zarr": ZARR,
    ".zip": {},
}
"""By extension: what `open_cube` refuses beside `ANY`."""
