"""Checks of the input of CFAR detectors: maps, windows, kinds of threshold and lists of cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from isacbench.checked_arrays import Floats, checked_array
from isacbench.dsp.cfar.factors.rate_roots import check_looks
from isacbench.errors import InputError

CellsPerSide = int | tuple[int, ...]
Threshold = Literal["exact", "paper"]
Cells = tuple["NDArray[np.intp]", ...]
"""Cells of a map as `numpy.nonzero` gives them: for each axis an array of indices, shape (n,)."""

_WEAKEST, _STRONGEST = 1e-200, 1e200
"""Limits of the strongest cell of a map, between which sums and thresholds are right in float64."""

_ROUNDING = 1e-9
"""Margin for rounding in the product of a fraction and a number of cells."""


def check_cells(name: str, sizes: CellsPerSide) -> None:
    """Refuse numbers of cells per side that are not whole numbers of at least 0.

    Parameters
    ----------
    name : str
        Name of the parameter, for the message; "training" must not be 0 on all axes.
    sizes : int or tuple of int
        Cells per side, for all axes or for each.

    Raises
    ------
    InputError
        If a number is negative or not whole, or "training" is 0 on all axes.
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


def check_fraction(name: str, fraction: float, lowest: float, highest: float) -> None:
    """Refuse a fraction of the training cells outside its limits.

    Parameters
    ----------
    name : str
        Name of the parameter, for the message.
    lowest, highest : float
        Limits, both allowed.

    Raises
    ------
    InputError
        If `fraction` is not a number within the limits.
    """
    if not isinstance(fraction, Real) or not lowest <= fraction <= highest:
        raise InputError(f"{name} = {fraction!r}: a fraction from {lowest:g} to {highest:g} is allowed")


def checked_axis(name: str, axis: int, n_axes: int | None = None) -> int:
    """Check the number of an axis that a detector treats differently.

    Parameters
    ----------
    name : str
        Name of the parameter, for the message.
    n_axes : int, optional
        Number of axes of the map; without it, any number of 0 and above is allowed.

    Raises
    ------
    InputError
        If the map has no axis of that number.
    """
    if not isinstance(axis, Integral) or axis < 0:
        raise InputError(f"{name} = {axis!r}: allowed are 0 (range) and above")
    if n_axes is not None and axis >= n_axes:
        raise InputError(
            f"{name} = {axis}: a map of {n_axes} axes has no axis {axis}; allowed are 0 to {n_axes - 1}"
        )
    return int(axis)


def checked_power(power: ArrayLike, looks: int) -> Floats:
    """Check a power map and convert it to float64.

    Parameters
    ----------
    power : array_like of real numbers
        Power map of any rank.
    looks : int
        Independent noise powers that each cell averages.

    Raises
    ------
    InputError
        If the map is complex or empty, or holds NaN, infinite or negative power;
        if its strongest cell is so strong that sums overflow, or so weak that they
        lose digits; or if `looks` is out of range.
    """
    check_looks(looks)
    cells = checked_array("the power map, |.|²", power)
    if cells.ndim == 0 or cells.size == 0:
        raise InputError(f"the power map has shape {cells.shape}: at least one axis and one cell are needed")
    lowest, highest = float(cells.min()), float(cells.max())
    # Both are NaN as soon as one cell is.
    if not 0 <= lowest <= highest < math.inf:
        raise InputError(f"the power map spans {lowest} to {highest}: finite powers >= 0 are allowed")
    # Sums and thresholds of stronger maps overflow, those of weaker ones lose digits.
    if highest and not _WEAKEST <= highest <= _STRONGEST:
        raise InputError(
            f"the strongest cell of the power map is {highest}: scale the map, "
            f"0 or {_WEAKEST} to {_STRONGEST} is allowed"
        )
    return cells


def checked_list(cells: Sequence[ArrayLike], shape: tuple[int, ...]) -> Cells:
    """Check a list of cells under test and convert it to arrays of indices.

    Parameters
    ----------
    cells : tuple of array_like of int
        One array of indices from 0 for each axis of the map, shape (n,), as
        `numpy.nonzero` gives them.
    shape : tuple of int
        Shape of the map.

    Returns
    -------
    tuple of ndarray of int, each shape (n,)

    Raises
    ------
    InputError
        If there is not one array for each axis, if they differ in length, or
        if a cell lies outside the map.
    """
    if not isinstance(cells, tuple) or len(cells) != len(shape):
        raise InputError(
            f"cells: a tuple of {len(shape)} arrays of indices is needed, as numpy.nonzero gives"
        )
    indices = tuple(checked_array("cells", index, np.int64) for index in cells)
    if any(index.ndim != 1 or index.size != indices[0].size for index in indices):
        raise InputError("cells: the arrays of indices must be one-dimensional and equally long")
    for axis, (index, length) in enumerate(zip(indices, shape, strict=True)):
        if index.size and not 0 <= index.min() <= index.max() < length:
            raise InputError(
                f"cells: {index.min()} to {index.max()} along axis {axis}, the map has 0 to {length - 1}"
            )
    return indices


def spread(
    training: CellsPerSide, guard: CellsPerSide, n_axes: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Spread numbers of training and guard cells per side over the axes of the map.

    Parameters
    ----------
    training, guard : int or tuple of int
        Cells per side, for all axes or for each.
    n_axes : int
        Axes of the map.

    Returns
    -------
    tuple of tuple of int
        Training cells, and guard cells, of each axis.

    Raises
    ------
    InputError
        If they are not numbers of cells, or not one for each axis.
    """
    per_side = []
    for name, sizes in (("training", training), ("guard", guard)):
        check_cells(name, sizes)
        per_axis = sizes if isinstance(sizes, tuple) else (sizes,) * n_axes
        if len(per_axis) != n_axes:
            raise InputError(f"{name} = {sizes}: the map has {n_axes} axes, give one number or {n_axes}")
        # A NumPy integer may be too narrow for the size of the window.
        per_side.append(tuple(int(size) for size in per_axis))
    return per_side[0], per_side[1]


def share_of(fraction: float, n_cells: int) -> int:
    """Share of a number of cells, ⌊fraction n⌋, without the loss of one cell to rounding."""
    return int(fraction * n_cells + _ROUNDING)
