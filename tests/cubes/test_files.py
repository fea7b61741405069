"""Every format gives back the array that was written, whatever the elements and the tiles."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import zarr
from scipy.io import savemat

from isacbench.cubes import open_cube

from .conftest import SMALL_TILE_BYTES, assert_gives, random_cube


def write_npy(path, array, **_):
    np.save(path, array)


def write_npz(path, array, compressed=False):
    (np.savez_compressed if compressed else np.savez)(path, other=np.arange(3), cube=array)


def write_mat(path, array, compressed=False):
    savemat(path, {"other": np.arange(3.0), "cube": array}, do_compression=compressed)


def write_mat73(path, array, compressed=False):
    """Write as MATLAB does: a header of its own, axes in reverse, records of two fields."""
    part = np.empty(0, array.dtype).real.dtype
    records = np.ascontiguousarray(array.T).view([("real", part), ("imag", part)])
    with h5py.File(path, "w", userblock_size=512) as file:
        dataset = file.create_dataset("cube", data=records, compression="gzip" if compressed else None)
        dataset.attrs["MATLAB_class"] = np.bytes_("single" if array.dtype.itemsize == 8 else "double")


def write_h5(path, array, compressed=False):
    with h5py.File(path, "w") as file:
        file.create_dataset("cube", data=array, compression="gzip" if compressed else None)


def write_chunked_h5(path, array, compressed=False):
    with h5py.File(path, "w") as file:
        file.create_dataset("cube", data=array, chunks=(5, 3, 2, 2), shuffle=compressed)


def write_zarr2(path, array, compressed=False):
    group = zarr.open_group(path, mode="w", zarr_format=2)
    group.create_array("cube", data=array, chunks=(10, 10, 2, 1), compressors="auto" if compressed else None)


def write_zarr3(path, array, compressed=False):
    zarr.create_array(path, data=array, chunks=(7, 4, 3, 4), compressors="auto" if compressed else None)


def write_sharded_zarr(path, array, compressed=False):
    zarr.create_array(path, data=array, chunks=(4, 5, 1, 1), shards=(8, 10, 3, 4))


def write_zipped_zarr(path, array, compressed=False):
    with zarr.storage.ZipStore(path, mode="w") as store:
        zarr.create_array(store, data=array, chunks=(10, 10, 2, 1))


FORMATS = {
    "npy": (write_npy, "cube.npy"),
    "npz": (write_npz, "cube.npz"),
    "mat": (write_mat, "cube.mat"),
    "mat 7.3": (write_mat73, "cube.mat"),
    "h5": (write_h5, "cube.h5"),
    "chunked h5": (write_chunked_h5, "cube.hdf5"),
    "zarr 2": (write_zarr2, "cube.zarr"),
    "zarr 3": (write_zarr3, "cube.zarr"),
    "sharded zarr": (write_sharded_zarr, "cube.zarr"),
    "zipped zarr": (write_zipped_zarr, "cube.zarr.zip"),
}


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_gives_its_array_back(tmp_path, dtype, order, kind, compressed):
    write, filename = FORMATS[kind]
    array = np.asarray(random_cube(dtype=dtype), order=order)
    write(tmp_path / filename, array, compressed=compressed)
    for tile_bytes in (500, SMALL_TILE_BYTES, 2**20):
        with open_cube(tmp_path / filename, tile_bytes=tile_bytes) as cube:
            assert_gives(cube, array)
