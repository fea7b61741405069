"""The study ``imaging``: every scenario as it is, scored as a cloud."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.cells.record import COLUMNS, REFERENCE_COLUMNS, TIMING_COLUMNS
from isacbench.bench.cells.statuses import failed
from isacbench.bench.store.score_columns import metrics_of
from isacbench.bench.studies.intervals import student_band
from isacbench.bench.studies.medians import median_times
from isacbench.bench.studies.study import (
    ImagedScene,
    build_estimators,
    element_snrs_db,
    require_scatterers,
)
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.metrics.paper import PROJECTIONS
from isacbench.metrics.realisations import SPREAD_COLUMNS
from isacbench.model.radio_coordinates import gain_db

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario

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

MANY_SCENARIOS = 12
"""More scenarios are not shown one by one, but by their mean."""


def averaged_columns(records: pd.DataFrame) -> list[str]:
    """List the columns of rows that are averaged: scores of all metrics, and the number of points.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    list of str
        Those of every run first.
    """
    others = {*COLUMNS, *TIMING_COLUMNS, *REFERENCE_COLUMNS, *AVERAGED}
    others |= {name for kind in KINDS.values() for name in kind.columns}
    floats = records.select_dtypes("float").columns
    return [*AVERAGED, *(name for name in floats if name not in others)]


def imaging_scenes(suite: Suite, scenarios: Mapping[str, Scenario]) -> list[ImagedScene]:
    """Plan one scene a scenario: the scenario as it is.

    Parameters
    ----------
    suite : Suite
    scenarios : mapping of str to Scenario
        By name.

    Returns
    -------
    list of ImagedScene

    Raises
    ------
    InputError
        If a scenario has no scatterers.
    """
    entries, metrics = build_estimators(suite), metrics_of(suite)
    require_scatterers(scenarios)
    return [
        ImagedScene(suite, scenario, entries, element_snrs_db(suite, gain_db(scenario)), metrics=metrics)
        for scenario in scenarios.values()
    ]


def summarise_scores(records: pd.DataFrame) -> pd.DataFrame:
    """Average the trials of every scenario, estimator and SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        One row for each scenario, estimator (with its parameters) and SNR:
        the counts ``n_cells``, ``n_no_detection`` and ``n_failed``; for every
        score ``<score>_mean`` and ``<score>_band``, the half width of the
        95 % confidence interval of the mean (Student's t), over the cells
        that did not fail, the band over five or more of them; of a reference
        the band is the mean spread over its realisations; and
        ``time_estimate_s_median`` as `isacbench.bench.studies.medians.median_times`
        has it.
    """
    broken, averaged = failed(records), averaged_columns(records)
    table = records.assign(
        n_estimated=records["n_estimated"].where(~broken),
        no_detection=records["status"] == "no_detection",
        failed=broken,
    )
    groups = table.groupby(GROUP, sort=False)
    mean, deviation, count = (getattr(groups[averaged], name)() for name in ("mean", "std", "count"))
    band = pd.DataFrame(student_band(deviation, count), index=mean.index, columns=averaged)
    spreads = {SPREAD_COLUMNS[name]: name for name in averaged if SPREAD_COLUMNS.get(name) in records}
    band = groups[list(spreads)].mean().rename(columns=spreads).combine_first(band)
    columns: dict[str, pd.Series[Any]] = {
        "n_cells": groups.size(),
        "n_no_detection": groups["no_detection"].sum(),
        "n_failed": groups["failed"].sum(),
    }
    for name in averaged:
        columns |= {f"{name}_mean": mean[name], f"{name}_band": band[name]}
    return pd.DataFrame(columns).join(median_times(records, GROUP)).reset_index()


def average_scenarios(records: pd.DataFrame) -> pd.DataFrame:
    """Average scores over scenarios, each of which counts once however many trials it has.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    DataFrame
        As `summarise_scores` returns it, one row for each estimator (with its parameters) and SNR,
        with means and bands over the scenarios' means. ``scenario`` says how many there are, and counts
        are sums.
    """
    by = ["estimator", "params", "snr_db"]
    summary, averaged = summarise_scores(records), averaged_columns(records)
    groups = summary.groupby(by, sort=False)
    counts = ["n_cells", "n_no_detection", "n_failed"]
    scores = [f"{name}_mean" for name in averaged]
    bands = student_band(groups[scores].std(), groups[scores].count())
    found = [
        groups[counts].sum(),
        groups[scores].mean(),
        pd.DataFrame(bands, columns=[f"{name}_band" for name in averaged], index=groups.size().index),
        median_times(records, by),
    ]
    table = pd.concat(found, axis=1).reset_index()
    table.insert(0, "scenario", f"{records['scenario'].nunique()} scenarios")
    return table
