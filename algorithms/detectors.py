"""The built-in CFAR detectors: parameters around the functions of isacbench.dsp.cfar."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from isacbench.dsp.cfar import (
    Cells,
    CellsPerSide,
    Detection,
    Threshold,
    ca_cfar,
    check_cells,
    check_fraction,
    check_pfa,
    check_threshold,
    check_trim,
    checked_axis,
    goca_cfar,
    os_cfar,
    osca_cfar,
    soca_cfar,
    tm_cfar,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Power = NDArray[np.floating]


class _Cfar(ABC):
    """The test that all detectors share."""

    def detect(self, power: Power, looks: int = 1, cells: Cells | None = None) -> Detection:
        """Test cells of a power map, see `isacbench.dsp.cfar`.

        Parameters
        ----------
        power : ndarray of real numbers
            Power map of any rank, any unit.
        looks : int, default 1
            Independent noise powers that each cell averages.
        cells : tuple of ndarray of int, optional
            Cells to test, as `numpy.nonzero` gives them; without it all.

        Returns
        -------
        Detection
            Mask, thresholds and noise, of the map's shape, or of shape (n,)
            for n listed cells.

        Raises
        ------
        InputError
            If map, `looks` or `cells` are bad, or the window larger than the
            map.
        """
        return self._test(power, looks, cells)

    @abstractmethod
    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        """Test cells with the parameters."""


@dataclass(frozen=True)
class _FramedCfar(_Cfar):
    """Parameters of detectors whose training cells frame the cell under test.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in homogeneous noise.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each. With `guard` 1 the default is the paper's 72 cells on a 2-D map.
    guard : int or tuple of int
        Guard cells to either side of the cell under test.
    threshold : {"exact", "paper"}
        Exact factor, or the one the paper prints.
    """

    pfa: float = 1e-3
    training: CellsPerSide = 3
    guard: CellsPerSide = 1
    threshold: Threshold = "exact"

    def __post_init__(self) -> None:
        check_pfa(self.pfa)
        check_cells("training", self.training)
        check_cells("guard", self.guard)
        check_threshold(self.threshold)


@dataclass(frozen=True)
class CaCfar(_FramedCfar):
    """Cell averaging: the noise is the mean of the training cells.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in homogeneous noise.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each. With `guard` 1 the default is the paper's 72 cells on a 2-D map.
    guard : int or tuple of int
        Guard cells to either side of the cell under test.
    threshold : {"exact", "paper"}
        Exact factor, or the one the paper prints.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(CaCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "ca"

    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        return ca_cfar(power, self.training, self.guard, self.pfa, self.threshold, looks, cells)


@dataclass(frozen=True)
class OsCfar(_FramedCfar):
    """Order statistic: the noise is the k-th smallest of n training cells, k = ⌊`rank_fraction` n⌋.

    Up to n - k echoes in the window do not mask another, and the border of
    clutter raises no alarm while less than k cells lie in it.

    Attributes
    ----------
    pfa, training, guard, threshold
        Probability of false alarm, cells per side of the window, by default
        72 training cells on a 2-D map, and kind of factor, as of `CaCfar`.
    rank_fraction : float
        Rank over number of training cells: the 54th of 72.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(OsCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "os"

    rank_fraction: float = 0.75

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fraction("rank_fraction", self.rank_fraction, 0, 1)

    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        return os_cfar(
            power, self.training, self.guard, self.pfa, self.threshold, looks, self.rank_fraction, cells
        )


@dataclass(frozen=True)
class OscaCfar(_Cfar):
    """Order statistic along range in each Doppler column, averaged across the columns.

    With ``order_axis=1`` the two axes change places: the order statistic runs
    along Doppler, where a street's static ridge fills few cells of a window
    and so does not mask its surroundings.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in homogeneous noise.
    training : int or tuple of int
        Training cells to either side of the guard cells, for all axes or for
        each. The default is the paper's 9 x 9 window on a 2-D map.
    guard : int or tuple of int or None
        Guard cells to either side of the cell under test; None keeps it in
        its own window, as the paper does.
    threshold : {"exact", "paper"}
        Exact factor, or the one the paper prints.
    order_axis : int
        Axis of the order statistic: 0 range, the paper's; 1 Doppler.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(OscaCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    pfa: float = 1e-3
    training: CellsPerSide = 4
    guard: CellsPerSide | None = None
    threshold: Threshold = "exact"
    order_axis: int = 0

    name: ClassVar[str] = "osca"

    def __post_init__(self) -> None:
        check_pfa(self.pfa)
        check_cells("training", self.training)
        if self.guard is not None:
            check_cells("guard", self.guard)
        check_threshold(self.threshold)
        checked_axis("order_axis", self.order_axis)

    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        return osca_cfar(
            power, self.training, self.guard, self.pfa, self.threshold, looks, self.order_axis, cells
        )


@dataclass(frozen=True)
class _HalvedCfar(_FramedCfar):
    """Parameters of detectors that cut their window into halves."""

    split_axis: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_axis("split_axis", self.split_axis)


@dataclass(frozen=True)
class GocaCfar(_HalvedCfar):
    """Greatest of: the noise is the greater of the means of the leading and the trailing half.

    Fewest false alarms at the border of clutter; an echo in the window masks
    others.

    Attributes
    ----------
    pfa, training, guard, threshold
        Probability of false alarm, cells per side of the window, by default
        72 training cells on a 2-D map, and kind of factor, as of `CaCfar`.
    split_axis : int
        Axis along which the window is cut into halves: of a range-Doppler map
        0 is range, 1 Doppler.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(GocaCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "goca"

    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        return goca_cfar(
            power, self.training, self.guard, self.pfa, self.threshold, looks, self.split_axis, cells
        )


@dataclass(frozen=True)
class SocaCfar(_HalvedCfar):
    """Smallest of: the noise is the smaller of the means of the leading and the trailing half.

    Echoes in one half of the window do not mask another; at the border of
    clutter alarms abound.

    Attributes
    ----------
    pfa, training, guard, threshold
        Probability of false alarm, cells per side of the window, by default
        72 training cells on a 2-D map, and kind of factor, as of `CaCfar`.
    split_axis : int
        Axis along which the window is cut into halves: of a range-Doppler map
        0 is range, 1 Doppler.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(SocaCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "soca"

    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        return soca_cfar(
            power, self.training, self.guard, self.pfa, self.threshold, looks, self.split_axis, cells
        )


@dataclass(frozen=True)
class TmCfar(_FramedCfar):
    """Trimmed mean: the noise is the mean of the training cells without the smallest and the largest.

    Between `ca`, with nothing trimmed, and `os`, with all but one.

    Attributes
    ----------
    pfa, training, guard, threshold
        Probability of false alarm, cells per side of the window, by default
        72 training cells on a 2-D map, and kind of factor, as of `CaCfar`.
    trim_low, trim_high : float
        Fractions of the training cells left out, the smallest and the largest:
        18 and 18 of 72.

    Raises
    ------
    InputError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(TmCfar().detect(power).mask).tolist()
    [[4, 7]]
    """

    name: ClassVar[str] = "tm"

    trim_low: float = 0.25
    trim_high: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        check_trim(self.trim_low, self.trim_high)

    def _test(self, power: Power, looks: int, cells: Cells | None) -> Detection:
        return tm_cfar(
            power,
            self.training,
            self.guard,
            self.pfa,
            self.threshold,
            looks,
            self.trim_low,
            self.trim_high,
            cells,
        )
