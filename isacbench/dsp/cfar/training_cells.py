"""Windows of CFAR detectors: cells under test, and their training cells.

Along an axis the window reaches `training + guard` cells to either side of the cell under test.
Near an edge it keeps its size and shifts to stay inside the map, while the guard cells stay around
the cell under test. Nothing is padded.

Cells under test whose windows are shifted alike are tested together. Sums add training cells only.
The whole window minus its guard cells, or a running sum, would lose the noise next to a strong echo to
cancellation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import prod
from typing import Any, cast

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from isacbench.checked_arrays import Floats, Mask
from isacbench.dsp.cfar.map_checks import Cells
from isacbench.errors import InputError

Index = tuple[slice, ...] | Cells

_MOST_VALUES = 2**19
"""Largest number of values of windows that are gathered at a time."""


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


def window_axes(
    shape: tuple[int, ...], training: tuple[int, ...], guard: tuple[int, ...]
) -> tuple[Axis, ...]:
    """Axes of a map with the window along each.

    Parameters
    ----------
    shape : tuple of int
        Shape of the map.
    training, guard : tuple of int
        Cells per side along each axis.

    Raises
    ------
    InputError
        If the window is larger than the map.
    """
    axes = tuple(Axis(*sizes) for sizes in zip(shape, training, guard, strict=True))
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
    def n_window(self) -> int:
        """Number of cells of a window."""
        return prod(axis.n_window for axis in self.axes)

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
        windows = sliding_window_view(power, self.trains.shape)
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

    Parameters
    ----------
    axes : tuple of Axis
        Window along each axis of the map.
    cells : tuple of ndarray of int, each shape (n,), optional
        Cells under test; default: all cells.

    Yields
    ------
    where : tuple of slice or tuple of ndarray of int
        Index of the part in arrays of the map's shape, or of shape (n,).
    """
    n_together = max(1, _MOST_VALUES // prod(axis.n_window for axis in axes))
    if cells is None:
        for block, place in _blocks(axes):
            first, *behind = block
            n_rows = max(1, n_together // prod(part.stop - part.start for part in behind))
            for start in range(first.start, first.stop, n_rows):
                part = (slice(start, min(start + n_rows, first.stop)), *behind)
                yield part, Windows(axes, part, place)
        return
    places = tuple(index - axis.start(index) for axis, index in zip(axes, cells, strict=True))
    sizes = tuple(axis.n_window for axis in axes)
    keys = np.ravel_multi_index(places, sizes)
    for key in np.unique(keys).tolist():
        rows = np.flatnonzero(keys == key)
        place = tuple(int(p) for p in np.unravel_index(key, sizes))
        for start in range(0, rows.size, n_together):
            chosen = rows[start : start + n_together]
            yield (chosen,), Windows(axes, tuple(index[chosen] for index in cells), place)


def _blocks(axes: tuple[Axis, ...]) -> Iterator[tuple[tuple[slice, ...], tuple[int, ...]]]:
    """Blocks of cells with the same place in their windows: the middle, and each cell near an edge."""
    along = []
    for axis in axes:
        middle = (slice(axis.reach, axis.length - axis.reach), axis.reach)
        before = [(slice(n, n + 1), n) for n in range(axis.reach)]
        first = axis.length - axis.n_window
        after = [(slice(n, n + 1), n - first) for n in range(axis.length - axis.reach, axis.length)]
        along.append([middle, *before, *after])
    for parts in product(*along):
        yield tuple(block for block, _ in parts), tuple(place for _, place in parts)
