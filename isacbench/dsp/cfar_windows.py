"""Windows of CFAR detectors: which cells train for a cell under test, and their sums.

Along an axis the window reaches `training + guard` cells to either side of
the cell under test. Near an edge it keeps its size and shifts to stay inside
the map, while the guard cells stay around the cell under test. Nothing is
padded.

Sums run over the training cells directly, in float64: running sums, or a
window minus its guard cells, lose the noise beside a strong echo. Windows are
summed axis by axis, either over a whole map (`MapWindows`) or for a list of
cells (`ListedWindows`); both add the same numbers in the same order, so that a
cell has the same noise in both to the last bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import sparse

from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from isacbench.dsp.cfar_checks import Cells

    Floats = NDArray[np.float64]
    Counts = NDArray[np.intp]

__all__ = [
    "Axis",
    "ListedWindows",
    "MapWindows",
    "Windows",
    "chunks",
    "estimate_by_sorting",
    "estimate_by_sums",
    "estimate_listed",
    "factor_map",
    "window_axes",
]

Part = Literal["window", "guard", "training", "level", "before_far", "before_near", "after_far", "after_near"]
"""Cells of the window along one axis: near and far are within and beyond the guard cells."""

Side = Literal["before", "after"]
"""Of the cell under test."""

_CHUNK = 2**20
"""Cells of windows that are gathered at a time."""

_GATHERING = 6
"""Time to gather and sum a cell of a window over that to add a cell in the sums of a whole map."""

_SMALL_TABLE = 2**16
"""Factors of a table that costs nothing worth mentioning."""


@dataclass(frozen=True)
class Axis:
    """One axis of a map, and the cells per side of the window along it."""

    length: int
    training: int
    guard: int

    @property
    def n_window(self) -> int:
        """Cells of the window along the axis."""
        return 2 * (self.training + self.guard) + 1

    def start(self) -> Counts:
        """First cell of the window of each cell of the axis, shape (length,)."""
        reach = self.training + self.guard
        return np.clip(np.arange(self.length) - reach, 0, self.length - self.n_window)

    def marks(self, part: Part) -> NDArray[np.bool_]:
        """Places in the window of each cell that belong to a part, shape (length, n_window)."""
        return _marks(self, part)

    def count(self, part: Part) -> Counts:
        """Cells of a part for each cell of the axis, shape (length,)."""
        return _count(self, part)

    def matrix(self, part: Part) -> sparse.csr_array:
        """Give a matrix that sums a part for each cell of the axis, shape (length, length)."""
        return _matrix(self, part)


@lru_cache(maxsize=1024)
def _marks(axis: Axis, part: Part) -> NDArray[np.bool_]:
    cell = np.arange(axis.length)[:, np.newaxis]
    offset = axis.start()[:, np.newaxis] + np.arange(axis.n_window) - cell
    far, side = np.abs(offset) > axis.guard, np.sign(offset)
    marks: NDArray[np.bool_] = {
        "window": np.ones_like(far),
        "guard": ~far,
        "training": far,
        "level": side == 0,
        "before_far": far & (side < 0),
        "before_near": ~far & (side < 0),
        "after_far": far & (side > 0),
        "after_near": ~far & (side > 0),
    }[part]
    marks.flags.writeable = False
    return marks


@lru_cache(maxsize=1024)
def _count(axis: Axis, part: Part) -> Counts:
    counts: Counts = _marks(axis, part).sum(axis=1)
    return counts


@lru_cache(maxsize=1024)
def _matrix(axis: Axis, part: Part) -> sparse.csr_array:
    row, place = np.nonzero(_marks(axis, part))
    column = axis.start()[row] + place
    return sparse.csr_array((np.ones(row.size), (row, column)), shape=(axis.length, axis.length))


def window_axes(
    shape: tuple[int, ...], training: tuple[int, ...], guard: tuple[int, ...]
) -> tuple[Axis, ...]:
    """Give the axes of a map with the window along each.

    Raises
    ------
    InputError
        If the window is larger than the map.
    """
    axes = tuple(Axis(*sizes) for sizes in zip(shape, training, guard, strict=True))
    if any(axis.n_window > axis.length for axis in axes):
        window = tuple(axis.n_window for axis in axes)
        raise InputError(f"the window of {window} cells is larger than the map of {shape} cells")
    return axes


class Windows(ABC):
    """Windows of cells under test; sums and counts of their parts.

    `first` leaves out the axes before it, which are summed or sorted already.
    """

    def __init__(self, axes: tuple[Axis, ...]) -> None:
        self.axes = axes

    @abstractmethod
    def sum_along(self, values: Floats, part: Part, number: int) -> Floats:
        """Sum a part of the window along an axis."""

    @abstractmethod
    def count(self, part: Part, number: int) -> Counts:
        """Count the cells of a part along an axis; counts of all axes broadcast to the cells under test."""

    def n_window(self, first: int = 0) -> int:
        """Cells of the window."""
        return prod(axis.n_window for axis in self.axes[first:])

    def n_guard(self, first: int = 0) -> Counts:
        """Guard cells and cell under test of each window."""
        counts = np.asarray(1)
        for number in range(first, len(self.axes)):
            counts = counts * self.count("guard", number)
        return counts

    def n_half(self, side: Side, first: int = 0) -> Counts:
        """Training cells before, or after, the cell under test, see `half_sum`."""
        if first == len(self.axes):
            return np.asarray(0)
        far = self.count("before_far" if side == "before" else "after_far", first)
        near = self.count("before_near" if side == "before" else "after_near", first)
        n_training = self.n_window(first + 1) - self.n_guard(first + 1)
        return far * self.n_window(first + 1) + near * n_training + self.n_half(side, first + 1)

    def window_sum(self, values: Floats, first: int = 0) -> Floats:
        """Sum over the window."""
        for number in range(first, len(self.axes)):
            values = self.sum_along(values, "window", number)
        return values

    def guard_sum(self, values: Floats, first: int = 0) -> Floats:
        """Sum over the guard cells and the cell under test."""
        for number in range(first, len(self.axes)):
            values = self.sum_along(values, "guard", number)
        return values

    def training_sum(self, values: Floats, first: int = 0) -> Floats:
        """Sum over the window without its guard cells.

        The frame is cut into blocks: training along one axis, guard along the
        axes before it, the whole window along the axes after it.
        """
        total = np.zeros(())
        for number in range(first, len(self.axes)):
            # A shifted window reaches beyond the guard cells even where nothing trains along the axis.
            if self.axes[number].count("training").any():
                block = self.sum_along(values, "training", number)
                total = total + self.window_sum(block, number + 1)
            if number + 1 < len(self.axes):
                values = self.sum_along(values, "guard", number)
        return total

    def half_sum(self, values: Floats, side: Side, first: int = 0) -> Floats:
        """Sum over the training cells before, or after, the cell under test.

        Cells are ordered by their place along the first axis; those level with
        the cell under test by their place along the next, and so on. The two
        halves of a window that is not shifted mirror each other.
        """
        if first == len(self.axes):
            return np.zeros(())
        far: Part = "before_far" if side == "before" else "after_far"
        near: Part = "before_near" if side == "before" else "after_near"
        total = self.window_sum(self.sum_along(values, far, first), first + 1)
        if first + 1 < len(self.axes):
            total = total + self.training_sum(self.sum_along(values, near, first), first + 1)
            level = self.sum_along(values, "level", first)
            total = total + self.half_sum(level, side, first + 1)
        return total


class MapWindows(Windows):
    """Windows of every cell of a map; values keep the map's shape."""

    def sum_along(self, values: Floats, part: Part, number: int) -> Floats:
        """Sum a part of the window along an axis, for each cell of the map."""
        if part == "level":
            return values
        moved = np.moveaxis(values, number, 0)
        sums = (self.axes[number].matrix(part) @ moved.reshape(len(moved), -1)).reshape(moved.shape)
        return np.moveaxis(sums, 0, number)

    def count(self, part: Part, number: int) -> Counts:
        """Count the cells of a part along an axis, broadcast against the map."""
        shape = [1] * len(self.axes)
        shape[number] = -1
        return self.axes[number].count(part).reshape(shape)


