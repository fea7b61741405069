"""Recorded cubes as sums of tiles, loaded one at a time: where to cut, and their transform to cells."""

import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import permutations, product
from math import prod
from typing import Any, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from isacbench.checked_arrays import Complex, Mask, unmasked_array
from isacbench.cores import available_cores, one_blas_thread
from isacbench.dsp import partial_dft
from isacbench.dsp.null_carriers import NullCarriers
from isacbench.errors import InputError, InputWarning
from isacbench.files.arrays import StoredArray
from isacbench.files.checked_files import GRID_BYTES, binary_size
from isacbench.files.escaping import plural
from isacbench.model.array import VirtualArray
from isacbench.model.gate import Gate
from isacbench.model.numerology import System

Lengths: TypeAlias = tuple[int, ...]
Indices: TypeAlias = NDArray[np.intp]
Extent: TypeAlias = tuple[slice, slice, Indices]
"""Part of a cube that a tile covers: subcarriers, symbols, and indices into the list of elements."""

Item = TypeVar("Item")
Result = TypeVar("Result")

TILE_BYTES = 32 * 2**20
"""Memory that a tile touches by default: 64 subcarriers at the paper's size in complex64."""

CUBE_NAME, GRID_NAME = "cube", "transmitted"
"""Names of a cube and of a transmitted grid in files of several arrays."""

AXES = "(subcarriers, symbols, P, Q)"

SUBCARRIERS, SYMBOLS, ELEMENTS = range(3)
"""Axes along which a cube is cut."""

SUBCARRIER_MULTIPLE = 16
"""Tiles cut along subcarriers have a multiple of this number of them: matrix products are then faster."""

TILES_AHEAD = 1
"""Tiles that are read in advance while others are transformed."""


class Tile(NamedTuple):
    """A part of a cube, loaded when it is asked for.

    It covers slices of subcarriers and symbols with explicit bounds, and elements as indices (e,) into the
    requested list. `load` returns the values (subcarriers, symbols, e) in the cube's precision and native
    byte order, in any strides: perhaps a view, not to be written to. It may be called from any thread and
    again; what it took is released with the array that it returned.
    """

    subcarriers: slice
    symbols: slice
    elements: NDArray[np.intp]
    load: Callable[[], Complex]


