"""Input of CFAR detectors: checked maps, windows and lists of cells, and the training cells of each window.

Along an axis the window reaches `training + guard` cells to either side of the cell under test.
Near an edge it keeps its size and shifts to stay inside the map, while the guard cells stay around
the cell under test. Nothing is padded.

Cells under test whose windows are shifted alike are tested together. Sums add training cells only.
The whole window minus its guard cells, or a running sum, would lose the noise next to a strong echo to
cancellation. The lines of a window are added first, each in sequence: in a list a cell has the same digits as
in the whole map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from numbers import Integral, Real
from typing import Any, Literal, cast

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from isacbench.checked_arrays import Floats, Integers, Mask, checked_array, parts_of
from isacbench.dsp.cfar.factors import checked_count
from isacbench.errors import InputError

CellsPerSide = int | tuple[int, ...]
Threshold = Literal["exact", "paper"]
Cells = tuple["NDArray[np.intp]", ...]
"""Cells of a map as `numpy.nonzero` gives them: for each axis an array of indices, shape (n,)."""

_WEAKEST, _STRONGEST = 1e-200, 1e200
"""Limits of the strongest cell of a map, between which sums and thresholds are right in float64."""

_ROUNDING = 1e-9
"""Margin for rounding in the product of a fraction and a number of cells."""

_MOST_VALUES = 2**19
"""Largest number of values of windows that are gathered at a time."""

CACHED_VALUES = 2**16
"""Values of windows that stay in the cache together."""


def check_cells(name: str, sizes: CellsPerSide) -> None:
    """Refuse cells per side that are not whole numbers of at least 0; "training" is not 0 on all axes."""
    per_axis = sizes if isinstance(sizes, tuple) else (sizes,)
    if not per_axis or not all(isinstance(size, Integral) and size >= 0 for size in per_axis):
        raise InputError(f"{name} = {sizes!r}: cells per side are whole numbers >= 0, one or a tuple")
    if name == "training" and not any(per_axis):
        raise InputError(f"training = {sizes}: at least one axis needs training cells")


def check_fraction(name: str, fraction: float, lowest: float, highest: float) -> None:
    """Refuse a fraction of the training cells that is not a number within limits, which are allowed."""
    if not isinstance(fraction, Real) or not lowest <= fraction <= highest:
        raise InputError(f"{name} = {fraction!r}: a fraction from {lowest:g} to {highest:g} is allowed")


def checked_axis(name: str, axis: int, n_axes: int | None = None) -> int:
    """Check the number of an axis that a detector treats differently; without a map, any from 0."""
    if not isinstance(axis, Integral) or axis < 0:
        raise InputError(f"{name} = {axis!r}: allowed are 0 (range) and above")
    if n_axes is not None and axis >= n_axes:
        raise InputError(
            f"{name} = {axis}: a map of {n_axes} axes has no axis {axis}; allowed are 0 to {n_axes - 1}"
        )
    return int(axis)


def checked_power(power: ArrayLike, looks: int) -> Floats:
    """Check a power map and convert it to float64.

    Parameters
    ----------
    power : array_like of real numbers
        Power map of any rank.
    looks : int
        Independent noise powers that each cell averages.

    Raises
    ------
    InputError
        If the map is complex or empty, or holds NaN, infinite or negative power;
        if its strongest cell is so strong that sums overflow, or so weak that they
        lose digits; or if `looks` is out of range.
    """
    checked_count("looks", looks)
    cells = checked_array("the power map, |.|²", power)
    if cells.ndim == 0 or cells.size == 0:
        raise InputError(f"the power map has shape {cells.shape}: at least one axis and one cell are needed")
    lowest, highest = float(cells.min()), float(cells.max())
    # Both are NaN as soon as one cell is.
    if not 0 <= lowest <= highest < math.inf:
        raise InputError(f"the power map spans {lowest} to {highest}: finite powers >= 0 are allowed")
    # Sums and thresholds of stronger maps overflow, those of weaker ones lose digits.
    if highest and not _WEAKEST <= highest <= _STRONGEST:
        raise InputError(
            f"the strongest cell of the power map is {highest}: scale the map, "
            f"0 or {_WEAKEST} to {_STRONGEST} is allowed"
        )
    return cells


def checked_list(cells: Sequence[ArrayLike], shape: tuple[int, ...]) -> Cells:
    """Check a list of cells under test and convert it to arrays of indices.

    One array of indices from 0 for each axis of the map, shape (n,), as `numpy.nonzero` gives them. Another
    number of arrays, different lengths, and cells outside of the map are refused.
    """
    if not isinstance(cells, tuple) or len(cells) != len(shape):
        raise InputError(
            f"cells: a tuple of {len(shape)} arrays of indices is needed, as numpy.nonzero gives"
        )
    indices = tuple(checked_array("cells", index, np.int64) for index in cells)
    if any(index.ndim != 1 or index.size != indices[0].size for index in indices):
        raise InputError("cells: the arrays of indices must be one-dimensional and equally long")
    for axis, (index, length) in enumerate(zip(indices, shape, strict=True)):
        if index.size and not 0 <= index.min() <= index.max() < length:
            raise InputError(
                f"cells: {index.min()} to {index.max()} along axis {axis}, the map has 0 to {length - 1}"
            )
    return indices


def share_of(fraction: float, n_cells: int) -> int:
    """Share of a number of cells, ⌊fraction n⌋, without the loss of one cell to rounding."""
    return int(fraction * n_cells + _ROUNDING)


Index = tuple[slice, ...] | Cells


@dataclass(frozen=True)
class Axis:
    """One axis of a map, and the cells per side of the window along it.

    Attributes
    ----------
    length : int
        Cells of the map along the axis.
    training, guard : int
        Cells per side.
    """

    length: int
    training: int
    guard: int

    @property
    def reach(self) -> int:
        """Cells to either side of the cell under test in a window that is not shifted."""
        return self.training + self.guard

    @property
    def n_window(self) -> int:
        """Cells of the window."""
        return 2 * self.reach + 1

    def start(self, cell: NDArray[np.intp]) -> NDArray[np.intp]:
        """First cell of each window.

        Parameters
        ----------
        cell : ndarray of int
            Cells under test along the axis.
        """
        return np.clip(cell - self.reach, 0, self.length - self.n_window)

    def at_place(self, place: int) -> slice:
        """Cells under test at a place of their windows: all of the middle, or a cell near an edge."""
        if place == self.reach:
            return slice(self.reach, self.length - self.reach)
        first = place if place < self.reach else self.length - self.n_window + place
        return slice(first, first + 1)

    def window(self, cell: NDArray[np.intp]) -> NDArray[np.intp]:
        """Cells (n_window, n) of the windows of n cells under test."""
        return self.start(cell) + np.arange(self.n_window)[:, None]

    def n_guards(self, cell: NDArray[np.intp]) -> Integers:
        """Number (n,) of the guard cells in these windows."""
        return np.minimum(cell + self.guard, self.length - 1) - np.maximum(cell - self.guard, 0) + 1

    def guards(self, cell: NDArray[np.intp]) -> Mask:
        """Mask (n_window, n) of these guard cells, the cells under test among them."""
        return np.abs(self.window(cell) - cell) <= self.guard


def window_axes(shape: tuple[int, ...], training: CellsPerSide, guard: CellsPerSide) -> tuple[Axis, ...]:
    """Axes of a map with the window along each, of cells per side for all axes or for each.

    InputError if there is not one number for each axis, or if the window is larger than the map.
    """
    per_side = []
    for name, sizes in (("training", training), ("guard", guard)):
        per_axis = sizes if isinstance(sizes, tuple) else (sizes,) * len(shape)
        if len(per_axis) != len(shape):
            n_axes = len(shape)
            raise InputError(f"{name} = {sizes}: the map has {n_axes} axes, give one number or {n_axes}")
        # A NumPy integer may be too narrow for the size of the window.
        per_side.append(map(int, per_axis))
    axes = tuple(Axis(*sizes) for sizes in zip(shape, *per_side, strict=True))
    if any(axis.n_window > axis.length for axis in axes):
        raise InputError(
            f"the window of {tuple(axis.n_window for axis in axes)} cells is larger than the map of {shape} "
            "cells: take fewer training or guard cells per side, or a larger map"
        )
    return axes


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows whose cells under test all have the same place in their window.

    Attributes
    ----------
    axes : tuple of Axis
        Window along each axis of the map.
    cells : tuple of slice or tuple of ndarray of int, each shape (n,)
        Cells under test: a block of the map, or a list.
    place : tuple of int
        Their place in their windows, from 0.
    """

    axes: tuple[Axis, ...]
    cells: Index
    place: tuple[int, ...]

    @property
    def n_training(self) -> int:
        """Number of training cells of a window."""
        return int(self.trains.sum())

    @property
    def n_leading(self) -> int:
        """Number of training cells before the cell under test, in the order of the map."""
        return int(self.trains.ravel()[: np.ravel_multi_index(self.place, self.trains.shape)].sum())

    @property
    def trains(self) -> Mask:
        """Mask of the training cells, of the window's shape."""
        return _training_places(self.axes, self.place)

    def whole(self, power: Floats) -> Floats:
        """All cells of each window.

        Parameters
        ----------
        power : ndarray of float64
            Map.

        Returns
        -------
        ndarray of float64
            Axes of the cells under test, then those of the window.
        """
        windows = sliding_window_view(power, [axis.n_window for axis in self.axes])
        first = tuple(
            slice(cell.start - place, cell.stop - place) if isinstance(cell, slice) else cell - place
            for cell, place in zip(cast("tuple[Any, ...]", self.cells), self.place, strict=True)
        )
        return windows[first]

    def training(self, power: Floats) -> Floats:
        """Training cells of each window, in the order of the map.

        Parameters
        ----------
        power : ndarray of float64
            Map.

        Returns
        -------
        ndarray of float64
            Axes of the cells under test, then one of training cells.
        """
        return self.whole(power)[..., self.trains]


