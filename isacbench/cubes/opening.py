"""Opening recorded cubes and transmitted grids, from arrays or from files of any known format."""

import re
import warnings
from collections import Counter
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from isacbench.checked_arrays import Complex
from isacbench.cubes.tiles import (
    CUBE_NAME,
    GRID_NAME,
    TILE_BYTES,
    Cube,
    require_cube,
    require_grid,
    require_grid_of,
)
from isacbench.errors import InputError, InputWarning
from isacbench.files import arrays
from isacbench.files.arrays import Entries, StoredArray
from isacbench.files.checked_files import HELD_BYTES, binary_size, known_suffix, require_file

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
        of four axes. An array named ``transmitted`` is the transmitted grid;
        without it, no other may be one.
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

    Warns
    -----
    InputWarning
        If the file holds other arrays or objects that may be data of the frame.

    Examples
    --------
    >>> with open_cube(np.ones((8, 4, 2, 2), np.complex64)) as cube:
    ...     cube.shape, str(cube.dtype)
    ((8, 4, 2, 2), 'complex64')
    """
    cube = reopen_cube(source, tile_bytes)
    _warn(cube.unused)
    return cube


def reopen_cube(source: Any, tile_bytes: int = TILE_BYTES) -> Cube:
    """Open a recorded cube as `open_cube` does, without its warning."""
    if isinstance(source, str | Path):
        return _open_file(Path(source), tile_bytes)
    if isinstance(source, Cube):
        return source
    if isinstance(source, np.ndarray):
        return Cube("array", source, tile_bytes)
    kind = type(source)
    match kind.__module__.partition(".")[0], kind.__name__:  # libraries that may not be installed
        case "h5py", "Dataset":
            name = f"{source.file.filename}: {source.name}"
            return _cube_of(name, arrays.hdf5_array(source, name), tile_bytes)
        case "zarr", "Array":
            name = str(source.store_path)
            return _cube_of(name, arrays.zarr_array(source, name), tile_bytes)
    raise InputError(f"a cube is a NumPy array, an h5py dataset, a zarr array or a path, not {kind.__name__}")


def read_grid(path: str | Path) -> Complex:
    """Read a transmitted grid.

    Parameters
    ----------
    path : str or Path
        A file as for `open_cube`. Of several arrays the grid is the one named
        ``transmitted``, else the only one of two axes, at the root if there is
        one.

    Returns
    -------
    ndarray of complex64 or complex128, shape (N, M)

    Raises
    ------
    InputError
        If the file is missing, of an unknown format or damaged, or holds no
        grid or several arrays that may be it.

    Warns
    -----
    InputWarning
        If the file holds other arrays or objects that may be data of the frame.
    """
    path = Path(path)
    _require_format(path)
    with arrays.open_arrays(path) as (entries, _):
        name, grid = _only_grid(path, entries)
        unused = _unused_data(path, entries, {name, *_all_named(entries, CUBE_NAME)}, grid.shape)
    _warn(unused)
    return grid


def _open_file(path: Path, tile_bytes: int) -> Cube:
    """Open the cube of a file, with its transmitted grid."""
    _require_format(path)
    with arrays.open_arrays(path) as (entries, opened):
        name, stored = _only_array(path, entries, CUBE_NAME, 4)
        cube, used = _cube_of(_place_in_file(path, name), stored, tile_bytes), {name}
        if _all_named(entries, GRID_NAME):
            name, cube.transmitted = _only_grid(path, entries)
            used.add(name)
            require_grid_of(cube, cube.transmitted)
        cube.unused = _unused_data(path, entries, used, cube.shape[:2])
        cube.close = opened.pop_all().close
    return cube


def _warn(unused: str) -> None:
    if unused:
        warnings.warn(unused, InputWarning, stacklevel=3)


def _unused_data(path: Path, entries: Entries, used: set[str], shape: tuple[int, ...]) -> str:
    """Say what may be data of the frame beside what is used, and refuse what may be the grid."""
    others = {name: entry for name, entry in entries.items() if name not in used}
    has_grid = bool(_all_named(entries, GRID_NAME))
    unclear = {
        name: entry
        for name, entry in others.items()
        if (not has_grid or _is_called_grid(name)) and _may_be_grid(name, entry, shape)
    }
    if unclear:
        raise InputError(
            f"{path}: holds {arrays.names_of(unclear)}, which may be the transmitted grid; "
            f"allowed is one array named {GRID_NAME!r}"
        )
    unused = {name: entry for name, entry in others.items() if _may_be_data(entry, shape)}
    return f"{path}: does not use {arrays.names_of(unused)}" if unused else ""


def _cube_of(name: str, stored: StoredArray, tile_bytes: int) -> Cube:
    """Make a cube of a stored array: read in parts where its format allows it, or else as a whole."""
    stored = stored.with_dropped_ones(4)
    if stored.chunks or stored.strides:
        return Cube(name, stored, tile_bytes)
    require_cube(name, stored.shape, stored.dtype)
    if stored.n_bytes > HELD_BYTES:
        raise InputError(
            f"{name}: {stored} takes {binary_size(stored.n_bytes)}; allowed are at most "
            f"{binary_size(HELD_BYTES)} in a file that is read as a whole, and any size in {READ_IN_PARTS}"
        )
    return Cube(name, stored.whole(), tile_bytes)


def _only_grid(path: Path, entries: Entries) -> tuple[str, Complex]:
    """Read the transmitted grid in C order and native byte order; real numbers become complex128."""
    name, stored = _only_array(path, entries, GRID_NAME, 2)
    require_grid(_place_in_file(path, name), stored.shape, stored.dtype)
    values = stored.whole()
    dtype = values.dtype.newbyteorder("=") if values.dtype.kind == "c" else np.dtype(np.complex128)
    return name, np.ascontiguousarray(values, dtype=dtype)


def _only_array(path: Path, entries: Entries, wanted: str, n_axes: int) -> tuple[str, StoredArray]:
    """Take the array of a name, else the only one of `n_axes` axes; unnamed formats hold just one."""
    stored = {name: entry for name, entry in entries.items() if isinstance(entry, StoredArray)}
    fitting = [name for name, array in stored.items() if not name or len(array.shape) == n_axes]
    at_root = [name for name in fitting if "/" not in name and n_axes == 2]  # settings may lie in groups
    named = _all_named(entries, wanted)
    names = named or at_root or fitting
    if len(names) == 1 and names[0] in stored:
        return names[0], stored[names[0]]
    others = "" if named else f", or exactly one array with {n_axes} axes"
    contents = arrays.names_of({name: entries[name] for name in named or entries}) or "no arrays"
    raise InputError(f"{path}: needs an array named {wanted!r}{others}; it holds {contents}")


def _all_named(entries: Entries, wanted: str) -> list[str]:
    """Names of all that is called the cube or the grid; what lies in a group of that name is the grid."""
    place = np.s_[-1:] if wanted == CUBE_NAME else np.s_[:]
    return [name for name in entries if wanted in re.split(r"[/.\\]", _plain(name))[place]]


def _plain(name: str) -> str:
    """Path of an entry in small letters, without underscores and the like."""
    return re.sub(r"[^\w/.\\]|_", "", name).lower()


def _is_called_grid(name: str) -> bool:
    return GRID_NAME in _plain(name)


def _may_be_grid(name: str, entry: StoredArray | str, shape: tuple[int, ...]) -> bool:
    """Tell if an entry may have a number for each of the (subcarriers, symbols); cubes and axes do not."""
    # Beside a frame of one symbol, real numbers are the frequencies.
    if isinstance(entry, str) or entry.dtype.kind not in ("cV" if 1 in shape else "biufcV"):
        return False
    n, is_full = prod(entry.shape), Counter(shape) <= Counter(entry.shape) and len(entry.shape) != 4
    return n > 1 and (is_full or n == prod(shape) or _is_called_grid(name))


def _may_be_data(entry: StoredArray | str, shape: tuple[int, ...]) -> bool:
    """Tell if an entry may hold samples of the frame; scalars, texts and small real arrays do not."""
    if isinstance(entry, str):
        return entry not in arrays.TEXTS
    least = {"c": 2, "V": 1, "O": 1}.get(entry.dtype.kind, prod(shape))
    return entry.dtype.kind not in "SUT" and prod(entry.shape) >= least


def _place_in_file(path: Path, name: str) -> str:
    return f"{path}: {name}" if name else str(path)


def _require_format(path: Path) -> None:
    """Refuse a path that is neither a file of a known format nor a folder of zarr."""
    if known_suffix(path, arrays.FORMATS, "allowed are") != ".zarr" or not path.is_dir():
        require_file(path)
