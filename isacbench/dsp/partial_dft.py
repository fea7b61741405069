"""Range-Doppler cells of a gate from a resource grid: partial transforms, block by block.

A full map needs every bin of both transforms. A gate needs few of them, and a
few bins are a product with a few rows of the DFT matrix, which

- reads the grid once, in blocks of any kind, and sums their shares;
- keeps to the cells of the gate: 12 MB in place of 940 MB on a street;
- runs at the speed of a matrix product, some sixteen times that of a strided
  FFT per operation.

Doppler goes first, because speeds span a smaller part of their axis than ranges
do. The rows of two opposite bins are sums and differences of a cosine and a
sine: of a gate that holds both, a real product with half the operations yields
both (`DopplerSums`). Range bins come from an FFT where that is faster for all
the same (`range_method`): of subcarriers that lie side by side in memory soon,
of others where the gate has many range bins; their lines are then collected
first.

References
----------
Sorensen and Burrus, "Efficient computation of the DFT with only a subset of
input or output points", IEEE Trans. SP 41 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, DTypeLike, NDArray

from isacbench.checked_arrays import Complex, Floats, Integers, checked_array

RangeMethod = Literal["partial", "fft"]

MOST_SUMS = 1.25
"""Real rows a Doppler bin up to which they pay: half the work over symbols, some more over subcarriers."""

FFT_OPERATION_COST = {"contiguous": 6.0, "strided": 16.0}
"""Time of an operation of an FFT over that of a matrix product, by how its lines lie in memory (measured)."""

FEW_ELEMENTS = 16
"""Columns below which products of small matrices are slow: elements are then moved outermost first."""


def range_rows(bins: ArrayLike, n_subcarriers: int) -> Complex:
    """Rows (r, n_subcarriers) of the unitary inverse DFT over subcarriers, for range bins of either sign."""
    return _rows(bins, n_subcarriers)


def doppler_rows(bins: ArrayLike, n_symbols: int) -> Complex:
    """Rows (d, n_symbols) of the unitary DFT over symbols, for Doppler bins, positive when approaching."""
    return _rows(bins, n_symbols).conj()


def _rows(bins: ArrayLike, n: int) -> Complex:
    # Whole turns are taken out in integers: no phase loses digits.
    turns = np.multiply.outer(checked_array("bins", bins, np.int64), np.arange(n)) % n
    return np.exp(2j * np.pi * np.arange(n) / n)[turns] / np.sqrt(n)


@dataclass(frozen=True, eq=False)
class DopplerSums:
    """Sums over symbols from which the Doppler bins of a gate follow, after any linear steps.

    Attributes
    ----------
    rows : ndarray of float64 or complex128, shape (k, n_symbols)
        Cosines and then sines of every distinct absolute Doppler bin; or, where
        few bins have their opposite, the rows of the DFT themselves.
    absolute : ndarray of int64, shape (d,)
        Index of the cosine of each bin of the gate.
    sign : ndarray of int64, shape (d,), or None
        Sign of each bin; None where the rows are the bins themselves.
    """

    rows: Floats | Complex
    absolute: Integers
    sign: Integers | None

    def rows_in(self, dtype: DTypeLike) -> NDArray[Any]:
        """Convert the rows (k, n_symbols) to the precision of a complex type, or of its real part."""
        return self.rows.astype(dtype if np.iscomplexobj(self.rows) else np.empty(0, dtype).real.dtype)

    def bins(self, sums: Complex) -> Complex:
        """Doppler bins of sums.

        Parameters
        ----------
        sums : ndarray of complex, shape (r, k, e)

        Returns
        -------
        ndarray of complex, shape (r, d, e)
        """
        if self.sign is None:
            return sums
        cosines, sines = np.split(sums, 2, axis=1)
        quadrature = sines[:, self.absolute] * (1j * self.sign[:, None]).astype(sums.dtype)
        return np.subtract(cosines[:, self.absolute], quadrature, out=quadrature)


def doppler_sums(bins: ArrayLike, n_symbols: int) -> DopplerSums:
    """Sums over symbols for the Doppler bins of a gate.

    Parameters
    ----------
    bins : array_like of int, shape (d,)
        Doppler bins, positive when approaching.
    """
    index = checked_array("bins", bins, np.int64)
    distinct, absolute = np.unique(np.abs(index), return_inverse=True)
    if 2 * distinct.size > MOST_SUMS * index.size:
        return DopplerSums(doppler_rows(index, n_symbols), absolute, None)
    rows = doppler_rows(distinct, n_symbols)
    return DopplerSums(np.concatenate([rows.real, -rows.imag]), absolute, np.sign(index))


def range_method(
    n_bins: int, n_subcarriers: int, lines: Literal["contiguous", "strided"] = "strided"
) -> RangeMethod:
    """Choose the faster way to the range bins of a gate: some rows of the DFT ("partial"), or an FFT.

    The rows take 8 N operations a bin, an FFT 5 N log2 N for all of them. `lines` is the layout in memory of
    the subcarriers of one symbol and element.
    """
    fft_cost = FFT_OPERATION_COST[lines] * 5 * np.log2(max(n_subcarriers, 2))
    return "partial" if 8 * n_bins <= fft_cost else "fft"


def is_element_major(block: Complex) -> bool:
    """Tell if subcarriers of a block (n, m, e) are closer in memory than its elements."""
    return block.strides[0] < block.strides[2]


def with_few_elements_outermost(block: Complex) -> Complex:
    """Copy a block (n, m, e) if products with so few elements side by side would be slow."""
    if is_element_major(block) or block.shape[2] >= min(FEW_ELEMENTS, block.shape[0]):
        return block
    return np.ascontiguousarray(block.transpose(2, 1, 0)).transpose(2, 1, 0)


def transform_block(
    block: Complex, along_doppler: NDArray[Any], along_range: Complex | None = None
) -> Complex:
    """Share of a block (n, m, e) of subcarriers, symbols and elements in the cells of a gate.

    `along_doppler` (k, m) are the columns of `doppler_rows` or of the rows of `DopplerSums` for the block's
    symbols, `along_range` (r, n) those of `range_rows` for its subcarriers; without it only the symbols are
    transformed. The result is (r, k, e), or (n, k, e), in the precision of the last matrix; the cells are the
    sum over all blocks. Fast where elements or subcarriers are contiguous.
    """
    if not is_element_major(block):
        at_doppler = _product(along_doppler, block)
        if along_range is None:
            return at_doppler
        n, d, e = at_doppler.shape
        lines = at_doppler.reshape(n, d * e).astype(along_range.dtype, copy=False)
        return (along_range @ lines).reshape(-1, d, e)
    by_element = _product(along_doppler, block.transpose(2, 1, 0))
    if along_range is not None:
        by_element = by_element.astype(along_range.dtype, copy=False) @ along_range.T
    return by_element.transpose(2, 1, 0)


def transform_lines(block: Complex, along_doppler: NDArray[Any], bins: ArrayLike) -> Complex:
    """Share (r, k, e) of whole lines of subcarriers in the cells of a gate, by FFTs in double precision.

    The block (n_subcarriers, m, e) holds all subcarriers, element-major. `along_doppler` is as for
    `transform_block`.
    """
    lines = _product(along_doppler, block.transpose(2, 1, 0)).astype(np.complex128, copy=False)
    ranges = scipy.fft.ifft(lines, axis=2, norm="ortho", overwrite_x=True)
    return ranges[:, :, checked_array("bins", bins, np.int64) % len(block)].transpose(2, 1, 0)


def _product(rows: NDArray[Any], blocks: Complex) -> Complex:
    """Product of rows (k, m) with blocks (..., m, x); of real rows with real and imaginary parts."""
    if np.iscomplexobj(rows):
        return rows @ blocks
    columns = blocks if blocks.strides[-1] == blocks.itemsize else np.ascontiguousarray(blocks)
    return (rows @ columns.view(rows.dtype)).view(blocks.dtype)


def range_bins_by_fft(at_doppler: Complex, bins: ArrayLike, workers: int = 1) -> Complex:
    """Range bins (r, d, e) of lines (n_subcarriers, d, e), which are overwritten, by a unitary FFT."""
    index = checked_array("bins", bins, np.int64) % len(at_doppler)
    cells = np.empty((index.size, *at_doppler.shape[1:]), dtype=at_doppler.dtype)
    # One Doppler bin at a time, so that no second copy of all lines is held.
    for k in range(at_doppler.shape[1]):
        lines = scipy.fft.ifft(at_doppler[:, k], axis=0, norm="ortho", workers=workers)
        cells[:, k] = lines[index]
    return cells
