"""Cubes of a few numbers, files of arrays in every format, and what a cube must give back."""

from __future__ import annotations

from functools import partial

import h5py
import numpy as np
import zarr
from scipy.io import savemat

SHAPE = (24, 10, 3, 4)
SMALL_TILE_BYTES = 2048


def random_cube(shape=SHAPE, dtype=np.complex64, order="C", seed=0):
    parts = np.random.default_rng(seed).standard_normal((2, *shape))
    return np.asarray(parts[0] + 1j * parts[1], dtype=dtype, order=order)


def all_elements(shape=SHAPE):
    return np.argwhere(np.ones(shape[2:], dtype=bool))


def cross_elements(shape=SHAPE):
    return np.array([*((p, 0) for p in range(shape[2])), *((0, q) for q in range(1, shape[3]))])


def of_elements(array, elements):
    """What the tiles of some elements must add up to."""
    return array[:, :, elements[:, 0], elements[:, 1]]


def sum_of_tiles(cube, elements):
    """The cube (N, M, e) that its tiles make, in whatever order they are loaded."""
    total = np.zeros((*cube.shape[:2], len(elements)), cube.dtype)
    for tile in cube.tiles(elements):
        values = tile.load()
        assert values.dtype == cube.dtype
        assert values.dtype.isnative
        total[tile.subcarriers, tile.symbols][:, :, tile.elements] += values
    return total


def assert_gives(cube, array):
    """Hold a cube to its array: all elements, one row and column, one element, a list out of order."""
    assert cube.shape == array.shape
    assert cube.dtype == array.dtype.newbyteorder("=")
    shape = array.shape
    corner = np.array([[shape[2] - 1, shape[3] - 1]])
    for elements in (all_elements(shape), cross_elements(shape), corner, all_elements(shape)[::-2]):
        assert np.array_equal(sum_of_tiles(cube, elements), of_elements(array, elements))


# Files. Each writer takes a path and the arrays by their names.


def write_npy(path, *, cube, compressed=False):
    np.save(path, cube)


def write_npz(path, *, compressed=False, **arrays):
    (np.savez_compressed if compressed else np.savez)(path, **arrays)


def write_mat(path, *, compressed=False, **arrays):
    savemat(path, arrays, do_compression=compressed)


def write_mat73(path, *, change=None, compressed=False, **arrays):
    """Write as MATLAB does: its header before the file, axes in reverse, classes, records of two fields."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            put_mat73(file, name, np.asarray(array), compressed)
        put_mat73(file, "#refs#/a", np.zeros((1, 1, 1, 1), np.complex64))
        if change is not None:
            change(file)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    with path.open("r+b") as file:
        file.write(header)


def put_mat73(group, name, array, compressed=False, kind=None):
    """Put an array of numbers, a text or an array without elements where MATLAB's variables are."""
    classes = {"U": "char", "f4": "single", "f8": "double", "c8": "single", "c16": "double"}
    code = "U" if array.dtype.kind == "U" else array.dtype.str[1:]
    if code == "U":
        array = np.array([[*map(ord, array.item())]], np.uint16)
    values = np.ascontiguousarray(np.atleast_2d(array.T))
    if array.dtype.kind == "c":
        part = values.real.dtype
        values = values.astype(array.dtype.newbyteorder("=")).view([("real", part), ("imag", part)])
    if not array.size:
        values = np.array(array.shape, np.uint64)
    options = {"chunks": True, "compression": "gzip"} if compressed else {}
    attributes = group.create_dataset(name, data=values, **options).attrs
    attributes["MATLAB_class"] = np.bytes_(kind or classes.get(code, array.dtype.name))
    if not array.size:
        attributes["MATLAB_empty"] = np.uint8(1)


def write_h5(path, *, change=None, compressed=False, **arrays):
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array, compression="gzip" if compressed else None)
        if change is not None:
            change(file)


def write_chunked_h5(path, *, cube, compressed=False):
    with h5py.File(path, "w") as file:
        file.create_dataset("cube", data=cube, chunks=(5, 3, 2, 2), shuffle=compressed)


def write_records_h5(path, *, cube, compressed=False):
    part = cube.real.dtype
    records = np.ascontiguousarray(cube).view([("real", part), ("imag", part)])
    write_h5(path, compressed=compressed, cube=records)


def write_zarr(path, *, compressed=False, zarr_format=3, chunks=None, **arrays):
    group = zarr.open_group(path, mode="w", zarr_format=zarr_format)
    compressors = "auto" if compressed else None
    for name, array in arrays.items():
        group.create_array(name, data=array, chunks=chunks or array.shape, compressors=compressors)


def write_zarr2(path, *, cube, compressed=False):
    write_zarr(path, cube=cube, compressed=compressed, zarr_format=2, chunks=(10, 10, 2, 1))


def write_lone_zarr(path, *, cube, compressed=False):
    zarr.create_array(path, data=cube, chunks=(7, 4, 3, 4), compressors="auto" if compressed else None)


def write_sharded_zarr(path, *, cube, compressed=False):
    zarr.create_array(path, data=cube, chunks=(8, 10, 1, 2), shards=(16, 10, 3, 4))


def write_zipped_zarr(path, *, compressed=False, **arrays):
    with zarr.storage.ZipStore(path, mode="w") as store:
        write_zarr(store, compressed=compressed, **arrays)


FORMATS = {
    "npy": (write_npy, "cube.npy"),
    "npz": (write_npz, "cube.npz"),
    "mat": (write_mat, "cube.mat"),
    "mat 7.3": (write_mat73, "cube.mat"),
    "h5": (write_h5, "cube.h5"),
    "chunked h5": (write_chunked_h5, "cube.HDF5"),
    "h5 of records": (write_records_h5, "cube.h5"),
    "zarr": (write_zarr, "cube.zarr"),
    "zarr 2": (write_zarr2, "cube.zarr"),
    "lone zarr": (write_lone_zarr, "cube.zarr"),
    "sharded zarr": (write_sharded_zarr, "cube.zarr"),
    "zipped zarr": (write_zipped_zarr, "cube.zarr.zip"),
}
"""How a cube is written, and the name of its file."""

OF_SEVERAL = ("npz", "mat", "mat 7.3", "h5", "zarr", "zipped zarr")
"""Formats of which a file can hold several arrays."""


# Files by their suffix and what writes them


def npz(**arrays):
    return ".npz", partial(write_npz, **arrays)


def mat(**arrays):
    return ".mat", partial(write_mat, **arrays)


def mat73(change=None, **arrays):
    return ".mat", partial(write_mat73, change=change, **arrays)


def h5(change=None, **arrays):
    return ".h5", partial(write_h5, change=change, **arrays)


def zarr_of(**arrays):
    return ".zarr", partial(write_zarr, **arrays)