@lru_cache(maxsize=4096)
def _training_places(axes: tuple[Axis, ...], place: tuple[int, ...]) -> Mask:
    """Mask of the cells outside the guard cells, of the window's shape."""
    trains = np.ones(tuple(axis.n_window for axis in axes), dtype=bool)
    guarded = (slice(max(p - axis.guard, 0), p + axis.guard + 1) for p, axis in zip(place, axes, strict=True))
    trains[tuple(guarded)] = False
    return trains


def windows_of(axes: tuple[Axis, ...], cells: Cells | None = None) -> Iterator[tuple[Index, Windows]]:
    """Windows of all cells of a map, or of listed ones, in parts that take little memory.

    Yielded with each is its index in arrays of the map's shape, or of the shape (n,) of the list.
    """
    sizes = tuple(axis.n_window for axis in axes)
    n_together = _MOST_VALUES // prod(sizes)
    if cells is None:
        for place in np.ndindex(*sizes):
            first, *behind = (axis.at_place(p) for axis, p in zip(axes, place, strict=True))
            n_rows = n_together // prod(part.stop - part.start for part in behind)
            for rows in parts_of(first.stop - first.start, n_rows):
                part = (slice(first.start + rows.start, first.start + rows.stop), *behind)
                yield part, Windows(axes, part, place)
        return
    places = tuple(index - axis.start(index) for axis, index in zip(axes, cells, strict=True))
    keys = np.ravel_multi_index(places, sizes)
    for key in np.unique(keys).tolist():
        listed = np.flatnonzero(keys == key)
        place = tuple(int(p) for p in np.unravel_index(key, sizes))
        for some in parts_of(listed.size, n_together):
            chosen = listed[some]
            yield (chosen,), Windows(axes, tuple(index[chosen] for index in cells), place)


