"""CFAR detectors: threshold = noise estimated around the cell under test x factor for a false-alarm rate.

`FixedThreshold`, which they are compared with, has one noise estimate for the whole map.

| detector | noise estimate |
|---|---|
| `CaCfar` | mean of the training cells |
| `GocaCfar`, `SocaCfar` | greater, smaller mean of the two halves of the window |
| `OsCfar` | order statistic of the training cells |
| `OscaCfar` | order statistic along one axis, averaged over the others |
| `TmCfar` | mean without the smallest and the largest training cells |
| `FixedThreshold` | median of the map |

All take power maps of any rank and unit. The factor of each cell comes from
`isacbench.dsp.cfar.factors`, for the training cells of its window
(`isacbench.dsp.cfar.training_cells` describes windows at edges).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from math import prod
from typing import Any, ClassVar, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from isacbench.checked_arrays import Floats, Mask, parts_of
from isacbench.dsp.cfar.factors import (
    ca_factor,
    check_pfa,
    goca_factor,
    osca_factor,
    paper_factor,
    soca_factor,
)
from isacbench.dsp.cfar.training_cells import (
    CACHED_VALUES,
    Axis,
    Cells,
    CellsPerSide,
    Threshold,
    Windows,
    check_cells,
    check_fraction,
    checked_axis,
    checked_list,
    checked_power,
    share_of,
    sums_along,
    total_of,
    training_sums,
    window_axes,
    windows_of,
)
from isacbench.dsp.cfar.trimmed_factors import tm_factor
from isacbench.dsp.detection import Detection
from isacbench.errors import InputError, require_option

Power = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class _Cfar(ABC):
    """Base class: the test and the parameters that all detectors share; `CaCfar` describes these."""

    pfa: float = 1e-3
    training: CellsPerSide = 3
    guard: CellsPerSide = 1
    threshold: Threshold = "exact"

    _axis: ClassVar[str] = ""
    """Parameter with the axis that is moved to the front before the test; empty if no axis is special."""

    def __post_init__(self) -> None:
        check_pfa(self.pfa)
        check_cells("training", self.training)
        self._check_guard()
        require_option(self, "threshold", get_args(Threshold))
        if self._axis:
            checked_axis(self._axis, getattr(self, self._axis))

    def _check_guard(self) -> None:
        check_cells("guard", self.guard)

    def detect(self, power: Power, looks: int = 1, cells: Cells | None = None) -> Detection:
        """Test cells of a power map.

        Parameters
        ----------
        power : ndarray of real numbers
            Power map of any rank and unit; finite and not negative.
        looks : int, default 1
            Independent noise powers that each cell averages.
        cells : tuple of ndarray of int, optional
            Cells to test, as `numpy.nonzero` gives them; default: all cells.

        Returns
        -------
        Detection
            Mask, thresholds and noise: arrays of the map's shape, or of
            shape (n,) for n listed cells.

        Raises
        ------
        InputError
            If the map is complex, holds NaN, infinite or negative power, or is
            smaller than the window; if `looks` is not a whole number above 0; or if
            a listed cell lies outside the map.
        """
        values = checked_power(power, looks)
        listed = None if cells is None else checked_list(cells, values.shape)
        first = checked_axis(self._axis, getattr(self, self._axis), values.ndim) if self._axis else 0
        order = (first, *(axis for axis in range(values.ndim) if axis != first))
        axes = window_axes(values.shape, self.training, self.guard or 0)
        found = self._test(
            np.ascontiguousarray(values.transpose(order)),
            tuple(axes[axis] for axis in order),
            None if listed is None else tuple(listed[axis] for axis in order),
            looks,
        )
        if listed is not None or first == 0:
            return found
        back = partial(np.moveaxis, source=0, destination=first)
        return Detection(back(found.mask), back(found.threshold), back(found.noise))

    def _test(self, power: Floats, axes: tuple[Axis, ...], cells: Cells | None, looks: int) -> Detection:
        noise, threshold = self._thresholds(power, axes, cells, looks)
        return Detection((power if cells is None else power[cells]) > threshold, threshold, noise)

    @abstractmethod
    def _thresholds(
        self, power: Floats, axes: tuple[Axis, ...], cells: Cells | None, looks: int
    ) -> tuple[Floats, Floats]:
        """Noise and thresholds of a whole map, or of listed cells."""


class _PlacewiseCfar(_Cfar):
    """Base class: cells with the same place in their windows are tested together."""

    def _thresholds(
        self, power: Floats, axes: tuple[Axis, ...], cells: Cells | None, looks: int
    ) -> tuple[Floats, Floats]:
        noise, threshold = np.empty((2, *(power.shape if cells is None else cells[0].shape)))
        for where, windows in windows_of(axes, cells):
            noise[where] = self._noise(power, windows)
            threshold[where] = self._factor(windows, looks) * noise[where]
        return noise, threshold

    @abstractmethod
    def _noise(self, power: Floats, windows: Windows) -> Floats:
        """Noise around cells under test."""

    def _factor(self, windows: Windows, looks: int) -> float:
        """Factor on the noise estimate."""
        if self.threshold == "paper":
            return paper_factor(self.pfa, self._n_printed(windows))
        return self._exact_factor(windows, looks)

    @abstractmethod
    def _exact_factor(self, windows: Windows, looks: int) -> float:
        """Factor that keeps the false-alarm rate."""

    def _n_printed(self, windows: Windows) -> int:
        """Number of cells N in the printed factor."""
        return windows.n_training


@dataclass(frozen=True)
class CaCfar(_Cfar):
    """Cell averaging: the noise is the mean of the training cells.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in homogeneous noise.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each. With `guard` 1 the default is the paper's 72 cells on a 2-D map.
    guard : int or tuple of int
        Guard cells to either side of the cell under test; 0 leaves out the
        cell under test alone.
    threshold : {"exact", "paper"}
        Exact factor, or the one the paper prints, which misses the rate.

    Raises
    ------
    InputError
        If a parameter is out of range.

    References
    ----------
    H. M. Finn, R. S. Johnson, RCA Review 29, 1968.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(CaCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "ca"

    def _thresholds(
        self, power: Floats, axes: tuple[Axis, ...], cells: Cells | None, looks: int
    ) -> tuple[Floats, Floats]:
        sums, n_training = training_sums(power, axes, cells)
        noise = sums / n_training
        factors = np.zeros(n_training.max(initial=0) + 1)
        for n in np.flatnonzero(np.bincount(n_training.ravel())).tolist():
            exact = self.threshold == "exact"
            factors[n] = ca_factor(self.pfa, n, looks) if exact else paper_factor(self.pfa, n)
        return noise, factors[n_training] * noise


@dataclass(frozen=True)
class _HalvedCfar(_PlacewiseCfar):
    """Base class: the noise is one of the means of the two halves of the window.

    The leading half holds the training cells before the cell under test along
    `split_axis`, the trailing half those after it. Cells with the same index
    along that axis are divided by their index along the next one, so that the
    halves mirror each other: 36 and 36 cells of 9 x 9 less 3 x 3. Shifted
    windows have unequal halves; where one is empty, the test is cell averaging
    over the other.
    """

    split_axis: int = 0

    _axis: ClassVar[str] = "split_axis"

    _choose: ClassVar[Callable[..., Floats]]
    """Chooses the noise from the means of the halves that are not empty."""
    _half_factor: ClassVar[Callable[..., float]]
    """Factor for a rate, the numbers of leading and trailing training cells, and looks."""

    def _noise(self, power: Floats, windows: Windows) -> Floats:
        training, n_leading = windows.training(power), windows.n_leading
        halves = training[..., :n_leading], training[..., n_leading:]
        means = [_mean(half) for half in halves if half.shape[-1]]
        return self._choose(means)

    def _exact_factor(self, windows: Windows, looks: int) -> float:
        halves = windows.n_leading, windows.n_training - windows.n_leading
        return self._half_factor(self.pfa, halves, looks)


@dataclass(frozen=True)
class GocaCfar(_HalvedCfar):
    """Greatest of: the noise is the greater of the means of the leading and the trailing half.

    It gives the fewest false alarms at a clutter edge, but an echo in the
    window masks others.

    Attributes
    ----------
    pfa, training, guard, threshold
        As of `CaCfar`.
    split_axis : int
        Axis along which the window is cut into halves: of a range-Doppler map
        0 is range, 1 Doppler. Training cells with the same index as the cell
        under test are divided by their index along the next axis.

    Raises
    ------
    InputError
        If a parameter is out of range.

    References
    ----------
    V. G. Hansen, J. H. Sawyers, IEEE Trans. AES 16(1), 1980.
    """

    name: ClassVar[str] = "goca"

    _choose = staticmethod(np.maximum.reduce)
    _half_factor = staticmethod(goca_factor)


@dataclass(frozen=True)
class SocaCfar(_HalvedCfar):
    """Smallest of: the noise is the smaller of the means of the leading and the trailing half.

    Echoes in one half of the window do not mask another echo, but there are
    many false alarms at a clutter edge.

    Attributes
    ----------
    pfa, training, guard, threshold
        As of `CaCfar`.
    split_axis : int
        Axis along which the window is cut into halves, as of `GocaCfar`.

    Raises
    ------
    InputError
        If a parameter is out of range.

    References
    ----------
    G. V. Trunk, IEEE Trans. AES 14(5), 1978.
    """

    name: ClassVar[str] = "soca"

    _choose = staticmethod(np.minimum.reduce)
    _half_factor = staticmethod(soca_factor)


@dataclass(frozen=True)
class TmCfar(_PlacewiseCfar):
    """Trimmed mean: the noise is the mean of the training cells without the smallest and the largest.

    It lies between `ca` (nothing trimmed) and `os` (all but one cell trimmed).

    Attributes
    ----------
    pfa, training, guard, threshold
        As of `CaCfar`.
    trim_low, trim_high : float
        Fractions of the n training cells left out: the ⌊`trim_low` n⌋ smallest
        and the ⌊`trim_high` n⌋ largest, 18 and 18 of 72.

    Raises
    ------
    InputError
        If a parameter is out of range.

    References
    ----------
    P. P. Gandhi, S. A. Kassam, IEEE Trans. AES 24(4), 1988.
    """

    name: ClassVar[str] = "tm"

    trim_low: float = 0.25
    trim_high: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fraction("trim_low", self.trim_low, 0, 1)
        check_fraction("trim_high", self.trim_high, 0, 1)
        if self.trim_low + self.trim_high >= 1:
            raise InputError(
                f"trim_low = {self.trim_low}, trim_high = {self.trim_high}: "
                "together below 1, or no training cell is left"
            )

    def _trimmed(self, n_training: int) -> tuple[int, int]:
        return share_of(self.trim_low, n_training), share_of(self.trim_high, n_training)

    def _noise(self, power: Floats, windows: Windows) -> Floats:
        below, above = self._trimmed(windows.n_training)
        ascending = np.sort(windows.training(power), axis=-1)
        return _mean(ascending[..., below : windows.n_training - above])

    def _exact_factor(self, windows: Windows, looks: int) -> float:
        return tm_factor(self.pfa, windows.n_training, self._trimmed(windows.n_training), looks)


@dataclass(frozen=True)
class OsCfar(_PlacewiseCfar):
    """Order statistic: the noise is the k-th smallest of n training cells, k = max(1, ⌊`rank_fraction` n⌋).

    Up to n - k echoes in the window do not mask another. At a clutter edge the
    estimate is a cell of the clutter, as long as fewer than k training cells
    lie outside it. Noise and thresholds are computed when they are first asked
    for: the mask needs no sorting.

    Attributes
    ----------
    pfa, training, guard, threshold
        As of `CaCfar`.
    rank_fraction : float
        Rank over number of training cells: 0.75 is the 54th of 72.

    Raises
    ------
    InputError
        If a parameter is out of range.

    References
    ----------
    H. Rohling, IEEE Trans. AES 19(4), 1983.
    """

    name: ClassVar[str] = "os"

    rank_fraction: float = 0.75

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fraction("rank_fraction", self.rank_fraction, 0, 1)

    def _test(self, power: Floats, axes: tuple[Axis, ...], cells: Cells | None, looks: int) -> Detection:
        """Count training cells: a power exceeds α times the k-th smallest if it exceeds α times k of them."""
        under_test = power if cells is None else power[cells]
        mask = np.empty(under_test.shape, dtype=bool)
        for where, windows in windows_of(axes, cells):
            scaled = self._factor(windows, looks) * windows.training(power)
            n_below = np.count_nonzero(scaled < under_test[where][..., np.newaxis], axis=-1)
            mask[where] = n_below >= self._rank(windows)
        # The caller may write to the map before it asks for the noise.
        return _OrderDetection(mask, partial(self._thresholds, power.copy(), axes, cells, looks))

    def _noise(self, power: Floats, windows: Windows) -> Floats:
        k = self._rank(windows) - 1
        return np.partition(windows.training(power), k, axis=-1)[..., k]

    def _exact_factor(self, windows: Windows, looks: int) -> float:
        return osca_factor(self.pfa, ((self._rank(windows), windows.n_training),), looks)

    def _rank(self, windows: Windows) -> int:
        return max(1, share_of(self.rank_fraction, windows.n_training))


class _OrderDetection(Detection):
    """A detection whose noise and thresholds are computed when they are first asked for."""

    def __init__(self, mask: Mask, thresholds: Callable[[], tuple[Floats, Floats]]) -> None:
        self.__dict__.update(mask=mask, _thresholds=thresholds)

    def __reduce__(self) -> tuple[type[Detection], tuple[NDArray[np.generic], ...]]:
        return Detection, (self.mask, self.threshold, self.noise)

    @cached_property
    def _estimated(self) -> tuple[Floats, Floats]:
        return self.__dict__["_thresholds"]()

    @property
    def noise(self) -> Floats:
        """Order statistic of each cell's training cells."""
        return self._estimated[0]

    @property
    def threshold(self) -> Floats:
        """Threshold of each cell."""
        return self._estimated[1]


@dataclass(frozen=True)
class OscaCfar(_PlacewiseCfar):
    """Order statistic along range in each Doppler column, averaged across the columns.

    Each column of n training cells gives its γ-th smallest,
    γ = max(1, ⌊0.75 n⌋): the 6th of 9. With ``order_axis=1`` the two axes
    change places: the order statistic runs along Doppler, where a street's
    static ridge fills few cells of a window and so does not mask its
    surroundings.

    Attributes
    ----------
    pfa, threshold
        As of `CaCfar`. The N of the printed factor is the number of cells of a
        whole column.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each. The default is the paper's 9 x 9 window on a 2-D map.
    guard : int or tuple of int or None
        Guard cells to either side of the cell under test, left out of the
        columns that pass through them; None keeps the cell under test in its
        own window, as the paper does.
    order_axis : int
        Axis of the order statistic: 0 range, the paper's; 1 Doppler.

    Raises
    ------
    InputError
        If a parameter is out of range.

    References
    ----------
    arXiv 2310.06401; H. Rohling, IEEE Trans. AES 19(4), 1983.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(OscaCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "osca"

    training: CellsPerSide = 4
    guard: CellsPerSide | None = None  # type: ignore[assignment]  # it may be none here alone
    order_axis: int = 0

    _axis: ClassVar[str] = "order_axis"

    def _check_guard(self) -> None:
        if self.guard is not None:
            super()._check_guard()

    def _thresholds(
        self, power: Floats, axes: tuple[Axis, ...], cells: Cells | None, looks: int
    ) -> tuple[Floats, Floats]:
        if self.guard is not None:
            return super()._thresholds(power, axes, cells, looks)
        along, *across = axes
        if along.training == 0:
            raise InputError(
                f"training = 0 along axis {self.order_axis}: "
                "with guard = None it must be at least 1 per side there"
            )
        n_cells, n_columns = along.n_window, prod(axis.n_window for axis in across)
        rank = _column_rank(n_cells)
        if cells is None:
            noise = _orders_of_map(power, axes, rank)
        else:
            noise = np.empty(cells[0].size)
            for some, windows in windows_of(axes, cells):
                orders = np.partition(windows.whole(power), rank - 1, axis=1)[:, rank - 1]
                for _ in across:
                    orders = total_of(np.moveaxis(orders, 1, 0))
                noise[some] = orders
        noise /= n_columns
        # The column of the cell under test has one training cell less.
        columns = (*((rank, n_cells),) * (n_columns - 1), (rank, n_cells - 1))
        exact = self.threshold == "exact"
        factor = osca_factor(self.pfa, columns, looks) if exact else paper_factor(self.pfa, n_cells)
        return noise, factor * noise

    def _noise(self, power: Floats, windows: Windows) -> Floats:
        window = windows.whole(power)
        columns = window.reshape(*window.shape[: -power.ndim], len(windows.trains), -1)
        trains = windows.trains.reshape(len(windows.trains), -1)
        ascending = np.sort(np.where(trains, columns, np.inf), axis=-2)
        counts = np.count_nonzero(trains, axis=0)
        orders = ascending[..., _column_rank(counts) - 1, np.arange(counts.size)]
        return _mean(orders[..., counts > 0])

    def _n_printed(self, windows: Windows) -> int:
        return windows.axes[0].n_window

    def _exact_factor(self, windows: Windows, looks: int) -> float:
        counts = windows.trains.sum(axis=0).ravel().tolist()
        columns = tuple((_column_rank(count), count) for count in sorted(counts, reverse=True) if count)
        return osca_factor(self.pfa, columns, looks)


@dataclass(frozen=True)
class FixedThreshold:
    """One threshold for the whole map: a factor on the median of all cells.

    The single threshold that a CFAR detector is compared with. It is the more
    accurate where all noise is alike and echoes fill less than half of the map;
    it knows nothing of clutter and of the sidelobes of strong echoes.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in homogeneous noise; exact as long
        as the threshold lies above the median, which it does up to about 0.5.

    Raises
    ------
    InputError
        If `pfa` is out of range.

    Notes
    -----
    A cell above the ⌊n/2⌋-th smallest of n cells does not change it, so that it
    is the same order statistic of the n - 1 other cells, as of `OsCfar`.
    """

    name: ClassVar[str] = "fixed"

    pfa: float = 1e-3

    def __post_init__(self) -> None:
        check_pfa(self.pfa)

    def detect(self, power: Power, looks: int = 1, cells: Cells | None = None) -> Detection:
        """Test cells of a power map.

        Parameters
        ----------
        power : ndarray of real numbers
            Power map of any rank and unit; finite and not negative.
        looks : int, default 1
            Independent noise powers that each cell averages.
        cells : tuple of ndarray of int, optional
            Cells to test, as `numpy.nonzero` gives them; default: all cells.

        Raises
        ------
        InputError
            As of `CaCfar.detect`, and if the map has a single cell.
        """
        values = checked_power(power, looks)
        if values.size < 2:
            raise InputError(f"a map of {values.size} cells has no noise to compare with: at least 2")
        tested = values if cells is None else values[checked_list(cells, values.shape)]
        rank = values.size // 2
        noise = np.full(tested.shape, np.partition(values, rank - 1, axis=None)[rank - 1])
        threshold = osca_factor(self.pfa, ((rank, values.size - 1),), looks) * noise
        return Detection(tested > threshold, threshold, noise)


def _mean(values: Floats) -> Floats:
    """Mean along the last axis."""
    return total_of(np.moveaxis(values, -1, 0)) / values.shape[-1]


def _orders_of_map(power: Floats, axes: tuple[Axis, ...], rank: int) -> Floats:
    """Sums of the order statistics of the columns of each window; windows share columns."""
    along, *across = axes
    columns = sliding_window_view(power, along.n_window, axis=0)
    orders = np.empty(columns.shape[:-1])
    for some in parts_of(len(orders), CACHED_VALUES // columns[0].size):
        orders[some] = np.partition(columns[some], rank - 1)[..., rank - 1]
    sums: Floats = orders[along.start(np.arange(along.length))]
    for number, axis in enumerate(across, start=1):
        sums = sums_along(number, axis, sums, sums)
    return sums


def _column_rank(n_cells: Any) -> Any:
    """Rank of the paper, ⌊0.75 n⌋ of n cells: the 6th smallest of 9."""
    return np.maximum(1, 3 * n_cells // 4)
