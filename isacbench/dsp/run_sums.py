"""Sums over runs of consecutive cells, by pairs of pairs.

A run is cut into blocks of powers of two, a block is summed by halves, and the
blocks are added one after the other. That order depends on the runs alone, so
that a window has the same sum to the last bit whether it is summed for itself
(`sum_of_runs`) or with those of all its neighbours (`sliding_sums`). Nothing is
ever subtracted: beside a strong echo a running sum, which subtracts what leaves
the window, loses the noise.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Runs", "sliding_sums", "sum_of_runs"]

Runs = tuple[tuple[int, int], ...]
"""First entry, and entry after the last, of runs in ascending order."""


def sum_of_runs(values: NDArray[np.float64], runs: Runs) -> NDArray[np.float64]:
    """Sum the entries of runs.

    Parameters
    ----------
    values : ndarray of float64, shape (n, ...)
    runs : tuple of (int, int)
        Places along the first axis.

    Returns
    -------
    ndarray of float64, shape (...)
        0 without runs.

    Examples
    --------
    >>> import numpy as np
    >>> float(sum_of_runs(np.arange(10.0), ((0, 3), (6, 8))))
    16.0
    """
    sums = []
    for start, size in _blocks(runs):
        block = values[start : start + size]
        while len(block) > 1:
            block = block[::2] + block[1::2]
        sums.append(block[0])
    total = np.empty(values.shape[1:])
    _add(sums, total)
    return total


def sliding_sums(values: NDArray[np.float64], runs: Runs, stride: int, total: NDArray[np.float64]) -> None:
    """Sum the entries of runs in every place of a window that slides along a line.

    Costs an addition a place for each doubling of the length of a run, and for
    each block.

    Parameters
    ----------
    values : ndarray of float64, shape (n,)
    runs : tuple of (int, int)
        Places in the window.
    stride : int
        Places of `values` between two entries of the window: along any axis of
        a map that is contiguous in memory, neighbours are so far apart.
    total : ndarray of float64, shape (m,)
        Receives the sums of the first m places of the window; 0 without runs.

    Examples
    --------
    >>> import numpy as np
    >>> total = np.empty(3)
    >>> sliding_sums(np.arange(6.0), ((0, 1), (2, 4)), 1, total)
    >>> total.tolist()
    [5.0, 8.0, 11.0]
    """
    by_size = {1: values}
    blocks = _blocks(runs)
    for _, size in blocks:
        while size not in by_size:
            half = max(by_size)
            shift = half * stride
            by_size[2 * half] = by_size[half][:-shift] + by_size[half][shift:]
    _add([by_size[size][start * stride : start * stride + total.size] for start, size in blocks], total)


@lru_cache(maxsize=1024)
def _blocks(runs: Runs) -> list[tuple[int, int]]:
    """First entries and sizes of the blocks that runs are cut into, in each the smallest first."""
    blocks = []
    for first, stop in runs:
        length = stop - first
        sizes = [1 << bit for bit in range(length.bit_length()) if length >> bit & 1]
        blocks += [(first + (length & (size - 1)), size) for size in sizes]
    return blocks


def _add(terms: Sequence[NDArray[np.float64]], total: NDArray[np.float64]) -> None:
    """Add terms one after the other."""
    if len(terms) < 2:
        total[...] = terms[0] if terms else 0.0
        return
    np.add(terms[0], terms[1], out=total)
    for term in terms[2:]:
        total += term
