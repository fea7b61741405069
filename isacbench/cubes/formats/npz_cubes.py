"""Cubes and grids in npz files: npy files in a zip archive, stored or compressed."""

from __future__ import annotations

import struct
import zipfile
from typing import TYPE_CHECKING

from isacbench.cubes.cube import complex_grid, describe_array, require_cube, require_grid
from isacbench.cubes.formats.cube_files import CUBE, GRID, choose, grid_beside
from isacbench.cubes.formats.raw_cubes import RawCube
from isacbench.errors import InputError
from isacbench.files.arrays.inflated import RAW_DEFLATE, InflatedBytes
from isacbench.files.arrays.listing import Listed
from isacbench.files.arrays.mapped import Bytes, MappedBytes
from isacbench.files.arrays.npy_files import SUFFIX, Header, read_array, read_header
from isacbench.files.arrays.raw_arrays import RawArray
from isacbench.files.checked_files import GRID_BYTES

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.cubes.cube import ComplexArray

LOCAL_HEADER = struct.Struct("<4s22xHH")


def open_npz(path: Path, tile_bytes: int) -> RawCube:
    """Open a cube in an npz file: mapped in place where stored, decompressed as a stream otherwise.

    Parameters
    ----------
    path : Path
    tile_bytes : int
        Memory that a tile may touch.

    Raises
    ------
    InputError
        If it does not tell which of its arrays is a cube, if that is shorter
        than its header says, or compressed otherwise than by deflate.
    """
    with zipfile.ZipFile(path) as archive:
        headers = _headers(archive)
        name = choose(path, _listed(headers), CUBE)
        header, member = headers[name], archive.getinfo(name + SUFFIX)
        shape = require_cube(f"{path}: {name}", header.shape, header.dtype)
        _require_whole(path, name, header, member)
        transmitted = grid_beside(path, _listed(headers), shape, lambda grid: _grid(path, archive, grid))
        source = _bytes_of(path, member)
    array = RawArray(source, header.offset, shape, header.dtype, header.order)
    return RawCube(f"{path}: {name}", array, transmitted, tile_bytes)


def read_npz_grid(path: Path) -> ComplexArray:
    """Read a transmitted grid from an npz file.

    Raises
    ------
    InputError
        If it does not tell which of its arrays is a grid.
    """
    with zipfile.ZipFile(path) as archive:
        headers = _headers(archive)
        return _grid(path, archive, choose(path, _listed(headers), GRID))


def _headers(archive: zipfile.ZipFile) -> dict[str, Header]:
    """Headers of all arrays by name."""
    headers = {}
    for member in archive.namelist():
        if member.endswith(SUFFIX):
            with archive.open(member) as file:
                headers[member.removesuffix(SUFFIX)] = read_header(file)
    return headers


def _listed(headers: dict[str, Header]) -> dict[str, Listed]:
    return {name: Listed(header.shape, header.dtype) for name, header in headers.items()}


def _grid(path: Path, archive: zipfile.ZipFile, name: str) -> ComplexArray:
    """Read one array as a transmitted grid."""
    with archive.open(name + SUFFIX) as file:
        header = read_header(file)
    require_grid(f"{path}: {name}", header.shape, header.dtype)
    with archive.open(name + SUFFIX) as file:
        return complex_grid(read_array(file, archive.getinfo(name + SUFFIX).file_size, GRID_BYTES))


def _require_whole(path: Path, name: str, header: Header, member: zipfile.ZipInfo) -> None:
    """Refuse an array that is shorter than its header says."""
    if member.file_size < header.end:
        array = describe_array(header.shape, header.dtype)
        raise InputError(
            f"{path}: {name} is truncated: {array} takes {header.end} bytes, it has {member.file_size}"
        )


def _bytes_of(path: Path, member: zipfile.ZipInfo) -> Bytes:
    """Bytes of a member of the archive as they were before compression."""
    start = _data_offset(path, member)
    if member.compress_type == zipfile.ZIP_STORED:
        return MappedBytes(path, start)
    if member.compress_type == zipfile.ZIP_DEFLATED:
        stop = start + member.compress_size
        return InflatedBytes(path, start, stop, member.file_size, RAW_DEFLATE, member.CRC)
    raise InputError(
        f"{path}: {member.filename} is compressed with method {member.compress_type}; "
        f"allowed are those of numpy.savez and numpy.savez_compressed"
    )


def _data_offset(path: Path, member: zipfile.ZipInfo) -> int:
    """Where in the file the data of a member begin, behind a header of its own and two strings."""
    with path.open("rb") as file:
        file.seek(member.header_offset)
        _, name_length, extra_length = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
    return int(member.header_offset + LOCAL_HEADER.size + name_length + extra_length)
