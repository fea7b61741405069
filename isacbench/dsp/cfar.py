"""CFAR detection on power maps of any rank.

Every detector estimates the noise around each cell under test from training
cells in a window, and multiplies it with a factor of `isacbench.dsp.thresholds`.

Windows: along an axis the window reaches `training + guard` cells to either
side of the cell under test. Near an edge it keeps its size and shifts to stay
inside the map, while the guard cells stay around the cell under test; each
cell gets the exact factor for the training cells it then has. Nothing is
padded. Training 0 and guard 0 along an axis treat its positions as
independent maps.

Sums run over the training cells directly, in float64: running sums, or a
window minus its guard cells, lose the noise beside a strong echo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, reduce
from math import prod
from numbers import Integral
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import sparse

from isacbench.contracts import Detection
from isacbench.dsp.thresholds import ca_factor, check_looks, check_pfa, osca_factor, paper_factor
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["CellsPerSide", "Threshold", "ca_cfar", "check_cells", "check_threshold", "osca_cfar"]

CellsPerSide = int | tuple[int, ...]
Threshold = Literal["exact", "paper"]


def ca_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
) -> Detection:
    """Test each cell against the mean of the training cells around it.

    Parameters
    ----------
    power : ndarray of real numbers
        Power map of any rank, any unit; finite and not negative.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each.
    guard : int or tuple of int
        Guard cells to either side of the cell under test; 0 leaves out the
        cell under test alone.
    pfa : float
        Probability of false alarm per cell.
    threshold : {"exact", "paper"}, default "exact"
        Exact factor, or the one the paper prints, which misses the rate.
    looks : int, default 1
        Independent noise powers that each cell averages. The printed factor
        knows nothing of them.

    Returns
    -------
    Detection
        Mask, thresholds and mean training power, of the map's shape.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range.

    References
    ----------
    H. M. Finn, R. S. Johnson, RCA Review 29, 1968.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(ca_cfar(power, training=3, guard=1, pfa=1e-3).mask).tolist()
    [[4, 7]]
    """
    cells = _checked_power(power, looks)
    train, keep = _spread(training, guard, cells.ndim)
    _check_test(pfa, threshold)
    axes = _axes(cells.shape, train, keep)

    n_window = prod(axis.n_window for axis in axes)
    n_training = n_window - _outer([axis.n_guard for axis in axes])
    factor = np.empty(n_training.max() + 1)
    for count in np.unique(n_window - _outer([np.unique(axis.n_guard) for axis in axes])).tolist():
        factor[count] = ca_factor(pfa, count, looks) if threshold == "exact" else paper_factor(pfa, count)
    return _decide(cells, _training_sum(cells, axes) / n_training, factor[n_training])


def osca_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide | None,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
) -> Detection:
    """Test each cell against an order statistic along axis 0, averaged over the other axes.

    The window is a set of columns along axis 0 (range). Each column of n
    training cells gives its γ-th smallest, γ = max(1, ⌊0.75 n⌋): the 6th of 9.
    The noise estimate is the mean over the columns. On a 1-D map this is the
    plain order-statistic detector.

    Parameters
    ----------
    power : ndarray of real numbers
        Power map of any rank, axis 0 range; any unit, finite and not negative.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each.
    guard : int or tuple of int or None
        Guard cells to either side of the cell under test, left out of the
        columns that pass through them; 0 leaves out the cell under test alone.
        None keeps the whole window with the cell under test in it, as the
        paper does.
    pfa : float
        Probability of false alarm per cell.
    threshold : {"exact", "paper"}, default "exact"
        Exact factor, or the one the paper prints, which misses the rate; its N
        is the number of cells of a whole column.
    looks : int, default 1
        Independent noise powers that each cell averages. The printed factor
        knows nothing of them.

    Returns
    -------
    Detection
        Mask, thresholds and mean order statistic, of the map's shape.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range; if `guard` is
        None and there are no training cells along axis 0.

    References
    ----------
    arXiv 2310.06401; H. Rohling, IEEE Trans. AES 19(4), 1983.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(osca_cfar(power, training=4, guard=None, pfa=1e-3).mask).tolist()
    [[4, 7]]
    """
    cells = _checked_power(power, looks)
    train, keep = _spread(training, 0 if guard is None else guard, cells.ndim)
    _check_test(pfa, threshold)
    if guard is None and train[0] == 0:
        raise InputError("training = 0 along axis 0: with guard = None it must be at least 1 per side there")
    along, *across = _axes(cells.shape, train, keep)
    n_cells, n_columns = along.n_window, prod(axis.n_window for axis in across)

    def factor_of(columns: tuple[tuple[int, int], ...]) -> float:
        return osca_factor(pfa, columns, looks) if threshold == "exact" else paper_factor(pfa, n_cells)

    whole, whole_column = _whole_order(cells, along), (_rank(n_cells), n_cells)
    if guard is None:
        own_column = (_rank(n_cells), n_cells - 1)
        factor = np.full(cells.shape, factor_of((whole_column,) * (n_columns - 1) + (own_column,)))
        return _decide(cells, _window_sum(whole, across) / n_columns, factor)

    cut_cells = n_cells - along.n_guard
    cut_columns = _outer([axis.n_guard for axis in across])
    used_columns = n_columns - cut_columns + np.multiply.outer(cut_cells > 0, cut_columns)
    noise = _training_sum(whole, across) + _guard_sum(_cut_order(cells, along), across)
    table = np.empty((n_cells + 1, n_columns + 1))
    for n_cut in np.unique(cut_cells).tolist():
        cut_column = ((_rank(n_cut), n_cut),) if n_cut else ()
        for count in np.unique(cut_columns).tolist():
            columns = (whole_column,) * (n_columns - count) + cut_column * count
            table[n_cut, count] = factor_of(columns)
    return _decide(cells, noise / used_columns, table[cut_cells][:, cut_columns])


def _spread(
    training: CellsPerSide, guard: CellsPerSide, n_axes: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Give training and guard cells per side for each axis of the map."""
    spread = []
    for name, sizes in (("training", training), ("guard", guard)):
        check_cells(name, sizes)
        per_axis = sizes if isinstance(sizes, tuple) else (sizes,) * n_axes
        if len(per_axis) != n_axes:
            raise InputError(f"{name} = {sizes}: the map has {n_axes} axes, give one number or {n_axes}")
        spread.append(per_axis)
    return spread[0], spread[1]


