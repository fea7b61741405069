"""Cubes in files that keep arrays in chunks: whole chunks are read, and only those of requested elements."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.cubes.cube import Cube, Tile, require_cube, require_elements
from isacbench.errors import InputError
from isacbench.files.arrays.listing import as_complex, complex_dtype
from isacbench.files.arrays.tiling import (
    ELEMENTS,
    SUBCARRIERS,
    SYMBOLS,
    Extent,
    box_lengths,
    extents,
    native,
    pick,
)
from isacbench.files.checked_files import binary_size

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.cubes.cube import ComplexArray
    from isacbench.files.arrays.listing import as_complex, complex_dtype
from isacbench.files.arrays.tiling import Indices

CHUNK_BYTES = 2**30
"""A chunk that any array may have, however small it is itself."""


class Stored(NamedTuple):
    """An array in a file of chunks.

    Attributes
    ----------
    shape, chunks : tuple of int
        Lengths of the array and of a chunk; a part of whole chunks is read at
        the least cost.
    dtype : dtype
        Complex, or two real fields, see `complex_dtype`.
    read : callable
        Reads a box, given as one slice an axis, in any thread.
    is_reversed : bool
        Whether the axes are (Q, P, symbols, subcarriers), as MATLAB writes
        them, instead of (subcarriers, symbols, P, Q).
    """

    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[tuple[slice, ...]], NDArray[Any]]
    is_reversed: bool = False


class ChunkedCube(Cube):
    """A cube in chunks.

    A tile is made of whole chunks that are one behind the other along
    subcarriers and symbols and hold the same elements.

    Parameters
    ----------
    name : str
    stored : Stored
    tile_bytes : int
        Memory that a tile may touch; one chunk at least.
    close : callable
        Closes the file.

    Raises
    ------
    InputError
        If the array is no cube.
    """

    def __init__(
        self,
        name: str,
        stored: Stored,
        tile_bytes: int,
        close: Callable[[], None] = lambda: None,
    ) -> None:
        self.name = name
        self.dtype = complex_dtype(stored.dtype)
        self.shape = require_cube(name, self._in_order(stored.shape, stored), self.dtype)
        self.transmitted: ComplexArray | None = None
        require_chunk(name, stored.chunks, stored.dtype, stored.shape)
        self._stored = stored
        self._chunk = self._in_order(stored.chunks, stored)
        self._tile_cells = tile_bytes // self.dtype.itemsize
        self._close = close

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements into tiles, see `Cube.tiles`."""
        require_elements(self, elements)
        groups = self._groups(elements)
        nesting = (SUBCARRIERS, SYMBOLS, ELEMENTS)
        if self._stored.is_reversed:
            nesting = nesting[::-1]
        box = (*self._box(nesting), max(1, len(elements)))  # The elements of a group stay together.
        for extent in extents(self.shape[:2], groups, box, nesting):
            yield Tile(*extent, partial(self._load, extent, elements[extent.elements]))

    def close(self) -> None:
        """Close the file."""
        self._close()

    def _in_order(self, axes: tuple[Any, ...], stored: Stored) -> tuple[Any, ...]:
        """Something of every axis, from the file's order to the cube's, or back."""
        return axes[::-1] if stored.is_reversed else axes

    def _box(self, nesting: tuple[int, ...]) -> tuple[int, int]:
        """Subcarriers and symbols of a tile: as many whole chunks as it has room for."""
        n_subcarriers, n_symbols, n_p, n_q = map(min, self._chunk, self.shape)
        outer = [axis for axis in nesting if axis != ELEMENTS]
        chunks = (-(-self.shape[0] // n_subcarriers), -(-self.shape[1] // n_symbols))
        room = self._tile_cells // (n_subcarriers * n_symbols * n_p * n_q)
        counts = box_lengths(chunks, outer, room)
        return counts[SUBCARRIERS] * n_subcarriers, counts[SYMBOLS] * n_symbols

    def _groups(self, elements: Indices) -> list[Indices]:
        """Indices of the elements that chunks have in common, in the order in which they lie there."""
        by_file = np.lexsort(self._in_order((elements[:, 1], elements[:, 0]), self._stored))
        chunks = elements[by_file] // self._chunk[2:]
        _, group_of = np.unique(chunks, axis=0, return_inverse=True)
        group_of = group_of.reshape(-1)
        return [by_file[group_of == group] for group in range(group_of.max(initial=-1) + 1)]

    def _load(self, extent: Extent, elements: Indices) -> ComplexArray:
        """Read the smallest box around the elements, and take them from it."""
        first, last = elements.min(axis=0), elements.max(axis=0)
        around = (slice(p, q + 1) for p, q in zip(first.tolist(), last.tolist(), strict=True))
        box = self._in_order((extent.subcarriers, extent.symbols, *around), self._stored)
        try:
            values = as_complex(self._stored.read(box))
        except Exception as error:  # Damaged chunks surface as anything that a library of codecs can raise.
            raise InputError(f"{self.name}: is damaged: {error}") from error
        if self._stored.is_reversed:
            values = values.T
        return native(pick(values, elements - first))


def require_chunk(name: str, chunks: tuple[int, ...], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Refuse chunks that take more memory than any need: a chunk is decompressed as a whole.

    Parameters
    ----------
    name : str
        What the message calls the array.
    chunks : tuple of int
        Lengths of a chunk, which may be larger than the array.
    dtype : dtype
    shape : tuple of int
        Of the array.

    Raises
    ------
    InputError
        If a chunk takes more than 1 GiB and more than the array.
    """
    takes = prod(chunks) * dtype.itemsize
    if takes > max(CHUNK_BYTES, prod(shape) * dtype.itemsize):
        raise InputError(
            f"{name}: has chunks of {binary_size(takes)}; allowed are at most {binary_size(CHUNK_BYTES)}, or "
            "one that holds the whole array"
        )
