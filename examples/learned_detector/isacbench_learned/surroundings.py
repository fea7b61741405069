"""The surroundings of every cell of a power map, as numbers that do not depend on the map's scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["FEATURES", "describe_surroundings"]

SIDE = 6
"""Cells of the window to either side of the cell under test, along range and along Doppler."""

WINDOW = 2 * SIDE + 1

FEATURES = (
    "lower quartile",
    "upper quartile",
    "upper decile",
    "mean",
    "stronger range neighbour",
    "weaker range neighbour",
    "stronger Doppler neighbour",
    "weaker Doppler neighbour",
    "strongest diagonal neighbour",
    "second range neighbours",
    "second Doppler neighbours",
    "peak along range",
    "peak along Doppler",
)
"""Levels of the surroundings, each as the logarithm of its ratio to the median of the training cells."""

RANKS = 17, 53, 64
"""Places of the quartiles and the upper decile among the 72 sorted training cells."""

MEDIAN = 35

DARKEST = 2.0**-100
"""Power relative to the strongest cell that stands for all that is weaker, so that logarithms are finite."""

BLOCK = 64
"""Rows of the map that are described at once, which bounds memory."""


def describe_surroundings(power: Floats) -> tuple[Floats, Floats]:
    """Describe the surroundings of every cell; the cell itself is left out.

    Windows wrap around the edges of the map. All cells have then the same
    window, and in white noise the same distribution of surroundings.

    Parameters
    ----------
    power : ndarray of float64, shape (n_range, n_doppler)
        Powers that are not negative, and not all zero.

    Returns
    -------
    reference : ndarray of float64, shape (n_range, n_doppler)
        Median of the training cells: 9 x 9 cells without the inner 3 x 3.
    features : ndarray of float64, shape (n_range, n_doppler, n_features)
        As `FEATURES` lists them.

    Raises
    ------
    InputError
        If the map has not two axes, or is smaller than the window.
    """
    if power.ndim != 2 or min(power.shape) < WINDOW:
        raise InputError(
            f"the power map has shape {power.shape}: two axes of {WINDOW} cells or more are allowed"
        )
    padded = np.pad(np.maximum(power, DARKEST * power.max()), SIDE, mode="wrap")
    windows = sliding_window_view(padded, (WINDOW, WINDOW))
    blocks = [windows[first : first + BLOCK] for first in range(0, len(windows), BLOCK)]
    reference, levels = zip(*map(_levels, blocks), strict=True)
    median = np.concatenate(reference)
    return median, np.log(np.concatenate(levels) / median[..., np.newaxis])


def _levels(window: Floats) -> tuple[Floats, Floats]:
    """Median of the training cells, and the levels that `FEATURES` lists."""
    inner = slice(SIDE - 4, SIDE + 5)
    trains = np.ones((9, 9), dtype=bool)
    trains[3:6, 3:6] = False
    training = np.partition(window[..., inner, inner][..., trains], (*RANKS, MEDIAN), axis=-1)
    along_range, along_doppler = window[..., SIDE], window[..., SIDE, :]
    diagonal = window[..., SIDE - 1 : SIDE + 2 : 2, SIDE - 1 : SIDE + 2 : 2]
    levels = (
        *(training[..., rank] for rank in RANKS),
        training.mean(axis=-1),
        *_extremes(along_range),
        *_extremes(along_doppler),
        diagonal.max(axis=(-2, -1)),
        *(_ring(line, [2]) for line in (along_range, along_doppler)),
        *(_ring(line, range(3, SIDE + 1)) for line in (along_range, along_doppler)),
    )
    return training[..., MEDIAN], np.stack(levels, axis=-1)


def _extremes(line: Floats) -> Iterator[Floats]:
    """Stronger and weaker of the two next cells of a line."""
    pair = line[..., SIDE - 1 : SIDE + 2 : 2]
    yield pair.max(axis=-1)
    yield pair.min(axis=-1)


def _ring(line: Floats, distances: Iterable[int]) -> Floats:
    """Strongest cell of a line at some distances to either side."""
    index = [SIDE + sign * distance for distance in distances for sign in (-1, 1)]
    strongest: Floats = line[..., index].max(axis=-1)
    return strongest
