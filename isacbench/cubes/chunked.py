"""Cubes in files that keep arrays in chunks: whole chunks are read, and only those of requested elements."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.cubes.cube import Cube
from isacbench.cubes.tiling import ELEMENTS, SUBCARRIERS, SYMBOLS, box_lengths, extents, native, pick
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.cubes.cube import ComplexArray
    from isacbench.cubes.tiling import Extent, Indices
    from isacbench.files.arrays.stored_arrays import ChunkedArray


class ChunkedCube(Cube):
    """A cube in chunks.

    A tile is made of whole chunks that are one behind the other along
    subcarriers and symbols and hold the same elements.

    Parameters
    ----------
    name : str
        Name in messages.
    stored : ChunkedArray
        With trailing axes of length one missing if its program drops them.
    tile_bytes : int
        Memory that a tile may touch; one chunk at least.

    Raises
    ------
    InputError
        If the array is no cube, or parts of it were never written.
    """

    def __init__(self, name: str, stored: ChunkedArray, tile_bytes: int) -> None:
        ones = stored.dropped_ones
        super().__init__(name, stored.shape + ones, stored.dtype)
        stored.require_filled()
        self._stored = stored
        self._chunk = stored.chunks + ones
        self._tile_cells = tile_bytes // self.dtype.itemsize

    def _extents(self, elements: Indices) -> Iterator[Extent]:
        nesting = (SUBCARRIERS, SYMBOLS, ELEMENTS)
        box = (*self._box(), len(elements))  # The elements of a group stay together.
        return extents(self.shape[:2], self._groups(elements), box, nesting)

    def _box(self) -> tuple[int, int]:
        """Subcarriers and symbols of a tile: as many whole chunks as it has room for."""
        n_subcarriers, n_symbols, n_p, n_q = map(min, self._chunk, self.shape)
        chunks = (-(-self.shape[0] // n_subcarriers), -(-self.shape[1] // n_symbols))
        room = self._tile_cells // (n_subcarriers * n_symbols * n_p * n_q)
        counts = box_lengths(chunks, (SUBCARRIERS, SYMBOLS), room)
        return counts[SUBCARRIERS] * n_subcarriers, counts[SYMBOLS] * n_symbols

    def _groups(self, elements: Indices) -> list[Indices]:
        """Indices of the elements that chunks have in common, in the order in which they lie there."""
        in_order = np.lexsort((elements[:, 1], elements[:, 0]))
        chunks = elements[in_order] // self._chunk[2:]
        _, group_of = np.unique(chunks, axis=0, return_inverse=True)
        group_of = group_of.reshape(-1)
        return [in_order[group_of == group] for group in range(group_of.max() + 1)]

    def _load(self, extent: Extent, elements: Indices) -> ComplexArray:
        """Read the smallest box around the elements, and take them from it."""
        first, last = elements.min(axis=0), elements.max(axis=0)
        around = (slice(p, q + 1) for p, q in zip(first.tolist(), last.tolist(), strict=True))
        box = (extent.subcarriers, extent.symbols, *around)
        try:
            values = self._stored.read_box(box[: len(self._stored.shape)])
        except Exception as error:  # Damaged chunks surface as anything that a library of codecs can raise.
            raise InputError(f"{self.name}: is damaged: {error}") from error
        values = values.reshape(values.shape + (1,) * (4 - values.ndim))
        return native(pick(values, elements - first))
