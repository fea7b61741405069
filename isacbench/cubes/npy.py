"""Cubes and grids in npy files."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isacbench.cubes.cube import complex_grid, describe, require_cube, require_grid
from isacbench.cubes.files import require_size
from isacbench.cubes.mapped import MappedBytes
from isacbench.cubes.raw import Order, RawArray, RawCube

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.cubes.cube import ComplexArray

__all__ = ["Header", "open_npy", "read_header", "read_npy_grid"]


class Header(NamedTuple):
    """What an npy header says of the array behind it.

    Attributes
    ----------
    shape : tuple of int
    order : {"C", "F"}
    dtype : dtype
    offset : int
        Byte at which the numbers begin.
    """

    shape: tuple[int, ...]
    order: Order
    dtype: np.dtype[Any]
    offset: int

    @property
    def end(self) -> int:
        """Byte behind the last number."""
        return self.offset + int(np.prod(self.shape, dtype=object)) * self.dtype.itemsize


def open_npy(path: Path, tile_bytes: int) -> RawCube:
    """Open a cube in an npy file, mapped tile by tile.

    Parameters
    ----------
    path : Path
    tile_bytes : int
        Memory that a tile may touch.

    Raises
    ------
    InputError
        If it holds no cube, or is shorter than its header says.
    """
    with path.open("rb") as file:
        header = read_header(file)
    shape = require_cube(str(path), header.shape, header.dtype)
    require_size(path, header.end, describe(shape, header.dtype))
    array = RawArray(MappedBytes(path), header.offset, shape, header.dtype, header.order)
    return RawCube(str(path), array, None, tile_bytes)


def read_npy_grid(path: Path) -> ComplexArray:
    """Read a transmitted grid from an npy file.

    Raises
    ------
    InputError
        If it holds no grid, or is shorter than its header says.
    """
    with path.open("rb") as file:
        header = read_header(file)
        require_grid(str(path), header.shape, header.dtype)
        require_size(path, header.end, describe(header.shape, header.dtype))
        file.seek(0)
        return complex_grid(np.lib.format.read_array(file, allow_pickle=False))


def read_header(file: IO[bytes]) -> Header:
    """Read the header of an npy file from where it begins.

    Raises
    ------
    ValueError
        If it is none; nothing is ever unpickled.
    """
    start = file.tell()
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, fortran_order, dtype = np.lib.format.read_array_header_1_0(file)
    elif version == (2, 0):
        shape, fortran_order, dtype = np.lib.format.read_array_header_2_0(file)
    else:
        # Version 3 differs in the names of fields, which complex numbers do not have.
        raise ValueError(f"version {version} of the format, where arrays of numbers have 1.0 or 2.0")
    return Header(shape, "F" if fortran_order else "C", dtype, file.tell() - start)
