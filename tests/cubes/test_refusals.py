"""What is no cube is refused before any work, in words that name the file and what is allowed."""

from __future__ import annotations

import re
import zipfile

import h5py
import numpy as np
import pytest
import zarr

from isacbench.cubes import open_cube, read_grid
from isacbench.cubes.tiles import require_shape
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.numerology import System

from .samples import (
    FORMATS,
    SHAPE,
    all_elements,
    random_cube,
    sum_of_tiles,
    write_chunked_h5,
    write_h5,
    write_mat,
    write_mat73,
    write_npz,
    write_zarr,
    write_zarr2,
)

ARRAY = random_cube()


def refusal(path, opening=open_cube):
    """Message with which a file is refused, less its path."""
    with pytest.raises(InputError) as refused:
        opening(path)
    message = str(refused.value)
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


# Arrays


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (ARRAY.real, r"holds float32; a cube takes complex64 or complex128"),
        (np.ones(SHAPE, ">i2"), r"holds int16; a cube takes complex64 or complex128"),
        (np.ones(SHAPE, bool), r"holds bool; a cube takes"),
        (np.ones(SHAPE, np.clongdouble), "holds complex256; a cube takes complex64 or complex128"),
        (ARRAY[0], r"has 3 axes, shape \(10, 3, 4\); a cube takes four: \(subcarriers, symbols, P, Q\)"),
        (ARRAY[0, 0, 0], r"has 1 axis, shape \(4,\); a cube takes four"),
        (ARRAY[:, :0], r"is empty, shape \(24, 0, 3, 4\); a cube takes at least one"),
    ],
)
def test_an_array_that_is_no_cube_is_refused(tmp_path, array, reason):
    with pytest.raises(InputError, match=f"^array: {reason}"):
        open_cube(array)
    np.save(tmp_path / "cube.npy", array, allow_pickle=True)
    assert re.match(reason, refusal(tmp_path / "cube.npy"))
    np.savez(tmp_path / "cube.npz", cube=array, allow_pickle=True)
    assert re.match(f"cube: {reason}", refusal(tmp_path / "cube.npz"))


def test_other_things_than_arrays_and_paths_are_refused():
    with pytest.raises(InputError, match=r"^a cube is a NumPy array, .* or a path, not list$"):
        open_cube([[1j]])


@pytest.mark.parametrize("kind", FORMATS)
def test_an_element_outside_the_array_is_refused(tmp_path, kind):
    write, filename = FORMATS[kind]
    write(tmp_path / filename, cube=ARRAY)
    with open_cube(tmp_path / filename) as cube:
        for element in ((3, 0), (0, 4), (-1, 0)):
            with pytest.raises(InputError, match=re.escape(f"has no element {element}")):
                next(cube.tiles(np.array([(0, 0), element])))


# Files


@pytest.mark.parametrize("opening", [open_cube, read_grid])
def test_a_path_that_is_no_file_of_a_known_format_is_refused(tmp_path, opening):
    allowed = ".npy, .npz, .mat, .h5, .hdf5, .zarr, .zip"
    assert refusal(tmp_path / "cube.csv", opening) == f"has suffix '.csv'; allowed are {allowed}"
    assert refusal(tmp_path / "cube", opening) == f"has no suffix; allowed are {allowed}"
    assert refusal(tmp_path / "cube.npy", opening) == "does not exist"
    (tmp_path / "cube.h5").mkdir()
    assert refusal(tmp_path / "cube.h5", opening) == "is a folder, not a file"


def test_a_zip_file_of_zarr_that_is_none_is_told(tmp_path):
    (tmp_path / "cube.zip").write_text("junk")
    assert "not a zip file" in refusal(tmp_path / "cube.zip")


