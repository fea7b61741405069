"""Cubes of a few numbers, and what a cube must give back."""

from __future__ import annotations

import numpy as np
import pytest

SHAPE = (24, 10, 3, 4)
SMALL_TILE_BYTES = 2048


def random_cube(shape=SHAPE, dtype=np.complex64, seed=0):
    parts = np.random.default_rng(seed).standard_normal((2, *shape))
    return (parts[0] + 1j * parts[1]).astype(dtype)


def all_elements(shape=SHAPE):
    return np.argwhere(np.ones(shape[2:], dtype=bool))


def cross_elements(shape=SHAPE):
    return np.array([*((p, 0) for p in range(shape[2])), *((0, q) for q in range(1, shape[3]))])


def sum_of_tiles(cube, elements):
    """The cube (N, M, e) that its tiles make, in whatever order they are loaded."""
    total = np.zeros((*cube.shape[:2], len(elements)), cube.dtype)
    for tile in reversed(list(cube.tiles(elements))):
        values = tile.load()
        assert values.dtype == cube.dtype
        assert values.dtype.isnative
        total[tile.subcarriers, tile.symbols, tile.elements] += values
    return total


def assert_gives(cube, array):
    """Hold a cube to its array: all elements, one row and column, one element, a list out of order."""
    assert cube.shape == array.shape
    assert cube.dtype == array.dtype.newbyteorder("=")
    shape = array.shape
    corner = np.array([[shape[2] - 1, shape[3] - 1]])
    for elements in (all_elements(shape), cross_elements(shape), corner, all_elements(shape)[::-2]):
        found = sum_of_tiles(cube, elements)
        assert np.array_equal(found, array[:, :, elements[:, 0], elements[:, 1]])


@pytest.fixture(params=[np.complex64, np.complex128], ids=["complex64", "complex128"])
def dtype(request):
    return np.dtype(request.param)


@pytest.fixture(params=["C", "F"])
def order(request):
    return request.param
