"""Summaries of records, and the one definition of the median times that tables and figures show."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.cells.statuses import failed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

TIME = "time_estimate_s"


def time_words(records: pd.DataFrame) -> str:
    """Say what the times of a run are: those of cells that ran beside others mislead.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    str
    """
    is_alone = records["timing"].astype(bool)[~failed(records)].all()
    return "median processor time" + ("" if is_alone else " (not measured alone)")


def median_times(records: pd.DataFrame, by: Sequence[str], columns: Sequence[str] = (TIME,)) -> pd.DataFrame:
    """Take the median over the cells of each group, whatever their SNR and trial.

    Cells that failed are left out. Where any cell of a group was timed
    (`isacbench run --timing`), the timed cells of the group count alone.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.
    by : sequence of str
        Columns whose values tell the groups apart.
    columns : sequence of str
        Columns of the records, in s; of stages and memory as well.

    Returns
    -------
    DataFrame
        One row for each group that has such a cell, with the columns
        ``<column>_median``. Its index is the group.

    Examples
    --------
    >>> records = pd.DataFrame({"estimator": "a", "status": "ok", "timing": False, TIME: [1, 2, 9]})
    >>> median_times(records, ["estimator"])["time_estimate_s_median"].to_dict()
    {'a': 2.0}
    """
    scored = records[~failed(records)]
    is_timed = scored["timing"].astype(bool)
    any_timed = is_timed.groupby([scored[name] for name in by], sort=False).transform("any")
    counting = scored[is_timed | ~any_timed]
    return counting.groupby(list(by), sort=False)[list(columns)].median().add_suffix("_median")


def summarise(
    records: pd.DataFrame, by: Sequence[str], numbers: Callable[[pd.DataFrame], Mapping[str, Any]]
) -> pd.DataFrame:
    """Summarise records, one row a group.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.
    by : sequence of str
        Columns whose values tell the groups apart.
    numbers : callable
        From the rows of a group to its numbers by column.

    Returns
    -------
    DataFrame
        The columns `by`, the numbers, and ``time_estimate_s_median`` as `median_times` returns it.

    Examples
    --------
    >>> records = pd.DataFrame({"estimator": ["a", "a"], "status": "ok", "timing": False, TIME: [1, 3]})
    >>> summarise(records, ["estimator"], lambda part: {"n_cells": len(part)}).to_dict("records")
    [{'estimator': 'a', 'n_cells': 2, 'time_estimate_s_median': 2.0}]
    """
    groups = records.groupby(list(by), sort=False)
    rows = [{**dict(zip(by, key, strict=True)), **numbers(part)} for key, part in groups]
    return pd.DataFrame(rows).join(median_times(records, by), on=list(by))
