"""Transform of a cube to the cells of a gate, tile by tile and in several threads."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex
from isacbench.cores import available_cores, one_blas_thread
from isacbench.cubes.tiles import Cube, Tile
from isacbench.dsp import partial_dft
from isacbench.dsp.null_carriers import NullCarriers
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import counted
from isacbench.model.gate import Gate
from isacbench.model.numerology import System

Item = TypeVar("Item")
Result = TypeVar("Result")

TILES_AHEAD = 1
"""Tiles that are read in advance while others are transformed."""


@one_blas_thread()
def gate_cells(
    cube: Cube,
    elements: NDArray[np.intp],
    gate: Gate,
    system: System,
    nulls: NullCarriers | None = None,
    factors: Complex | None = None,
    workers: int | None = None,
) -> NDArray[np.complex128]:
    """Transform elements (e, 2) of a cube to the range-Doppler cells (n_range, n_doppler, e) of a gate.

    The transforms are unitary. Factors of the resource elements are applied first. Of a cube with null
    carriers, `system` is that of the band between its outermost used carriers. Sums over the
    symbols of a block are made in the cube's precision, those over
    subcarriers in double. What is not finite or too large is refused.
    """
    n_workers = available_cores() if workers is None else workers
    bins, n_subcarriers = gate.range_bins, system.n_subcarriers
    doppler = partial_dft.doppler_sums(gate.doppler_bins, system.n_symbols)
    along_doppler = doppler.rows_in(cube.dtype)
    has_fast_lines = (
        nulls is None and partial_dft.range_method(bins.size, n_subcarriers, "contiguous") == "fft"
    )
    along_range, n_lines = None, n_subcarriers
    if nulls is not None or partial_dft.range_method(bins.size, n_subcarriers) == "partial":
        along_range, n_lines = partial_dft.range_rows(bins, n_subcarriers), 0
        along_range = along_range if nulls is None else nulls.interpolated(along_range)
    with np.errstate(all="ignore"):  # numbers that are not finite are looked for once, at the end
        weights = None if factors is None else factors.astype(cube.dtype)

    def transform(tile: Tile) -> tuple[NDArray[np.bool_], bool, Complex]:
        """Mask of what an element of a tile holds, whether the tile's share is lines, and the share."""
        block, rows = partial_dft.with_few_elements_outermost(tile.load()), along_doppler[:, tile.symbols]
        held = block[:, :, 0] != 0
        with np.errstate(all="ignore"):  # a thread has its own
            if weights is not None:
                block = block * weights[tile.subcarriers, tile.symbols, None]
            if nulls is not None:  # whatever they held, NaN as well
                block = np.where(nulls.used[tile.subcarriers, None, None], block, 0)
            if has_fast_lines and len(block) == n_subcarriers and partial_dft.is_element_major(block):
                return held, False, partial_dft.transform_lines(block, rows, bins)
            if along_range is None:
                return held, True, partial_dft.transform_block(block, rows)
            return held, False, partial_dft.transform_block(block, rows, along_range[:, tile.subcarriers])

    shape = len(along_doppler), len(elements)
    sums = np.zeros((bins.size, *shape), dtype=np.complex128)
    lines = np.zeros((n_lines, *shape), dtype=cube.dtype)  # of which one FFT gives the range bins in the end
    is_held, has_lines = np.zeros(cube.shape[:2], dtype=np.bool_), False
    with np.errstate(all="ignore"):
        done = in_order(transform, cube.tiles(elements), n_workers, n_workers + TILES_AHEAD)
        for tile, (held, is_lines, share) in done:
            is_held[tile.subcarriers, tile.symbols] |= held
            has_lines |= is_lines
            summed: Complex = lines[tile.subcarriers] if is_lines else sums
            summed[:, :, _consecutive(tile.elements)] += share
        _warn_of_zeros(cube.name, is_held, np.True_ if weights is None else weights != 0)
        if has_lines:
            sums += partial_dft.range_bins_by_fft(lines, bins, n_workers)
        cells = doppler.bins(sums).astype(np.complex128, copy=False)
    if not np.isfinite(cells).all():
        raise InputError(f"{cube.name}: {_find_fault(cube, elements, nulls)}")
    return cells


def _consecutive(index: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Slice in place of consecutive indices, which adds in place."""
    first, size = int(index[0]), index.size
    return slice(first, first + size) if np.array_equal(index, np.arange(first, first + size)) else index


def in_order(
    work: Callable[[Item], Result], items: Iterable[Item], n_threads: int, n_ahead: int
) -> Iterator[tuple[Item, Result]]:
    """Work on items in threads, few at a time, in their order: sums do not depend on the threads."""
    waiting: deque[tuple[Item, Future[Result]]] = deque()
    with ThreadPoolExecutor(n_threads) as threads:
        for item in items:
            waiting.append((item, threads.submit(work, item)))
            if len(waiting) > n_ahead:
                first, future = waiting.popleft()
                yield first, future.result()
        for first, future in waiting:
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
