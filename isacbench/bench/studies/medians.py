"""Median times: the one definition behind every table and figure that shows a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from isacbench.bench.cells.statuses import failed

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

TIME = "time_estimate_s"


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
    >>> import pandas as pd
    >>> records = pd.DataFrame({"estimator": "a", "status": "ok", "timing": False, TIME: [1, 2, 9]})
    >>> median_times(records, ["estimator"])["time_estimate_s_median"].to_dict()
    {'a': 2.0}
    """
    scored = records[~failed(records)]
    is_timed = scored["timing"].astype(bool)
    any_timed = is_timed.groupby([scored[name] for name in by], sort=False).transform("any")
    counting = scored[is_timed | ~any_timed]
    return counting.groupby(list(by), sort=False)[list(columns)].median().add_suffix("_median")
