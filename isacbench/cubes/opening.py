"""Opening recorded cubes and transmitted grids, whatever they are kept in."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isacbench.cubes.cube import TILE_BYTES
from isacbench.cubes.formats.array_cubes import ArrayCube
from isacbench.cubes.formats.cube_files import parsing
from isacbench.cubes.formats.hdf5 import dataset_cube, open_hdf5, read_hdf5_grid
from isacbench.cubes.formats.mat_cubes import open_mat, read_mat_grid
from isacbench.cubes.formats.npy_cubes import open_npy, read_npy_grid
from isacbench.cubes.formats.npz_cubes import open_npz, read_npz_grid
from isacbench.cubes.formats.zarr_cubes import open_zarr, read_zarr_grid, zarr_cube
from isacbench.errors import InputError
from isacbench.files.checked_files import require_file

if TYPE_CHECKING:
    from isacbench.cubes.cube import ComplexArray, Cube


def open_cube(source: Any, *, tile_bytes: int = TILE_BYTES) -> Cube:
    """Open a recorded cube; of a file, headers and the transmitted grid are read, and nothing else.

    Parameters
    ----------
    source : ndarray, h5py.Dataset, zarr.Array, str or Path
        An array (N, M, P, Q) of complex64 or complex128, or a file that holds
        one: npy, npz, mat, h5, hdf5, zarr, or zip with zarr in it. In a file
        of several arrays it is the one named ``cube``, else the only one of
        four axes; one named ``transmitted`` is the transmitted grid.
    tile_bytes : int
        Memory that a tile may touch.

    Returns
    -------
    Cube
        A context manager, which closes what it opened.

    Raises
    ------
    InputError
        If the file is missing, of an unknown format or damaged, or if the array is no cube.

    Examples
    --------
    >>> with open_cube(np.ones((8, 4, 2, 2), np.complex64)) as cube:
    ...     cube.shape, str(cube.dtype)
    ((8, 4, 2, 2), 'complex64')
    """
    if isinstance(source, str | Path):
        path = Path(source)
        file_format = _format_of(path)
        with parsing(path, file_format.name):
            return file_format.open_cube(path, tile_bytes)
    if isinstance(source, np.ndarray):
        return ArrayCube(source, tile_bytes=tile_bytes)
    if _is_a(source, "h5py", "Dataset"):
        return dataset_cube(source, f"{source.file.filename}: {source.name}", tile_bytes)
    if _is_a(source, "zarr", "Array"):
        return zarr_cube(source, str(source.store_path), tile_bytes)
    raise InputError(
        f"a cube is a NumPy array, an h5py dataset, a zarr array or a path, not {type(source).__name__}"
    )


def read_grid(path: str | Path) -> ComplexArray:
    """Read a transmitted grid.

    Parameters
    ----------
    path : str or Path
        A file as for `open_cube`. Of several arrays it is the one named
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
    file_format = _format_of(path)
    with parsing(path, file_format.name):
        return file_format.read_grid(path)


def _format_of(path: Path) -> _Format:
    """Format of an existing path by its suffix, upper or lower case."""
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(f"{path}: has {found}; allowed are {', '.join(_FORMATS)}")
    if suffix not in FOLDERS or not path.is_dir():
        require_file(path)
    return _FORMATS[suffix]


def _is_a(source: object, module: str, name: str) -> bool:
    """Whether something is an instance of a library's class; that library is not imported to tell."""
    library = sys.modules.get(module)
    return library is not None and isinstance(source, getattr(library, name))


class _Format(NamedTuple):
    """How a cube is opened and a transmitted grid is read; either raises whatever a damaged file leads to."""

    name: str
    open_cube: Callable[[Path, int], Cube]
    read_grid: Callable[[Path], ComplexArray]


_FORMATS: dict[str, _Format] = {
    ".npy": _Format("npy", open_npy, read_npy_grid),
    ".npz": _Format("npz", open_npz, read_npz_grid),
    ".mat": _Format("mat", open_mat, read_mat_grid),
    ".h5": _Format("HDF5", open_hdf5, read_hdf5_grid),
    ".hdf5": _Format("HDF5", open_hdf5, read_hdf5_grid),
    ".zarr": _Format("zarr", open_zarr, read_zarr_grid),
    ".zip": _Format("zarr", open_zarr, read_zarr_grid),
}
FOLDERS = (".zarr",)
"""Suffixes of formats that are, or can be, folders."""