class ListedWindows(Windows):
    """Windows of n listed cells; values have the shape (window along the axes that are left, n)."""

    def __init__(self, axes: tuple[Axis, ...], cells: Cells) -> None:
        super().__init__(axes)
        self.cells = cells
        self._starts = tuple(axis.start()[index] for axis, index in zip(axes, cells, strict=True))

    def gathered(self, power: Floats) -> Floats:
        """Copy the windows out of a map, shape (window along each axis, n)."""
        windows = sliding_window_view(power, tuple(axis.n_window for axis in self.axes))
        last = np.moveaxis(windows, range(power.ndim), range(power.ndim, 2 * power.ndim))
        values: Floats = last[(slice(None),) * power.ndim + self._starts]
        return values

    def training_cells(self, power: Floats) -> Iterator[tuple[Counts, Floats]]:
        """Copy the training cells out of a map, together for cells that have them in the same places.

        Yields
        ------
        chosen : ndarray of int, shape (m,)
            Which of the listed cells.
        training : ndarray of float64, shape (m, number of training cells)
        """
        window = tuple(axis.n_window for axis in self.axes)
        windows = sliding_window_view(power, window)[self._starts].reshape(-1, prod(window))
        places = [index - start for index, start in zip(self.cells, self._starts, strict=True)]
        keys = np.ravel_multi_index(places, window)
        for key in np.unique(keys).tolist():
            guarded = np.zeros(window, dtype=bool)
            guarded[
                tuple(
                    slice(max(place - axis.guard, 0), place + axis.guard + 1)
                    for place, axis in zip(np.unravel_index(key, window), self.axes, strict=True)
                )
            ] = True
            trains = np.flatnonzero(~guarded.ravel())
            chosen = np.flatnonzero(keys == key)
            some = windows if chosen.size == keys.size else windows[chosen]
            yield chosen, some.take(trains, axis=1)

    def sum_along(self, values: Floats, part: Part, number: int) -> Floats:
        """Sum a part of the window along the first axis that is left, as the product with a matrix does."""
        marks = self.axes[number].marks(part)[self.cells[number]].T
        total = np.zeros(values.shape[1:])
        for mark, value in zip(np.ascontiguousarray(marks), values, strict=True):
            # Most often all cells have the same part of the window, or none.
            if mark.all():
                total += value
            elif mark.any():
                total += np.where(mark, value, 0.0)
        return total

    def count(self, part: Part, number: int) -> Counts:
        """Count the cells of a part along an axis, shape (n,)."""
        return self.axes[number].count(part)[self.cells[number]]


