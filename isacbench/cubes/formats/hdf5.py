"""Cubes and grids in HDF5 files, MATLAB's version 7.3 among them."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.cubes.cube import complex_grid, require_grid
from isacbench.cubes.formats.chunked import ChunkedCube, Stored, as_complex, complex_dtype, require_chunk
from isacbench.cubes.formats.cube_files import CUBE, GRID, Listed, choose, grid_beside
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import h5py
    from numpy.typing import NDArray

    from isacbench.cubes.cube import ComplexArray

__all__ = [
    "MATLAB_ATTRIBUTE",
    "dataset_cube",
    "is_hdf5",
    "open_hdf5",
    "read_hdf5_grid",
    "require_filled",
    "require_own",
]

SIGNATURE = b"\x89HDF\r\n\x1a\n"
SIGNATURE_PLACES = (0, 512)
"""Where it stands: at the beginning, or behind MATLAB's header."""

MATLAB_ATTRIBUTE = "MATLAB_class"
"""MATLAB writes it beside every array, and the array's axes in reverse."""


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, with or without a header of MATLAB's."""
    with path.open("rb") as file:
        head = file.read(SIGNATURE_PLACES[-1] + len(SIGNATURE))
    return any(head[place:].startswith(SIGNATURE) for place in SIGNATURE_PLACES)


def open_hdf5(path: Path, tile_bytes: int) -> ChunkedCube:
    """Open a cube in an HDF5 file.

    Parameters
    ----------
    path : Path
    tile_bytes : int
        Memory that a tile may touch.

    Raises
    ------
    InputError
        If it does not tell which of its datasets is a cube, or that was not filled.
    """
    import h5py

    with ExitStack() as on_failure:
        file = on_failure.enter_context(h5py.File(path, "r"))
        datasets = _datasets(file)
        name = choose(path, _listed(datasets), CUBE)
        require_own(f"{path}: {name}", datasets[name])
        cube = dataset_cube(datasets[name], f"{path}: {name}", tile_bytes, file.close)
        cube.transmitted = grid_beside(
            path, _listed(datasets), cube.shape, lambda grid: _grid(f"{path}: {grid}", datasets[grid])
        )
        on_failure.pop_all()
    return cube


def dataset_cube(
    dataset: h5py.Dataset,
    name: str,
    tile_bytes: int,
    close: Callable[[], None] = lambda: None,
) -> ChunkedCube:
    """Make a cube of an open dataset.

    Parameters
    ----------
    dataset : h5py.Dataset
    name : str
        What messages call it.
    tile_bytes : int
        Memory that a tile may touch.
    close : callable
        Closes the file.

    Raises
    ------
    InputError
        If it is no cube, or was not filled.
    """
    cube = ChunkedCube(name, _stored(dataset), tile_bytes, close)
    require_filled(name, dataset)
    return cube


def read_hdf5_grid(path: Path) -> ComplexArray:
    """Read a transmitted grid from an HDF5 file.

    Raises
    ------
    InputError
        If it does not tell which of its datasets is a grid.
    """
    import h5py

    with h5py.File(path, "r") as file:
        datasets = _datasets(file)
        name = choose(path, _listed(datasets), GRID)
        return _grid(f"{path}: {name}", datasets[name])


def _datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    """All datasets of a file by their paths in it, less what MATLAB keeps for itself."""
    import h5py

    found = {}

    def add(name: str, item: h5py.HLObject) -> None:
        if isinstance(item, h5py.Dataset) and item.shape is not None and not name.startswith("#"):
            found[name] = item

    file.visititems(add)
    return found


def _listed(datasets: dict[str, h5py.Dataset]) -> dict[str, Listed]:
    return {name: Listed(dataset.shape, complex_dtype(dataset.dtype)) for name, dataset in datasets.items()}


def _stored(dataset: h5py.Dataset) -> Stored:
    """How a dataset is stored; one without chunks is read by planes of its last two axes."""
    is_reversed = MATLAB_ATTRIBUTE in dataset.attrs
    missing = max(0, 4 - dataset.ndim) if is_reversed else 0  # Ones at MATLAB's end, which it drops.
    chunks = dataset.chunks or (*(1 for _ in dataset.shape[:-2]), *dataset.shape[-2:])
    ones = (1,) * missing
    return Stored(
        ones + dataset.shape, ones + chunks, dataset.dtype, partial(_read, dataset, missing), is_reversed
    )


def _read(dataset: h5py.Dataset, missing: int, box: tuple[slice, ...]) -> NDArray[Any]:
    """Read a box of a dataset that lacks some first axes, all of length one."""
    values = as_complex(dataset[box[missing:]])
    return values.reshape((1,) * missing + values.shape)


def _grid(name: str, dataset: h5py.Dataset) -> ComplexArray:
    """Read a dataset as a transmitted grid."""
    require_grid(name, dataset.shape, complex_dtype(dataset.dtype))
    require_own(name, dataset)
    require_filled(name, dataset)
    require_chunk(name, dataset.chunks or (), dataset.dtype, dataset.shape)
    values = complex_grid(as_complex(dataset[:]))
    return np.ascontiguousarray(values.T) if MATLAB_ATTRIBUTE in dataset.attrs else values


def require_own(name: str, dataset: h5py.Dataset) -> None:
    """Refuse numbers that lie in other files: HDF5 opens whatever they name, and gives zeros otherwise.

    Parameters
    ----------
    name : str
        What the message calls the dataset.
    dataset : h5py.Dataset

    Raises
    ------
    InputError
        If its storage is external or virtual.
    """
    if dataset.is_virtual or dataset.external:
        raise InputError(
            f"{name}: keeps its numbers in other files; allowed is a file that holds them itself"
        )


def require_filled(name: str, dataset: h5py.Dataset) -> None:
    """Refuse a dataset of which parts were never written; HDF5 would give zeros for them.

    Parameters
    ----------
    name : str
        What the message calls the dataset.
    dataset : h5py.Dataset

    Raises
    ------
    InputError
        With the numbers of chunks that were written and that there should be.
    """
    if dataset.is_virtual or dataset.external:
        return
    if dataset.chunks is None:
        present, wanted = int(dataset.id.get_storage_size() > 0), int(dataset.size > 0)
    else:
        present = dataset.id.get_num_chunks()
        wanted = prod(-(-length // part) for length, part in zip(dataset.shape, dataset.chunks, strict=True))
    if present < wanted:
        raise InputError(f"{name}: is not complete: {present} of {wanted} chunks were written")