class Cube:
    """A recorded frame: one complex number for every subcarrier, symbol and array element.

    Closed at the end of a ``with`` block.

    Attributes
    ----------
    name : str
        Name in messages: the file, and the array in it.
    shape : (int, int, int, int)
        Subcarriers N, symbols M, elements P along u and Q along w.
    dtype : dtype
        complex64 or complex128, native byte order.
    transmitted : ndarray of complex, shape (N, M), or None
        Transmitted grid that the same file holds.
    unused : str
        What the file holds besides that may be data, in a sentence.
    is_in_memory : bool
        True if the whole cube is in memory.
    close : callable
        Closes the file; no tile may be loaded after.

    Parameters
    ----------
    array : ndarray or StoredArray
        Four axes of complex64 or complex128 in any order: ``array[box]`` is
        read, tile by tile, in its chunks or along its largest strides. Neither
        copied nor written to.
    tile_bytes : int, optional
        Memory that a tile may touch; one chunk at least.

    Raises
    ------
    InputError
        If the array is no cube, or parts of it were never written.

    Examples
    --------
    >>> cube = Cube("array", np.ones((8, 4, 2, 2), np.complex64))
    >>> [tile.load().shape for tile in cube.tiles(np.array([[0, 0], [1, 1]]))]
    [(8, 4, 2)]
    """

    def __init__(self, name: str, array: NDArray[Any] | StoredArray, tile_bytes: int = TILE_BYTES) -> None:
        self.is_in_memory = isinstance(array, np.ndarray)
        self.name, self.shape = name, require_cube(name, array.shape, array.dtype)
        self.dtype = array.dtype.newbyteorder("=")
        self.transmitted: Complex | None = None
        self.unused = ""
        self.close: Callable[[], None] = lambda: None
        self._tile_cells = tile_bytes // self.dtype.itemsize
        self._array: NDArray[Any] | StoredArray = array
        if isinstance(array, np.ndarray):
            self._array = unmasked_array(name, array)
        else:
            array.require_filled()

    def tiles(self, elements: NDArray[np.intp]) -> Iterator[Tile]:
        """Cut the cube of some elements (e, 2), given by their indices (p, q), into disjoint tiles."""
        outside = ((elements < 0) | (elements >= self.shape[2:])).any(axis=1)
        if outside.any():
            element = tuple(elements[outside.argmax()].tolist())
            raise InputError(f"{self.name}: has no element {element}; its array is {self.shape[2:]}")
        chunks = getattr(self._array, "chunks", None)
        cut, lengths = (chunked_extents, chunks) if chunks else (strided_extents, self._array.strides)
        assert lengths is not None
        for subcarriers, symbols, chosen in cut(self.shape, lengths, elements, self._tile_cells):
            load = partial(self._load, subcarriers, symbols, elements[chosen])
            yield Tile(subcarriers, symbols, chosen, load)

    def _load(self, subcarriers: slice, symbols: slice, elements: Indices) -> Complex:
        """Read the smallest box around elements (e, 2), and take them from it."""
        first, last = elements.min(axis=0), elements.max(axis=0)
        around = (slice(p, q + 1) for p, q in zip(first.tolist(), last.tolist(), strict=True))
        try:
            values = self._array[subcarriers, symbols, *around]
        except Exception as error:  # Damaged chunks surface as anything that a library of codecs can raise.
            raise InputError(f"{self.name}: is damaged: {error}") from error
        return pick(values, elements - first).astype(self.dtype, copy=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def is_complex(dtype: np.dtype[Any]) -> bool:
    """Tell if a type is complex64 or complex128, in any byte order."""
    return dtype.kind == "c" and dtype.itemsize in (8, 16)


def require_cube(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, int, int, int]:
    """Refuse an array that is no cube, and return its shape."""
    if not is_complex(dtype):
        raise InputError(f"{name}: holds {dtype.newbyteorder('=')}; a cube takes complex64 or complex128")
    if len(shape) != 4 or min(shape) < 1:
        raise InputError(f"{name}: has shape {shape}; a cube takes four axes, none empty: {AXES}")
    n_subcarriers, n_symbols, n_p, n_q = shape
    return n_subcarriers, n_symbols, n_p, n_q


def require_grid(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse an array that is no transmitted grid."""
    if not (is_complex(dtype) or dtype.kind in "iuf"):
        raise InputError(
            f"{name}: holds {dtype.newbyteorder('=')}; "
            "a transmitted grid takes complex64, complex128 or real numbers"
        )
    if len(shape) != 2 or min(shape) < 1:
        raise InputError(
            f"{name}: has shape {shape}; a transmitted grid takes two axes: (subcarriers, symbols)"
        )
    if (takes := 16 * prod(shape)) > GRID_BYTES:
        raise InputError(
            f"{name}: has shape {shape}, which takes {binary_size(takes)} as complex128; "
            f"a transmitted grid takes at most {binary_size(GRID_BYTES)}"
        )


def require_grid_of(cube: Cube, grid: NDArray[Any]) -> None:
    """Refuse a transmitted grid that does not fit a cube."""
    if grid.shape != cube.shape[:2]:
        raise InputError(
            f"{cube.name}: the transmitted grid has shape {grid.shape}; allowed is {cube.shape[:2]}, "
            "subcarriers by symbols as in the cube"
        )


def require_shape(cube: Cube, system: System, array: VirtualArray) -> None:
    """Refuse a cube that does not fit the radio of a scenario, saying so when the axes look permuted."""
    wanted = (system.n_subcarriers, system.n_symbols, *array.shape)
    if cube.shape != wanted:
        orders = permutations(range(4))
        fitting = [str(axes) for axes in orders if tuple(cube.shape[axis] for axis in axes) == wanted]
        fault = f"{cube.name}: has shape {cube.shape}; the scenario takes {wanted}: {AXES}"
        hint = f". The axes look permuted: numpy.transpose with axes {' or '.join(fitting)} would fit"
        raise InputError(fault + hint if fitting else fault)


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
    parts = [group[part] for group in groups for part in slices(len(group), box[ELEMENTS])]
    steps: list[list[Any]] = [*map(slices, lengths, box), parts]
    for choice in product(*(steps[axis] for axis in nesting)):
        subcarriers, symbols, elements = (choice[nesting.index(axis)] for axis in range(3))
        yield subcarriers, symbols, elements


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


def slices(length: int, size: int) -> list[slice]:
    """Cut an axis into slices of a size, the last one shorter."""
    return [slice(start, min(start + size, length)) for start in range(0, length, size)]


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
    has_fast_lines = partial_dft.range_method(bins.size, n_subcarriers, "contiguous") == "fft"
    along_range, n_lines = None, n_subcarriers
    if nulls is not None or partial_dft.range_method(bins.size, n_subcarriers) == "partial":
        along_range, n_lines = partial_dft.range_rows(bins, n_subcarriers), 0
        along_range = along_range if nulls is None else nulls.interpolated(along_range)
    with np.errstate(all="ignore"):  # numbers that are not finite are looked for once, at the end
        weights = None if factors is None else factors.astype(cube.dtype)

    def transform(tile: Tile) -> tuple[Mask, bool, Complex]:
        """Mask of what an element of a tile holds, whether the tile's share is lines, and the share."""
        block, rows = partial_dft.with_few_elements_outermost(tile.load()), along_doppler[:, tile.symbols]
        not_zero = block[:, :, 0] != 0
        with np.errstate(all="ignore"):  # a thread has its own
            if weights is not None:
                block = block * weights[tile.subcarriers, tile.symbols, None]
            if nulls is not None:  # whatever they hold, NaN as well
                block = np.where(nulls.used[tile.subcarriers, None, None], block, 0)
            if (
                nulls is None
                and has_fast_lines
                and len(block) == n_subcarriers
                and partial_dft.is_element_major(block)
            ):
                return not_zero, False, partial_dft.transform_lines(block, rows, bins)
            if along_range is None:
                return not_zero, True, partial_dft.transform_block(block, rows)
            return not_zero, False, partial_dft.transform_block(block, rows, along_range[:, tile.subcarriers])

    shape = len(along_doppler), len(elements)
    sums = np.zeros((bins.size, *shape), dtype=np.complex128)
    lines = np.zeros((n_lines, *shape), dtype=cube.dtype)  # of which one FFT gives the range bins in the end
    has_signal, has_lines = np.zeros(cube.shape[:2], dtype=np.bool_), False
    with np.errstate(all="ignore"):
        done = in_order(transform, cube.tiles(elements), n_workers, n_workers + TILES_AHEAD)
        for tile, (not_zero, is_lines, share) in done:
            has_signal[tile.subcarriers, tile.symbols] |= not_zero
            has_lines |= is_lines
            summed: Complex = lines[tile.subcarriers] if is_lines else sums
            summed[:, :, _consecutive(tile.elements)] += share
        _warn_of_zeros(cube.name, has_signal, np.True_ if weights is None else weights != 0)
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


def _warn_of_zeros(name: str, has_signal: Mask, is_sensed: Mask | np.bool_) -> None:
    """Tell of subcarriers and symbols that hold nothing, but are transformed as if something was received."""
    is_empty, places = ~has_signal & is_sensed, []
    for noun, axis in (("subcarrier", 1), ("symbol", 0)):
        where = is_empty.any(axis) & ~has_signal.any(axis)
        if where.any():
            places.append(f"{plural(int(where.sum()), noun)} from {where.argmax()} on")
    if places and has_signal.any():
        warnings.warn(
            f"{name}: {' and '.join(places)} hold zeros alone, which give false ranges or velocities; a "
            "transmitted grid that is 0 in null carriers leaves them out, symbols have to be cut off",
            InputWarning,
            stacklevel=2,
        )


def _find_fault(cube: Cube, elements: NDArray[np.intp], nulls: NullCarriers | None) -> str:
    """Describe the first number that is not finite by its place, or else an overflow."""
    for tile in cube.tiles(elements):
        faulty = ~np.isfinite(block := tile.load())
        if nulls is not None:
            faulty[~nulls.used[tile.subcarriers]] = False
        if faulty.any():
            n, m, e = np.argwhere(faulty)[0]
            subcarrier, symbol = tile.subcarriers.start + n, tile.symbols.start + m
            element = tuple(elements[tile.elements[e]].tolist())
            place = f"subcarrier {subcarrier}, symbol {symbol}, element {element}"
            return f"{block[n, m, e]} at {place}; allowed are finite numbers"
    return f"sums over the frame overflow {cube.dtype}; scale the cube down"
