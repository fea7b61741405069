"""Ratios of Hausdorff sums to those of the oracle, scene by scene."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pandas as pd

if TYPE_CHECKING:
    from collections.abc import Collection

SMALLEST_ORACLE_M = 0.3
"""Least denominator of a ratio in m: the oracle of a scene of lone scatterers is 0."""

POINT_FAMILIES = ("sparse",)
"""Families without ratios: their targets are absolute."""


def hausdorff_ratios(records: pd.DataFrame, without: Collection[str] = ()) -> pd.Series[float]:
    """Divide the Hausdorff sum of each row by that of the oracle at the same scenario, SNR and trial.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.
    without : collection of str
        Scenarios that get no ratios, such as those of `POINT_FAMILIES`.

    Returns
    -------
    Series of float64
        With the index of the records; NaN without scores or without a row of the oracle.
        The denominator is at least `SMALLEST_ORACLE_M`.
    """
    keys = ["scenario", "snr_db", "trial"]
    table = records[keys].assign(sum_m=records["hausdorff_sum_m"])
    is_oracle = (records["estimator"] == "oracle") & (records["params"].map(_cell) == 1)
    oracle_m = table[is_oracle].groupby(keys)["sum_m"].mean().clip(lower=SMALLEST_ORACLE_M)
    below = pd.Series(oracle_m.reindex(pd.MultiIndex.from_frame(table[keys])).to_numpy(), index=records.index)
    ratio = table["sum_m"] / below
    return ratio.where(~records["scenario"].isin(list(without)))


def _cell(params: str) -> float:
    """Cell size of an oracle in Rayleigh cells."""
    return float(json.loads(params or "{}").get("cell", 1.0))
