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

    Lengths = tuple[int, ...]

Indices = NDArray[np.intp]

SUBCARRIERS, SYMBOLS, ELEMENTS = range(3)
"""Axes along which a cube is cut."""

SUBCARRIER_MULTIPLE = 16
"""Tiles cut along subcarriers have a multiple of this number of them: matrix products are then faster."""


class Extent(NamedTuple):
    """Part of a cube that a tile covers: subcarriers, symbols, and indices into the list of elements."""

    subcarriers: slice
    symbols: slice
    elements: Indices


def strided_extents(shape: Lengths, strides: Lengths, elements: Indices, cells: int) -> Iterator[Extent]:
    """Cut an array in memory or in a mapped file into extents of at most so many cells.

    It is cut along the axis of its largest stride: a C-ordered array along
    subcarriers, where tiles of all elements are views and those of a few are
    gathered. An array whose elements are outermost, such as one in Fortran
    order, is cut along elements: all tiles are views.
    """
    address = elements @ np.array(strides[2:], dtype=np.intp)
    by_address = np.argsort(address, kind="stable")
    # An axis of length one has no stride.
    lengths = [abs(stride) if n > 1 else 0 for stride, n in zip(strides, shape, strict=True)]
    by_axis = {SUBCARRIERS: lengths[0], SYMBOLS: lengths[1], ELEMENTS: max(lengths[2:])}
    nesting = sorted(by_axis, key=by_axis.__getitem__, reverse=True)
    n_elements, groups = shape[2] * shape[3], [by_address]
    if nesting[-1] != ELEMENTS:
        # Elements that are not requested are not touched, and equidistant ones need no copy.
        n_elements = len(elements)
        groups = [by_address[run] for run in progressions(address[by_address])]
    return extents(shape[:2], groups, box_lengths((*shape[:2], n_elements), nesting, cells), nesting)


def chunked_extents(shape: Lengths, chunks: Lengths, elements: Indices, cells: int) -> Iterator[Extent]:
    """Cut an array that a file keeps in chunks into extents of about so many cells.

    An extent is made of whole chunks that are one behind the other along
    subcarriers and symbols and hold the same elements.
    """
    n_subcarriers, n_symbols, n_p, n_q = map(min, chunks, shape)
    n_chunks = (-(-shape[0] // n_subcarriers), -(-shape[1] // n_symbols))
    room = cells // (n_subcarriers * n_symbols * n_p * n_q)
    counts = box_lengths(n_chunks, (SUBCARRIERS, SYMBOLS), room)
    in_order = np.lexsort((elements[:, 1], elements[:, 0]))  # in which they lie in a chunk
    _, chunk_of = np.unique(elements[in_order] // chunks[2:], axis=0, return_inverse=True)
    groups = [in_order[chunk_of.ravel() == chunk] for chunk in range(chunk_of.max() + 1)]
    box = counts[SUBCARRIERS] * n_subcarriers, counts[SYMBOLS] * n_symbols, len(elements)
    return extents(shape[:2], groups, box, (SUBCARRIERS, SYMBOLS, ELEMENTS))


def extents(
    lengths: Sequence[int], groups: Sequence[Indices], box: Sequence[int], nesting: Sequence[int]
) -> Iterator[Extent]:
    """Cut subcarriers, symbols and groups of elements into boxes of a largest size.

    The innermost axis of the nesting, which begins with the largest stride, changes fastest.
    """
    steps: tuple[list[Any], ...] = (
        _sliced(lengths[SUBCARRIERS], box[SUBCARRIERS]),
        _sliced(lengths[SYMBOLS], box[SYMBOLS]),
        [group[part] for group in groups for part in _sliced(len(group), box[ELEMENTS])],
    )
    for choice in product(*(steps[axis] for axis in nesting)):
        by_axis = dict(zip(nesting, choice, strict=True))
        yield Extent(by_axis[SUBCARRIERS], by_axis[SYMBOLS], by_axis[ELEMENTS])


def box_lengths(lengths: Sequence[int], nesting: Sequence[int], cells: int) -> Lengths:
    """Lengths of a box of limited size, cut along as few of the outermost axes as possible.

    If the subcarriers, the first axis, are cut, their number is a multiple of
    16 where more than 16 fit. A box has at least one cell.

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


def progressions(values: Indices) -> list[slice]:
    """Cut a sequence of integers into arithmetic progressions, each as long as possible.

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
    """Take elements (e, 2), one at least, of an array (n, m, P, Q).

    A read-only view where the elements are equidistant in memory, such as all
    of them in order, one row or one column; otherwise a copy.
    """
    p, q = elements.T
    steps = np.diff(elements @ np.array(block.strides[2:], dtype=np.intp))
    if (steps != steps[:1]).any():
        return block[:, :, p, q]
    first = block[:, :, p[0], q[0]]
    step = int(steps[0]) if len(steps) else block.itemsize
    return as_strided(first, (*first.shape, len(elements)), (*first.strides, step), writeable=False)


def _sliced(length: int, size: int) -> list[slice]:
    """Cut an axis into slices of a size, the last one shorter."""
    return [slice(start, min(start + size, length)) for start in range(0, length, size)]
