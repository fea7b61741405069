"""Cubes in memory: any order, any elements, views where they can be."""

import numpy as np

from isacbench.cubes import open_cube

from .conftest import (
    SMALL_TILE_BYTES,
    assert_gives,
    random_cube,
)


def test_any_order_and_size_of_tiles_gives_the_array(dtype, order):
    array = np.asarray(random_cube(dtype=dtype), order=order)
    assert_gives(open_cube(array, tile_bytes=SMALL_TILE_BYTES), array)
    assert_gives(open_cube(array), array)
    assert_gives(open_cube(array.astype(array.dtype.newbyteorder(">")), tile_bytes=1), array)
