"""Statuses of rows: scored cells and failures."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

SCORED: tuple[str, ...] = ("ok", "no_detection")
"""Statuses of cells that have a score. An empty image has a score, too."""


def failed(records: pd.DataFrame) -> pd.Series[bool]:
    """Mark cells that failed.

    Parameters
    ----------
    records : DataFrame
        Rows of a run, with the column ``status``.

    Returns
    -------
    Series of bool
        True if a cell has no score: it raised, ran out of time, was killed,
        or was skipped. Has the index of the rows.

    Examples
    --------
    >>> import pandas as pd
    >>> failed(pd.DataFrame({"status": ["ok", "no_detection", "timeout"]})).tolist()
    [False, False, True]
    """
    return ~records["status"].isin(SCORED)
