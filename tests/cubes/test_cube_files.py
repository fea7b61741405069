"""Every format gives back the array that was written, whatever the elements, the tiles and the threads."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest
import zarr

from isacbench.cubes import open_cube, read_grid
from isacbench.cubes.tiles import require_shape
from isacbench.errors import InputError, InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.numerology import System

from .samples import (
    FORMATS,
    OF_SEVERAL,
    SHAPE,
    SMALL_TILE_BYTES,
    all_elements,
    assert_gives,
    random_cube,
    sum_of_tiles,
    write_chunked_h5,
    write_h5,
    write_mat,
    write_mat73,
    write_npy,
    write_npz,
    write_zarr2,
)

GRID = random_cube((*SHAPE[:2], 1, 1), seed=1)[:, :, 0, 0]


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_gives_its_array_back(tmp_path, kind):
    write, filename = FORMATS[kind]
    for dtype, order, compressed in ((np.complex64, "C", True), (np.complex128, "F", False)):
        array, path = random_cube(dtype=dtype, order=order), tmp_path / f"{order}-{filename}"
        write(path, cube=array, compressed=compressed)
        for tile_bytes in (SMALL_TILE_BYTES, 2**20):
            with open_cube(path, tile_bytes=tile_bytes) as cube:
                assert_gives(cube, array)
                assert cube.transmitted is None
                assert str(path) in cube.name


@pytest.mark.parametrize(("write", "name"), [(write_npy, "c.npy"), (write_npz, "c.npz"), (write_h5, "c.h5")])
def test_a_file_of_the_other_byte_order_gives_native_numbers(tmp_path, dtype, write, name):
    array = random_cube(dtype=dtype.newbyteorder(">"), order="F")
    write(tmp_path / name, cube=array)
    with open_cube(str(tmp_path / name), tile_bytes=SMALL_TILE_BYTES) as cube:
        assert_gives(cube, array)


@pytest.mark.parametrize("write", [write_mat, write_mat73])
def test_the_trailing_ones_that_matlab_drops_come_back(tmp_path, write):
    for number, shape in enumerate([(5, 4, 3, 1), (5, 4, 1, 1), (5, 1, 1, 1), (1, 1, 1, 1)]):
        array, path = random_cube(shape), tmp_path / f"{number}.mat"
        as_matlab = array.reshape(shape[: max(2, np.flatnonzero(np.array(shape) > 1).max(initial=0) + 1)])
        write(path, cube=as_matlab, compressed=number % 2 == 1)
        with open_cube(path) as cube:
            assert_gives(cube, array)


def test_datasets_zarr_arrays_and_maps_are_cubes_and_stay_open(tmp_path, order):
    array = random_cube(order=order)
    write_chunked_h5(tmp_path / "c.h5", cube=array)
    write_mat73(tmp_path / "c.mat", cube=array)
    write_zarr2(tmp_path / "c.zarr", cube=array)
    np.save(tmp_path / "c.npy", array)
    with h5py.File(tmp_path / "c.h5") as plain, h5py.File(tmp_path / "c.mat") as matlab:
        sources = [
            plain["cube"],
            matlab["cube"],
            zarr.open(tmp_path / "c.zarr", mode="r")["cube"],
            np.load(tmp_path / "c.npy", mmap_mode="r"),
        ]
        for source in sources:
            for _ in range(2):
                with open_cube(source) as cube:
                    assert_gives(cube, array)


# Tiles


@pytest.mark.parametrize("kind", FORMATS)
def test_tiles_partition_the_cube_keep_to_their_memory_and_load_in_any_thread_order_and_again(tmp_path, kind):
    write, filename = FORMATS[kind]
    write(tmp_path / filename, cube=random_cube())
    budget = {"zarr": 2**20, "zipped zarr": 2**20, "lone zarr": 2688}.get(kind, SMALL_TILE_BYTES)
    with open_cube(tmp_path / filename, tile_bytes=budget) as cube, ThreadPoolExecutor(4) as pool:
        tiles = list(cube.tiles(all_elements()))
        order = np.random.default_rng(0).permutation([*range(len(tiles))] * 3)
        loaded = list(pool.map(lambda tile: tile.load(), [tiles[k] for k in order]))
        expected = [tile.load() for tile in tiles]
    assert all(np.array_equal(values, expected[k]) for k, values in zip(order, loaded, strict=True))
    assert max(values.nbytes for values in expected) <= budget
    covered = np.zeros((*SHAPE[:2], 12), int)
    for tile in tiles:
        covered[tile.subcarriers, tile.symbols, tile.elements] += 1
    assert (covered == 1).all()


# Names


@pytest.mark.parametrize("kind", OF_SEVERAL)
def test_the_cube_is_the_array_of_that_name_or_the_only_one_of_four_axes(tmp_path, kind):
    write, filename = FORMATS[kind]
    array, other = random_cube(), random_cube(seed=2)
    for number, arrays in enumerate(({"cube": array, "other": other}, {"echo": array, "t": GRID[:-1]})):
        path = tmp_path / str(number) / filename
        path.parent.mkdir()
        write(path, **arrays)
        with pytest.warns(InputWarning, match=r"does not use (other|t) \(complex"):
            cube = open_cube(path)
        with cube:
            assert_gives(cube, array)
            assert cube.transmitted is None


@pytest.mark.parametrize("kind", OF_SEVERAL)
def test_the_transmitted_grid_is_found_beside_the_cube_and_in_a_file_of_its_own(tmp_path, kind):
    write, filename = FORMATS[kind]
    write(tmp_path / filename, cube=random_cube(), transmitted=GRID, compressed=True)
    with open_cube(tmp_path / filename) as cube:
        assert np.array_equal(cube.transmitted, GRID)
        assert cube.transmitted.dtype == GRID.dtype
    assert np.array_equal(read_grid(tmp_path / filename), GRID)
    alone = tmp_path / f"alone-{filename}"
    write(alone, symbols=GRID)
    assert np.array_equal(read_grid(alone), GRID)


def test_a_real_grid_becomes_complex_and_any_byte_order_native(tmp_path):
    np.save(tmp_path / "real.npy", np.array([[1, 0], [0, -1]], np.int8))
    assert read_grid(tmp_path / "real.npy").dtype == np.complex128
    np.save(tmp_path / "big.npy", np.asfortranarray(GRID).astype(">c8"))
    grid = read_grid(tmp_path / "big.npy")
    assert grid.dtype.isnative
    assert np.array_equal(grid, GRID)


# What is refused when it is opened is in the table of tests/hostile.


def test_other_things_than_arrays_and_paths_are_refused():
    with pytest.raises(InputError, match=r"^a cube is a NumPy array, .* or a path, not list$"):
        open_cube([[1j]])
    with pytest.raises(InputError, match=r"^array: holds float32; a cube takes complex64 or complex128"):
        open_cube(random_cube().real)


def test_an_element_outside_the_array_is_refused():
    for element in ((3, 0), (0, 4), (-1, 0)):
        with pytest.raises(InputError, match=re.escape(f"has no element {element}")):
            next(open_cube(random_cube()).tiles(np.array([(0, 0), element])))


def test_damaged_chunks_are_told_when_they_are_met(tmp_path):
    write_h5(tmp_path / "c.h5", cube=random_cube(), compressed=True)
    with h5py.File(tmp_path / "c.h5") as file:
        chunk = file["cube"].id.get_chunk_info(0)
    with (tmp_path / "c.h5").open("r+b") as raw:
        raw.seek(chunk.byte_offset + chunk.size // 2)
        raw.write(bytes(100))
    write_zarr2(tmp_path / "c.zarr", cube=random_cube())
    with (tmp_path / "c.zarr" / "cube" / "1.0.1.3").open("r+b") as raw:
        raw.truncate(100)
    for name in ("c.h5", "c.zarr"):
        words = f"^{re.escape(str(tmp_path / name))}: cube: is damaged: "
        with open_cube(tmp_path / name) as cube, pytest.raises(InputError, match=words):
            sum_of_tiles(cube, all_elements())


def test_a_cube_too_large_to_be_read_whole_is_told_the_formats_that_are_read_in_parts(tmp_path, monkeypatch):
    monkeypatch.setattr("isacbench.cubes.opening.HELD_BYTES", random_cube().nbytes - 1)
    write_npz(tmp_path / "c.npz", cube=random_cube())
    with pytest.raises(InputError, match=r"allowed are at most 22.5 KiB .* any size in \.npy, \.h5"):
        open_cube(tmp_path / "c.npz")


def test_open_arrays_that_are_not_complete_are_refused(tmp_path):
    with h5py.File(tmp_path / "c.h5", "w") as file:
        cube = file.create_dataset("cube", SHAPE, np.complex64, chunks=(12, 10, 3, 2))
        with pytest.raises(InputError, match="is not complete: the file has 0 of 4 chunks"):
            open_cube(cube)
    write_zarr2(tmp_path / "c.zarr", cube=random_cube())
    (tmp_path / "c.zarr" / "cube" / "1.0.1.3").unlink()
    with pytest.raises(InputError, match="lacks 1 of 24 chunks"):
        open_cube(zarr.open(tmp_path / "c.zarr", mode="r")["cube"])


def test_a_refused_file_is_closed_again(tmp_path):
    """An open HDF5 file cannot be opened for writing; other open files warn, which is an error here."""
    write_chunked_h5(tmp_path / "c.h5", cube=random_cube().real)
    write_mat73(tmp_path / "c.mat", cube=random_cube(), transmitted=np.ones((2, 2)))
    for name in ("c.h5", "c.mat"):
        with pytest.raises(InputError):
            open_cube(tmp_path / name)
        h5py.File(tmp_path / name, "a").close()


def test_a_cube_of_another_shape_is_refused_and_permuted_axes_are_named():
    system = System(n_subcarriers=24, n_symbols=10)
    array = VirtualArray(tx_shape=(1, 2), rx_shape=(3, 2), tx_spacing=2)
    cube = random_cube()
    require_shape(open_cube(cube), system, array)
    hint = ". The axes look permuted: numpy.transpose with axes (1, 3, 0, 2) would fit"
    for found, words in ((cube[1:], ""), (cube.transpose(2, 0, 3, 1), hint)):
        with pytest.raises(InputError) as refused:
            require_shape(open_cube(found), system, array)
        assert str(refused.value) == (
            f"array: has shape {found.shape}; the scenario takes (24, 10, 3, 4): "
            f"(subcarriers, symbols, P, Q){words}"
        )