def training_sums(
    power: Floats, axes: tuple[Axis, ...], cells: Cells | None = None
) -> tuple[Floats, Integers]:
    """Sums of the training cells of every window, or of those of listed cells, and numbers of these cells."""
    tested = [np.arange(axis.length) for axis in axes] if cells is None else cells
    n_guarded = [axis.n_guards(cell) for axis, cell in zip(axes, tested, strict=True)]
    n_all: Any = prod(axis.n_window for axis in axes)
    if cells is not None:
        return _listed_sums(power, axes, cells), n_all - prod(n_guarded)
    lines, sums = power, np.zeros(power.shape)
    for number, axis in reversed([*enumerate(axes)]):
        sums = sums_along(number, axis, lines, sums)
        lines = sums_along(number, axis, lines, lines) if number else lines
    return sums, n_all - prod(np.ix_(*n_guarded))


def sums_along(number: int, axis: Axis, lines: Floats, guarded: Floats) -> Floats:
    """Sums of windows along an axis of C-contiguous `lines`; guard cells are taken from `guarded`."""
    sums, step = np.zeros(lines.shape), prod(lines.shape[number + 1 :])
    n_inner = lines.size - 2 * axis.reach * step
    inner = sums.ravel()[axis.reach * step :][:n_inner]
    for k in range(axis.n_window):
        source = guarded if abs(k - axis.reach) <= axis.guard else lines
        inner += source.ravel()[k * step :][:n_inner]
    # Windows near an edge are shifted to stay inside: their sums above are wrong, and are made anew.
    edges, edge = np.moveaxis(sums, number, 0), np.r_[: axis.reach, axis.length - axis.reach : axis.length]
    if guarded is lines:
        edges[: axis.reach], edges[axis.length - axis.reach :] = edges[axis.reach], edges[-axis.reach - 1]
        return sums
    guarded, lines = (np.moveaxis(each, number, 0) for each in (guarded, lines))
    for some in parts_of(edge.size, CACHED_VALUES // (axis.n_window * lines[0].size)):
        window = axis.window(edge[some])
        is_guarded = axis.guards(edge[some]).reshape(*window.shape, *[1] * (lines.ndim - 1))
        edges[edge[some]] = total_of(np.where(is_guarded, guarded[window], lines[window]))
    return sums


def _listed_sums(power: Floats, axes: tuple[Axis, ...], cells: Cells) -> Floats:
    """The same of listed cells, in parts that stay in the cache."""
    windows, sums = sliding_window_view(power, [axis.n_window for axis in axes]), np.empty(cells[0].size)
    for some in parts_of(sums.size, CACHED_VALUES // prod(axis.n_window for axis in axes)):
        starts = tuple(axis.start(index[some]) for axis, index in zip(axes, cells, strict=True))
        is_guarded = np.ones(1, dtype=bool)
        for axis, index in zip(axes, cells, strict=True):
            is_guarded = is_guarded[..., None, :] & axis.guards(index[some])
        # Zeros between the terms of a sum change no digit of it.
        terms = np.where(is_guarded, 0, np.moveaxis(windows[starts], 0, -1))
        for _ in axes:
            terms = total_of(np.moveaxis(terms, -2, 0))
        sums[some] = terms
    return sums


def total_of(values: Floats) -> Floats:
    """Sum along the first axis, added in sequence: one cell tested alone gives the same digits as many."""
    terms = np.ascontiguousarray(values)
    # NumPy adds a single column by pairs.
    total: Floats = terms.sum(axis=0) if terms[0].size > 1 else np.add.accumulate(terms, axis=0)[-1]
    return total
