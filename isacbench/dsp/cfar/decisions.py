"""From windows to decisions: noise of listed cells or of a whole map, factors, thresholds.

Noise that is made of sums is estimated in strips of rows that fit the cache,
which a whole map does not.
"""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import numpy as np

from isacbench.dsp.cfar.map_scaling import at_most_largest
from isacbench.dsp.cfar.training_cells import ListedWindows, MapWindows
from isacbench.dsp.detection import Detection

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from isacbench.dsp.cfar.map_checks import Cells
    from isacbench.dsp.cfar.training_cells import Axis, Counts, Floats, Windows

_CHUNK = 2**18
"""Cells of windows that are gathered at a time."""

_STRIP = 2**16
"""Cells of a map that are summed at a time: with what lies between, they fit a cache of 1 MiB or two."""

_SMALL_TABLE = 2**16
"""Factors of a table that costs nothing worth mentioning."""

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


def detect_by_sums(
    power: Floats,
    axes: tuple[Axis, ...],
    cells: Cells | None,
    estimate: Callable[[Windows, Floats], Estimate],
    factor_of: Callable[[int], float],
    map_cost: int = 1,
) -> Detection:
    """Test a whole map, or listed cells, against noise from sums axis by axis.

    `map_cost` is how many cells of windows are gathered and summed in the time
    that a cell of a whole map takes: about one, and more where cells are sorted.
    """
    n_window = prod(axis.n_window for axis in axes)
    if cells is not None and cells[0].size * n_window <= map_cost * power.size:
        noise, key = estimate_listed(
            power, axes, cells, lambda windows: estimate(windows, windows.gathered(power))
        )
        return decide(power[cells], noise, factor_map(key, factor_of))
    found = _detect_map(power, axes, estimate, factor_of)
    if cells is None:
        return found
    # The same to the last bit, and faster where much of the map is listed.
    return Detection(found.mask[cells], found.threshold[cells], found.noise[cells])


def _detect_map(
    power: Floats,
    axes: tuple[Axis, ...],
    estimate: Callable[[Windows, Floats], Estimate],
    factor_of: Callable[[int], float],
) -> Detection:
    """Test every cell of a map."""
    power = np.ascontiguousarray(power)
    # One block: allocators keep for the next map what is at most twice as large as the largest one freed.
    found_noise, threshold = np.empty((2, *power.shape))
    mask = np.empty(power.shape, dtype=bool)
    n_rows = max(1, _STRIP // prod(power.shape[1:]))
    last_key, factor = np.empty(0, dtype=np.intp), np.empty(0)
    for start in range(0, len(power), n_rows):
        rows = slice(start, min(start + n_rows, len(power)))
        noise, key = estimate(MapWindows(axes, range(rows.start, rows.stop)), power)
        # Strips between the edges have the same factors.
        if not np.array_equal(key, last_key):
            last_key, factor = key, factor_map(key, factor_of)
        found_noise[rows] = noise
        thresholds(noise, factor, threshold[rows])
        np.greater(power[rows], threshold[rows], out=mask[rows])
    return Detection(mask, threshold, found_noise)


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


def decide(power: Floats, noise: Floats, factor: Floats) -> Detection:
    """Compare powers with factor times noise; factors broadcast."""
    threshold = thresholds(noise, factor)
    return Detection(mask=power > threshold, threshold=threshold, noise=noise)


def thresholds(noise: Floats, factor: Floats, out: Floats | None = None) -> Floats:
    """Multiply factors and noise; what overflows is the largest float64, which no power exceeds."""
    with np.errstate(over="ignore"):
        product: Floats = np.multiply(factor, noise, out=out)
    return at_most_largest(product)


def chunks(axes: tuple[Axis, ...], cells: Cells) -> Iterator[Cells]:
    """Cut a list of cells so that the windows of a part fill little memory; an empty list is one part."""
    size = max(1, _CHUNK // prod(axis.n_window for axis in axes))
    for start in range(0, max(1, cells[0].size), size):
        yield tuple(index[start : start + size] for index in cells)
