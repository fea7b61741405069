"""Tables of a run as files: parquet with a digest of what it holds, and CSV that is safe in a spreadsheet.

Clouds of rows are one array, and one table: they are selected, joined and sorted as the rows are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from isacbench.bench.cells.record import CLOUD_KEYS
from isacbench.bench.store.run_folder import replacing
from isacbench.bench.suites.scenario_digest import digest
from isacbench.errors import AccessError
from isacbench.files.checked_files import require_file, require_inside
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.columns import POINT_COLUMNS

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


DIGEST = "digest"
"""Attribute of a table's file that holds the digest of its content."""

FORMULA = r"^[=+\-@\t\r]"
"""First character of a text that a spreadsheet evaluates as a formula."""

GUARD = "'"
"""Mark by which spreadsheets know that a text follows."""


def read_table(path: Path) -> pd.DataFrame:
    """Read a table. ValueError if it is not as it was written, InputError if it is no file of its folder."""
    require_inside(path, path.parent)
    require_file(path)
    try:
        with path.open("rb") as file:
            table = pd.read_parquet(file, page_checksum_verification=True)
    except Exception as error:  # Arrow raises many types for a damaged file, without a number of the system
        if isinstance(error, MemoryError) or getattr(error, "errno", None) is not None:
            raise AccessError(f"{path}: cannot be read: {error}") from error
        raise ValueError(f"{path.name}: {type(error).__name__}: {error}") from error
    # The checksums of pages do not cover the description of the table.
    if DIGEST in table.attrs and table.attrs[DIGEST] != _table_digest(table):
        raise ValueError(f"{path.name}: its content does not match its digest")
    table.attrs = {}
    return table


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table with its digest, in place of an older one."""
    signed = table.copy(deep=False)
    signed.attrs = {DIGEST: _table_digest(table)}
    with replacing(path) as temporary:
        signed.to_parquet(temporary, index=False, write_page_checksum=True)


def write_csv_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV: text in quotes, missing values empty, numbers with all their digits.

    Each column has one type, else pyarrow raises ArrowInvalid or ArrowTypeError.
    """
    csv.write_csv(pa.Table.from_pandas(table, preserve_index=False), path)


def without_formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Put an apostrophe before text that a spreadsheet would evaluate as a formula.

    Examples
    --------
    >>> without_formulas(pd.DataFrame({"scenario": ["street", "=1+1"]}))["scenario"].tolist()
    ['street', "'=1+1"]
    """
    guarded = {}
    for name in table.columns:
        if pd.api.types.infer_dtype(table[name], skipna=True) == "string":
            is_formula = table[name].str.match(FORMULA, na=False)
            guarded[name] = table[name].mask(is_formula, GUARD + table[name])
    return table.assign(**guarded)


def _table_digest(table: pd.DataFrame) -> str:
    """Digest of the names and values of a table."""
    rows = pd.util.hash_pandas_object(table, index=False).to_numpy()
    return digest([list(table.columns), len(table), hashlib.sha256(rows.tobytes()).hexdigest()])
