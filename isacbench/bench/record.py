"""What a run yields: one record a cell, and all of them together with what they were made from."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from isacbench.model.cloud import PointCloud

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from datetime import datetime

    from isacbench.bench.suite import Suite
    from isacbench.model.scenario import Scenario

__all__ = [
    "CLOUD_KEYS",
    "DRAW_COLUMNS",
    "POINT_COLUMNS",
    "Cell",
    "Outcome",
    "Record",
    "Results",
    "Status",
    "tabulate",
]

Status = Literal["ok", "no_detection", "error", "timeout", "killed", "skipped"]

CLOUD_KEYS = ["scenario", "estimator", "params", "snr_db", "trial"]
POINT_COLUMNS = ["x", "y", "z", "v", "power"]
DRAW_COLUMNS = ["scenario", "trial", *POINT_COLUMNS, "phase_rad"]


@dataclass(frozen=True)
class Cell:
    """One image to take: the key of its row.

    Attributes
    ----------
    suite, scenario, estimator : str
        Bare names.
    params : str
        The estimator's parameters as canonical JSON.
    snr_db : float
    trial, seed : int
    """

    suite: str
    scenario: str
    estimator: str
    params: str
    snr_db: float
    trial: int
    seed: int


@dataclass(frozen=True)
class Record(Cell):
    """One row of the results, its fields in the order of the columns.

    Attributes
    ----------
    status : str
        ``ok``, ``no_detection`` (an empty cloud), or what went wrong.
    reason : str
        ``Type: message`` of a failure, else empty.
    n_true, n_estimated : int
        Points of the truth and of the estimate; a failure delivered 0.
    hausdorff_xy_m, ..., recall : float
        Scores of the metric ``paper``, NaN for a failure.
    time_estimate_s : float
        Wall time of the estimate, or until it failed.
    time_score_s : float
        Wall time of the scoring, NaN for a failure.
    """

    status: Status
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


@dataclass(frozen=True, eq=False)
class Outcome:
    """A record, the cloud that it scores, and what a study adds; the cloud of a failure is empty.

    Attributes
    ----------
    record : Record
    cloud : PointCloud
    extras : mapping of str to Any
        Values of further columns, as far as there are any.
    """

    record: Record
    cloud: PointCloud
    extras: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Results:
    """Everything that a run knows afterwards.

    Attributes
    ----------
    suite : Suite
        As it was run, overrides included.
    records : DataFrame
        One row a cell, columns as in `Record` and then those of the study.
    clouds : DataFrame
        One row a point: the keys of its cell, then x, y, z in m, v in m/s, power.
    scenarios : dict of str to Scenario
        By name, as the suite lists them.
    draws : DataFrame
        One row a scatterer that a study drew: scenario, trial, x, y, z, v,
        power, phase_rad. Empty where all scatterers are the scenarios' own.
    started : datetime
        With its time zone.
    wall_time_s : float
        Loading, echoes, estimates and scores together.
    interrupted : bool
        Whether the run was stopped before its last cell.
    """

    suite: Suite
    records: pd.DataFrame
    clouds: pd.DataFrame
    scenarios: dict[str, Scenario]
    draws: pd.DataFrame
    started: datetime
    wall_time_s: float
    interrupted: bool

    def cloud(self, scenario: str, estimator: str, params: str, snr_db: float, trial: int) -> PointCloud:
        """Return the estimated cloud of a cell, empty where nothing was detected."""
        chosen = np.ones(len(self.clouds), dtype=np.bool_)
        for key, value in zip(CLOUD_KEYS, (scenario, estimator, params, snr_db, trial), strict=True):
            chosen &= (self.clouds[key] == value).to_numpy()
        return PointCloud.from_array(self.clouds.loc[chosen, POINT_COLUMNS].to_numpy())


def tabulate(
    outcomes: Sequence[Outcome], columns: Mapping[str, Any] | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables of the records and of the points of some outcomes.

    Parameters
    ----------
    outcomes : sequence of Outcome
    columns : mapping of str to Any, optional
        Further columns, each with its value where an outcome has none.

    Returns
    -------
    records, clouds : DataFrame
        As in `Results`.
    """
    names = [field.name for field in dataclasses.fields(Record)]
    rows = [outcome.record for outcome in outcomes]
    table = {name: [getattr(row, name) for row in rows] for name in names}
    for name, default in (columns or {}).items():
        table[name] = [outcome.extras.get(name, default) for outcome in outcomes]
    records = pd.DataFrame(table)
    n_points = [len(outcome.cloud) for outcome in outcomes]
    clouds = records[CLOUD_KEYS].loc[np.repeat(records.index, n_points)].reset_index(drop=True)
    points = np.concatenate([np.empty((0, 5)), *(outcome.cloud.to_array() for outcome in outcomes)])
    clouds[POINT_COLUMNS] = points
    return records, clouds
