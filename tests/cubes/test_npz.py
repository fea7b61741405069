"""Cubes in npz files."""

import numpy as np
import pytest

from isacbench.cubes import open_cube

from .conftest import SMALL_TILE_BYTES, assert_gives, random_cube


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("byte_order", "<>")
def test_an_npz_file_gives_its_array_back(tmp_path, dtype, order, byte_order, save):
    array = np.asarray(random_cube(dtype=dtype), dtype=dtype.newbyteorder(byte_order), order=order)
    save(tmp_path / "cube.npz", cube=array, other=np.arange(3))
    for tile_bytes in (500, SMALL_TILE_BYTES, 2**20):
        with open_cube(tmp_path / "cube.npz", tile_bytes=tile_bytes) as cube:
            assert_gives(cube, array)