def check_cells(name: str, sizes: CellsPerSide) -> None:
    """Refuse numbers of cells per side that are not whole numbers of at least 0.

    Parameters
    ----------
    name : str
        Name of the parameter, for the message; "training" must not be 0 throughout.
    sizes : int or tuple of int
        Cells per side, for all axes or for each.

    Raises
    ------
    InputError
        If a number is negative or no whole number, or all training is 0.
    """
    per_axis = sizes if isinstance(sizes, tuple) else (sizes,)
    if not per_axis or not all(isinstance(size, Integral) and size >= 0 for size in per_axis):
        raise InputError(f"{name} = {sizes!r}: cells per side are whole numbers >= 0, one or a tuple")
    if name == "training" and not any(per_axis):
        raise InputError(f"training = {sizes}: at least one axis needs training cells")


def check_threshold(threshold: str) -> None:
    """Refuse an unknown kind of threshold factor.

    Parameters
    ----------
    threshold : str
        Kind of factor.

    Raises
    ------
    InputError
        If it is neither "exact" nor "paper".
    """
    if threshold not in ("exact", "paper"):
        raise InputError(f'threshold = {threshold!r}: "exact" or "paper" is allowed')


@dataclass(frozen=True, eq=False)
class _Axis:
    """Which cells along one axis train for, guard and surround each of its cells.

    The matrices hold ones: row i marks the cells that belong to cell i.
    """

    n_window: int
    start: NDArray[np.intp]
    n_guard: NDArray[np.intp]
    window: sparse.csr_array
    guard: sparse.csr_array
    training: sparse.csr_array


@lru_cache(maxsize=256)
def _axis(length: int, training: int, guard: int) -> _Axis:
    cell = np.arange(length)
    n_window = 2 * (training + guard) + 1
    start = np.clip(cell - training - guard, 0, length - n_window)
    column = start[:, np.newaxis] + np.arange(n_window)
    row = np.broadcast_to(cell[:, np.newaxis], column.shape)
    guarded = np.abs(column - row) <= guard

    def marked(chosen: NDArray[np.bool_]) -> sparse.csr_array:
        ones = np.ones(np.count_nonzero(chosen))
        return sparse.csr_array((ones, (row[chosen], column[chosen])), shape=(length, length))

    return _Axis(
        n_window,
        start,
        guarded.sum(axis=1),
        marked(np.ones_like(guarded)),
        marked(guarded),
        marked(~guarded),
    )


