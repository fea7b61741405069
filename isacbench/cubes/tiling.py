"""Tiles of a four-dimensional array: where to cut it, and how to take the elements of a tile."""

from __future__ import annotations

from itertools import product
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

Indices = NDArray[np.intp]

SUBCARRIERS, SYMBOLS, ELEMENTS = range(3)
"""Axes along which a cube is cut."""

SUBCARRIER_MULTIPLE = 16
"""Tiles cut along subcarriers have a multiple of this number of them: matrix products are then faster."""


class Extent(NamedTuple):
    """Part of a cube that a tile covers.

    Attributes
    ----------
    subcarriers, symbols : slice
    elements : ndarray of intp, shape (e,)
        Indices into the requested list.
    """

    subcarriers: slice
    symbols: slice
    elements: Indices


def extents(
    lengths: Sequence[int], groups: Sequence[Indices], box: Sequence[int], nesting: Sequence[int]
) -> Iterator[Extent]:
    """Cut an array into extents, the innermost axis of the nesting changing fastest.

    Parameters
    ----------
    lengths : sequence of int
        Subcarriers and symbols of the cube.
    groups : sequence of ndarray of intp
        Indices of the elements that may share a tile.
    box : (int, int, int)
        Largest number of subcarriers, symbols and elements of a tile.
    nesting : sequence of int
        The three axes from the outermost, of largest stride, to the innermost.

    Yields
    ------
    Extent
    """
    steps: tuple[list[Any], ...] = (
        sliced(lengths[SUBCARRIERS], box[SUBCARRIERS]),
        sliced(lengths[SYMBOLS], box[SYMBOLS]),
        [group[part] for group in groups for part in sliced(len(group), box[ELEMENTS])],
    )
    for choice in product(*(steps[axis] for axis in nesting)):
        by_axis = dict(zip(nesting, choice, strict=True))
        yield Extent(by_axis[SUBCARRIERS], by_axis[SYMBOLS], by_axis[ELEMENTS])


def box_lengths(lengths: Sequence[int], nesting: Sequence[int], cells: int) -> tuple[int, ...]:
    """Lengths of a box of limited size, cut along as few of the outermost axes as possible.

    Parameters
    ----------
    lengths : sequence of int
        Cells along every axis, subcarriers first.
    nesting : sequence of int
        Axes from the outermost, of largest stride, to the innermost.
    cells : int
        Largest number of cells; a box has at least one.

    Returns
    -------
    tuple of int
        If the subcarriers are cut, their number is a multiple of 16 where more
        than 16 fit.

    Examples
    --------
    >>> box_lengths((2048, 224, 256), (0, 1, 2), 2**22)
    (64, 224, 256)
    >>> box_lengths((2048, 224, 256), (2, 1, 0), 2**18)
    (2048, 128, 1)
    """
    box = list(lengths)
    for axis in nesting:
        inner = prod(box) // box[axis]
        box[axis] = min(box[axis], max(1, cells // inner))
    if SUBCARRIER_MULTIPLE < box[SUBCARRIERS] < lengths[SUBCARRIERS]:
        box[SUBCARRIERS] -= box[SUBCARRIERS] % SUBCARRIER_MULTIPLE
    return tuple(box)


def sliced(length: int, size: int) -> list[slice]:
    """Cut an axis into slices of a size, the last one shorter.

    Parameters
    ----------
    length, size : int

    Returns
    -------
    list of slice

    Examples
    --------
    >>> sliced(5, 2)
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    """
    return [slice(start, min(start + size, length)) for start in range(0, length, size)]


def progressions(values: Indices) -> list[slice]:
    """Cut a sequence of integers into arithmetic progressions, each as long as possible.

    Parameters
    ----------
    values : ndarray of intp, shape (n,)

    Returns
    -------
    list of slice
        Slices of `values`.

    Examples
    --------
    >>> progressions(np.array([0, 4, 8, 1, 2, 3]))
    [slice(0, 3, None), slice(3, 6, None)]
    """
    numbers = values.tolist()
    runs, start = [], 0
    for k in range(1, len(numbers)):
        if numbers[k] - numbers[k - 1] != numbers[start + 1] - numbers[start]:
            runs.append(slice(start, k))
            start = k
    return [*runs, slice(start, len(numbers))]


def pick(block: NDArray[Any], elements: Indices) -> NDArray[Any]:
    """Take some elements of an array whose last two axes are P and Q.

    Parameters
    ----------
    block : ndarray, shape (n, m, P, Q)
    elements : ndarray of intp, shape (e, 2)
        Indices (p, q), at least one, all inside the array.

    Returns
    -------
    ndarray, shape (n, m, e)
        A read-only view where the elements are equidistant in memory, such as
        all of them in order, one row or one column; otherwise a copy.
    """
    p, q = elements.T
    steps = np.diff(elements @ np.array(block.strides[2:], dtype=np.intp))
    if (steps != steps[:1]).any():
        return block[:, :, p, q]
    first = block[:, :, p[0], q[0]]
    step = int(steps[0]) if len(steps) else block.itemsize
    return as_strided(first, (*first.shape, len(elements)), (*first.strides, step), writeable=False)


def native(values: NDArray[Any]) -> NDArray[Any]:
    """Convert values to native byte order; copy them only if they are not in it.

    Parameters
    ----------
    values : ndarray

    Returns
    -------
    ndarray
    """
    return values.astype(values.dtype.newbyteorder("="), copy=False)
