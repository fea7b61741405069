"""Cubes in memory, in whatever order."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.cubes.cube import TILE_BYTES, Cube, Tile, require_cube, require_elements
from isacbench.files.arrays.tiling import (
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
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from isacbench.cubes.cube import ComplexArray
    from isacbench.files.arrays.tiling import Indices


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
        What messages call it.
    tile_bytes : int
        Memory that a tile may touch.

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

    def __init__(self, array: NDArray[Any], name: str = "array", tile_bytes: int = TILE_BYTES) -> None:
        self.name = name
        self.shape = require_cube(name, array.shape, array.dtype)
        self.dtype = array.dtype.newbyteorder("=")
        self.transmitted = None
        self._array = np.asarray(array)
        self._tile_cells = tile_bytes // array.itemsize

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements into tiles, see `Cube.tiles`."""
        require_elements(self, elements)
        if not len(elements):
            return
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
        for extent in extents(self.shape[:2], groups, box, nesting):
            load = partial(self._load, extent.subcarriers, extent.symbols, elements[extent.elements])
            yield Tile(*extent, load)

    def close(self) -> None:
        """Nothing: the array is its owner's."""

    def _nesting(self) -> list[int]:
        """Subcarriers, symbols and elements, the largest stride first; an axis of length one has none."""
        strides = [
            abs(stride) if length > 1 else 0
            for stride, length in zip(self._array.strides, self.shape, strict=True)
        ]
        by_axis = {SUBCARRIERS: strides[0], SYMBOLS: strides[1], ELEMENTS: max(strides[2:])}
        return sorted(by_axis, key=by_axis.__getitem__, reverse=True)

    def _load(self, subcarriers: slice, symbols: slice, elements: Indices) -> ComplexArray:
        return native(pick(self._array[subcarriers, symbols], elements))
