"""CFAR detectors that sort their training cells: mean order statistics of columns, and trimmed means."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from isacbench.dsp.cfar.cell_averaging import moved_back, moved_first
from isacbench.dsp.cfar.decisions import decide, detect_by_sums, estimate_by_sorting, factor_map
from isacbench.dsp.cfar.factors.mean_factors import paper_factor
from isacbench.dsp.cfar.factors.order_factors import osca_factor
from isacbench.dsp.cfar.factors.rate_roots import check_pfa
from isacbench.dsp.cfar.factors.trimmed_factors import tm_factor
from isacbench.dsp.cfar.map_checks import (
    check_fraction,
    check_threshold,
    checked_axis,
    checked_list,
    share_of,
    spread,
)
from isacbench.dsp.cfar.map_scaling import ScaledMap
from isacbench.dsp.cfar.training_cells import ListedWindows, window_axes
from isacbench.dsp.detection import Detection
from isacbench.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.dsp.cfar.decisions import Estimate
    from isacbench.dsp.cfar.map_checks import Cells, CellsPerSide, Threshold
    from isacbench.dsp.cfar.training_cells import Floats, Windows

_MAP_COST = 6
"""Measured from 9 x 9 to 41 cells: see `detect_by_sums`."""


def osca_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide | None,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    order_axis: int = 0,
    cells: Cells | None = None,
) -> Detection:
    """Test each cell against an order statistic along one axis, averaged over the other axes.

    The window is a set of columns along `order_axis`. Each column of n
    training cells gives its γ-th smallest, γ = max(1, ⌊0.75 n⌋): the 6th of 9.
    The noise estimate is the mean over the columns. On a 1-D map this is the
    plain order-statistic detector.

    Parameters
    ----------
    power : ndarray of real numbers
        Power map of any rank, any unit; finite and not negative.
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
    order_axis : int, default 0
        Axis of the order statistic: of a range-Doppler map 0 is range, the
        paper's.
    cells : tuple of ndarray of int, optional
        Cells to test, as `numpy.nonzero` gives them; without it all.

    Returns
    -------
    Detection
        Mask, thresholds and mean order statistic, of the map's shape, or of
        shape (n,) for n listed cells.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range, or a cell
        outside the map; if `guard` is None and there are no training cells
        along `order_axis`.

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
    scaled = ScaledMap.of(power, looks)
    values = scaled.values
    order = checked_axis("order_axis", order_axis, values.ndim)
    keep_all = 0 if guard is None else guard
    train, keep = (moved_first(sizes, order) for sizes in spread(training, keep_all, values.ndim))
    check_pfa(pfa)
    check_threshold(threshold)
    if guard is None and train[0] == 0:
        raise InputError(
            f"training = 0 along axis {order}: with guard = None it must be at least 1 per side there"
        )
    listed = None if cells is None else moved_first(checked_list(cells, values.shape), order)
    values = np.moveaxis(values, order, 0)
    axes = window_axes(values.shape, train, keep)
    n_cells, n_columns = axes[0].n_window, prod(axis.n_window for axis in axes[1:])

    def estimate(windows: Windows, values: Floats) -> Estimate:
        whole = _column_order(windows, values)
        if guard is None:
            return windows.window_sum(whole, 1) / n_columns, np.asarray(0)
        n_cut = n_cells - windows.count("guard", 0)
        cut_columns = windows.n_guard(1)
        cut = _cut_column_order(windows, values)
        total = windows.training_sum(whole, 1) + windows.guard_sum(cut, 1)
        n_used = n_columns - cut_columns + (n_cut > 0) * cut_columns
        return total / n_used, n_cut * (n_columns + 1) + cut_columns

    def factor_of(key: int) -> float:
        if threshold == "paper":
            return paper_factor(pfa, n_cells)
        whole_column = (_rank(n_cells), n_cells)
        if guard is None:
            own_column = (_rank(n_cells), n_cells - 1)
            return osca_factor(pfa, (whole_column,) * (n_columns - 1) + (own_column,), looks)
        n_cut, cut_columns = divmod(key, n_columns + 1)
        cut_column = ((_rank(n_cut), n_cut),) if n_cut else ()
        columns = (whole_column,) * (n_columns - cut_columns) + cut_column * cut_columns
        return osca_factor(pfa, columns, looks)

    found = detect_by_sums(values, axes, listed, estimate, factor_of, _MAP_COST)
    return scaled.unscaled(found if listed is not None else moved_back(found, order), cells)


