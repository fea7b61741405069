"""Files of cubes: every format gives its array back, and what lies beside it is used or told."""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr

from isacbench import get_estimator, observe_cube
from isacbench.cubes import open_cube, read_grid
from isacbench.cubes.tiles import require_shape
from isacbench.errors import InputWarning
from isacbench.model.array import VirtualArray
from isacbench.model.echo import resource_grid
from isacbench.model.numerology import System
from tests.conftest import refusal

from ..hostile.faults import CELL, CUBE, QPSK, M, N
from . import samples
from .samples import FORMATS, SHAPE, assert_gives, h5, mat, mat73, npz, random_cube, zarr_of
from .test_path_lengths import scenario_of

DOCUMENT = Path(__file__).parents[2] / "docs" / "cubes.md"
SCENARIO = scenario_of(("-u", "-w"))
GRID = random_cube((*SHAPE[:2], 1, 1), seed=1)[:, :, 0, 0]


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_gives_its_array_back(tmp_path, kind):
    write, filename = FORMATS[kind]
    for dtype, order, compressed in ((np.complex64, "C", True), (np.complex128, "F", False)):
        array, path = random_cube(dtype=dtype, order=order), tmp_path / f"{order}-{filename}"
        write(path, cube=array, compressed=compressed)
        for tile_bytes in (samples.SMALL_TILE_BYTES, 2**20):
            with open_cube(path, tile_bytes=tile_bytes) as cube:
                assert_gives(cube, array)
                assert cube.transmitted is None
                assert str(path) in cube.name


@pytest.mark.parametrize("kind", ["npy", "npz", "h5"])
def test_a_file_of_the_other_byte_order_gives_native_numbers(tmp_path, dtype, kind):
    write, filename = FORMATS[kind]
    array = random_cube(dtype=dtype.newbyteorder(">"), order="F")
    write(tmp_path / filename, cube=array)
    with open_cube(str(tmp_path / filename), tile_bytes=samples.SMALL_TILE_BYTES) as cube:
        assert_gives(cube, array)


@pytest.mark.parametrize("write", [samples.write_mat, samples.write_mat73])
def test_the_trailing_ones_that_matlab_drops_come_back(tmp_path, write):
    for number, shape in enumerate([(5, 4, 3, 1), (5, 4, 1, 1), (5, 1, 1, 1), (1, 1, 1, 1)]):
        array, path = random_cube(shape), tmp_path / f"{number}.mat"
        as_matlab = array.reshape(shape[: max(2, np.flatnonzero(np.array(shape) > 1).max(initial=0) + 1)])
        write(path, cube=as_matlab, compressed=number % 2 == 1)
        with open_cube(path) as cube:
            assert_gives(cube, array)


def test_datasets_zarr_arrays_and_maps_are_cubes_and_stay_open(tmp_path, order):
    array = random_cube(order=order)
    samples.write_chunked_h5(tmp_path / "c.h5", cube=array)
    samples.write_mat73(tmp_path / "c.mat", cube=array)
    samples.write_zarr2(tmp_path / "c.zarr", cube=array)
    np.save(tmp_path / "c.npy", array)
    stored, mapped = zarr.open(tmp_path / "c.zarr", mode="r"), np.load(tmp_path / "c.npy", mmap_mode="r")
    with h5py.File(tmp_path / "c.h5") as plain, h5py.File(tmp_path / "c.mat") as matlab:
        for source in 2 * [plain["cube"], matlab["cube"], stored["cube"], mapped]:
            with open_cube(source) as cube:
                assert_gives(cube, array)


# Tiles


@pytest.mark.parametrize("kind", FORMATS)
def test_tiles_partition_the_cube_keep_to_their_memory_and_load_in_any_thread_order_and_again(tmp_path, kind):
    write, filename = FORMATS[kind]
    write(tmp_path / filename, cube=random_cube())
    budget = {"zarr": 2**20, "zipped zarr": 2**20, "lone zarr": 2688}.get(kind, samples.SMALL_TILE_BYTES)
    with open_cube(tmp_path / filename, tile_bytes=budget) as cube, ThreadPoolExecutor(4) as pool:
        tiles = list(cube.tiles(samples.all_elements()))
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


@pytest.mark.parametrize("kind", samples.OF_SEVERAL)
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


@pytest.mark.parametrize("kind", samples.OF_SEVERAL)
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
    assert re.fullmatch("a cube is a NumPy array, .* or a path, not list", refusal(open_cube, [[1j]]))
    message = refusal(open_cube, random_cube().real)
    assert message.startswith("array: holds float32; a cube takes complex64 or complex128")


def test_an_element_outside_the_array_is_refused():
    for element in ((3, 0), (0, 4), (-1, 0)):
        tiles = open_cube(random_cube()).tiles(np.array([(0, 0), element]))
        assert f"has no element {element}" in refusal(next, tiles)


