"""Transform of a cube to the cells of a gate, tile by tile and in several threads."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex
from isacbench.cores import available_cores, one_blas_thread
from isacbench.dsp.null_carriers import NullCarriers
from isacbench.dsp.partial_dft import (
    DopplerSums,
    RangeMethod,
    doppler_sums,
    is_element_major,
    range_bins_by_fft,
    range_method,
    range_rows,
    transform_block,
    transform_lines,
    with_few_elements_outermost,
)
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import counted

if TYPE_CHECKING:
    from isacbench.cubes.cube import Cube, Tile
    from isacbench.model.gate import Gate
    from isacbench.model.numerology import System

TILES_AHEAD = 1
"""Tiles that are read in advance while others are transformed."""


@dataclass(frozen=True, eq=False)
class GateTransform:
    """Unitary transforms of cubes to the range-Doppler cells of a gate.

    Attributes
    ----------
    nulls : NullCarriers, optional
        Null carriers of the cube; `system` is that of the band between its outermost used carriers.
    """

    gate: Gate
    system: System
    nulls: NullCarriers | None = None

    @property
    def range_method(self) -> RangeMethod:
        """Transform to range bins of blocks whose subcarriers are not side by side."""
        n_bins = self.gate.range_bins.size
        return "partial" if self.nulls is not None else range_method(n_bins, self.system.n_subcarriers)

    @one_blas_thread()
    def cells(
        self,
        cube: Cube,
        elements: NDArray[np.intp],
        factors: NDArray[np.complexfloating[Any, Any]] | None = None,
        workers: int | None = None,
    ) -> Complex:
        """Transform elements (e, 2) of a cube to cells (n_range, n_doppler, e).

        Factors of the resource elements are applied first. Sums over the
        symbols of a block are made in the cube's precision, those over
        subcarriers in double. What is not finite or too large is refused.
        """
        n_workers = available_cores() if workers is None else workers
        # Numbers that are not finite are looked for once, at the end.
        with np.errstate(all="ignore"):
            weights = None if factors is None else factors.astype(cube.dtype)
            sums = self._summed(cube, elements, weights, n_workers)
            cells = self._doppler_sums.bins(sums).astype(np.complex128, copy=False)
        if not np.isfinite(cells).all():
            raise InputError(f"{cube.name}: {_find_fault(cube, elements, self.nulls)}")
        return cells

    @cached_property
    def _doppler_sums(self) -> DopplerSums:
        return doppler_sums(self.gate.doppler_bins, self.system.n_symbols)

    @cached_property
    def _range_rows(self) -> Complex:
        rows = range_rows(self.gate.range_bins, self.system.n_subcarriers)
        return rows if self.nulls is None else self.nulls.interpolated(rows)

    def _summed(
        self, cube: Cube, elements: NDArray[np.intp], weights: Complex | None, n_workers: int
    ) -> Complex:
        """Sum what the tiles give: range bins, or lines whose range bins one FFT yields in the end."""
        along_doppler = self._doppler_sums.rows_in(cube.dtype)
        n_sums = len(along_doppler)
        cells = np.zeros((self.gate.range_bins.size, n_sums, len(elements)), dtype=np.complex128)
        lines = np.zeros(0, dtype=cube.dtype)
        if self.range_method == "fft":
            lines = np.zeros((self.system.n_subcarriers, n_sums, len(elements)), dtype=cube.dtype)

        def transform(tile: Tile) -> tuple[NDArray[np.bool_], bool, Complex]:
            """Mask of what an element of a tile holds, whether the tile's share is lines, and the share."""
            block, rows = with_few_elements_outermost(tile.load()), along_doppler[:, tile.symbols]
            held = block[:, :, 0] != 0
            with np.errstate(all="ignore"):  # a thread has its own
                if weights is not None:
                    block = block * weights[tile.subcarriers, tile.symbols, None]
                if self.nulls is not None:  # whatever they held, NaN as well
                    block = np.where(self.nulls.used[tile.subcarriers, None, None], block, 0)
                if self._has_fast_lines(block):
                    return held, False, transform_lines(block, rows, self.gate.range_bins)
                if lines.size:
                    return held, True, transform_block(block, rows)
                return held, False, transform_block(block, rows, self._range_rows[:, tile.subcarriers])

        is_held = np.zeros(cube.shape[:2], dtype=np.bool_)
        has_lines = False
        with ThreadPoolExecutor(n_workers) as threads:
            done = _in_order(threads, transform, cube.tiles(elements), n_workers + TILES_AHEAD)
            for tile, (held, is_lines, share) in done:
                is_held[tile.subcarriers, tile.symbols] |= held
                if is_lines:
                    lines[tile.subcarriers, :, _consecutive(tile.elements)] += share
                    has_lines = True
                else:
                    cells[:, :, _consecutive(tile.elements)] += share
        _warn_of_zeros(cube.name, is_held, np.True_ if weights is None else weights != 0)
        if has_lines:
            cells += range_bins_by_fft(lines, self.gate.range_bins, n_workers)
        return cells

    def _has_fast_lines(self, block: Complex) -> bool:
        """Tell if an FFT yields the range bins of a block fastest."""
        n_subcarriers = self.system.n_subcarriers
        if self.nulls is not None:
            return False
        method = range_method(self.gate.range_bins.size, n_subcarriers, "contiguous")
        return len(block) == n_subcarriers and is_element_major(block) and method == "fft"


