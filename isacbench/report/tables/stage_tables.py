"""Tables of timed runs: how long an estimate takes, in which stages, and how much memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.cells.record import TIMING_COLUMNS
from isacbench.bench.cells.statuses import failed
from isacbench.bench.plan.labels import estimator_labels, variants_in
from isacbench.bench.studies.imaging_study import MANY_SCENARIOS
from isacbench.bench.studies.medians import TIME, median_times
from isacbench.instrument.stages import STAGES
from isacbench.report.tables.run_tables import Grid, milliseconds

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from isacbench.bench.plan.labels import Variant

MEDIANS = [TIME, *TIMING_COLUMNS]
VARIANT = ["estimator", "params"]
POINT = ["scenario", *VARIANT, "snr_db"]
DIGITS = 2
"""Decimals of milliseconds: stages are short."""


def is_timed(records: pd.DataFrame) -> bool:
    """Tell whether any row has times that count.

    Parameters
    ----------
    records : DataFrame
        Rows of a run.

    Returns
    -------
    bool
    """
    return bool(records["timing"].any())


def summarise_stages(records: pd.DataFrame) -> pd.DataFrame:
    """Median times and memory of every scenario, estimator and SNR.

    Parameters
    ----------
    records : DataFrame
        Rows of a run, some of them timed.

    Returns
    -------
    DataFrame
        One row for each scenario, estimator (with its parameters) and SNR:
        ``n_timed``, the cells that were timed and did not fail, and of those,
        by `isacbench.bench.studies.medians.median_times`, ``time_estimate_s_median``,
        ``time_<stage>_s_median``, ``time_spread_s_median`` and
        ``peak_memory_mib_median``. What has no such cell is left out.
    """
    return _medians(records, POINT)


def stage_grids(records: pd.DataFrame) -> list[Grid]:
    """Lay out the time of an estimate and of its stages, a row an estimator.

    Parameters
    ----------
    records : DataFrame
        Rows of a run, some of them timed.

    Returns
    -------
    list of Grid
        One a scenario, or a template from which many scenes are made.
        Medians are over all SNRs and trials; stages that do not occur are
        empty. Of more than 12 scenarios first all together; the others are details.
    """
    place = "template" if "template" in records else "scenario"
    table = _medians(records, [place, *VARIANT])
    labels = estimator_labels(variants_in(table))
    n_places, found = table[place].nunique(), []
    if n_places > MANY_SCENARIOS:
        found.append(_stage_grid(f"{n_places} scenarios", _medians(records, VARIANT), labels))
    for name, part in table.groupby(place, sort=False):
        found.append(_stage_grid(str(name), part, labels)._replace(is_detail=n_places > MANY_SCENARIOS))
    return found


def _stage_grid(name: str, table: pd.DataFrame, labels: Mapping[Variant, str]) -> Grid:
    """Times of some scenarios, a row an estimator."""
    title = f"{name}: median processor time of an estimate and its stages [ms], peak memory [MiB]"
    header = ["estimator", "cells", "time", "spread", *STAGES, "memory"]
    rows = [_row(labels[entry["estimator"], entry["params"]], entry) for _, entry in table.iterrows()]
    return Grid(title, header, rows)


def _medians(records: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    timed = records[records["timing"] & ~failed(records)]
    n_timed = timed.groupby(list(by), sort=False).size().rename("n_timed")
    return pd.concat([n_timed, median_times(timed, by, MEDIANS)], axis=1).reset_index()


def _row(label: str, entry: pd.Series[Any]) -> list[str]:
    stages_s = [entry[f"time_{name}_s_median"] for name in STAGES]
    return [
        label,
        str(entry["n_timed"]),
        milliseconds(entry["time_estimate_s_median"], DIGITS),
        milliseconds(entry["time_spread_s_median"], DIGITS),
        *("" if time_s == 0 else milliseconds(time_s, DIGITS) for time_s in stages_s),
        f"{entry['peak_memory_mib_median']:.1f}",
    ]
