"""Rows with their clouds: a table and a ragged array that are selected, joined and sorted together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import CLOUD_KEYS, COLUMNS
from isacbench.model.cloud_files.columns import POINT_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from isacbench.bench.store.provenance import Environment

TEXTS = ["scenario", "estimator", "params"]
"""Keys that a table of points holds as categories."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a run and the clouds that they score.

    Attributes
    ----------
    records : DataFrame
        n rows, columns as in `isacbench.bench.cells.record.COLUMNS` and those of the study.
    n_points : ndarray of int64, shape (n,)
        Points of each row's cloud.
    points : ndarray of float64, shape (sum of n_points, 5)
        Clouds one after the other: x, y, z, v, power.
    environments : mapping of str to Environment
        By the names that the rows have.
    """

    records: pd.DataFrame
    n_points: NDArray[np.int64]
    points: NDArray[np.float64]
    environments: Mapping[str, Environment]

    @classmethod
    def of_tables(
        cls, records: pd.DataFrame, clouds: pd.DataFrame, environments: Mapping[str, Environment]
    ) -> Rows:
        """Rows of a table of records and a table of points.

        Parameters
        ----------
        records : DataFrame
            One row a cell.
        clouds : DataFrame
            One row a point, with the key of its cell. Points of other cells
            are left out.
        environments : mapping of str to Environment

        Returns
        -------
        Rows
        """
        of_row = _index(records).get_indexer(_index(clouds))
        known = of_row >= 0
        order = np.argsort(of_row[known], kind="stable")
        points = clouds[POINT_COLUMNS].to_numpy(dtype=np.float64)[known][order]
        return cls(records, np.bincount(of_row[known], minlength=len(records)), points, environments)

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """Rows of several parts, one after the other.

        Parameters
        ----------
        parts : sequence of Rows

        Returns
        -------
        Rows
        """
        tables = [part.records for part in parts if len(part.records)]
        return cls(
            pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=COLUMNS),
            np.concatenate([np.empty(0, dtype=np.int64), *(part.n_points for part in parts)]),
            np.concatenate([np.empty((0, 5)), *(part.points for part in parts)]),
            {name: environment for part in parts for name, environment in part.environments.items()},
        )

    def __len__(self) -> int:
        return len(self.records)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Rows:
        """Select rows with their clouds.

        Parameters
        ----------
        rows : ndarray of int or bool
            Positions in the wanted order, or a mask.

        Returns
        -------
        Rows
        """
        picked = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
        starts = np.cumsum(self.n_points) - self.n_points
        n_points = self.n_points[picked]
        shift = np.repeat(starts[picked] - (np.cumsum(n_points) - n_points), n_points)
        points = self.points[np.arange(n_points.sum()) + shift]
        return Rows(self.records.iloc[picked].reset_index(drop=True), n_points, points, self.environments)

    def used_environments(self) -> dict[str, Environment]:
        """Environments of the rows, by name."""
        used = self.records["environment"].unique()
        return {name: self.environments[name] for name in used if name in self.environments}

    def clouds(self) -> pd.DataFrame:
        """One row a point: the keys of its cell, then x, y, z in m, v in m/s, power."""
        keys = self.records[CLOUD_KEYS].astype(dict.fromkeys(TEXTS, "category"))
        table = keys.iloc[np.repeat(np.arange(len(self)), self.n_points)].reset_index(drop=True)
        return pd.concat([table, pd.DataFrame(self.points, columns=POINT_COLUMNS)], axis=1)


def _index(table: pd.DataFrame) -> pd.Index[Any]:
    return pd.MultiIndex.from_frame(table[CLOUD_KEYS])
