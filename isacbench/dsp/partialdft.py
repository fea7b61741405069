"""Range-Doppler cells of a gate from a resource grid: partial transforms, block by block.

A full map needs every bin of both transforms. A gate needs few of them, and a
few bins are a product with a few rows of the DFT matrix, which

- reads the grid once, in whatever blocks it comes, and sums what they give;
- keeps to the cells of the gate: 7 MB instead of 940 MB on a street;
- runs at the speed of a matrix product, some sixteen times that of a strided
  FFT per operation.

Doppler goes first, because speeds span a smaller part of their axis than ranges
do. Where the gate has so many range bins that an FFT is faster for all the same,
Doppler bins of all subcarriers are collected and transformed by FFT
(`isacbench.dsp.partialdft.range_method`).

References
----------
Sorensen and Burrus, "Efficient computation of the DFT with only a subset of
input or output points", IEEE Trans. SP 41 (1993).
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "RangeMethod",
    "doppler_rows",
    "range_bins_by_fft",
    "range_method",
    "range_rows",
    "transform_block",
]

Complex = NDArray[np.complexfloating[Any, Any]]
RangeMethod = Literal["partial", "fft"]

FFT_OPERATION_COST = 16.0
"""Time of an operation of a strided FFT over that of a matrix product, measured (docs/performance.md)."""


def range_rows(bins: ArrayLike, n_subcarriers: int) -> NDArray[np.complex128]:
    """Rows of the unitary inverse DFT over subcarriers.

    Parameters
    ----------
    bins : array_like of int, shape (r,)
        Range bins, of either sign.
    n_subcarriers : int

    Returns
    -------
    ndarray of complex128, shape (r, n_subcarriers)

    Examples
    --------
    >>> abs(range_rows([0, 1], 4) @ [1, -1j, -1, 1j]).round(12).tolist()
    [0.0, 2.0]
    """
    return _rows(bins, n_subcarriers)


def doppler_rows(bins: ArrayLike, n_symbols: int) -> NDArray[np.complex128]:
    """Rows of the unitary DFT over symbols.

    Parameters
    ----------
    bins : array_like of int, shape (d,)
        Doppler bins, positive when approaching.
    n_symbols : int

    Returns
    -------
    ndarray of complex128, shape (d, n_symbols)
    """
    return _rows(bins, n_symbols).conj()


def _rows(bins: ArrayLike, n: int) -> NDArray[np.complex128]:
    # Whole turns are taken out in integers: no phase loses digits.
    turns = np.multiply.outer(np.asarray(bins, dtype=np.int64), np.arange(n)) % n
    rows: NDArray[np.complex128] = np.exp(2j * np.pi * np.arange(n) / n)[turns] / np.sqrt(n)
    return rows


def range_method(n_bins: int, n_subcarriers: int) -> RangeMethod:
    """Which way to so many range bins takes less time.

    Parameters
    ----------
    n_bins, n_subcarriers : int
        Range bins of the gate, and of the whole map.

    Returns
    -------
    {"partial", "fft"}
        A product with rows of the DFT matrix, 8 N operations a bin, or an FFT,
        5 N log2 N operations for all of them.

    Examples
    --------
    >>> range_method(89, 2048), range_method(400, 2048)
    ('partial', 'fft')
    """
    return "partial" if 8 * n_bins <= FFT_OPERATION_COST * 5 * np.log2(max(n_subcarriers, 2)) else "fft"


def transform_block(block: Complex, along_doppler: Complex, along_range: Complex | None = None) -> Complex:
    """Share of a block of the resource grid in the cells of a gate.

    Parameters
    ----------
    block : ndarray of complex, shape (n, m, e)
        Some subcarriers, symbols and elements. Fast where elements or
        subcarriers are contiguous.
    along_doppler : ndarray of complex, shape (d, m)
        Columns of `doppler_rows`, those of the block's symbols.
    along_range : ndarray of complex, shape (r, n), optional
        Columns of `range_rows`, those of the block's subcarriers; without it
        only the symbols are transformed.

    Returns
    -------
    ndarray of complex, shape (r, d, e), or (n, d, e) without `along_range`
        In the precision of the last matrix; the cells are the sum over all blocks.
    """
    if block.strides[0] >= block.strides[2]:
        at_doppler = along_doppler @ block
        if along_range is None:
            return at_doppler
        n, d, e = at_doppler.shape
        lines = at_doppler.reshape(n, d * e).astype(along_range.dtype, copy=False)
        cells: Complex = (along_range @ lines).reshape(-1, d, e)
        return cells
    by_element = along_doppler @ block.transpose(2, 1, 0)
    if along_range is not None:
        by_element = by_element.astype(along_range.dtype, copy=False) @ along_range.T
    return by_element.transpose(2, 1, 0)


def range_bins_by_fft(at_doppler: Complex, bins: ArrayLike, workers: int = 1) -> Complex:
    """Range bins of lines of subcarriers, by a unitary inverse FFT of all of them.

    Parameters
    ----------
    at_doppler : ndarray of complex, shape (n_subcarriers, d, e)
        Overwritten.
    bins : array_like of int, shape (r,)
    workers : int
        Threads.

    Returns
    -------
    ndarray of complex, shape (r, d, e)
    """
    index = np.asarray(bins, dtype=np.int64) % len(at_doppler)
    cells = np.empty((index.size, *at_doppler.shape[1:]), dtype=at_doppler.dtype)
    # One Doppler bin at a time, so that no second copy of all lines is held.
    for k in range(at_doppler.shape[1]):
        lines = scipy.fft.ifft(at_doppler[:, k], axis=0, norm="ortho", workers=workers)
        cells[:, k] = lines[index]
    return cells