def _axes(shape: tuple[int, ...], training: tuple[int, ...], guard: tuple[int, ...]) -> list[_Axis]:
    window = tuple(2 * (train + keep) + 1 for train, keep in zip(training, guard, strict=True))
    if any(size > length for size, length in zip(window, shape, strict=True)):
        raise InputError(f"the window of {window} cells is larger than the map of {shape} cells")
    return [_axis(*sizes) for sizes in zip(shape, training, guard, strict=True)]


def _sum_along(values: NDArray[np.float64], marks: sparse.csr_array, axis: int) -> NDArray[np.float64]:
    moved = np.moveaxis(values, axis, 0)
    sums = (marks @ moved.reshape(len(moved), -1)).reshape(moved.shape)
    return np.moveaxis(sums, 0, axis)


def _window_sum(values: NDArray[np.float64], axes: Sequence[_Axis]) -> NDArray[np.float64]:
    """Sum over the window along the last axes."""
    for place, axis in enumerate(axes, start=-len(axes)):
        values = _sum_along(values, axis.window, place)
    return values


def _guard_sum(values: NDArray[np.float64], axes: Sequence[_Axis]) -> NDArray[np.float64]:
    """Sum over the guard cells and the cell under test along the last axes."""
    for place, axis in enumerate(axes, start=-len(axes)):
        values = _sum_along(values, axis.guard, place)
    return values


def _training_sum(values: NDArray[np.float64], axes: Sequence[_Axis]) -> NDArray[np.float64]:
    """Sum over the window without its guard cells along the last axes.

    The frame is cut into blocks: training along one axis, guard along the
    axes before it, the whole window along the axes after it.
    """
    total = np.zeros_like(values)
    for place, axis in enumerate(axes):
        if axis.training.nnz:
            block = _sum_along(values, axis.training, place - len(axes))
            total += _window_sum(block, axes[place + 1 :])
        if place + 1 < len(axes):
            values = _sum_along(values, axis.guard, place - len(axes))
    return total


def _outer(counts: Sequence[NDArray[np.intp]]) -> NDArray[np.intp]:
    """Multiply one vector an axis into a map of products."""
    return reduce(np.multiply.outer, counts, np.asarray(1))


def _rank(n_cells: int) -> int:
    """Give the paper's rank, ⌊0.75 n⌋ of n cells: the 6th smallest of 9."""
    return max(1, 3 * n_cells // 4)


def _whole_order(cells: NDArray[np.float64], along: _Axis) -> NDArray[np.float64]:
    """Give the order statistic of the whole window along axis 0."""
    windows = sliding_window_view(cells, along.n_window, axis=0)
    index = _rank(along.n_window) - 1
    return np.partition(windows, index, axis=-1)[..., index][along.start]


def _cut_order(cells: NDArray[np.float64], along: _Axis) -> NDArray[np.float64]:
    """Give the order statistic of the window without its guard cells along axis 0; 0 where none is left."""
    order = np.zeros_like(cells)
    n_training = along.n_window - along.n_guard
    for count in np.unique(n_training[n_training > 0]).tolist():
        rows = np.flatnonzero(n_training == count)
        chosen = along.training[rows].indices.reshape(-1, count)
        index = _rank(count) - 1
        order[rows] = np.partition(cells[chosen], index, axis=1)[:, index]
    return order


def _decide(cells: NDArray[np.float64], noise: NDArray[np.float64], factor: NDArray[np.float64]) -> Detection:
    with np.errstate(over="ignore"):
        threshold = factor * noise
    if not np.isfinite(threshold).all():
        raise InputError("the power is too large: a threshold overflows float64; scale the map down")
    return Detection(mask=cells > threshold, threshold=threshold, noise=noise)


def _checked_power(power: NDArray[np.floating], looks: int) -> NDArray[np.float64]:
    check_looks(looks)
    given = np.asarray(power)
    if given.dtype.kind not in "fiu":
        raise InputError(f"the power map holds {given.dtype}: real numbers are allowed, take |.|² first")
    if given.ndim == 0 or given.size == 0:
        raise InputError(f"the power map has shape {given.shape}: at least one axis and one cell are needed")
    cells = np.asarray(given, dtype=np.float64)
    lowest, highest = float(cells.min()), float(cells.max())
    # Both are NaN as soon as one cell is.
    if not 0 <= lowest <= highest < math.inf:
        raise InputError(f"the power map spans {lowest} to {highest}: finite powers >= 0 are allowed")
    return cells


def _check_test(pfa: float, threshold: str) -> None:
    check_pfa(pfa)
    check_threshold(threshold)
