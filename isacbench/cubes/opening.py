"""Opening recorded cubes and transmitted grids, whatever they are kept in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from isacbench.cubes.arrays import ArrayCube
from isacbench.cubes.cube import TILE_BYTES
from isacbench.cubes.npy import open_npy, read_npy_grid
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from isacbench.cubes.cube import ComplexArray, Cube

__all__ = ["open_cube", "read_grid"]

T = TypeVar("T")


def open_cube(source: Any, *, tile_bytes: int = TILE_BYTES) -> Cube:
    """Open a recorded cube; nothing of it is read but its header.

    Parameters
    ----------
    source : ndarray, str or Path
        An array (N, M, P, Q) of complex64 or complex128, or a file that holds one.
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
        return _open_path(Path(source), tile_bytes)
    if isinstance(source, np.ndarray):
        return ArrayCube(source, tile_bytes=tile_bytes)
    raise InputError(f"a cube is an array or a path, not {type(source).__name__}")


def read_grid(path: str | Path) -> ComplexArray:
    """Read a transmitted grid.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    ndarray of complex64 or complex128, shape (N, M)

    Raises
    ------
    InputError
        If the file is missing, of an unknown format or damaged, or holds no grid.
    """
    path = Path(path)
    return _by_suffix(path, _GRID_READERS)(path)


def _open_path(path: Path, tile_bytes: int) -> Cube:
    return _by_suffix(path, _OPENERS)(path, tile_bytes)


def _by_suffix(path: Path, handlers: Mapping[str, T]) -> T:
    """Pick what handles an existing path by its suffix, upper or lower case."""
    suffix = path.suffix.lower()
    if suffix not in handlers:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(f"{path}: has {found}; allowed are {', '.join(handlers)}")
    if not path.exists():
        raise InputError(f"{path}: does not exist")
    return handlers[suffix]


_OPENERS: dict[str, Callable[[Path, int], Cube]] = {".npy": open_npy}
_GRID_READERS: dict[str, Callable[[Path], ComplexArray]] = {".npy": read_npy_grid}
