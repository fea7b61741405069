"""Records of a run, one for each cell, and the columns of their table."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import pandas as pd

from isacbench.files.escaping import quoted
from isacbench.instrument.stages import STAGES
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.model.cloud import PointCloud
from isacbench.model.cloud_files.columns import POINT_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Mapping

CellStatus = Literal["ok", "no_detection", "error", "timeout", "killed", "skipped"]

CLOUD_KEYS = ["scenario", "estimator", "params", "snr_db", "trial"]
DRAW_COLUMNS = ["scenario", "trial", *POINT_COLUMNS, "phase_rad"]


@dataclass(frozen=True)
class Cell:
    """Key of a row: identifies one image of a run.

    Attributes
    ----------
    suite, scenario, estimator : str
        Bare names.
    params : str
        The estimator's parameters as canonical JSON.
    scenario_content : str
        Digest of the content of the scene, part of the cell's identity.
    """

    suite: str
    scenario: str
    estimator: str
    params: str
    snr_db: float
    trial: int
    seed: int
    scenario_content: str


@dataclass(frozen=True)
class Record(Cell):
    """One row of the results; `COLUMNS` has the order of the columns.

    Attributes
    ----------
    status : str
        ``ok``, ``no_detection`` (an empty cloud), or the kind of failure.
    reason : str
        ``Type: message`` of a failure, else empty.
    n_true, n_estimated : int
        Points of the truth and of the estimate; 0 estimated for a failure. Of a
        reference the rounded mean over its realisations.
    hausdorff_xy_m, ..., recall, hausdorff_sum_m : float
        Scores of the metric ``paper``, NaN for a failure.
    time_estimate_s : float
        Processor time of the estimate, of a failure the wall time until then; of a
        timed row the median over its repeats; of a reference that of all its realisations.
    time_score_s : float
        Wall time of the scoring, NaN for a failure.
    timing : bool
        True if the row was timed: alone, one cell after the other, on one
        thread, warm.
    environment : str
        Name of the environment (machine and versions) that made the row; the
        manifest describes it.
    """

    status: CellStatus
    reason: str
    n_true: int
    n_estimated: int
    hausdorff_xy_m: float = math.nan
    hausdorff_xz_m: float = math.nan
    hausdorff_yz_m: float = math.nan
    density: float = math.nan
    velocity_nmse: float = math.nan
    deviation: float = math.nan
    chamfer_m: float = math.nan
    gospa_m: float = math.nan
    time_estimate_s: float = math.nan
    precision: float = math.nan
    recall: float = math.nan
    time_score_s: float = math.nan
    timing: bool = False
    environment: str = ""
    hausdorff_sum_m: float = math.nan


PROVENANCE = ["timing", "scenario_content", "environment"]
COLUMNS = [field.name for field in dataclasses.fields(Record) if field.name not in PROVENANCE] + PROVENANCE
"""Columns of every table of results; a study appends its own."""

TYPES = {field.name: str(field.type) for field in dataclasses.fields(Record)}
KINDS = {"str": "str", "CellStatus": "str", "int": "int64", "float": "float64", "bool": "bool"}

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
class Outcome:
    """Record of a cell, with the cloud that was scored and the columns of the study.

    Attributes
    ----------
    cloud : PointCloud
        Empty for a failure.
    extras : mapping of str to Any
        Values of further columns.
    """

    record: Record
    cloud: PointCloud
    extras: Mapping[str, Any] = field(default_factory=dict)

    def labelled(self, labels: Mapping[str, Any]) -> Outcome:
        """Add columns that the outcome does not have yet."""
        return dataclasses.replace(self, extras={**labels, **self.extras})

    def made_by(self, environment: str, timing: bool = False) -> Outcome:
        """Add the environment of the row.

        Parameters
        ----------
        environment : str
            Name of the environment.
        timing : bool
            True if the row was timed.
        """
        record = dataclasses.replace(self.record, environment=environment, timing=timing)
        return dataclasses.replace(self, record=record)


def typed(records: pd.DataFrame, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Put the columns of a table into their order and their types.

    `columns` are those of the study, each with its value for rows without it. The order is that of `COLUMNS`,
    then those of the study, and then those of `TIMING_COLUMNS` and `REFERENCE_COLUMNS` that the records have.
    """
    kinds = {name: KINDS[TYPES[name]] for name in COLUMNS}
    optional = {**TIMING_COLUMNS, **REFERENCE_COLUMNS}
    present = {name: default for name, default in optional.items() if name in records}
    kinds |= {name: KINDS[type(default).__name__] for name, default in {**columns, **present}.items()}
    missing = {name: value for name, value in columns.items() if name not in records}
    table = records.reindex(columns=list(kinds)).assign(**missing)
    return table.astype(kinds).copy()  # in one piece


def stored_points(records: pd.DataFrame) -> pd.Series[Any]:
    """Number of points of the cloud that is stored for each row; of references ``n_stored``."""
    if N_STORED not in records:
        return records["n_estimated"]
    return records[N_STORED].fillna(records["n_estimated"])


def require_sound_records(records: pd.DataFrame) -> None:
    """Refuse records whose columns have other types, or a status that this isacbench does not know.

    ValueError names the column; any of the columns `COLUMNS` may be missing.
    """
    records.astype({name: KINDS[TYPES[name]] for name in COLUMNS if name in records})
    if "status" in records:
        statuses = get_args(CellStatus)
        unknown = set(records["status"].unique()) - set(statuses)
        if unknown:
            raise ValueError(f"column status: {quoted(unknown.pop())}; allowed are {', '.join(statuses)}")
