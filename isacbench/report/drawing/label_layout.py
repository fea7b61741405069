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
    boxes = list(np.asarray(taken, dtype=np.float64).reshape(-1, 4))
    found: list[Floats | None] = []
    for anchor, size, places in zip(np.asarray(anchors), np.asarray(sizes), offsets, strict=True):
        candidates = np.asarray(places, dtype=np.float64)
        lower, upper = anchor + candidates - size / 2, anchor + candidates + size / 2
        others = np.array(boxes).reshape(-1, 4)
        overlaps = (lower[:, None] < others[:, 2:]) & (others[:, :2] < upper[:, None])
        free = np.flatnonzero(~overlaps.all(axis=2).any(axis=1))
        found.append(candidates[free[0]] if free.size else None)
        boxes += [np.concatenate([lower[place], upper[place]]) for place in free[:1]]
    return found
