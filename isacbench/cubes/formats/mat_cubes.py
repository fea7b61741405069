"""Cubes and grids in MATLAB's mat files."""

from __future__ import annotations

from contextlib import ExitStack
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from isacbench.cubes.cube import Cube, Tile, complex_grid, require_cube, require_elements, require_grid
from isacbench.cubes.formats.cube_files import CUBE, GRID, choose, grid_beside
from isacbench.cubes.formats.hdf5 import open_hdf5, read_hdf5_grid
from isacbench.files.arrays import mat5
from isacbench.files.arrays.hdf5_datasets import is_hdf5
from isacbench.files.arrays.raw_arrays import raw_extents
from isacbench.files.checked_files import GRID_BYTES

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from isacbench.cubes.cube import ComplexArray
    from isacbench.files.arrays.mapped import Bytes
    from isacbench.files.arrays.mat5 import MatArray
    from isacbench.files.arrays.raw_arrays import RawArray
    from isacbench.files.arrays.tiling import Extent, Indices


class MatCube(Cube):
    """A cube in a mat file of version 5 to 7: all real parts, then all imaginary parts.

    Parts that are mapped are put together tile by tile. Those of a stream are
    tiles of their own, so that it is decompressed once: real tiles first, then
    imaginary ones.

    Parameters
    ----------
    path : Path
    name : str
        The array's.
    array : MatArray
    source : Bytes
        Of the array, see `mat5.open_bytes`; closed with the cube.
    tile_bytes : int
        Memory that a tile may touch.
    """

    def __init__(self, path: Path, name: str, array: MatArray, source: Bytes, tile_bytes: int) -> None:
        self.name = f"{path}: {name}"
        self.shape = _cube_shape(path, name, array)
        self.dtype = array.listed.dtype
        self.transmitted: ComplexArray | None = None
        self._tile_cells = tile_bytes // self.dtype.itemsize
        self._source = source
        self._real = mat5.real_part(path, source, array, self.shape)
        self._find_imaginary = partial(mat5.imaginary_part, path, source, array, self.shape)
        if not source.sequential:
            _ = self._imaginary  # A damaged one is told before any work.

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements into tiles, see `Cube.tiles`."""
        require_elements(self, elements)
        if not len(elements):
            return
        loads = (self._load_real, self._load_imaginary) if self._source.sequential else (self._load_both,)
        for load in loads:
            for extent in raw_extents(self.shape, "F", elements, self._tile_cells):
                yield Tile(*extent, partial(load, extent, elements[extent.elements]))

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    @cached_property
    def _imaginary(self) -> RawArray:
        return self._find_imaginary()

    def _load_real(self, extent: Extent, elements: Indices) -> ComplexArray:
        return self._real.load(extent, elements).astype(self.dtype)

    def _load_imaginary(self, extent: Extent, elements: Indices) -> ComplexArray:
        part = self._imaginary.load(extent, elements)
        values = np.zeros_like(part, self.dtype)
        values.imag = part
        return values

    def _load_both(self, extent: Extent, elements: Indices) -> ComplexArray:
        values = self._load_real(extent, elements)
        values.imag = self._imaginary.load(extent, elements)
        return values


def open_mat(path: Path, tile_bytes: int) -> Cube:
    """Open a cube in a mat file.

    Parameters
    ----------
    path : Path
        Version 5 to 7, mapped where it is not compressed and decompressed as a
        stream otherwise, or version 7.3, which is HDF5.
    tile_bytes : int
        Memory that a tile may touch.

    Raises
    ------
    InputError
        If it is truncated, or does not tell which of its arrays is a cube.
    """
    if is_hdf5(path):
        return open_hdf5(path, tile_bytes)
    with ExitStack() as on_failure:
        arrays = mat5.list_arrays(path)
        listed = {name: array.listed for name, array in arrays.items()}
        name = choose(path, listed, CUBE)
        shape = _cube_shape(path, name, arrays[name])
        transmitted = grid_beside(path, listed, shape, lambda grid: _grid(path, grid, arrays[grid]))
        source = mat5.open_bytes(path, arrays[name])
        on_failure.callback(source.close)
        cube = MatCube(path, name, arrays[name], source, tile_bytes)
        cube.transmitted = transmitted
        on_failure.pop_all()
    return cube


def read_mat_grid(path: Path) -> ComplexArray:
    """Read a transmitted grid from a mat file.

    Raises
    ------
    InputError
        If it is truncated, or does not tell which of its arrays is a grid.
    """
    if is_hdf5(path):
        return read_hdf5_grid(path)
    arrays = mat5.list_arrays(path)
    name = choose(path, {name: array.listed for name, array in arrays.items()}, GRID)
    return _grid(path, name, arrays[name])


def _cube_shape(path: Path, name: str, array: MatArray) -> tuple[int, int, int, int]:
    """Shape of a cube with the trailing ones that MATLAB drops."""
    shape = array.listed.shape
    return require_cube(f"{path}: {name}", shape + (1,) * (4 - len(shape)), array.listed.dtype)


def _grid(path: Path, name: str, array: MatArray) -> ComplexArray:
    """Read one array as a transmitted grid."""
    require_grid(f"{path}: {name}", *array.listed)
    mat5.require_at_most(path, {name: array}, GRID_BYTES)
    return complex_grid(mat5.read_numbers(path, array))
