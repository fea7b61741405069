"""What a run yields: one record a cell, and all of them together with what they were made from."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import pandas as pd

from isacbench.model.cloud import PointCloud

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime

    from isacbench.bench.suite import Suite
    from isacbench.model.scenario import Scenario

__all__ = ["CLOUD_KEYS", "POINT_COLUMNS", "Cell", "Outcome", "Record", "Results", "Status", "tabulate"]

Status = Literal["ok", "no_detection", "error", "timeout", "killed", "skipped"]

CLOUD_KEYS = ["scenario", "estimator", "params", "snr_db", "trial"]
POINT_COLUMNS = ["x", "y", "z", "v", "power"]


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
    """A record and the cloud that it scores; the cloud of a failure is empty."""

    record: Record
    cloud: PointCloud


@dataclass(frozen=True, eq=False)
class Results:
    """Everything that a run knows afterwards.

    Attributes
    ----------
    suite : Suite
        As it was run, overrides included.
    records : DataFrame
        One row a cell, columns as in `Record`.
    clouds : DataFrame
        One row a point: the keys of its cell, then x, y, z in m, v in m/s, power.
    scenarios : dict of str to Scenario
        By name.
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
    started: datetime
    wall_time_s: float
    interrupted: bool

    def cloud(self, scenario: str, estimator: str, params: str, snr_db: float, trial: int) -> PointCloud:
        """Return the estimated cloud of a cell, empty where nothing was detected."""
        chosen = np.ones(len(self.clouds), dtype=np.bool_)
        for key, value in zip(CLOUD_KEYS, (scenario, estimator, params, snr_db, trial), strict=True):
            chosen &= (self.clouds[key] == value).to_numpy()
        return PointCloud.from_array(self.clouds.loc[chosen, POINT_COLUMNS].to_numpy())


def tabulate(outcomes: Sequence[Outcome]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables of the records and of the points of some outcomes.

    Returns
    -------
    records, clouds : DataFrame
        As in `Results`.
    """
    columns = [field.name for field in dataclasses.fields(Record)]
    rows = [outcome.record for outcome in outcomes]
    records = pd.DataFrame({name: [getattr(row, name) for row in rows] for name in columns})
    n_points = [len(outcome.cloud) for outcome in outcomes]
    clouds = records[CLOUD_KEYS].loc[np.repeat(records.index, n_points)].reset_index(drop=True)
    points = np.concatenate([np.empty((0, 5)), *(outcome.cloud.to_array() for outcome in outcomes)])
    clouds[POINT_COLUMNS] = points
    return records, clouds
