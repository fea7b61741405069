"""Windows of CFAR detectors: which cells train for a cell under test, and their sums.

Along an axis the window reaches `training + guard` cells to either side of
the cell under test. Near an edge it keeps its size and shifts to stay inside
the map, while the guard cells stay around the cell under test. Nothing is
padded.

Sums run over the training cells directly, in float64: running sums, or a
window minus its guard cells, lose the noise beside a strong echo. Windows are
summed axis by axis, either over the rows of a map (`MapWindows`) or for a list
of cells (`ListedWindows`). Both add the same numbers in the same order, where
windows are not shifted as `isacbench.dsp.cfar.window_sums` has it and elsewhere one
after the other, so that a cell has the same noise in both to the last bit.
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

from isacbench.dsp.cfar.window_sums import sliding_sums, sum_of_runs
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from isacbench.dsp.cfar.map_checks import Cells
    from isacbench.dsp.cfar.window_sums import Runs

    Floats = NDArray[np.float64]
    Counts = NDArray[np.intp]

Part = Literal["window", "guard", "training", "level", "before_far", "before_near", "after_far", "after_near"]
"""Cells of the window along one axis: near and far are within and beyond the guard cells."""

Side = Literal["before", "after"]
"""Of the cell under test."""


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

    @property
    def reach(self) -> int:
        """Cells of a window that is not shifted to either side of the cell under test."""
        return self.training + self.guard

    @property
    def unshifted(self) -> range:
        """Cells of the axis whose window is not shifted."""
        return range(self.reach, self.length - self.reach)

    def start(self) -> Counts:
        """First cell of the window of each cell of the axis, shape (length,)."""
        return np.clip(np.arange(self.length) - self.reach, 0, self.length - self.n_window)

    def place(self) -> Counts:
        """Place of each cell of the axis in its window, shape (length,)."""
        return np.arange(self.length) - self.start()

    def marks(self, part: Part) -> NDArray[np.bool_]:
        """Places in the window that belong to a part, for each place of the cell under test in it.

        Shape (n_window, n_window).
        """
        return _marks(self.training, self.guard, part)

    def count(self, part: Part) -> Counts:
        """Cells of a part for each cell of the axis, shape (length,)."""
        return _count(self, part)

    def runs(self, part: Part) -> Runs:
        """Runs of a part in a window that is not shifted."""
        return _runs(self, part)

    def matrix(self, part: Part, cells: range) -> sparse.csr_array:
        """Give a matrix that sums a part of the windows of some cells, shape (cells, n_window)."""
        return _matrix(self, part, cells)


@lru_cache(maxsize=1024)
def _marks(training: int, guard: int, part: Part) -> NDArray[np.bool_]:
    place = np.arange(2 * (training + guard) + 1)
    offset = place - place[:, np.newaxis]
    far, side = np.abs(offset) > guard, np.sign(offset)
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
    counts: Counts = axis.marks(part).sum(axis=1)[axis.place()]
    return counts


@lru_cache(maxsize=1024)
def _runs(axis: Axis, part: Part) -> Runs:
    marks = axis.marks(part)[axis.reach]
    ends = np.flatnonzero(np.diff(marks.astype(np.int8), prepend=0, append=0)).tolist()
    return tuple(zip(ends[::2], ends[1::2], strict=True))


@lru_cache(maxsize=1024)
def _matrix(axis: Axis, part: Part, cells: range) -> sparse.csr_array:
    return sparse.csr_array(axis.marks(part)[axis.place()[cells.start : cells.stop]].astype(np.float64))


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
        raise InputError(
            f"the window of {window} cells is larger than the map of {shape} cells: "
            "fewer training or guard cells per side, or a larger map, are needed"
        )
    return axes


class Windows(ABC):
    """Windows of cells under test; sums and counts of their parts.

    `rows` are the places along the first axis that the cells have, or fill.
    `first` leaves out the axes before it, which are summed or sorted already.
    """

    def __init__(self, axes: tuple[Axis, ...], rows: Counts) -> None:
        self.axes = axes
        self.rows = rows

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
        blocks = []
        for number in range(first, len(self.axes)):
            # A shifted window reaches beyond the guard cells even where nothing trains along the axis.
            if self.axes[number].count("training").any():
                block = self.sum_along(values, "training", number)
                blocks.append(self.window_sum(block, number + 1))
            if number + 1 < len(self.axes):
                values = self.sum_along(values, "guard", number)
        return sum(blocks[1:], start=blocks[0]) if blocks else np.zeros(())

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
    """Windows of all cells in consecutive rows of a map.

    Values have all rows of the map until they are summed along the first axis,
    and then those of the cells under test; they must be contiguous in memory.
    """

    def __init__(self, axes: tuple[Axis, ...], rows: range) -> None:
        super().__init__(axes, np.arange(rows.start, rows.stop))
        self._range = rows

    def sum_along(self, values: Floats, part: Part, number: int) -> Floats:
        """Sum a part of the window along an axis, for each cell under test."""
        axis = self.axes[number]
        cells = self._range if number == 0 else range(axis.length)
        n_behind = prod(values.shape[number + 1 :])
        lines = values.reshape(-1, axis.length, n_behind)
        sums = np.empty((len(lines), len(cells), n_behind))
        inside = _common(cells, axis.unshifted)
        if inside:
            # What is summed across the end of a line belongs to shifted windows, which come after.
            seen = lines[:, inside.start - axis.reach : inside.stop + axis.reach].reshape(-1)
            first = (inside.start - cells.start) * n_behind
            n_sums = seen.size - (axis.n_window - 1) * n_behind
            sliding_sums(seen, axis.runs(part), n_behind, sums.reshape(-1)[first : first + n_sums])
        for shifted, window in (
            (_common(cells, range(axis.reach)), slice(0, axis.n_window)),
            (
                _common(cells, range(axis.length - axis.reach, axis.length)),
                slice(axis.length - axis.n_window, axis.length),
            ),
        ):
            if shifted:
                places = slice(shifted.start - cells.start, shifted.stop - cells.start)
                sums[:, places] = _product(axis.matrix(part, shifted), lines[:, window])
        return sums.reshape(*values.shape[:number], len(cells), *values.shape[number + 1 :])

    def count(self, part: Part, number: int) -> Counts:
        """Count the cells of a part along an axis, broadcast against the cells under test."""
        counts = self.axes[number].count(part)
        if number == 0:
            counts = counts[self.rows]
            if counts.min() == counts.max():
                counts = counts[:1]
        shape = [1] * len(self.axes)
        shape[number] = -1
        return counts.reshape(shape)


def _common(some: range, others: range) -> range:
    """Cells in both of two ranges."""
    return range(max(some.start, others.start), min(some.stop, others.stop))


def _product(matrix: sparse.csr_array, lines: Floats) -> Floats:
    """Product of a matrix (m, n) with the middle axis of lines (k, n, l), shape (k, m, l)."""
    n_lines, n_along, n_behind = lines.shape
    columns = lines.transpose(1, 0, 2).reshape(n_along, n_lines * n_behind)
    return (matrix @ columns).reshape(-1, n_lines, n_behind).transpose(1, 0, 2)


class ListedWindows(Windows):
    """Windows of n listed cells; values have the shape (window along the axes that are left, n)."""

    def __init__(self, axes: tuple[Axis, ...], cells: Cells) -> None:
        super().__init__(axes, cells[0])
        self.cells = cells
        self._starts = tuple(axis.start()[index] for axis, index in zip(axes, cells, strict=True))
        self._places = tuple(index - start for index, start in zip(cells, self._starts, strict=True))

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
        keys = np.ravel_multi_index(self._places, window)
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
        """Sum a part of the window along the first axis that is left, in the order of `MapWindows`."""
        axis, index = self.axes[number], self.cells[number]
        shifted = (index < axis.unshifted.start) | (index >= axis.unshifted.stop)
        if not shifted.any():
            return sum_of_runs(values, axis.runs(part))
        sums = np.empty(values.shape[1:])
        sums[..., ~shifted] = sum_of_runs(values[..., ~shifted], axis.runs(part))
        sums[..., shifted] = _sum_marked(
            values[..., shifted], axis.marks(part)[self._places[number][shifted]].T
        )
        return sums

    def count(self, part: Part, number: int) -> Counts:
        """Count the cells of a part along an axis, shape (n,)."""
        return self.axes[number].count(part)[self.cells[number]]


def _sum_marked(values: Floats, marks: NDArray[np.bool_]) -> Floats:
    """Sum one after the other the values (n_window, ..., n) that are marked (n_window, n)."""
    total = np.zeros(values.shape[1:])
    for mark, value in zip(np.ascontiguousarray(marks), values, strict=True):
        # Most often all cells have the same part of the window, or none.
        if mark.all():
            total += value
        elif mark.any():
            total += np.where(mark, value, 0.0)
    return total