Estimate = tuple["Floats", "Counts"]
"""Noise of cells under test, and a number for each that its factor depends on."""


def estimate_listed(
    power: Floats,
    axes: tuple[Axis, ...],
    cells: Cells,
    estimate: Callable[[ListedWindows], Estimate],
) -> Estimate:
    """Estimate the noise of listed cells, as many at a time as fill little memory."""
    parts = []
    for some in chunks(axes, cells):
        # A noise that overflows becomes a threshold that is refused.
        with np.errstate(over="ignore"):
            noise, key = estimate(ListedWindows(axes, some))
        parts.append((noise, np.broadcast_to(key, noise.shape)))
    noises, keys = zip(*parts, strict=True)
    return np.concatenate(noises), np.concatenate(keys)


def estimate_by_sorting(
    power: Floats, axes: tuple[Axis, ...], cells: Cells | None, estimate: Callable[[Floats], Floats]
) -> Estimate:
    """Estimate the noise of a whole map, or of listed cells, from sorted training cells (m, number).

    Factors depend on the number of training cells.
    """
    listed = np.unravel_index(np.arange(power.size), power.shape) if cells is None else cells

    def estimate_some(windows: ListedWindows) -> Estimate:
        noise = np.empty(windows.cells[0].size)
        for chosen, training in windows.training_cells(power):
            noise[chosen] = estimate(training)
        return noise, windows.n_window() - windows.n_guard()

    noise, n_training = estimate_listed(power, axes, listed, estimate_some)
    if cells is not None:
        return noise, n_training
    return noise.reshape(power.shape), n_training.reshape(power.shape)


def estimate_by_sums(
    power: Floats,
    axes: tuple[Axis, ...],
    cells: Cells | None,
    estimate: Callable[[Windows, Floats], Estimate],
) -> Estimate:
    """Estimate the noise of a whole map, or of listed cells, from sums axis by axis."""
    n_window, n_along = prod(axis.n_window for axis in axes), sum(axis.n_window for axis in axes)
    if cells is not None and _GATHERING * cells[0].size * n_window <= power.size * n_along:
        return estimate_listed(power, axes, cells, lambda windows: estimate(windows, windows.gathered(power)))
    noise, key = estimate(MapWindows(axes), power)
    key = np.broadcast_to(key, noise.shape)
    # The same to the last bit, and faster where much of the map is listed.
    return (noise, key) if cells is None else (noise[cells], key[cells])


def factor_map(keys: Counts, factor_of: Callable[[int], float]) -> Floats:
    """Give the factor of each cell, evaluated once for each number that occurs."""
    if not keys.size:
        return np.empty(keys.shape)
    highest = int(keys.max())
    if highest > keys.size + _SMALL_TABLE:
        occurring, place = np.unique(keys, return_inverse=True)
        return np.array([factor_of(key) for key in occurring.tolist()])[place].reshape(keys.shape)
    table = np.empty(highest + 1)
    for key in np.flatnonzero(np.bincount(keys.ravel())).tolist():
        table[key] = factor_of(key)
    factors: Floats = table[keys]
    return factors


def chunks(axes: tuple[Axis, ...], cells: Cells) -> Iterator[Cells]:
    """Cut a list of cells so that the windows of a part fill little memory; an empty list is one part."""
    size = max(1, _CHUNK // prod(axis.n_window for axis in axes))
    for start in range(0, max(1, cells[0].size), size):
        yield tuple(index[start : start + size] for index in cells)
