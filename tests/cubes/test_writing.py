"""Writing cubes block by block: what comes back, and that nothing is left of what did not end well."""

from __future__ import annotations

import re
import shutil
from collections import namedtuple
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.cubes import create_cube, open_cube
from isacbench.cubes.writing import chunk_lengths
from isacbench.errors import InputError

from .samples import SHAPE, assert_gives, random_cube

FILES = ("cube.npy", "cube.NPY", "cube.zarr")


def fill(path, blocks, then=lambda: None):
    """Write blocks by their first subcarriers, and do something before the file is complete."""
    with create_cube(path, SHAPE) as writer:
        for first, block in blocks.items():
            writer.write(first, block)
        then()


@pytest.mark.parametrize("filename", FILES)
@pytest.mark.parametrize("step", [1, 7, 24])
def test_what_is_written_is_read_and_stands_in_its_place_when_it_is_complete(tmp_path, dtype, filename, step):
    array = random_cube(dtype=dtype)
    with create_cube(tmp_path / filename, SHAPE, dtype) as writer:
        assert (writer.shape, writer.dtype) == (SHAPE, dtype)
        for first in reversed(range(0, SHAPE[0], step)):
            writer.write(first, array[first : first + step])
        assert not (tmp_path / filename).exists()
    assert [path.name for path in tmp_path.iterdir()] == [filename]
    with open_cube(tmp_path / filename) as cube:
        assert_gives(cube, array)


@pytest.mark.parametrize("filename", FILES)
def test_blocks_of_any_layout_and_precision_are_converted(tmp_path, filename):
    array = random_cube(dtype=np.complex128)
    with create_cube(str(tmp_path / filename), SHAPE, ">c8") as writer:
        writer.write(0, np.asfortranarray(array[:10]))
        writer.write(10, array[10:].astype(">c16"))
    with open_cube(tmp_path / filename) as cube:
        assert_gives(cube, array.astype(np.complex64))


def test_an_npy_file_is_what_numpy_reads_and_writes(tmp_path):
    array = random_cube()
    with create_cube(tmp_path / "ours.npy", SHAPE) as writer:
        writer.write(0, array)
    np.save(tmp_path / "numpys.npy", array)
    assert (tmp_path / "ours.npy").read_bytes() == (tmp_path / "numpys.npy").read_bytes()


def test_a_cube_of_zeros_is_complete(tmp_path):
    with create_cube(tmp_path / "cube.zarr", SHAPE) as writer:
        writer.write(0, np.zeros(SHAPE, np.complex64))
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


def fail(error):
    raise error


@pytest.mark.parametrize("filename", FILES)
def test_writing_that_is_interrupted_leaves_nothing_and_passes_the_reason_on(tmp_path, filename):
    for ending in (KeyboardInterrupt(), SystemExit(), OSError("on fire"), ZeroDivisionError()):
        with pytest.raises(type(ending)) as raised:
            fill(tmp_path / filename, {0: random_cube()[:12]}, partial(fail, ending))
        assert raised.value is ending
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("filename", FILES)
def test_subcarriers_that_were_not_written_are_told_and_leave_nothing(tmp_path, filename):
    with pytest.raises(InputError, match=r"3 of 24 subcarriers were not written, subcarrier 7 first$"):
        fill(tmp_path / filename, {0: random_cube()[:7], 10: random_cube()[10:]})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("filename", FILES)
def test_what_exists_is_not_overwritten_even_if_it_came_meanwhile(tmp_path, filename):
    path = tmp_path / filename
    with pytest.raises(InputError, match="exists already and is not overwritten"):
        fill(path, {0: random_cube()}, lambda: path.write_text("mine"))
    assert path.read_text() == "mine"
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: exists already"):
        create_cube(path, SHAPE).__enter__()
    assert [found.name for found in tmp_path.iterdir()] == [filename]


@pytest.mark.parametrize(
    ("name", "shape", "dtype", "reason"),
    [
        ("c.h5", SHAPE, "c8", "has suffix '.h5'; a cube is written as .npy, .zarr$"),
        ("c", SHAPE, "c8", "has no suffix"),
        ("none/c.npy", SHAPE, "c8", "its folder .*none does not exist$"),
        ("c.npy", SHAPE[:3], "c8", "has 3 axes"),
        ("c.npy", SHAPE, "f8", "holds float64"),
        ("c.npy", (0, 1, 1, 1), "c8", "is empty"),
    ],
)
def test_what_cannot_be_created_is_told_before_work(tmp_path, name, shape, dtype, reason):
    with pytest.raises(InputError, match=f"^{re.escape(str(tmp_path / name))}: {reason}"):
        create_cube(tmp_path / name, shape, dtype).__enter__()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_told_before_work(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 0, 10**9))
    with pytest.raises(InputError, match=r"takes 1\.03 GB, its disk has 1\.00 GB left$"):
        create_cube(tmp_path / "c.npy", (1000, 500, 16, 16), np.complex64).__enter__()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("first", "block", "reason"),
    [
        (0, np.ones((2, *SHAPE[1:])), r"takes complex numbers of shape \(n, 10, 3, 4\), not float64"),
        (0, np.ones((2, 3), np.complex64), r"not complex64 of shape \(2, 3\)$"),
        (-1, random_cube()[:2], "a block of 2 subcarriers from -1 on does not lie in the cube's 24$"),
        (23, random_cube()[:2], "a block of 2 subcarriers from 23 on"),
        (0, np.ma.masked_less(random_cube()[:2], -1), "a block has .* masked numbers of 240"),
        (0, 1e40 * random_cube(dtype=np.complex128)[:2], "numbers that are too large for complex64$"),
        (0, 1e-60 * random_cube(dtype=np.complex128)[:2], "numbers that are too small for complex64$"),
        (0, random_cube()[:0], "a block of 0 subcarriers from 0 on"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(tmp_path, first, block, reason):
    with pytest.raises(InputError, match=reason):
        fill(tmp_path / "c.npy", {first: block})
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr("pathlib.Path.open", lambda *_: (_ for _ in ()).throw(PermissionError(13, "denied")))
    with pytest.raises(InputError, match=r"c\.npy: cannot be written: denied$"):
        create_cube(tmp_path / "c.npy", SHAPE).__enter__()
