"""Writing cubes block by block: what comes back, and that nothing is left of what did not end well."""

from __future__ import annotations

from unittest.mock import Mock, call

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.cubes import open_cube, write_cube
from isacbench.cubes.writing import chunk_lengths
from tests.conftest import refusal

from .samples import SHAPE, assert_gives, random_cube

FILES = ("cube.npy", "cube.NPY", "cube.zarr")


def steps(array, step):
    return (array[first : first + step] for first in range(0, len(array), step))


@pytest.mark.parametrize("filename", FILES)
def test_what_is_written_is_read_and_stands_in_its_place_when_it_is_complete(tmp_path, dtype, filename):
    array = random_cube(dtype=dtype)
    for step in (1, 7, 24):
        folder, progress = tmp_path / str(step), Mock()
        folder.mkdir()
        write_cube(folder / filename, SHAPE, steps(array, step), dtype, progress)
        assert progress.call_args == call(SHAPE[0], SHAPE[0])
        assert [path.name for path in folder.iterdir()] == [filename]
        with open_cube(folder / filename) as cube:
            assert_gives(cube, array)


def test_blocks_that_end_within_chunks_are_written_chunk_by_chunk(tmp_path):
    array = np.repeat(random_cube((300, 2, 2, 2)), 250, axis=1)  # 32 subcarriers a chunk
    write_cube(tmp_path / "cube.zarr", array.shape, steps(array, 50))
    with open_cube(tmp_path / "cube.zarr") as cube:
        assert_gives(cube, array)


@pytest.mark.parametrize("filename", FILES)
def test_blocks_of_any_layout_and_precision_are_converted(tmp_path, filename):
    array = random_cube(dtype=np.complex128)
    blocks = [np.asfortranarray(array[:10]), array[10:].astype(">c16")]
    write_cube(str(tmp_path / filename), SHAPE, blocks, ">c8")
    with open_cube(tmp_path / filename) as cube:
        assert_gives(cube, array.astype(np.complex64))


def test_an_npy_file_is_what_numpy_reads_and_writes(tmp_path):
    array = random_cube()
    write_cube(tmp_path / "ours.npy", SHAPE, [array])
    np.save(tmp_path / "numpys.npy", array)
    assert (tmp_path / "ours.npy").read_bytes() == (tmp_path / "numpys.npy").read_bytes()


def test_a_cube_of_zeros_is_complete(tmp_path):
    write_cube(tmp_path / "cube.zarr", SHAPE, [np.zeros(SHAPE, np.complex64)])
    with open_cube(tmp_path / "cube.zarr") as cube:
        assert_gives(cube, np.zeros(SHAPE, np.complex64))


@given(
    shape=st.tuples(st.integers(1, 5000), st.integers(1, 5000), st.integers(1, 64), st.integers(1, 64)),
    itemsize=st.sampled_from([8, 16]),
)
def test_chunks_hold_half_a_mebibyte_or_all(shape, itemsize):
    chunks = chunk_lengths(shape, itemsize)
    size = np.prod(chunks) * itemsize
    assert all(chunk <= length for chunk, length in zip(chunks, shape, strict=True))
    assert size <= 2**19
    assert size >= 2**17 or chunks[:2] == shape[:2]


@pytest.mark.parametrize("filename", FILES)
@pytest.mark.parametrize("ending", [KeyboardInterrupt(), SystemExit(), ZeroDivisionError()])
def test_writing_that_is_interrupted_leaves_nothing_and_passes_the_reason_on(tmp_path, filename, ending):
    def blocks():
        yield random_cube()[:12]
        raise ending

    with pytest.raises(type(ending)) as raised:
        write_cube(tmp_path / filename, SHAPE, blocks())
    assert raised.value is ending
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("filename", FILES)
def test_what_exists_is_not_overwritten_even_if_it_came_meanwhile(tmp_path, filename):
    path = tmp_path / filename

    def blocks():
        path.write_text("mine")
        yield random_cube()

    for given_blocks in (blocks(), [random_cube()]):
        assert refusal(write_cube, path, SHAPE, given_blocks).startswith(f"{path}: exists already")
        assert path.read_text() == "mine"
    assert [found.name for found in tmp_path.iterdir()] == [filename]


def test_what_cannot_be_created_is_told_before_work(tmp_path):
    for name, shape, dtype, message in (
        ("c.h5", SHAPE, "c8", "has suffix '.h5'; a cube is written as .npy, .zarr"),
        ("c", SHAPE, "c8", "has no suffix"),
        ("none/c.npy", SHAPE, "c8", f"its folder {tmp_path / 'none'} does not exist"),
        ("c.npy", SHAPE[:3], "c8", "has shape (24, 10, 3); a cube takes four axes"),
        ("c.npy", SHAPE, "f8", "holds float64"),
        ("x" * 300 + ".npy", SHAPE, "c8", "cannot be written: File name too long"),
    ):
        path = tmp_path / name
        assert refusal(write_cube, path, shape, [random_cube()], dtype).startswith(f"{path}: {message}")
    assert list(tmp_path.iterdir()) == []


def test_blocks_that_do_not_fit_are_refused_and_leave_nothing(tmp_path):
    for message, block in {
        "takes complex numbers of shape (n, 10, 3, 4), not float64": np.ones((2, *SHAPE[1:])),
        "not complex64 of shape (2, 3)": np.ones((2, 3), np.complex64),
        "25 subcarriers were given; the cube has 24": random_cube((25, *SHAPE[1:])),
        "only 23 of 24 subcarriers were given": random_cube()[:23],
        " masked numbers of 240": np.ma.masked_less(random_cube()[:2], -1),
    }.items():
        for filename in FILES:
            assert message in refusal(write_cube, tmp_path / filename, SHAPE, [block])
    assert list(tmp_path.iterdir()) == []
