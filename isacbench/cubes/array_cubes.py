"""Cubes in memory or in a mapped file, in any order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.checked_arrays import unmasked_array
from isacbench.cubes.cube import TILE_BYTES, Cube
from isacbench.cubes.tiling import (
    ELEMENTS,
    SUBCARRIERS,
    SYMBOLS,
    box_lengths,
    extents,
    native,
    pick,
    progressions,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from isacbench.cubes.cube import ComplexArray
    from isacbench.cubes.tiling import Extent, Indices


class ArrayCube(Cube):
    """A cube that is an array, cut along the axis of its largest stride.

    A C-ordered array is cut along subcarriers: tiles of all elements are views,
    those of a few are gathered. An array whose elements are outermost, such as
    one in Fortran order, is cut along elements: all tiles are views.

    Parameters
    ----------
    array : ndarray of complex64 or complex128, shape (N, M, P, Q)
        In any memory and byte order, possibly a `numpy.memmap`; neither copied nor written to.
    name : str
        Name in messages.
    tile_bytes : int
        Memory that a tile may touch.
    remap : callable, optional
        Maps the file of the array anew, for each tile: the pages that a tile
        touched are then released with it.

    Raises
    ------
    InputError
        If the array is no cube.

    Examples
    --------
    >>> cube = ArrayCube(np.ones((8, 4, 2, 2), np.complex64))
    >>> [tile.load().shape for tile in cube.tiles(np.array([[0, 0], [1, 1]]))]
    [(8, 4, 2)]
    """

    def __init__(
        self,
        array: NDArray[Any],
        name: str = "array",
        tile_bytes: int = TILE_BYTES,
        remap: Callable[[], NDArray[Any]] | None = None,
    ) -> None:
        super().__init__(name, array.shape, array.dtype)
        self.is_held = remap is None
        self._array = unmasked_array(name, array)
        self._remap = remap
        self._tile_cells = tile_bytes // array.itemsize

    def _extents(self, elements: Indices) -> Iterator[Extent]:
        address = elements @ np.array(self._array.strides[2:], dtype=np.intp)
        by_address = np.argsort(address, kind="stable")
        nesting = self._nesting()
        n_elements = self.shape[2] * self.shape[3]
        groups = [by_address]
        if nesting[-1] != ELEMENTS:
            # Elements that are not requested are not touched, and equidistant ones need no copy.
            n_elements = len(elements)
            groups = [by_address[run] for run in progressions(address[by_address])]
        box = box_lengths((*self.shape[:2], n_elements), nesting, self._tile_cells)
        return extents(self.shape[:2], groups, box, nesting)

    def _nesting(self) -> list[int]:
        """Subcarriers, symbols and elements, the largest stride first; an axis of length one has none."""
        strides = [
            abs(stride) if length > 1 else 0
            for stride, length in zip(self._array.strides, self.shape, strict=True)
        ]
        by_axis = {SUBCARRIERS: strides[0], SYMBOLS: strides[1], ELEMENTS: max(strides[2:])}
        return sorted(by_axis, key=by_axis.__getitem__, reverse=True)

    def _load(self, extent: Extent, elements: Indices) -> ComplexArray:
        array = self._array if self._remap is None else self._remap()
        return native(pick(array[extent.subcarriers, extent.symbols], elements))
