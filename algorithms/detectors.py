"""The built-in CFAR detectors: parameters around the functions of isacbench.dsp.cfar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from isacbench.contracts import Detection
from isacbench.dsp.cfar import CellsPerSide, Threshold, ca_cfar, check_cells, check_threshold, osca_cfar
from isacbench.dsp.thresholds import check_pfa
from isacbench.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CaCfar", "OscaCfar"]


@dataclass(frozen=True)
class CaCfar:
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

    pfa: float = 1e-3
    training: CellsPerSide = 3
    guard: CellsPerSide = 1
    threshold: Threshold = "exact"

    name: ClassVar[str] = "ca"

    def __post_init__(self) -> None:
        check_pfa(self.pfa)
        check_cells("training", self.training)
        check_cells("guard", self.guard)
        check_threshold(self.threshold)

    def detect(self, power: NDArray[np.floating], looks: int = 1) -> Detection:
        """Test every cell of a power map, see `isacbench.dsp.cfar.ca_cfar`.

        Parameters
        ----------
        power : ndarray of real numbers
            Power map of any rank, any unit.
        looks : int, default 1
            Independent noise powers that each cell averages.

        Returns
        -------
        Detection
            Mask, thresholds and noise, of the map's shape.

        Raises
        ------
        InputError
            If the map or `looks` is bad, or the window larger than the map.
        """
        return ca_cfar(power, self.training, self.guard, self.pfa, self.threshold, looks)


@dataclass(frozen=True)
class OscaCfar:
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
        if self.order_axis < 0:
            raise InputError(f"order_axis = {self.order_axis}: allowed are 0 (range) and above")

    def detect(self, power: NDArray[np.floating], looks: int = 1) -> Detection:
        """Test every cell of a power map, see `isacbench.dsp.cfar.osca_cfar`.

        Parameters
        ----------
        power : ndarray of real numbers
            Power map of any rank, axis 0 range; any unit.
        looks : int, default 1
            Independent noise powers that each cell averages.

        Returns
        -------
        Detection
            Mask, thresholds and noise, of the map's shape.

        Raises
        ------
        InputError
            If the map or `looks` is bad, or the window larger than the map.
        """
        axis = self.order_axis
        if axis == 0:
            return osca_cfar(power, self.training, self.guard, self.pfa, self.threshold, looks)
        if axis >= np.ndim(power):
            raise InputError(f"order_axis = {axis}: a map of {np.ndim(power)} axes has none of that number")
        turned = osca_cfar(
            np.moveaxis(power, axis, 0),
            _moved(self.training, axis),
            None if self.guard is None else _moved(self.guard, axis),
            self.pfa,
            self.threshold,
            looks,
        )
        return Detection(
            mask=np.moveaxis(turned.mask, 0, axis),
            threshold=np.moveaxis(turned.threshold, 0, axis),
            noise=np.moveaxis(turned.noise, 0, axis),
        )


def _moved(cells: CellsPerSide, axis: int) -> CellsPerSide:
    """Cells per side with those of an axis put first, as `numpy.moveaxis` does to the map."""
    if isinstance(cells, int) or axis >= len(cells):
        return cells
    return (cells[axis], *cells[:axis], *cells[axis + 1 :])
