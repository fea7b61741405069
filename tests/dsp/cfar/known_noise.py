"""Noise that the built-in detectors estimate, cell by cell and with exact sums: slow, and plainly right."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Cell = tuple[int, ...]

_ROUNDING = 1e-9
"""What rounding may take from the product of a fraction and a number of cells."""


def known_noise(detector: Any, power: NDArray[np.float64]) -> NDArray[np.float64]:
    """Estimate the noise around every cell of a map with a double loop."""
    return np.array([known_noise_at(detector, power, cell) for cell in np.ndindex(power.shape)])


def known_noise_at(detector: Any, power: NDArray[np.float64], cell: Cell) -> float:
    """Estimate the noise around one cell, as the definition of the built-in detector has it."""
    places = training_cells(detector, power.shape, cell)
    values = [float(power[place]) for place in places]
    match detector.name:
        case "ca":
            return _mean(values)
        case "os":
            return sorted(values)[max(1, share(detector.rank_fraction, len(values))) - 1]
        case "tm":
            first = share(detector.trim_low, len(values))
            stop = len(values) - share(detector.trim_high, len(values))
            return _mean(sorted(values)[first:stop])
        case "osca":
            columns = [[float(power[place]) for place in column] for column in columns_of(detector, places)]
            return _mean([sorted(column)[column_rank(len(column)) - 1] for column in columns])
        case _:
            halves = [half for half in halves_of(detector, places, cell) if half]
            means = [_mean([float(power[place]) for place in half]) for half in halves]
            return max(means) if detector.name == "goca" else min(means)


def columns_of(detector: Any, places: Sequence[Cell]) -> list[list[Cell]]:
    """Sort training cells into columns along the axis of the order statistic."""
    columns: dict[Cell, list[Cell]] = {}
    for place in places:
        columns.setdefault(_without(place, detector.order_axis), []).append(place)
    return list(columns.values())


def column_rank(n_cells: int) -> int:
    """Rank of the order statistic of a column; 1 is the smallest."""
    return max(1, 3 * n_cells // 4)


def halves_of(detector: Any, places: Sequence[Cell], cell: Cell) -> tuple[list[Cell], list[Cell]]:
    """Sort training cells, not the cell under test, into those that lead it and those that trail it."""

    def order(place: Cell) -> Cell:
        return (place[detector.split_axis], *_without(place, detector.split_axis))

    halves: tuple[list[Cell], list[Cell]] = [], []
    tested = order(cell)
    for place in places:
        halves[order(place) > tested].append(place)
    return halves


def training_cells(detector: Any, shape: Cell, cell: Cell) -> list[Cell]:
    """List the training cells of a cell; the window shifts to stay inside the map, its guard cells do not."""
    training = _per_axis(detector.training, len(shape))
    guard = _per_axis(0 if detector.guard is None else detector.guard, len(shape))
    reach = [t + g for t, g in zip(training, guard, strict=True)]
    starts = [
        min(max(place - r, 0), length - 2 * r - 1)
        for place, r, length in zip(cell, reach, shape, strict=True)
    ]
    window = product(*(range(start, start + 2 * r + 1) for start, r in zip(starts, reach, strict=True)))
    if detector.guard is None:
        return list(window)
    guarded = set(product(*(range(c - g, c + g + 1) for c, g in zip(cell, guard, strict=True))))
    return [place for place in window if place not in guarded]


def _per_axis(sizes: int | tuple[int, ...], n_axes: int) -> tuple[int, ...]:
    return sizes if isinstance(sizes, tuple) else (sizes,) * n_axes


def _without(place: Cell, axis: int) -> Cell:
    return (*place[:axis], *place[axis + 1 :])


def share(fraction: float, n_cells: int) -> int:
    """Round a share of the training cells down."""
    return int(fraction * n_cells + _ROUNDING)


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
