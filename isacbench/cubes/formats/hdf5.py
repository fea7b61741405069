"""Cubes and grids in HDF5 files, MATLAB's version 7.3 among them."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.cubes.cube import complex_grid, require_grid
from isacbench.cubes.formats.chunked import ChunkedCube, Stored, require_chunk
from isacbench.cubes.formats.cube_files import CUBE, GRID, choose, grid_beside
from isacbench.files.arrays.hdf5_datasets import MATLAB_ATTRIBUTE, require_filled, require_own
from isacbench.files.arrays.listing import Listed, as_complex, complex_dtype

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import h5py
    from numpy.typing import NDArray

    from isacbench.cubes.cube import ComplexArray


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
