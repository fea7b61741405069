"""Sums over runs of consecutive cells, by pairs of pairs.

A run is cut into blocks of powers of two, a block is summed by halves, the
blocks are added one after the other, and then the runs. That order depends on
the runs alone, so that a window has the same sum to the last bit whether it is
summed for itself (`sum_of_runs`) or with those of all its neighbours
(`sliding_sums`). Nothing is ever subtracted: beside a strong echo a running
sum, which subtracts what leaves the window, loses the noise.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

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
    total = np.empty(values.shape[1:])
    _add([_sum(values[first:stop]) for first, stop in runs], total)
    return total


def sliding_sums(values: NDArray[np.float64], runs: Runs, stride: int, total: NDArray[np.float64]) -> None:
    """Sum the entries of runs in every place of a window that slides along a line.

    Costs at most two additions a place for each doubling of the length of a
    run, and one for each run more.

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
    by_length = {
        length: _sliding(values, length, stride) for length in {stop - first for first, stop in runs}
    }
    places = total.size
    _add(
        [by_length[stop - first][first * stride : first * stride + places] for first, stop in runs],
        total,
    )


def _sum(run: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum a run along the first axis."""
    sums = []
    for start, size in _blocks(len(run)):
        block = run[start : start + size]
        while len(block) > 1:
            block = block[::2] + block[1::2]
        sums.append(block[0])
    return _added(sums)


def _sliding(values: NDArray[np.float64], length: int, stride: int) -> NDArray[np.float64]:
    """Sums of all runs of a length: a block twice as long is the sum of two."""
    n_runs = values.size - (length - 1) * stride
    sums, summed = values, 1
    blocks = []
    for start, size in _blocks(length):
        while summed < size:
            sums = sums[: -summed * stride] + sums[summed * stride :]
            summed *= 2
        blocks.append(sums[start * stride : start * stride + n_runs])
    return _added(blocks)


@lru_cache(maxsize=1024)
def _blocks(length: int) -> list[tuple[int, int]]:
    """Start and size of the blocks of powers of two that a run is cut into, the smallest first."""
    sizes = [1 << bit for bit in range(length.bit_length()) if length >> bit & 1]
    return [(length & (size - 1), size) for size in sizes]


def _added(terms: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Sum of at least one term, which may be that term itself."""
    if len(terms) == 1:
        return terms[0]
    total = np.empty(terms[0].shape)
    _add(terms, total)
    return total


def _add(terms: Sequence[NDArray[np.float64]], total: NDArray[np.float64]) -> None:
    """Add terms one after the other."""
    if len(terms) < 2:
        total[...] = terms[0] if terms else 0.0
        return
    np.add(terms[0], terms[1], out=total)
    for term in terms[2:]:
        total += term
