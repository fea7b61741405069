"""The order-statistic CFAR detector; its mask comes from counting, without sorting."""

from __future__ import annotations

from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from isacbench.dsp.cfar.decisions import chunks, estimate_by_sorting, factor_map, thresholds
from isacbench.dsp.cfar.factors.mean_factors import paper_factor
from isacbench.dsp.cfar.factors.order_factors import osca_factor
from isacbench.dsp.cfar.factors.rate_roots import check_pfa
from isacbench.dsp.cfar.map_checks import (
    check_fraction,
    check_threshold,
    checked_list,
    share_of,
    spread,
)
from isacbench.dsp.cfar.map_scaling import ScaledMap, unscaled_noise, unscaled_threshold
from isacbench.dsp.cfar.training_cells import Axis, ListedWindows, window_axes
from isacbench.dsp.detection import Detection

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.dsp.cfar.decisions import Estimate
    from isacbench.dsp.cfar.map_checks import Cells, CellsPerSide, Threshold
    from isacbench.dsp.cfar.training_cells import Floats

_BLOCK = 2**15
"""Cells of a map that are counted at a time: few enough for the cache."""


def os_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    rank_fraction: float = 0.75,
    cells: Cells | None = None,
) -> Detection:
    """Test each cell against an order statistic of the training cells around it.

    Of n training cells it is the k-th smallest, k = max(1, ⌊`rank_fraction` n⌋):
    the 54th of 72. The mask comes from counting, see `os_mask`; noise and
    thresholds are computed when they are first asked for, and cost ten times
    as much.

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
    rank_fraction : float, default 0.75
        Rank over number of training cells.
    cells : tuple of ndarray of int, optional
        Cells to test, as `numpy.nonzero` gives them; without it all.

    Returns
    -------
    Detection
        Mask, thresholds and order statistic, of the map's shape, or of shape (n,) for
        n listed cells.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range, or a cell
        outside the map.

    References
    ----------
    H. Rohling, IEEE Trans. AES 19(4), 1983.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(os_cfar(power, training=3, guard=1, pfa=1e-3).mask).tolist()
    [[4, 7]]
    """
    test = _OsTest.of(power, training, guard, pfa, threshold, looks, rank_fraction, cells)
    return _LazyDetection(test.mask(), test)


def os_mask(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    rank_fraction: float = 0.75,
    cells: Cells | None = None,
) -> NDArray[np.bool_]:
    """Give the mask of `os_cfar` by counting, without sorting.

    A cell of power x exceeds α times the k-th smallest training cell where k
    training cells or more lie below x/α. Training cells times α are compared
    with x, so that both say the same to the last bit.

    Parameters
    ----------
    power, training, guard, pfa, threshold, looks, rank_fraction, cells
        See `os_cfar`.

    Returns
    -------
    ndarray of bool
        Of the map's shape, or of shape (n,) for n listed cells.

    Raises
    ------
    InputError
        As `os_cfar` does.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(os_mask(power, training=3, guard=1, pfa=1e-3)).tolist()
    [[4, 7]]
    """
    return _OsTest.of(power, training, guard, pfa, threshold, looks, rank_fraction, cells).mask()


