"""Places of small labels near their points, none over another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]


def place_labels(
    anchors: ArrayLike, sizes: ArrayLike, offsets: Sequence[ArrayLike], taken: ArrayLike = ()
) -> list[Floats | None]:
    """Place labels one after the other, each at the first offset where it covers no label placed before.

    Parameters
    ----------
    anchors : array_like, shape (n, 2)
        Points that the labels belong to.
    sizes : array_like, shape (n, 2)
        Widths and heights of the labels, in the same unit.
    offsets : sequence of array_like, each of shape (m, 2) with m of its own
        Places for the centre of each label relative to its point, the best one first.
    taken : array_like, shape (k, 4)
        Left, lower, right and upper ends of further boxes that must not be covered.

    Returns
    -------
    list of ndarray of float64, shape (2,), or None
        Offset of each label, None where all are covered.

    Examples
    --------
    >>> offsets = [[(2.0, 0.0), (-2.0, 0.0)]] * 3
    >>> place_labels([(0.0, 0.0)] * 3, [(3.0, 1.0)] * 3, offsets)
    [array([2., 0.]), array([-2.,  0.]), None]
    """
    boxes = [np.asarray(box, dtype=np.float64) for box in np.asarray(taken, dtype=np.float64).reshape(-1, 4)]
    found: list[Floats | None] = []
    for anchor, size, places in zip(np.asarray(anchors), np.asarray(sizes), offsets, strict=True):
        candidates = np.asarray(places, dtype=np.float64)
        corners = np.concatenate([anchor + candidates - size / 2, anchor + candidates + size / 2], axis=1)
        free = [place for place in range(len(candidates)) if not _covers(corners[place], boxes)]
        found.append(candidates[free[0]] if free else None)
        boxes += [corners[place] for place in free[:1]]
    return found


def _covers(box: Floats, others: Sequence[Floats]) -> bool:
    """Tell whether a box has an area in common with any of the others."""
    if not others:
        return False
    left, lower, right, upper = np.transpose(others)
    overlaps = (box[0] < right) & (left < box[2]) & (box[1] < upper) & (lower < box[3])
    return bool(overlaps.any())
