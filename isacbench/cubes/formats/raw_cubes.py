"""Cubes that lie in a file as one array of complex numbers."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from isacbench.cubes.cube import TILE_BYTES, Cube, Tile, require_cube, require_elements
from isacbench.files.arrays.raw_arrays import raw_extents

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.cubes.cube import ComplexArray
    from isacbench.files.arrays.raw_arrays import RawArray


class RawCube(Cube):
    """A cube that lies in a file as one array of complex numbers.

    Parameters
    ----------
    name : str
    array : RawArray
    transmitted : ndarray of complex, shape (N, M), or None
    tile_bytes : int
        Memory that a tile may touch.
    """

    def __init__(
        self, name: str, array: RawArray, transmitted: ComplexArray | None, tile_bytes: int = TILE_BYTES
    ) -> None:
        self.name = name
        self.shape = require_cube(name, array.shape, array.dtype)
        self.dtype = array.dtype.newbyteorder("=")
        self.transmitted = transmitted
        self._array = array
        self._tile_cells = tile_bytes // self.dtype.itemsize

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements into tiles, see `Cube.tiles`."""
        require_elements(self, elements)
        if not len(elements):
            return
        for extent in raw_extents(self.shape, self._array.order, elements, self._tile_cells):
            yield Tile(*extent, partial(self._array.load, extent, elements[extent.elements]))

    def close(self) -> None:
        """Close the file."""
        self._array.source.close()