def _consecutive(index: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Slice in place of consecutive indices, which adds in place."""
    first, size = int(index[0]), index.size
    return slice(first, first + size) if np.array_equal(index, np.arange(first, first + size)) else index


def _in_order(threads: ThreadPoolExecutor, work: Any, tiles: Iterator[Tile], n_ahead: int) -> Iterator[Any]:
    """Tiles and what becomes of them, few at a time: sums of floating point do not depend on the threads."""
    waiting: deque[tuple[Tile, Future[Any]]] = deque()
    for tile in tiles:
        waiting.append((tile, threads.submit(work, tile)))
        if len(waiting) > n_ahead:
            first, future = waiting.popleft()
            yield first, future.result()
    while waiting:
        first, future = waiting.popleft()
        yield first, future.result()


def _warn_of_zeros(name: str, is_held: NDArray[np.bool_], is_sensed: NDArray[np.bool_] | np.bool_) -> None:
    """Tell of subcarriers and symbols that hold nothing, but are transformed as if something was received."""
    is_empty = ~is_held & is_sensed
    empty = {
        "subcarrier": is_empty.any(axis=1) & ~is_held.any(axis=1),
        "symbol": is_empty.any(axis=0) & ~is_held.any(axis=0),
    }
    told = [
        f"{counted(int(where.sum()), what)} from {where.argmax()} on"
        for what, where in empty.items()
        if where.any()
    ]
    if told and is_held.any():
        warnings.warn(
            f"{name}: {' and '.join(told)} hold zeros alone, which give false ranges or velocities; a "
            "transmitted grid that is 0 in null carriers leaves them out, symbols have to be cut off",
            InputWarning,
            stacklevel=2,
        )


def _find_fault(cube: Cube, elements: NDArray[np.intp], nulls: NullCarriers | None) -> str:
    """Describe the first number that is not finite by its place, or else an overflow."""
    for tile in cube.tiles(elements):
        block = tile.load()
        faulty = ~np.isfinite(block)
        if nulls is not None:
            faulty[~nulls.used[tile.subcarriers]] = False
        if faulty.any():
            n, m, e = np.unravel_index(int(faulty.argmax()), block.shape)
            p, q = elements[tile.elements[e]]
            subcarrier = range(cube.shape[0])[tile.subcarriers][int(n)]
            symbol = range(cube.shape[1])[tile.symbols][int(m)]
            return (
                f"{block[n, m, e]} at subcarrier {subcarrier}, symbol {symbol}, element ({p}, {q}); "
                "allowed are finite numbers"
            )
    return f"sums over the frame overflow {cube.dtype}; scale the cube down"
