"""Table of failed cells: how many, where, and for what reasons."""

from __future__ import annotations

from typing import TYPE_CHECKING

from isacbench.bench.cells.statuses import failed
from isacbench.bench.plan.labels import estimator_labels
from isacbench.files.escaping import shortened
from isacbench.report.tables.run_tables import Grid

if TYPE_CHECKING:
    import pandas as pd

MAX_ROWS = 20
HEADER = ["reason", "status", "estimator", "scenario", "cells"]


def failure_grids(records: pd.DataFrame) -> list[Grid]:
    """Count the failed cells of a run by reason, estimator and scenario, the most frequent first.

    Parameters
    ----------
    records : DataFrame
        Rows of a run, of any kind of suite.

    Returns
    -------
    list of Grid
        One grid, or nothing where no cell failed. Of more than twenty rows the last one
        counts what the others leave; long reasons are without their middle.
    """
    broken = records[failed(records)]
    if broken.empty:
        return []
    labels = estimator_labels(zip(records["estimator"], records["params"], strict=True))
    keys = ["reason", "status", "estimator", "params", "scenario"]
    groups = broken.assign(scenario=_scenarios(broken)).groupby(keys, sort=False)
    counts = groups.size().sort_values(ascending=False, kind="stable").reset_index(name="n_cells")
    rows = [
        [
            shortened(row["reason"]),
            row["status"],
            labels[row["estimator"], row["params"]],
            row["scenario"],
            str(row["n_cells"]),
        ]
        for row in counts.head(MAX_ROWS).to_dict("records")
    ]
    rest = counts["n_cells"].iloc[MAX_ROWS:]
    if len(rest):
        rows.append([f"{len(rest)} further rows", "", "", "", str(rest.sum())])
    return [Grid(f"{len(broken)} of {len(records)} cells failed", HEADER, rows)]


def _scenarios(records: pd.DataFrame) -> pd.Series[str]:
    """Names of the scenarios, of a study whose scenes are made from templates those of the templates."""
    if "template" not in records:
        return records["scenario"]
    return records["template"].where(records["template"] != "", records["scenario"])