class _OsTest(NamedTuple):
    """An order-statistic test of a map or of listed cells; its mask does not need its noise."""

    power: Floats
    axes: tuple[Axis, ...]
    cells: Cells | None
    pfa: float
    exact: bool
    looks: int
    rank_fraction: float
    exponent: int
    """Of the power of two that the map is scaled by."""

    @classmethod
    def of(
        cls,
        power: NDArray[np.floating],
        training: CellsPerSide,
        guard: CellsPerSide,
        pfa: float,
        threshold: Threshold,
        looks: int,
        rank_fraction: float,
        cells: Cells | None,
    ) -> _OsTest:
        scaled = ScaledMap.of(power, looks, sums=False)
        values = scaled.values
        train, keep = spread(training, guard, values.ndim)
        check_pfa(pfa)
        check_threshold(threshold)
        check_fraction("rank_fraction", rank_fraction, 0, 1)
        axes = window_axes(values.shape, train, keep)
        listed = None if cells is None else checked_list(cells, values.shape)
        exact = threshold == "exact"
        return cls(values, axes, listed, pfa, exact, looks, rank_fraction, scaled.exponent)

    def rank(self, n_training: int) -> int:
        return max(1, share_of(self.rank_fraction, n_training))

    def factor(self, n_training: int) -> float:
        if not self.exact:
            return paper_factor(self.pfa, n_training)
        return osca_factor(self.pfa, ((self.rank(n_training), n_training),), self.looks)

    def noise(self) -> Estimate:
        def order(training_cells: Floats) -> Floats:
            index = self.rank(training_cells.shape[1]) - 1
            statistic: Floats = np.partition(training_cells, index, axis=1)[:, index]
            return statistic

        return estimate_by_sorting(self.power, self.axes, self.cells, order)

    def mask(self) -> NDArray[np.bool_]:
        if self.cells is not None:
            return self._counted(self.cells)
        mask = np.ones(self.power.shape, dtype=bool)
        mask[tuple(slice(axis.unshifted.start, axis.unshifted.stop) for axis in self.axes)] = False
        mask[self._not_rejected()] = True
        doubtful = np.nonzero(mask)
        mask[doubtful] = self._counted(doubtful)
        return mask

    def _counted(self, cells: Cells) -> NDArray[np.bool_]:
        """Test listed cells by counting the training cells below."""
        masks = []
        for some in chunks(self.axes, cells):
            under_test = self.power[some]
            mask = np.empty(under_test.shape, dtype=bool)
            for chosen, training_cells in ListedWindows(self.axes, some).training_cells(self.power):
                count = training_cells.shape[1]
                scaled = thresholds(training_cells, np.asarray(self.factor(count)))
                below = np.count_nonzero(scaled < under_test[chosen, np.newaxis], axis=1)
                mask[chosen] = below >= self.rank(count)
            masks.append(mask)
        return np.concatenate(masks)

    def _not_rejected(self) -> Cells:
        """Cells whose window is not shifted and that half of their training cells do not reject.

        A cell is rejected as soon as too many training cells do not lie below:
        nearly all are. A neighbour is a fixed number of cells away in memory,
        so that a stretch of it is counted at a time; where it goes around the
        end of an axis windows are shifted, and nothing that is counted counts.
        """
        axes, power = self.axes, np.ascontiguousarray(self.power)
        n_training = prod(axis.n_window for axis in axes) - prod(2 * axis.guard + 1 for axis in axes)
        scaled = thresholds(power, np.asarray(self.factor(n_training))).ravel()
        most_above = n_training - self.rank(n_training)
        steps = self._training_steps()[: 2 * (most_above + 1)]
        first = _step(power.shape, tuple(axis.reach for axis in axes))
        under_test = power.ravel()[first : power.size - first]
        found = []
        for start in range(0, under_test.size, _BLOCK):
            tested = under_test[start : start + _BLOCK]
            above = np.zeros(tested.shape, dtype=np.min_scalar_type(len(steps)))
            not_below = np.empty(tested.shape, dtype=bool)
            for step in steps:
                there = first + start + step
                np.greater_equal(scaled[there : there + tested.size], tested, out=not_below)
                np.add(above, not_below.view(np.uint8), out=above)
            found.append(first + start + np.flatnonzero(above <= most_above))
        cells = np.unravel_index(np.concatenate(found), power.shape)
        inside = np.all(
            [
                (index >= axis.unshifted.start) & (index < axis.unshifted.stop)
                for index, axis in zip(cells, axes, strict=True)
            ],
            axis=0,
        )
        return tuple(index[inside] for index in cells)

    def _training_steps(self) -> list[int]:
        """Cells in memory from a cell under test to those that train for it, where no window is shifted."""
        offsets = (
            tuple(place - axis.reach for place, axis in zip(places, self.axes, strict=True))
            for places in np.ndindex(tuple(axis.n_window for axis in self.axes))
        )
        return [
            _step(self.power.shape, offset)
            for offset in offsets
            if any(abs(o) > axis.guard for o, axis in zip(offset, self.axes, strict=True))
        ]


def _step(shape: tuple[int, ...], offset: tuple[int, ...]) -> int:
    """Cells in memory between two cells of a map that are an offset apart."""
    step = 0
    for length, o in zip(shape, offset, strict=True):
        step = step * length + o
    return step


class _LazyDetection(Detection):
    """A detection whose noise and thresholds are computed when they are first asked for."""

    def __init__(self, mask: NDArray[np.bool_], test: _OsTest) -> None:
        self.__dict__["mask"] = mask
        # The map may be written to before noise is asked for.
        self.__dict__["_test"] = test._replace(power=test.power.copy())

    def __reduce__(self) -> tuple[type[Detection], tuple[NDArray[np.generic], ...]]:
        return Detection, (self.mask, self.threshold, self.noise)

    @cached_property
    def _estimate(self) -> Estimate:
        test: _OsTest = self.__dict__["_test"]
        return test.noise()

    @cached_property
    def noise(self) -> Floats:
        """Order statistic of each cell's training cells."""
        test: _OsTest = self.__dict__["_test"]
        return unscaled_noise(self._estimate[0], test.exponent)

    @cached_property
    def threshold(self) -> Floats:
        """Threshold of each cell."""
        test: _OsTest = self.__dict__["_test"]
        noise, n_training = self._estimate
        return unscaled_threshold(thresholds(noise, factor_map(n_training, test.factor)), test.exponent)
