"""Cubes and grids in npy files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from isacbench.cubes.cube import complex_grid, describe_array, require_cube, require_grid
from isacbench.cubes.formats.cube_files import require_size
from isacbench.cubes.formats.raw_cubes import RawCube
from isacbench.files.arrays.mapped import MappedBytes
from isacbench.files.arrays.npy_files import read_array, read_header
from isacbench.files.arrays.raw_arrays import RawArray
from isacbench.files.checked_files import GRID_BYTES

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.cubes.cube import ComplexArray


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
    require_size(path, header.end, describe_array(shape, header.dtype))
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
        require_size(path, header.end, describe_array(header.shape, header.dtype))
        file.seek(0)
        return complex_grid(read_array(file, header.end, GRID_BYTES))
