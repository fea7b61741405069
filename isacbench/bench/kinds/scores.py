"""Means of the scores of images, over trials and over scenarios."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from isacbench.bench.cells.record import COLUMNS, REFERENCE_COLUMNS, TIMING_COLUMNS, failed
from isacbench.bench.kinds.kind import SNR_GAIN
from isacbench.bench.statistics import median_times, student_band
from isacbench.metrics.paper import PROJECTIONS
from isacbench.metrics.realisations import SPREAD_COLUMNS

if TYPE_CHECKING:
    from typing import Any

GROUP = ["scenario", "estimator", "params", "snr_db"]
AVERAGED = [
    "n_estimated",
    *PROJECTIONS,
    "hausdorff_sum_m",
    "density",
    "velocity_nmse",
    "deviation",
    "chamfer_m",
    "gospa_m",
    "precision",
    "recall",
]

VARIANT = ["estimator", "params"]

MANY_SCENARIOS = 12
"""More scenarios are not shown one by one, but by their mean."""


def averaged_columns(rows: pd.DataFrame) -> list[str]:
    """List the columns of rows that are averaged: scores of all metrics, and the number of points."""
    others = {*COLUMNS, *TIMING_COLUMNS, *REFERENCE_COLUMNS, *SNR_GAIN, *AVERAGED, *LONE_COUNTS}
    floats = rows.select_dtypes("float").columns
    return [*AVERAGED, *(name for name in floats if name not in others)]


LONE_COUNTS = "n_resolvable", "n_resolved", "n_false"
"""Columns of a population that count something in families of lone scatterers alone."""


def summarise_scores(rows: pd.DataFrame) -> pd.DataFrame:
    """Average the trials of every scenario, estimator and SNR.

    Returns
    -------
    DataFrame
        One row for each scenario, estimator (with its parameters) and SNR:
        the counts ``n_cells``, ``n_no_detection`` and ``n_failed``; for every
        score ``<score>_mean`` and ``<score>_band``, the half width of the
        95 % confidence interval of the mean (Student's t), over the cells
        that did not fail, the band over five or more of them; of a reference
        the band is the mean spread over its realisations; and
        ``time_estimate_s_median`` as `isacbench.bench.statistics.median_times`
        has it.
    """
    broken, averaged = failed(rows), averaged_columns(rows)
    table = rows.assign(
        n_estimated=rows["n_estimated"].where(~broken),
        no_detection=rows["status"] == "no_detection",
        failed=broken,
    )
    groups = table.groupby(GROUP, sort=False)
    mean, deviation, count = (getattr(groups[averaged], name)() for name in ("mean", "std", "count"))
    band = pd.DataFrame(student_band(deviation, count), index=mean.index, columns=averaged)
    spreads = {SPREAD_COLUMNS[name]: name for name in averaged if SPREAD_COLUMNS.get(name) in rows}
    band = groups[list(spreads)].mean().rename(columns=spreads).combine_first(band)
    columns: dict[str, pd.Series[Any]] = {
        "n_cells": groups.size(),
        "n_no_detection": groups["no_detection"].sum(),
        "n_failed": groups["failed"].sum(),
    }
    for name in averaged:
        columns |= {f"{name}_mean": mean[name], f"{name}_band": band[name]}
    return pd.DataFrame(columns).join(median_times(rows, GROUP)).reset_index()


def average_scenarios(rows: pd.DataFrame) -> pd.DataFrame:
    """Average scores over scenarios, each of which counts once however many trials it has.

    Returns
    -------
    DataFrame
        As `summarise_scores` returns it, one row for each estimator (with its parameters) and SNR,
        with means and bands over the scenarios' means. ``scenario`` says how many there are, and counts
        are sums.
    """
    by = ["estimator", "params", "snr_db"]
    summary, averaged = summarise_scores(rows), averaged_columns(rows)
    groups = summary.groupby(by, sort=False)
    counts = ["n_cells", "n_no_detection", "n_failed"]
    scores = [f"{name}_mean" for name in averaged]
    bands = student_band(groups[scores].std(), groups[scores].count())
    found = [
        groups[counts].sum(),
        groups[scores].mean(),
        pd.DataFrame(bands, columns=[f"{name}_band" for name in averaged], index=groups.size().index),
        median_times(rows, by),
    ]
    table = pd.concat(found, axis=1).reset_index()
    table.insert(0, "scenario", f"{rows['scenario'].nunique()} scenarios")
    return table
