"""Opening recorded cubes and transmitted grids, from arrays or from files of any known format."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.cubes.array_cubes import ArrayCube
from isacbench.cubes.chunked import ChunkedCube
from isacbench.cubes.cube import CUBE_NAME, GRID_NAME, TILE_BYTES, Cube, require_cube, require_grid
from isacbench.errors import InputError
from isacbench.files.arrays.array_files import FORMATS, listed_arrays
from isacbench.files.arrays.hdf5_files import dataset_array
from isacbench.files.arrays.stored_arrays import ChunkedArray, StoredArray
from isacbench.files.arrays.zarr_stores import zarr_array
from isacbench.files.checked_files import HELD_BYTES, binary_size, require_file
from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    from isacbench.cubes.cube import ComplexArray
    from isacbench.files.arrays.stored_arrays import ArrayFile

READ_IN_PARTS = ".npy, .h5, .hdf5, .zarr and MATLAB's -v7.3"
"""Formats that can be read in parts."""


def open_cube(source: Any, *, tile_bytes: int = TILE_BYTES) -> Cube:
    """Open a recorded cube; of a file, only headers and the transmitted grid are read.

    Parameters
    ----------
    source : ndarray, h5py.Dataset, zarr.Array, str, Path or Cube
        An array (N, M, P, Q) of complex64 or complex128, or a file that holds
        one: npy, npz, mat, h5, hdf5, zarr, or zip with zarr in it. In a file
        of several arrays the cube is the one named ``cube``, else the only one
        of four axes. An array named ``transmitted`` is the transmitted grid.
    tile_bytes : int
        Largest memory that a tile may touch, in bytes.

    Returns
    -------
    Cube
        A context manager, which closes what it opened.

    Raises
    ------
    InputError
        If the file is missing, of an unknown format or damaged, or if the array is not a cube.

    Examples
    --------
    >>> with open_cube(np.ones((8, 4, 2, 2), np.complex64)) as cube:
    ...     cube.shape, str(cube.dtype)
    ((8, 4, 2, 2), 'complex64')
    """
    if isinstance(source, str | Path):
        return _open_file(Path(source), tile_bytes)
    if isinstance(source, Cube):
        return source
    if isinstance(source, np.ndarray):
        return ArrayCube(source, tile_bytes=tile_bytes)
    if _is_a(source, "h5py", "Dataset"):
        name = f"{source.file.filename}: {source.name}"
        return _cube_of(name, dataset_array(source, name), tile_bytes)
    if _is_a(source, "zarr", "Array"):
        name = str(source.store_path)
        return _cube_of(name, zarr_array(source, name), tile_bytes)
    raise InputError(
        f"a cube is a NumPy array, an h5py dataset, a zarr array or a path, not {type(source).__name__}"
    )


def read_grid(path: str | Path) -> ComplexArray:
    """Read a transmitted grid.

    Parameters
    ----------
    path : str or Path
        A file as for `open_cube`. Of several arrays the grid is the one named
        ``transmitted``, else the only one of two axes.

    Returns
    -------
    ndarray of complex64 or complex128, shape (N, M)

    Raises
    ------
    InputError
        If the file is missing, of an unknown format or damaged, or holds no grid.
    """
    path = Path(path)
    _require_format(path)
    with listed_arrays(path) as file, closing(file):
        return _read_grid(path, *_choose(path, file, GRID_NAME, 2))


def _open_file(path: Path, tile_bytes: int) -> Cube:
    """Open the cube of a file, with its transmitted grid."""
    _require_format(path)
    with listed_arrays(path) as file:
        name, stored = _choose(path, file, CUBE_NAME, 4)
        cube = _cube_of(_called(path, name), stored, tile_bytes)
        cube.close = file.close
        grid = file.arrays.get(GRID_NAME)
        if isinstance(grid, StoredArray):
            cube.transmitted = _read_grid(path, GRID_NAME, grid)
            if cube.transmitted.shape != cube.shape[:2]:
                raise InputError(
                    f"{path}: {GRID_NAME} has shape {cube.transmitted.shape}; the cube needs a grid of "
                    f"shape {cube.shape[:2]}: (subcarriers, symbols)"
                )
    return cube


def _cube_of(name: str, stored: StoredArray, tile_bytes: int) -> Cube:
    """Make a cube of a stored array: read in chunks, memory-mapped, or read as a whole."""
    if isinstance(stored, ChunkedArray):
        return ChunkedCube(name, stored, tile_bytes)
    shape = require_cube(name, stored.shape + stored.dropped_ones(4), stored.dtype)
    if stored.is_mapped:
        return ArrayCube(stored.read(), name, tile_bytes, remap=stored.read)
    if stored.n_bytes > HELD_BYTES:
        raise InputError(
            f"{name}: {stored} takes {binary_size(stored.n_bytes)}; allowed are at most "
            f"{binary_size(HELD_BYTES)} in a file that is read as a whole, and any size in {READ_IN_PARTS}"
        )
    return ArrayCube(stored.read().reshape(shape), name, tile_bytes)


def _read_grid(path: Path, name: str, stored: StoredArray) -> ComplexArray:
    """Read a transmitted grid in C order and native byte order; real numbers become complex128."""
    require_grid(_called(path, name), stored.shape, stored.dtype)
    values = stored.read()
    dtype = values.dtype.newbyteorder("=") if values.dtype.kind == "c" else np.dtype(np.complex128)
    return np.ascontiguousarray(values, dtype=dtype)


def _choose(path: Path, file: ArrayFile, wanted: str, n_axes: int) -> tuple[str, StoredArray]:
    """Find an array by its name, or else as the only one of `n_axes` axes; unnamed formats hold just one."""
    arrays = {name: array for name, array in file.arrays.items() if isinstance(array, StoredArray)}
    for name in (wanted, ""):
        if name in arrays:
            return name, arrays[name]
    fitting = [name for name, array in arrays.items() if len(array.shape) == n_axes]
    if len(fitting) == 1:
        return fitting[0], arrays[fitting[0]]
    found = ", ".join(f"{name} ({array})".strip() for name, array in file.arrays.items())
    raise InputError(
        f"{path}: needs an array named {wanted!r}, or exactly one array with {n_axes} axes; "
        f"it holds {shortened(found) or 'no arrays'}"
    )


def _called(path: Path, name: str) -> str:
    return f"{path}: {name}" if name else str(path)


def _require_format(path: Path) -> None:
    """Refuse a path that is neither a file of a known format nor a folder of zarr."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(f"{path}: has {found}; allowed are {', '.join(FORMATS)}")
    if suffix != ".zarr" or not path.is_dir():
        require_file(path)


def _is_a(source: object, module: str, name: str) -> bool:
    """Tell if an object is an instance of a library's class, without importing that library."""
    library = sys.modules.get(module)
    return library is not None and isinstance(source, getattr(library, name))