def tm_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    trim_low: float = 0.25,
    trim_high: float = 0.25,
    cells: Cells | None = None,
) -> Detection:
    """Test each cell against the mean of the training cells without the smallest and the largest.

    Of n training cells the ⌊`trim_low` n⌋ smallest and the ⌊`trim_high` n⌋
    largest are left out: 18 and 18 of 72.

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
        Exact factor, or the one the paper prints, which misses the rate; its N
        is the number of training cells.
    looks : int, default 1
        Independent noise powers that each cell averages. The printed factor
        knows nothing of them.
    trim_low, trim_high : float, default 0.25
        Fractions of the training cells that are left out; below 1 together.
    cells : tuple of ndarray of int, optional
        Cells to test, as `numpy.nonzero` gives them; without it all.

    Returns
    -------
    Detection
        Mask, thresholds and trimmed mean, of the map's shape, or of shape (n,) for
        n listed cells.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range, or a cell
        outside the map.

    References
    ----------
    P. P. Gandhi, S. A. Kassam, IEEE Trans. AES 24(4), 1988.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(tm_cfar(power, training=3, guard=1, pfa=1e-3).mask).tolist()
    [[4, 7]]
    """
    scaled = ScaledMap.of(power, looks)
    values = scaled.values
    train, keep = spread(training, guard, values.ndim)
    check_pfa(pfa)
    check_threshold(threshold)
    check_trim(trim_low, trim_high)
    axes = window_axes(values.shape, train, keep)
    listed = None if cells is None else checked_list(cells, values.shape)

    def trimmed(n_training: int) -> tuple[int, int]:
        return share_of(trim_low, n_training), share_of(trim_high, n_training)

    def estimate(training_cells: Floats) -> Floats:
        below, above = trimmed(training_cells.shape[1])
        kept = np.sort(training_cells, axis=1)[:, below : training_cells.shape[1] - above]
        mean: Floats = kept.mean(axis=1)
        return mean

    def factor_of(n_training: int) -> float:
        if threshold == "paper":
            return paper_factor(pfa, n_training)
        return tm_factor(pfa, n_training, trimmed(n_training), looks)

    noise, n_training = estimate_by_sorting(values, axes, listed, estimate)
    found = decide(values if listed is None else values[listed], noise, factor_map(n_training, factor_of))
    return scaled.unscaled(found, cells)


def check_trim(trim_low: float, trim_high: float) -> None:
    """Refuse fractions that leave nothing of the training cells.

    Raises
    ------
    InputError
        If a fraction is out of range, or both together are 1 or more.
    """
    check_fraction("trim_low", trim_low, 0, 1)
    check_fraction("trim_high", trim_high, 0, 1)
    if trim_low + trim_high >= 1:
        raise InputError(
            f"trim_low = {trim_low}, trim_high = {trim_high}: together below 1, or no training cell is left"
        )


def _column_order(windows: Windows, values: Floats) -> Floats:
    """Give the order statistic of each column of the window along axis 0."""
    along = windows.axes[0]
    index = _rank(along.n_window) - 1
    if isinstance(windows, ListedWindows):
        order: Floats = np.partition(values, index, axis=0)[index]
        return order
    start = along.start()[windows.rows]
    seen = values[start[0] : start[-1] + along.n_window]
    columns = sliding_window_view(seen, along.n_window, axis=0)
    order = np.partition(columns, index, axis=-1)[..., index][start - start[0]]
    return order


def _cut_column_order(windows: Windows, values: Floats) -> Floats:
    """Give the order statistic of each column without its guard cells along axis 0; 0 where none is left."""
    along = windows.axes[0]
    listed = isinstance(windows, ListedWindows)
    rows = windows.rows
    counts = along.count("training")[rows]
    windowed = np.moveaxis(values, -1, 0) if listed else values
    order = np.zeros((rows.size, *windowed.shape[2 if listed else 1 :]))
    for count in np.unique(counts[counts > 0]).tolist():
        chosen = np.flatnonzero(counts == count)
        place = np.nonzero(along.marks("training")[along.place()[rows[chosen]]])[1].reshape(-1, count)
        if listed:
            columns = windowed[chosen[:, np.newaxis], place]
        else:
            columns = windowed[along.start()[rows[chosen], np.newaxis] + place]
        index = _rank(count) - 1
        order[chosen] = np.partition(columns, index, axis=1)[:, index]
    return np.moveaxis(order, 0, -1) if listed else order


def _rank(n_cells: int) -> int:
    """Give the paper's rank, ⌊0.75 n⌋ of n cells: the 6th smallest of 9."""
    return max(1, 3 * n_cells // 4)
