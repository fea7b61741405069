"""Cubes and grids in zarr stores of versions 2 and 3, in a folder or in a zip file."""

from __future__ import annotations

import os
import zipfile
from contextlib import ExitStack, closing
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.cubes.cube import complex_grid, require_grid
from isacbench.cubes.formats.chunked import ChunkedCube, Stored, require_chunk
from isacbench.cubes.formats.cube_files import CUBE, GRID, choose, grid_beside
from isacbench.errors import InputError
from isacbench.files.arrays.listing import Listed, as_complex, complex_dtype
from isacbench.files.checked_files import require_file, require_inside

if TYPE_CHECKING:
    from collections.abc import Callable

    import zarr
    from numpy.typing import NDArray
    from zarr.abc.store import Store

    from isacbench.cubes.cube import ComplexArray

DESCRIPTIONS = ("zarr.json", ".zarray")
"""What files are called that describe an array, in either version; one of them groups as well."""

MOST_CHUNKS = 2**22
"""Of a cube: more would hold less than thirty numbers each at the paper's size."""


def open_zarr(path: Path, tile_bytes: int) -> ChunkedCube:
    """Open a cube in a zarr store.

    Parameters
    ----------
    path : Path
        A folder or a zip file.
    tile_bytes : int
        Memory that a tile may touch.

    Raises
    ------
    InputError
        If it does not tell which of its arrays is a cube, or that lacks chunks.
    """
    with ExitStack() as on_failure:
        store = on_failure.enter_context(closing(_store(path)))
        arrays = _arrays(store, path)
        name = choose(path, _listed(arrays), CUBE)
        cube = zarr_cube(arrays[name], _called(path, name), tile_bytes, store.close)
        cube.transmitted = grid_beside(
            path, _listed(arrays), cube.shape, lambda grid: _grid(_called(path, grid), arrays[grid])
        )
        on_failure.pop_all()
    return cube


def zarr_cube(
    array: zarr.Array[Any], name: str, tile_bytes: int, close: Callable[[], None] = lambda: None
) -> ChunkedCube:
    """Make a cube of an open zarr array.

    Parameters
    ----------
    array : zarr.Array
    name : str
        What messages call it.
    tile_bytes : int
        Memory that a tile may touch.
    close : callable
        Closes the store.

    Raises
    ------
    InputError
        If it is no cube, or lacks chunks.
    """

    def read(box: tuple[slice, ...]) -> NDArray[Any]:
        return as_complex(np.asarray(array[box]))

    if array.nchunks > MOST_CHUNKS:  # which would be looked for one by one
        raise InputError(f"{name}: has {array.nchunks} chunks; allowed are at most {MOST_CHUNKS}")
    cube = ChunkedCube(name, Stored(array.shape, array.chunks, array.dtype, read), tile_bytes, close)
    present, wanted = array.nchunks_initialized, array.nchunks
    if present < wanted:
        raise InputError(
            f"{name}: lacks {wanted - present} of {wanted} chunks; if they hold zeros, "
            "write them with the zarr setting write_empty_chunks"
        )
    return cube


def read_zarr_grid(path: Path) -> ComplexArray:
    """Read a transmitted grid from a zarr store.

    Raises
    ------
    InputError
        If it does not tell which of its arrays is a grid.
    """
    with closing(_store(path)) as store:
        arrays = _arrays(store, path)
        name = choose(path, _listed(arrays), GRID)
        return _grid(_called(path, name), arrays[name])


def _store(path: Path) -> Store:
    """Open the store of a path."""
    from zarr.storage import LocalStore, ZipStore

    if not path.is_dir():
        return ZipStore(path, mode="r")
    _require_files(path, path)
    return LocalStore(path, read_only=True)


def _require_files(folder: Path, store: Path) -> None:
    """Refuse what is neither file nor folder of the store's own: links to elsewhere, pipes without an end."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                _require_files(Path(entry), store)
            elif not entry.is_file(follow_symlinks=False):
                require_inside(Path(entry), store)
                require_file(Path(entry))


def _arrays(store: Store, path: Path) -> dict[str, zarr.Array[Any]]:
    """All arrays of a store by their paths in it; the only one of a store that is an array has none."""
    import zarr

    root = zarr.open(store, mode="r")
    if isinstance(root, zarr.Array):
        return {"": root}
    # One by one: of members that are damaged zarr's own list leaves tracebacks on the terminal.
    members = {name: zarr.open(store, path=name, mode="r") for name in _described(path)}
    return {name: member for name, member in members.items() if isinstance(member, zarr.Array)}


def _described(path: Path) -> list[str]:
    """Paths in a store at which something is described, sorted."""
    if path.is_dir():
        names = [found.relative_to(path).as_posix() for name in DESCRIPTIONS for found in path.rglob(name)]
    else:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    places = [PurePosixPath(name) for name in names]
    return sorted({str(place.parent) for place in places if place.name in DESCRIPTIONS} - {"."})


def _listed(arrays: dict[str, zarr.Array[Any]]) -> dict[str, Listed]:
    return {name: Listed(array.shape, complex_dtype(array.dtype)) for name, array in arrays.items()}


def _called(path: Path, name: str) -> str:
    return f"{path}: {name}" if name else str(path)


def _grid(name: str, array: zarr.Array[Any]) -> ComplexArray:
    """Read an array as a transmitted grid."""
    require_grid(name, array.shape, complex_dtype(array.dtype))
    require_chunk(name, array.shards or array.chunks, array.dtype, array.shape)
    return complex_grid(as_complex(np.asarray(array[:])))