def test_damaged_chunks_are_told_when_they_are_met(tmp_path):
    samples.write_h5(tmp_path / "c.h5", cube=random_cube(), compressed=True)
    with h5py.File(tmp_path / "c.h5") as file:
        chunk = file["cube"].id.get_chunk_info(0)
    with (tmp_path / "c.h5").open("r+b") as raw:
        raw.seek(chunk.byte_offset + chunk.size // 2)
        raw.write(bytes(100))
    samples.write_zarr2(tmp_path / "c.zarr", cube=random_cube())
    with (tmp_path / "c.zarr" / "cube" / "1.0.1.3").open("r+b") as raw:
        raw.truncate(100)
    for path in (tmp_path / "c.h5", tmp_path / "c.zarr"):
        with open_cube(path) as cube:
            message = refusal(samples.sum_of_tiles, cube, samples.all_elements())
            assert message.startswith(f"{path}: cube: is damaged: ")


def test_a_cube_too_large_to_be_read_whole_is_told_the_formats_that_are_read_in_parts(tmp_path, monkeypatch):
    monkeypatch.setattr("isacbench.cubes.opening.HELD_BYTES", random_cube().nbytes - 1)
    samples.write_npz(tmp_path / "c.npz", cube=random_cube())
    message = refusal(open_cube, tmp_path / "c.npz")
    assert re.search(r"allowed are at most 22\.5 KiB .* any size in \.npy, \.h5", message)


def test_open_arrays_that_are_not_complete_are_refused(tmp_path):
    with h5py.File(tmp_path / "c.h5", "w") as file:
        cube = file.create_dataset("cube", SHAPE, np.complex64, chunks=(12, 10, 3, 2))
        assert "is not complete: the file has 0 of 4 chunks" in refusal(open_cube, cube)
    samples.write_zarr2(tmp_path / "c.zarr", cube=random_cube())
    (tmp_path / "c.zarr" / "cube" / "1.0.1.3").unlink()
    cube = zarr.open(tmp_path / "c.zarr", mode="r")["cube"]
    assert "lacks 1 of 24 chunks" in refusal(open_cube, cube)


def test_a_refused_file_is_closed_again(tmp_path):
    """An open HDF5 file cannot be opened for writing; other open files warn, which is an error here."""
    samples.write_chunked_h5(tmp_path / "c.h5", cube=random_cube().real)
    samples.write_mat73(tmp_path / "c.mat", cube=random_cube(), transmitted=np.ones((2, 2)))
    for name in ("c.h5", "c.mat"):
        refusal(open_cube, tmp_path / name)
        h5py.File(tmp_path / name, "a").close()


def test_a_cube_of_another_shape_is_refused_and_permuted_axes_are_named():
    system = System(n_subcarriers=24, n_symbols=10)
    array = VirtualArray(tx_shape=(1, 2), rx_shape=(3, 2), tx_spacing=2)
    cube = random_cube()
    require_shape(open_cube(cube), system, array)
    hint = ". The axes look permuted: numpy.transpose with axes (1, 3, 0, 2) would fit"
    takes = "the scenario takes (24, 10, 3, 4): (subcarriers, symbols, P, Q)"
    for found, words in ((cube[1:], ""), (cube.transpose(2, 0, 3, 1), hint)):
        message = refusal(require_shape, open_cube(found), system, array)
        assert message == f"array: has shape {found.shape}; {takes}{words}"


# Contents beside the cube: the grid above all


def added_to_consolidated(path):
    samples.write_zarr(path, zarr_format=2, cube=CUBE)
    zarr.consolidate_metadata(path)
    zarr.open_group(path, mode="a", use_consolidated=False).create_array("transmitted", data=QPSK)


@pytest.fixture
def path_of(tmp_path):
    def write(suffix_and_writer):
        suffix, writer = suffix_and_writer
        path = tmp_path / f"frame{suffix}"
        writer(path)
        return path

    return write


USED = {
    "capital": npz(cube=CUBE, Transmitted=QPSK),
    "spaces": npz(**{"Cube": CUBE, " Transmitted ": QPSK}),
    "capital, mat": mat(Cube=CUBE, TRANSMITTED=QPSK),
    "structure": mat(cube=CUBE, transmitted={"grid": QPSK}),
    "structure of both": mat(frame={"cube": CUBE, "transmitted": QPSK, "carrier_hz": 70e9}),
    "structure of both, 7.3": mat73(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "flattened": npz(**{"frame.cube": CUBE, "frame.transmitted": QPSK}),
    "groups": h5(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "group of the grid": h5(cube=CUBE, **{"transmitted/values": QPSK}),
    "zarr groups": zarr_of(**{"frame/cube": CUBE, "frame/transmitted": QPSK}),
    "zarr capital": zarr_of(cube=CUBE, Transmitted=QPSK),
    "zarr, consolidated before": (".zarr", added_to_consolidated),
}


@pytest.mark.parametrize("contents", USED.values(), ids=USED)
def test_the_grid_is_used_wherever_it_lies(path_of, contents):
    path = path_of(contents)
    with open_cube(path) as cube:
        assert_gives(cube, CUBE)
        assert np.array_equal(cube.transmitted, QPSK)
    assert np.array_equal(read_grid(path), QPSK)


OTHERS = {
    "second cube": (npz(cube=CUBE, raw=CUBE), r"raw \(complex128 of shape"),
    "flat cube": (npz(cube=CUBE, raw=CUBE.ravel()), r"raw \(complex128 of shape"),
    "second cube in a group": (h5(cube=CUBE, **{"old/raw": CUBE}), "old/raw"),
    "map beside the grid": (mat(cube=CUBE, transmitted=np.ones((N, M)), map=np.ones((N, M))), "map"),
    "calibration": (h5(cube=CUBE, calibration=np.ones(SHAPE[2:], complex)), r"calibration \(complex"),
    "a vector each symbol": (npz(cube=CUBE, x0=QPSK[:, 0], x1=QPSK[:, 1]), "x0 .*, x1"),
    "cell": (mat(cube=CUBE, symbols=CELL), r"symbols \(cell\)$"),
    "Python objects": (npz(cube=CUBE, meta=np.array({"transmitted": QPSK})), r"meta \(object"),
    "link": (h5(lambda file: file.update(grid=h5py.SoftLink("/x")), cube=CUBE), r"grid \(link\)"),
}


@pytest.mark.parametrize(("contents", "unused"), OTHERS.values(), ids=OTHERS)
def test_what_may_be_data_and_is_not_used_is_told(path_of, contents, unused):
    path = path_of(contents)
    with pytest.warns(InputWarning, match=f"frame.* does not use {unused}"), open_cube(path) as cube:
        assert_gives(cube, CUBE)


METADATA = {
    "carrier_hz": 70e9,
    "f": np.arange(float(N)),
    "t": np.arange(float(M)),
    "positions": np.ones((12, 3)),
    "element_gain_db": np.ones(SHAPE[2:]),
    "scale": 1 + 0j,
    "note": "by hand",
    "transmitted_power_dbm": 20.0,
    "transmitted_modulation": "QPSK",
}


@pytest.mark.parametrize("contents", [npz, mat, mat73, zarr_of, h5])
def test_scalars_texts_axes_and_other_shapes_beside_the_cube_are_no_grid(path_of, contents):
    held = {name: np.asarray(value) for name, value in METADATA.items()}
    if contents in (zarr_of, h5):
        held = {name: value for name, value in held.items() if value.dtype.kind != "U"}
    with open_cube(path_of(contents(cube=CUBE, **held))) as cube:
        assert_gives(cube, CUBE)
        assert cube.transmitted is None


@pytest.mark.parametrize("contents", [npz, mat, mat73, h5])
def test_the_axes_of_a_frame_of_one_symbol_are_no_grid(path_of, contents):
    path = path_of(contents(cube=CUBE[:, :1], f=np.arange(float(N)), t=0.5))
    with pytest.warns(InputWarning, match=r"does not use f \(float64"), open_cube(path) as cube:
        assert cube.transmitted is None


@pytest.mark.parametrize("contents", [npz, mat73, zarr_of, h5])
def test_a_grid_alone_may_have_settings_in_groups_beside_it(path_of, contents):
    path = path_of(contents(symbols=QPSK, **{"setup/limits": np.ones((2, 2))}))
    assert np.array_equal(read_grid(path), QPSK)


def test_a_frame_is_told_of_once(path_of):
    frame = np.ones((128, 56, 8, 6), np.complex64)
    with pytest.warns(InputWarning) as told:
        _ = observe_cube(path_of(h5(cube=frame, raw=frame)), SCENARIO).cross
    assert len(told) == 1


def test_the_image_of_a_received_frame_is_that_of_its_echoes(path_of):
    """(F X) / X = F: the one point, not one of eighteen."""
    divided = resource_grid(SCENARIO, SCENARIO.array.positions).reshape(128, 56, 8, 6)
    grid = np.exp(0.5j * np.pi * np.random.default_rng(0).integers(4, size=divided.shape[:2]))
    cube = divided * grid[:, :, None, None]
    files = mat(cube=cube, transmitted={"grid": grid}), h5(**{"frame/cube": cube, "frame/transmitted": grid})
    for path in map(path_of, files):
        cloud = get_estimator("fft4d").estimate(observe_cube(path, SCENARIO))
        assert np.allclose(cloud.xyz, SCENARIO.scatterers.xyz, atol=0.1), path


def test_the_examples_of_the_page_run_and_write_cubes_that_are_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    examples = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL)
    names = {}
    for example in examples:
        exec(example, names)
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"cube.npy", "element-major.npy", "cube.npz", "cube.h5", "cube.zarr", "streamed.zarr"}
    for name in written:
        with open_cube(name) as cube:
            assert_gives(cube, names["echo"])
            if name in ("cube.npz", "cube.h5", "cube.zarr"):
                assert (cube.transmitted == names["transmitted"]).all()
                assert (read_grid(name) == names["transmitted"]).all()
