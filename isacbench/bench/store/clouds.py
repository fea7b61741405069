"""Clouds of the rows of a run as one array: they are selected, joined and sorted as the rows are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import CLOUD_KEYS
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.columns import POINT_COLUMNS

if TYPE_CHECKING:
    from numpy.typing import NDArray

TEXTS = ["scenario", "estimator", "params"]
"""Keys that a table of points holds as categories."""


@dataclass(frozen=True, eq=False)
class CloudArray:
    """Clouds one after the other, one for each row.

    Attributes
    ----------
    n_points : ndarray of int64, shape (n,)
    points : ndarray of float64, shape (sum of n_points, 5)
        x, y, z, v, power.
    """

    n_points: NDArray[np.int64]
    points: NDArray[np.float64]

    @classmethod
    def of_table(cls, rows: pd.DataFrame, table: pd.DataFrame) -> CloudArray:
        """Find the clouds of rows in a table of points with their cells' keys; other cells are left out."""
        index, keys = (pd.MultiIndex.from_frame(one[CLOUD_KEYS]) for one in (rows, table))
        of_row = index.get_indexer(keys)
        known = of_row >= 0
        order = np.argsort(of_row[known], kind="stable")
        points = table[POINT_COLUMNS].to_numpy(dtype=np.float64)[known][order]
        return cls(np.bincount(of_row[known], minlength=len(rows)), points)

    @classmethod
    def empty(cls, n: int = 0) -> CloudArray:
        """Empty clouds."""
        return cls(np.zeros(n, dtype=np.int64), np.empty((0, len(POINT_COLUMNS))))

    @classmethod
    def joined(cls, parts: Sequence[CloudArray]) -> CloudArray:
        """Clouds of several parts, one part after the other."""
        every = [cls.empty(), *parts]
        return cls(
            np.concatenate([part.n_points for part in every]), np.concatenate([part.points for part in every])
        )

    @cached_property
    def ends(self) -> NDArray[np.int64]:
        """End of each cloud among the points."""
        return np.cumsum(self.n_points)

    def cloud(self, index: int) -> PointCloud:
        """Cloud of one row."""
        end = self.ends[index]
        return PointCloud.from_array(self.points[end - self.n_points[index] : end])

    def take(self, picked: NDArray[np.int64]) -> CloudArray:
        """Select clouds by their positions, in the wanted order."""
        starts, n_points = (self.ends - self.n_points)[picked], self.n_points[picked]
        shift = np.repeat(starts - (np.cumsum(n_points) - n_points), n_points)
        return CloudArray(n_points, self.points[np.arange(n_points.sum()) + shift])

    def table(self, rows: pd.DataFrame) -> pd.DataFrame:
        """One row a point: the keys of its cell, then x, y, z in m, v in m/s, power."""
        keys = rows[CLOUD_KEYS].astype(dict.fromkeys(TEXTS, "category"))
        own = keys.iloc[np.repeat(np.arange(len(rows)), self.n_points)].reset_index(drop=True)
        return pd.concat([own, pd.DataFrame(self.points, columns=POINT_COLUMNS)], axis=1)
