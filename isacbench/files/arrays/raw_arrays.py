"""Arrays that lie in a file as numbers one after another, in C or in Fortran order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

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

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from isacbench.files.arrays.mapped import Bytes
    from isacbench.files.arrays.tiling import Indices

Order = Literal["C", "F"]


@dataclass(frozen=True, eq=False)
class RawArray:
    """Four-dimensional array of numbers one after another.

    Attributes
    ----------
    source : Bytes
        Where they are.
    offset : int
        Byte at which they begin.
    shape : (int, int, int, int)
    dtype : dtype
        Of any kind and byte order.
    order : {"C", "F"}
        Whether the last or the first axis changes fastest.
    """

    source: Bytes
    offset: int
    shape: tuple[int, int, int, int]
    dtype: np.dtype[Any]
    order: Order

    def load(self, extent: Extent, elements: Indices) -> NDArray[Any]:
        """Read what `raw_extents` cut: one piece of the file.

        Parameters
        ----------
        extent : Extent
        elements : ndarray of intp, shape (e, 2)
            Indices (p, q) of the extent's elements.

        Returns
        -------
        ndarray, shape (n, m, e)
            In native byte order.
        """
        read = self._load_rows if self.order == "C" else self._load_planes
        return native(read(extent, elements))

    def _load_rows(self, extent: Extent, elements: Indices) -> NDArray[Any]:
        """Rows of all elements, and from them those that are asked for."""
        lengths = (_length(extent.subcarriers), _length(extent.symbols), *self.shape[2:])
        first = np.ravel_multi_index((extent.subcarriers.start, extent.symbols.start, 0, 0), self.shape)
        return pick(self._read(int(first), lengths), elements)

    def _load_planes(self, extent: Extent, elements: Indices) -> NDArray[Any]:
        """Planes of elements that are neighbours in the file."""
        lengths = (_length(extent.subcarriers), _length(extent.symbols), len(elements))
        place = (extent.subcarriers.start, extent.symbols.start, *elements[0])
        first = np.ravel_multi_index(place, self.shape, order="F")
        return self._read(int(first), lengths)

    def _read(self, first: int, lengths: tuple[int, ...]) -> NDArray[Any]:
        """Array of some lengths that begins with a number of the file."""
        start = self.offset + first * self.dtype.itemsize
        stop = start + int(np.prod(lengths)) * self.dtype.itemsize
        return np.ndarray(lengths, self.dtype, self.source.read(start, stop), order=self.order)


def raw_extents(
    shape: tuple[int, int, int, int], order: Order, elements: Indices, cells: int
) -> Iterator[Extent]:
    """Cut some elements of an array into pieces that are contiguous in the file.

    Parameters
    ----------
    shape : (int, int, int, int)
    order : {"C", "F"}
        C order is cut along subcarriers, and pieces hold all elements; Fortran
        order is cut along elements, and pieces hold the requested ones alone.
    elements : ndarray of intp, shape (e, 2)
    cells : int
        Numbers that a piece may hold.

    Yields
    ------
    Extent
        In the order of the file.
    """
    if order == "C":
        nesting, n_elements = (SUBCARRIERS, SYMBOLS, ELEMENTS), shape[2] * shape[3]
        groups = [np.arange(len(elements))]
    else:
        nesting, n_elements = (ELEMENTS, SYMBOLS, SUBCARRIERS), len(elements)
        groups = _neighbours(elements @ np.array([1, shape[2]]))
    box = box_lengths((*shape[:2], n_elements), nesting, cells)
    return extents(shape[:2], groups, box, nesting)


def _neighbours(planes: Indices) -> list[Indices]:
    """Group elements whose planes follow each other; indices in the order of the planes."""
    by_plane = np.argsort(planes, kind="stable")
    gaps = np.flatnonzero(np.diff(planes[by_plane]) != 1) + 1
    return np.split(by_plane, gaps)


def _length(part: slice) -> int:
    return int(part.stop - part.start)
