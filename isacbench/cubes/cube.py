"""Recorded cubes as a sum of tiles, loaded one at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import permutations
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import unmasked_array
from isacbench.cubes.tiling import Extent, chunked_extents, pick, strided_extents
from isacbench.errors import InputError
from isacbench.files.checked_files import GRID_BYTES, binary_size

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.files.arrays import StoredArray
    from isacbench.model.array import VirtualArray
    from isacbench.model.numerology import System

ComplexArray: TypeAlias = NDArray[np.complexfloating[Any, Any]]

TILE_BYTES = 32 * 2**20
"""Memory that a tile touches, unless told otherwise: 64 subcarriers at the paper's size in complex64."""

CUBE_NAME, GRID_NAME = "cube", "transmitted"
"""Names of a cube and of a transmitted grid in files of several arrays."""

AXES = "(subcarriers, symbols, P, Q)"


class Tile(NamedTuple):
    """A part of a cube, loaded when it is asked for.

    Attributes
    ----------
    subcarriers, symbols : slice
        Covered part, with explicit bounds and step 1.
    elements : ndarray of intp, shape (e,)
        Covered array elements, as indices into the requested list.
    load : callable
        Returns the values, complex of the cube's precision and native byte
        order, shape (subcarriers, symbols, e), in any strides. The array may
        be a view or a mapped file and must not be written to. May be called
        from any thread, in any order and again; what it took is released with
        the array that it returned.
    """

    subcarriers: slice
    symbols: slice
    elements: NDArray[np.intp]
    load: Callable[[], ComplexArray]


