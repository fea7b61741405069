"""Run time against error: the points of a timed run, and which of them are worth their time.

What a point is: one estimator with its parameters, on one scenario at one SNR; of
more than 12 scenarios, on all of them, each of which counts as a trial.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from isacbench.bench.cells.statuses import failed
from isacbench.bench.plan.labels import estimator_labels, find_limits
from isacbench.bench.studies.imaging_study import MANY_SCENARIOS, summarise_scores
from isacbench.bench.studies.intervals import median_interval

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import ArrayLike, NDArray

PANEL = ["scenario", "snr_db"]
POINT = ["scenario", "estimator", "params", "snr_db"]
"""Key of a point."""

ERROR = "hausdorff_sum_m"
MEMORY = "peak_memory_mib"


def pareto_frontier(time_s: ArrayLike, error: ArrayLike) -> NDArray[np.bool_]:
    """Tell which alternatives no other one beats in time and in error.

    One beats another if it is worse in neither and better in one of them.
    Alternatives that are equal in both do not beat each other.

    Parameters
    ----------
    time_s, error : array_like, shape (n,)
        Finite; lower is better in both.

    Returns
    -------
    ndarray of bool, shape (n,)
        True on the frontier.

    Examples
    --------
    >>> pareto_frontier([1.0, 2.0, 3.0, 3.0], [5.0, 4.0, 4.5, 4.0]).tolist()
    [True, True, False, False]
    """
    times, errors = np.asarray(time_s), np.asarray(error)
    is_worse_in_neither = (times[:, None] <= times) & (errors[:, None] <= errors)
    is_better_in_one = (times[:, None] < times) | (errors[:, None] < errors)
    is_beaten: NDArray[np.bool_] = np.asarray(np.any(is_worse_in_neither & is_better_in_one, axis=0))
    return ~is_beaten


def summarise_times(records: pd.DataFrame) -> pd.DataFrame:
    """Summarise the points of a timed run, limits found by name.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        As `summarise_points` returns it; empty where nothing was timed.
    """
    rows = timed_rows(records)
    return pd.DataFrame() if rows.empty else summarise_points(rows, find_limits(rows))


def timed_rows(records: pd.DataFrame) -> pd.DataFrame:
    """Rows whose time counts; of estimators that have such rows, those too that failed before one was there.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        None where nothing was timed. Of more than 12 scenarios means over the trials of each, as
        trials of one scenario.
    """
    is_timed = records["timing"].astype(bool)
    return _pooled(records[is_timed | (failed(records) & bool(is_timed.any()))])


def _pooled(rows: pd.DataFrame) -> pd.DataFrame:
    """Many scenarios as trials of one; one that failed in any trial has failed."""
    n_scenarios = rows["scenario"].nunique()
    if n_scenarios <= MANY_SCENARIOS:
        return rows
    groups = rows.assign(failed=failed(rows)).groupby(POINT, sort=False)
    has_failed = groups["failed"].any()
    numbers = rows.select_dtypes(np.float64).columns.drop("snr_db", errors="ignore").tolist()
    others = groups.first().drop(columns=numbers)
    others["status"] = others["status"].mask(has_failed, "error")
    table = pd.concat([others, groups[numbers].mean()[~has_failed]], axis=1).reset_index()
    return table.assign(
        trial=pd.factorize(table["scenario"])[0], scenario=f"{n_scenarios} scenarios as trials"
    )


def summarise_points(records: pd.DataFrame, limits: Collection[str]) -> pd.DataFrame:
    """Average Hausdorff sum and time of every point of a timed run, and find the frontiers.

    Parameters
    ----------
    records : DataFrame
        Rows of a run; only those that `timed_rows` picks are used.
    limits : collection of str
        Names of estimators that see the truth.

    Returns
    -------
    DataFrame
        One row for each scenario, SNR, estimator and params, SNRs ascending:

        - ``number`` of the estimator with its params in figures, ``label``;
          the counts ``n_trials``, ``n_failed``, ``n_no_detection``;
        - ``hausdorff_sum_m_mean``, ``hausdorff_sum_m_low``, ``hausdorff_sum_m_high``
          (Student's t), over the trials that did not fail;
        - ``time_s``, the median over the same
          (`isacbench.bench.studies.medians.median_times`), ``time_low_s``,
          ``time_high_s`` (order statistics), ``time_slowest_s``, and
          ``peak_memory_mib``, the median, where the records have it;
        - ``is_limit``; ``is_complete``, whether every trial of the scenario
          and SNR has a score; ``is_on_frontier``, of mean Hausdorff sum and
          median time among those that are complete and no limit.

        Limits of intervals are NaN where the trials are too few: five are
        needed of Hausdorff sums, six of times.
    """
    rows = timed_rows(records)
    columns = ["estimator", "params"]
    labels = estimator_labels(zip(*(records[name] for name in columns), strict=True))
    points = summarise_scores(rows)
    variants = list(zip(*(points[name] for name in columns), strict=True))
    points["number"] = [1 + list(labels).index(variant) for variant in variants]
    points["label"] = [labels[variant] for variant in variants]
    points = points.rename(columns={"n_cells": "n_trials", "time_estimate_s_median": "time_s"})
    for end, sign in (("low", -1), ("high", 1)):
        points[f"hausdorff_sum_m_{end}"] = (
            points["hausdorff_sum_m_mean"] + sign * points["hausdorff_sum_m_band"]
        )
    points = points.merge(_times(rows[~failed(rows)]), on=POINT, how="left")
    points["is_limit"] = points["estimator"].isin(list(limits))
    all_trials = points.groupby(PANEL)["n_trials"].transform("max")
    points["is_complete"] = (points["n_failed"] == 0) & (points["n_trials"] == all_trials)
    points["is_on_frontier"] = _on_frontiers(points)
    names = [
        *(*POINT, "number", "label", "n_trials", "n_failed", "n_no_detection"),
        *("hausdorff_sum_m_mean", "hausdorff_sum_m_low", "hausdorff_sum_m_high"),
        *("time_s", "time_low_s", "time_high_s", "time_slowest_s"),
        *([MEMORY] if MEMORY in points else []),
        *("is_limit", "is_complete", "is_on_frontier"),
    ]
    order = pd.factorize(points["scenario"])[0], points["snr_db"]
    return points[names].iloc[np.lexsort(order[::-1])].reset_index(drop=True)


def _times(scored: pd.DataFrame) -> pd.DataFrame:
    """Interval of the median time of every point, its slowest trial, and its peak memory where measured."""
    rows = []
    for key, part in scored.groupby(POINT, sort=False):
        times_s = part["time_estimate_s"].to_numpy(dtype=np.float64)
        _, low, high = median_interval(times_s)
        rows.append((*key, low, high, times_s.max()))
    table = pd.DataFrame(rows, columns=[*POINT, "time_low_s", "time_high_s", "time_slowest_s"])
    if MEMORY in scored:
        table[MEMORY] = scored.groupby(POINT, sort=False)[MEMORY].median().to_numpy()
    return table


def _on_frontiers(points: pd.DataFrame) -> NDArray[np.bool_]:
    """Mark the points on the frontier of their scenario and SNR."""
    found = np.zeros(len(points), dtype=np.bool_)
    competes = points["is_complete"] & ~points["is_limit"]
    for chosen in points[competes].groupby(PANEL, sort=False).indices.values():
        rows = np.flatnonzero(competes)[chosen]
        part = points.iloc[rows]
        found[rows] = pareto_frontier(part["time_s"], part["hausdorff_sum_m_mean"])
    return found
