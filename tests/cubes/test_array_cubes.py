"""Cubes in memory: any order, any elements, views where there can be views."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.cubes import open_cube
from isacbench.cubes.tiles import Cube
from isacbench.files.arrays import StoredArray

from .samples import all_elements, assert_gives, cross_elements, of_elements, random_cube, sum_of_tiles

shapes = st.tuples(st.integers(1, 40), st.integers(1, 6), st.integers(1, 5), st.integers(1, 5))


@st.composite
def shape_and_elements(draw):
    shape = draw(shapes)
    element = st.tuples(st.integers(0, shape[2] - 1), st.integers(0, shape[3] - 1))
    return shape, np.array(draw(st.lists(element, min_size=1, max_size=30)))


def test_an_array_of_any_order_and_byte_order_comes_back(dtype, order):
    array = random_cube((6, 5, 3, 4), dtype=dtype, order=order)
    for tile_bytes in (1, 200, 2**20):
        assert_gives(open_cube(array, tile_bytes=tile_bytes), array)
    assert_gives(open_cube(array.astype(dtype.newbyteorder(">")), tile_bytes=200), array)


@given(
    case=shape_and_elements(),
    axes=st.permutations(range(4)),
    flipped=st.sets(st.integers(0, 3)),
    tile_bytes=st.integers(1, 5000),
)
def test_whatever_the_strides_and_the_list_of_elements_the_tiles_add_up(case, axes, flipped, tile_bytes):
    shape, elements = case
    in_memory = random_cube(tuple(shape[axis] for axis in axes))
    array = in_memory.transpose(np.argsort(axes))
    array = array[tuple(slice(None, None, -1 if axis in flipped else 1) for axis in range(4))]
    cube = open_cube(array, tile_bytes=tile_bytes)
    # Repeated elements are separate entries of the list.
    assert np.array_equal(sum_of_tiles(cube, elements), of_elements(array, elements))
    assert all(tile.load().nbytes <= max(tile_bytes, array.itemsize) for tile in cube.tiles(elements))


@given(case=shape_and_elements(), chunks=st.tuples(*[st.integers(1, 9)] * 4), tile_bytes=st.integers(1, 5000))
def test_whatever_the_chunks_tiles_add_up_and_chunks_of_requested_elements_are_read(case, chunks, tile_bytes):
    shape, elements = case
    array = random_cube(shape)
    wanted = {tuple(element // chunks[2:]) for element in elements}
    read_chunks = []

    def read(box):
        n, m, *element = box
        assert (n.start % chunks[0], m.start % chunks[1]) == (0, 0)
        first = [part.start // size for part, size in zip(element, chunks[2:], strict=True)]
        assert first == [(part.stop - 1) // size for part, size in zip(element, chunks[2:], strict=True)]
        read_chunks.append((n.start, m.start, *first))
        return array[box]

    cube = Cube("c", StoredArray(array.shape, array.dtype, read, chunks=chunks), tile_bytes)
    assert np.array_equal(sum_of_tiles(cube, elements), of_elements(array, elements))
    assert {place[2:] for place in read_chunks} == wanted
    assert len({*read_chunks}) == len(read_chunks)


def test_tiles_of_all_elements_of_a_c_ordered_array_are_views_along_subcarriers():
    array = random_cube()
    for elements in (all_elements(), all_elements()[::-1]):
        tiles = list(open_cube(array, tile_bytes=array.nbytes // 3).tiles(elements))
        assert [tile.subcarriers for tile in tiles] == [slice(0, 8), slice(8, 16), slice(16, 24)]
        assert all(np.shares_memory(tile.load(), array) for tile in tiles)


@pytest.mark.parametrize("elements", [all_elements(), cross_elements(), np.array([[2, 3]])])
def test_tiles_of_an_element_major_array_are_views_of_requested_elements(elements):
    for array in (random_cube(order="F"), random_cube((3, 4, 24, 10)).transpose(2, 3, 0, 1)):
        tiles = list(open_cube(array, tile_bytes=2 * array[:, :, 0, 0].nbytes).tiles(elements))
        assert all(np.shares_memory(tile.load(), array) for tile in tiles)
        assert all(tile.subcarriers == slice(0, 24) for tile in tiles)
        assert max(len(tile.elements) for tile in tiles) <= 2


def test_the_papers_cube_is_cut_into_64_subcarriers():
    array = np.broadcast_to(np.complex64(1), (2048, 224, 16, 16))  # Has no strides, so C order is assumed.
    parts = [tile.subcarriers for tile in open_cube(array).tiles(all_elements(array.shape))]
    assert {part.stop - part.start for part in parts} == {64}


def test_views_are_read_only_and_the_array_stays_writable():
    array = random_cube()
    (tile,) = open_cube(array).tiles(all_elements())
    assert not tile.load().flags.writeable
    assert array.flags.writeable