class Cube:
    """A recorded frame: one complex number for every subcarrier, symbol and array element.

    Closed at the end of a ``with`` block.

    Attributes
    ----------
    name : str
        Name in messages: the file, and the array in it.
    shape : (int, int, int, int)
        Subcarriers N, symbols M, elements P along u and Q along w.
    dtype : dtype
        complex64 or complex128, native byte order.
    transmitted : ndarray of complex, shape (N, M), or None
        Transmitted grid that the same file holds.
    unused : str
        What the file holds besides that may be data, in a sentence.
    is_held : bool
        True if the whole cube is in memory.
    close : callable
        Closes the file; no tile may be loaded after.

    Parameters
    ----------
    array : ndarray or StoredArray
        Four axes of complex64 or complex128 in any order: ``array[box]`` is
        read, tile by tile, in its chunks or along its largest strides. Neither
        copied nor written to.
    tile_bytes : int, optional
        Memory that a tile may touch; one chunk at least.

    Raises
    ------
    InputError
        If the array is no cube, or parts of it were never written.

    Examples
    --------
    >>> cube = Cube("array", np.ones((8, 4, 2, 2), np.complex64))
    >>> [tile.load().shape for tile in cube.tiles(np.array([[0, 0], [1, 1]]))]
    [(8, 4, 2)]
    """

    def __init__(self, name: str, array: NDArray[Any] | StoredArray, tile_bytes: int = TILE_BYTES) -> None:
        self.is_held = isinstance(array, np.ndarray)
        self._array = unmasked_array(name, array) if isinstance(array, np.ndarray) else array
        self.name = name
        self.shape = require_cube(name, array.shape, array.dtype)
        self.dtype = array.dtype.newbyteorder("=")
        self.transmitted: ComplexArray | None = None
        self.unused = ""
        self.close: Callable[[], None] = lambda: None
        self._tile_cells = tile_bytes // self.dtype.itemsize
        if not isinstance(self._array, np.ndarray):
            self._array.require_filled()

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements into disjoint tiles.

        Parameters
        ----------
        elements : ndarray of int, shape (e, 2)
            Indices (p, q) of the elements that are needed.

        Raises
        ------
        InputError
            If an element lies outside the array.
        """
        outside = ((elements < 0) | (elements >= self.shape[2:])).any(axis=1)
        if outside.any():
            p, q = elements[outside.argmax()].tolist()
            raise InputError(f"{self.name}: has no element ({p}, {q}); its array is {self.shape[2:]}")
        if len(elements):
            for extent in self._extents(elements):
                yield Tile(*extent, partial(self._load, extent, elements[extent.elements]))

    def _extents(self, elements: NDArray[np.intp]) -> Iterator[Extent]:
        if chunks := getattr(self._array, "chunks", None):
            return chunked_extents(self.shape, chunks, elements, self._tile_cells)
        assert self._array.strides is not None
        return strided_extents(self.shape, self._array.strides, elements, self._tile_cells)

    def _load(self, extent: Extent, elements: NDArray[np.intp]) -> ComplexArray:
        """Read the smallest box around the elements (e, 2) of an extent, and take them from it."""
        first, last = elements.min(axis=0), elements.max(axis=0)
        around = (slice(p, q + 1) for p, q in zip(first.tolist(), last.tolist(), strict=True))
        try:
            values = self._array[extent.subcarriers, extent.symbols, *around]
        except Exception as error:  # Damaged chunks surface as anything that a library of codecs can raise.
            raise InputError(f"{self.name}: is damaged: {error}") from error
        return pick(values, elements - first).astype(self.dtype, copy=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def is_complex(dtype: np.dtype[Any]) -> bool:
    """Tell if a type is complex64 or complex128, in any byte order."""
    return dtype.kind == "c" and dtype.itemsize in (8, 16)


def require_cube(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, int, int, int]:
    """Refuse an array that is no cube, and return its shape."""
    if not is_complex(dtype):
        raise InputError(f"{name}: holds {dtype.newbyteorder('=')}; a cube takes complex64 or complex128")
    if len(shape) != 4:
        axes = f"{len(shape)} {'axis' if len(shape) == 1 else 'axes'}"
        raise InputError(f"{name}: has {axes}, shape {shape}; a cube takes four: {AXES}")
    if min(shape) < 1:
        raise InputError(f"{name}: is empty, shape {shape}; a cube takes at least one of {AXES} each")
    n_subcarriers, n_symbols, n_p, n_q = (int(length) for length in shape)
    return n_subcarriers, n_symbols, n_p, n_q


def require_grid(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse an array that is no transmitted grid."""
    if not (is_complex(dtype) or dtype.kind in "iuf"):
        raise InputError(
            f"{name}: holds {dtype.newbyteorder('=')}; "
            "a transmitted grid takes complex64, complex128 or real numbers"
        )
    if len(shape) != 2 or min(shape) < 1:
        raise InputError(
            f"{name}: has shape {shape}; a transmitted grid takes two axes: (subcarriers, symbols)"
        )
    takes = prod(shape) * np.dtype(np.complex128).itemsize
    if takes > GRID_BYTES:
        raise InputError(
            f"{name}: has shape {shape}, which takes {binary_size(takes)}; a transmitted grid takes at most "
            f"{binary_size(GRID_BYTES)}"
        )


def require_shape(cube: Cube, system: System, array: VirtualArray) -> None:
    """Refuse a cube that does not fit the radio of a scenario, saying so when the axes look permuted."""
    wanted = (system.n_subcarriers, system.n_symbols, *array.shape)
    if cube.shape != wanted:
        raise InputError(
            f"{cube.name}: has shape {cube.shape}; the scenario takes {wanted}: {AXES}"
            f"{_permuted(cube.shape, wanted)}"
        )


def _permuted(shape: tuple[int, ...], wanted: tuple[int, ...]) -> str:
    """Say how the axes of a shape have to be permuted to give another; nothing where they cannot."""
    fitting = [axes for axes in permutations(range(4)) if tuple(shape[axis] for axis in axes) == wanted]
    if not fitting:
        return ""
    return f". The axes look permuted: numpy.transpose with axes {' or '.join(map(str, fitting))} would fit"
