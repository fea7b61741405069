"""CFAR detectors whose noise estimate is a mean of training cells: of all, or of one of two halves."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from isacbench.dsp.cfar.decisions import detect_by_sums
from isacbench.dsp.cfar.factors.mean_factors import ca_factor, goca_factor, paper_factor, soca_factor
from isacbench.dsp.cfar.factors.rate_roots import check_pfa
from isacbench.dsp.cfar.map_checks import check_threshold, checked_axis, checked_list, spread
from isacbench.dsp.cfar.map_scaling import ScaledMap
from isacbench.dsp.cfar.training_cells import window_axes
from isacbench.dsp.detection import Detection

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.dsp.cfar.decisions import Estimate
    from isacbench.dsp.cfar.map_checks import Cells, CellsPerSide, Threshold
    from isacbench.dsp.cfar.training_cells import Counts, Side, Windows

T = TypeVar("T")


def ca_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    cells: Cells | None = None,
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
        Exact factor, or the one the paper prints, which misses the rate; its N
        is the number of training cells.
    looks : int, default 1
        Independent noise powers that each cell averages. The printed factor
        knows nothing of them.
    cells : tuple of ndarray of int, optional
        Cells to test, as `numpy.nonzero` gives them; without it all.

    Returns
    -------
    Detection
        Mask, thresholds and mean training power, of the map's shape, or of shape (n,) for
        n listed cells.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range, or a cell
        outside the map.

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
    scaled = ScaledMap.of(power, looks)
    values = scaled.values
    train, keep = spread(training, guard, values.ndim)
    check_pfa(pfa)
    check_threshold(threshold)
    axes = window_axes(values.shape, train, keep)
    listed = None if cells is None else checked_list(cells, values.shape)

    def estimate(windows: Windows, values: NDArray[np.float64]) -> Estimate:
        n_training = windows.n_window() - windows.n_guard()
        return windows.training_sum(values) / n_training.astype(np.float64), n_training

    def factor_of(n_training: int) -> float:
        return ca_factor(pfa, n_training, looks) if threshold == "exact" else paper_factor(pfa, n_training)

    found = detect_by_sums(values, axes, listed, estimate, factor_of)
    return scaled.unscaled(found, cells)


def goca_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    split_axis: int = 0,
    cells: Cells | None = None,
) -> Detection:
    """Test each cell against the greater of the means of the two halves of its window.

    The leading half are the training cells before the cell under test along
    `split_axis`, the trailing half those after it. Cells level with it are
    divided by their place along the next axis, in the order of the axes, so
    that the halves mirror each other: 36 and 36 cells of 9 x 9 less 3 x 3.
    Shifted windows have unequal halves and the factor for them; where one is
    empty the test is cell averaging over the other.

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
    split_axis : int, default 0
        Axis along which the window is cut into halves.
    cells : tuple of ndarray of int, optional
        Cells to test, as `numpy.nonzero` gives them; without it all.

    Returns
    -------
    Detection
        Mask, thresholds and greater mean, of the map's shape, or of shape (n,) for
        n listed cells.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range, or a cell
        outside the map.

    References
    ----------
    V. G. Hansen, J. H. Sawyers, IEEE Trans. AES 16(1), 1980.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(goca_cfar(power, training=3, guard=1, pfa=1e-3).mask).tolist()
    [[4, 7]]
    """
    return _chosen_half(power, training, guard, pfa, threshold, looks, split_axis, cells, greatest=True)


def soca_cfar(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold = "exact",
    looks: int = 1,
    split_axis: int = 0,
    cells: Cells | None = None,
) -> Detection:
    """Test each cell against the smaller of the means of the two halves of its window.

    The leading half are the training cells before the cell under test along
    `split_axis`, the trailing half those after it. Cells level with it are
    divided by their place along the next axis, in the order of the axes, so
    that the halves mirror each other: 36 and 36 cells of 9 x 9 less 3 x 3.
    Shifted windows have unequal halves and the factor for them; where one is
    empty the test is cell averaging over the other.

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
    split_axis : int, default 0
        Axis along which the window is cut into halves.
    cells : tuple of ndarray of int, optional
        Cells to test, as `numpy.nonzero` gives them; without it all.

    Returns
    -------
    Detection
        Mask, thresholds and smaller mean, of the map's shape, or of shape (n,) for
        n listed cells.

    Raises
    ------
    InputError
        If the map is complex, holds NaN, infinite or negative power, or is
        smaller than the window; if a parameter is out of range, or a cell
        outside the map.

    References
    ----------
    G. V. Trunk, IEEE Trans. AES 14(5), 1978.

    Examples
    --------
    >>> import numpy as np
    >>> power = np.ones((20, 20))
    >>> power[4, 7] = 30.0
    >>> np.argwhere(soca_cfar(power, training=3, guard=1, pfa=1e-3).mask).tolist()
    [[4, 7]]
    """
    return _chosen_half(power, training, guard, pfa, threshold, looks, split_axis, cells, greatest=False)


def _chosen_half(
    power: NDArray[np.floating],
    training: CellsPerSide,
    guard: CellsPerSide,
    pfa: float,
    threshold: Threshold,
    looks: int,
    split_axis: int,
    cells: Cells | None,
    greatest: bool,
) -> Detection:
    scaled = ScaledMap.of(power, looks)
    values = scaled.values
    split = checked_axis("split_axis", split_axis, values.ndim)
    train, keep = (moved_first(sizes, split) for sizes in spread(training, guard, values.ndim))
    check_pfa(pfa)
    check_threshold(threshold)
    listed = None if cells is None else moved_first(checked_list(cells, values.shape), split)
    values = np.moveaxis(values, split, 0)
    axes = window_axes(values.shape, train, keep)
    base = 1 + np.prod([axis.n_window for axis in axes], dtype=int)

    def estimate(windows: Windows, values: NDArray[np.float64]) -> Estimate:
        leading, trailing = windows.n_half("before"), windows.n_half("after")
        means = []
        sides: tuple[tuple[Side, Counts], ...] = (("before", leading), ("after", trailing))
        for side, count in sides:
            mean = windows.half_sum(values, side) / np.maximum(count, 1)
            # An empty half is never chosen.
            means.append(np.where(count > 0, mean, -np.inf if greatest else np.inf))
        noise = np.maximum(*means) if greatest else np.minimum(*means)
        return noise, leading * base + trailing

    def factor_of(key: int) -> float:
        halves = divmod(key, base)
        if threshold == "paper":
            return paper_factor(pfa, sum(halves))
        return (goca_factor if greatest else soca_factor)(pfa, halves, looks)

    found = detect_by_sums(values, axes, listed, estimate, factor_of)
    return scaled.unscaled(found if listed is not None else moved_back(found, split), cells)


def moved_first(per_axis: tuple[T, ...], axis: int) -> tuple[T, ...]:
    """Put what belongs to an axis first, as `numpy.moveaxis` does to the map."""
    return (per_axis[axis], *per_axis[:axis], *per_axis[axis + 1 :])


def moved_back(found: Detection, axis: int) -> Detection:
    """Give a detection whose axes are in the order of the map again."""
    if axis == 0:
        return found
    return Detection(
        mask=np.moveaxis(found.mask, 0, axis),
        threshold=np.moveaxis(found.threshold, 0, axis),
        noise=np.moveaxis(found.noise, 0, axis),
    )
