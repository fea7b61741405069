"""Rows of a run, one for each cell, and the columns of their table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import pandas as pd

from isacbench.bench.cells.provenance import Environment
from isacbench.files.escaping import quoted
from isacbench.instrument.stages import STAGES
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.tables import POINT_COLUMNS

CellStatus = Literal["ok", "no_detection", "error", "timeout", "killed", "skipped"]

CLOUD_KEYS = ["scenario", "estimator", "params", "snr_db", "trial"]
DRAW_COLUMNS = ["scenario", "trial", *POINT_COLUMNS, "phase_rad"]

TYPES = {
    **dict.fromkeys(["suite", "scenario", "estimator", "params"], "str"),
    "snr_db": "float64",
    **dict.fromkeys(["trial", "seed"], "int64"),
    **dict.fromkeys(["status", "reason"], "str"),
    **dict.fromkeys(["n_true", "n_estimated"], "int64"),
    **dict.fromkeys(["hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m"], "float64"),
    **dict.fromkeys(["density", "velocity_nmse", "deviation", "chamfer_m", "gospa_m"], "float64"),
    **dict.fromkeys(["time_estimate_s", "precision", "recall", "time_score_s"], "float64"),
    "hausdorff_sum_m": "float64",
    "timing": "bool",
    **dict.fromkeys(["scenario_content", "environment"], "str"),
}
"""Columns of every table of results, with their types; a kind of suite appends its own.

``params`` are the parameters as canonical JSON, ``seed`` is that of the suite. ``status`` is ``ok``,
``no_detection`` (an empty cloud), or the kind of failure, whose ``reason`` is ``Type: message``. Of a failure
no points are estimated, and the scores of the metric ``paper`` are NaN. ``n_estimated`` of a reference is the
rounded mean over its realisations. ``time_estimate_s`` is the processor time of the estimate: of a failure
the wall time until then, of a timed row the median over its repeats, of a reference that of all its
realisations. ``time_score_s`` is wall time. ``timing`` tells whether the row was timed: alone, one cell after
the other, on one thread, warm. ``scenario_content`` is the digest of the content of the scene, and
``environment`` the name of the environment (machine and versions), which the manifest describes.
"""

COLUMNS = list(TYPES)

PANDAS_TYPES = {str: "str", int: "int64", float: "float64", bool: "bool"}

TIMING_COLUMNS: dict[str, float] = dict.fromkeys(
    [*(f"time_{name}_s" for name in STAGES), "time_spread_s", "peak_memory_mib"], math.nan
)
"""Further columns of a run with timing, each with its value for rows that were not timed."""

N_STORED = "n_stored"
"""Column with the points of the stored cloud, one realisation of a reference."""

REFERENCE_COLUMNS: dict[str, float] = dict.fromkeys([*SPREAD_COLUMNS.values(), N_STORED], math.nan)
"""Further columns of a run with references, each with its value for rows of other estimators."""

TIMES = ["time_estimate_s", "time_score_s"]
"""Columns of every table that differ from one run to the next."""


@dataclass(frozen=True, eq=False)
class Row:
    """Row of a cell with its cloud, before and after the cell was worked on.

    Attributes
    ----------
    labels : mapping of str to Any
        Columns that it has beforehand: its key, and what every row of the observation has.
    environment : Environment
        Description of what made it.
    result : mapping of str to Any
        Columns that came out of the cell.
    cloud : PointCloud
        Empty for a failure.
    answer_digest : str
        Of the plugin's answer, which repeats of the same call give again.
    """

    labels: Mapping[str, Any]
    environment: Environment
    result: Mapping[str, Any] = field(default_factory=dict)
    cloud: PointCloud = field(default_factory=PointCloud.empty)
    answer_digest: str = ""

    @property
    def values(self) -> dict[str, Any]:
        """All its columns that are no default."""
        return {**self.labels, **self.result}

    @property
    def status(self) -> CellStatus:
        """Status of the cell."""
        status: CellStatus = self.result["status"]
        return status

    @property
    def is_scored(self) -> bool:
        """Whether the cell has a score; an empty image has one, too."""
        return self.status in SCORED

    def failed(self, status: CellStatus, reason: str, time_s: float) -> Row:
        """Row of the same cell if it fails after some time."""
        result = {"status": status, "reason": reason, "time_estimate_s": time_s}
        return replace(self, result=result, cloud=PointCloud.empty())


def status_of(n_found: int) -> CellStatus:
    """Status of a cell that found so many things."""
    return "ok" if n_found else "no_detection"


def typed(rows: pd.DataFrame, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Put the columns of a table into their order and their types.

    `columns` are those of the study, each with its value for rows without it. The order is that of `COLUMNS`,
    then those of the study, and then those of `TIMING_COLUMNS` and `REFERENCE_COLUMNS` that the rows have.
    """
    optional = {**TIMING_COLUMNS, **REFERENCE_COLUMNS}
    present = {name: default for name, default in optional.items() if name in rows}
    further = {name: PANDAS_TYPES[type(default)] for name, default in {**columns, **present}.items()}
    missing = {name: value for name, value in columns.items() if name not in rows}
    table = rows.reindex(columns=[*(TYPES | further)]).assign(**missing)
    return table.astype(TYPES | further).copy()  # in one piece


def stored_points(rows: pd.DataFrame) -> pd.Series[Any]:
    """Number of points of the cloud that is stored for each row; of references ``n_stored``."""
    if N_STORED not in rows:
        return rows["n_estimated"]
    return rows[N_STORED].fillna(rows["n_estimated"])


def require_sound_records(rows: pd.DataFrame) -> None:
    """Refuse rows whose columns have other types, or a status that this isacbench does not know.

    ValueError names the column; any of the columns `COLUMNS` may be missing.
    """
    rows.astype({name: kind for name, kind in TYPES.items() if name in rows})
    if "status" in rows:
        statuses = get_args(CellStatus)
        unknown = set(rows["status"].unique()) - set(statuses)
        if unknown:
            raise ValueError(f"column status: {quoted(unknown.pop())}; allowed are {', '.join(statuses)}")


SCORED: tuple[str, ...] = ("ok", "no_detection")
"""Statuses of cells that have a score. An empty image has a score, too."""


def failed(records: pd.DataFrame) -> pd.Series[bool]:
    """Mark the rows that have no score: error, timeout, killed.

    >>> import pandas as pd
    >>> failed(pd.DataFrame({"status": ["ok", "no_detection", "timeout"]})).tolist()
    [False, False, True]
    """
    return ~records["status"].isin(SCORED)