@pytest.mark.parametrize("kind", [kind for kind, (_, name) in FORMATS.items() if not name.endswith(".zarr")])
def test_a_truncated_file_is_refused_at_whatever_byte_it_ends(tmp_path, kind):
    write, filename = FORMATS[kind]
    path = tmp_path / filename
    for compressed in (False, True):
        write(path, cube=ARRAY, compressed=compressed)
        whole = path.read_bytes()
        for size in (1, 130, 200, len(whole) - 1):
            path.write_bytes(whole[:size])
            assert re.search("truncated|cannot be read as|wanted is", refusal(path)), (compressed, size)


@pytest.mark.parametrize("order", ["C", "F"])
def test_a_truncated_npy_file_says_how_much_it_lacks(tmp_path, order):
    path = tmp_path / "cube.npy"
    np.save(path, random_cube(order=order))
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.truncate(size - 1)
    wanted = f"is truncated: complex64 of shape {SHAPE} takes {size} bytes, the file has {size - 1}"
    assert refusal(path) == wanted


def test_damaged_chunks_are_told_when_they_are_met(tmp_path):
    write_h5(tmp_path / "c.h5", cube=ARRAY, compressed=True)
    with h5py.File(tmp_path / "c.h5") as file:
        chunk = file["cube"].id.get_chunk_info(0)
    with (tmp_path / "c.h5").open("r+b") as raw:
        raw.seek(chunk.byte_offset + chunk.size // 2)
        raw.write(bytes(100))
    write_zarr2(tmp_path / "c.zarr", cube=ARRAY)
    with (tmp_path / "c.zarr" / "cube" / "1.0.1.3").open("r+b") as raw:
        raw.truncate(100)
    for name in ("c.h5", "c.zarr"):
        told = f"^{re.escape(str(tmp_path / name))}: cube: is damaged: "
        with open_cube(tmp_path / name) as cube, pytest.raises(InputError, match=told):
            sum_of_tiles(cube, all_elements())


def test_checksums_are_compared(tmp_path):
    write_npz(tmp_path / "c.npz", cube=ARRAY, compressed=True)
    data = (tmp_path / "c.npz").read_bytes()
    with zipfile.ZipFile(tmp_path / "c.npz") as archive:
        crc = archive.getinfo("cube.npy").CRC.to_bytes(4, "little")
    (tmp_path / "c.npz").write_bytes(data.replace(crc, bytes(4)))
    assert "CRC" in refusal(tmp_path / "c.npz")
    write_mat(tmp_path / "c.mat", cube=ARRAY, compressed=True)
    data = bytearray((tmp_path / "c.mat").read_bytes())
    data[-1] ^= 1
    (tmp_path / "c.mat").write_bytes(data)
    assert "incorrect data check" in refusal(tmp_path / "c.mat")


def test_a_stored_array_that_is_shorter_than_its_header_says_is_refused(tmp_path):
    np.save(tmp_path / "cube.npy", ARRAY)
    data = (tmp_path / "cube.npy").read_bytes()
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        with zipfile.ZipFile(tmp_path / "c.npz", "w", method) as archive:
            archive.writestr("cube.npy", data[:-8])
        assert refusal(tmp_path / "c.npz") == (
            f"cube: is truncated: complex64 of shape {SHAPE} takes {len(data)} bytes, "
            f"the file has {len(data) - 8}"
        )


def test_a_cube_too_large_to_be_read_whole_is_told_the_formats_that_are_read_in_parts(tmp_path, monkeypatch):
    monkeypatch.setattr("isacbench.cubes.opening.HELD_BYTES", ARRAY.nbytes - 1)
    write_npz(tmp_path / "c.npz", cube=ARRAY)
    assert re.search(r"allowed are at most 22.5 KiB .* any size in \.npy, \.h5", refusal(tmp_path / "c.npz"))


def test_datasets_that_were_not_filled_are_refused(tmp_path):
    with h5py.File(tmp_path / "plain.h5", "w") as file:
        file.create_dataset("cube", SHAPE, np.complex64)
    assert refusal(tmp_path / "plain.h5") == "cube: is not complete: 0 of 1 chunks were written"
    with h5py.File(tmp_path / "chunked.h5", "w") as file:
        file.create_dataset("cube", SHAPE, np.complex64, chunks=(12, 10, 3, 2))[:12] = 1
    assert refusal(tmp_path / "chunked.h5") == "cube: is not complete: 2 of 4 chunks were written"
    with h5py.File(tmp_path / "chunked.h5") as file, pytest.raises(InputError, match="is not complete"):
        open_cube(file["cube"])


def test_a_zarr_store_that_lacks_chunks_is_refused(tmp_path):
    write_zarr2(tmp_path / "two.zarr", cube=ARRAY)
    write_zarr(tmp_path / "three.zarr", cube=ARRAY, chunks=(10, 10, 2, 1))
    for name, chunk in (("two.zarr", "cube/1.0.1.3"), ("three.zarr", "cube/c/1/0/1/3")):
        (tmp_path / name / chunk).unlink()
        assert refusal(tmp_path / name).startswith("cube: lacks 1 of 24 chunks; if they hold zeros, ")
    with pytest.raises(InputError, match="lacks 1 of 24 chunks"):
        open_cube(zarr.open(tmp_path / "two.zarr", mode="r")["cube"])


def test_a_refused_file_is_closed_again(tmp_path):
    """An open HDF5 file cannot be opened for writing; other open files warn, which is an error here."""
    write_chunked_h5(tmp_path / "c.h5", cube=ARRAY.real)
    write_mat73(tmp_path / "c.mat", cube=ARRAY, transmitted=np.ones((2, 2)))
    for name in ("c.h5", "c.mat"):
        refusal(tmp_path / name)
        h5py.File(tmp_path / name, "a").close()


# Grids


@pytest.mark.parametrize(
    ("grid", "reason"),
    [
        (np.array([["a"]]), "a transmitted grid takes complex64, complex128 or real numbers"),
        (np.ones(3), r"has shape \(3,\); a transmitted grid takes two axes: \(subcarriers, symbols\)"),
        (np.ones((0, 4)), r"has shape \(0, 4\); a transmitted grid takes two axes"),
    ],
)
def test_what_is_no_grid_is_refused(tmp_path, grid, reason):
    np.save(tmp_path / "g.npy", grid)
    assert re.search(reason, refusal(tmp_path / "g.npy", read_grid))
    np.savez(tmp_path / "g.npz", transmitted=grid)
    assert re.search(reason, refusal(tmp_path / "g.npz", read_grid))


# The scenario's shape


def test_a_cube_that_fits_the_scenario_passes():
    array = VirtualArray(tx_shape=(1, 2), rx_shape=(3, 2), tx_spacing=2)
    require_shape(open_cube(ARRAY), System(n_subcarriers=24, n_symbols=10), array)


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ((3, 2, 1, 0), ". The axes look permuted: numpy.transpose with axes (3, 2, 1, 0) would fit"),
        ((1, 0, 2, 3), ". The axes look permuted: numpy.transpose with axes (1, 0, 2, 3) would fit"),
        ((2, 0, 3, 1), ". The axes look permuted: numpy.transpose with axes (1, 3, 0, 2) would fit"),
        (None, ""),
    ],
)
def test_a_cube_of_another_shape_is_refused_and_permuted_axes_are_named(axes, words):
    found = ARRAY[1:] if axes is None else ARRAY.transpose(axes)
    array = VirtualArray(tx_shape=(1, 2), rx_shape=(3, 2), tx_spacing=2)
    with pytest.raises(InputError) as refused:
        require_shape(open_cube(found), System(n_subcarriers=24, n_symbols=10), array)
    assert str(refused.value) == (
        f"array: has shape {found.shape}; the scenario takes (24, 10, 3, 4): "
        f"(subcarriers, symbols, P, Q){words}"
    )
