"""Table of failed cells: how many, where, and for what reasons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.statuses import failed
from isacbench.bench.compare.worst_scenes import command_to_show
from isacbench.bench.plan.labels import estimator_labels
from isacbench.files.escaping import shortened
from isacbench.report.tables.run_tables import Grid

if TYPE_CHECKING:
    import pandas as pd

MAX_ROWS = 20
HEADER = ["reason", "status", "estimator", "scenario", "cells", "the first one again"]
"""Without the last one where no command repeats a cell."""

NOTHING: Mapping[str, Any] = {}


def failure_grids(records: pd.DataFrame, manifest: Mapping[str, Any] = NOTHING) -> list[Grid]:
    """Count the failed cells of a run by reason, estimator and scenario, the most frequent first.

    Parameters
    ----------
    records : DataFrame
        Rows of a run, of any kind of suite.
    manifest : mapping of str to Any
        Its manifest, with which the table has a command for a cell of each row.

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
    groups = broken.assign(scene=broken["scenario"], scenario=_scenarios(broken)).groupby(keys, sort=False)
    first = {name: (name, "first") for name in ("scene", "snr_db", "trial")}
    counts = groups.agg(n_cells=("trial", "size"), **first)
    counts = counts.sort_values("n_cells", ascending=False, kind="stable").reset_index()
    rows = [
        [
            shortened(row["reason"]),
            row["status"],
            labels[row["estimator"], row["params"]],
            row["scenario"],
            str(row["n_cells"]),
            _command(manifest, labels[row["estimator"], row["params"]], row),
        ]
        for row in counts.head(MAX_ROWS).to_dict("records")
    ]
    rest = counts["n_cells"].iloc[MAX_ROWS:]
    if len(rest):
        rows.append([f"{len(rest)} further rows", "", "", "", str(rest.sum()), ""])
    n_columns = len(HEADER) if any(row[-1] for row in rows) else len(HEADER) - 1
    title = f"{len(broken)} of {len(records)} cells failed"
    return [Grid(title, HEADER[:n_columns], [row[:n_columns] for row in rows])]


def _command(manifest: Mapping[str, Any], label: str, row: Mapping[Any, Any]) -> str:
    return command_to_show(manifest, row["scene"], label, row["snr_db"], row["trial"], picture="")


def _scenarios(records: pd.DataFrame) -> pd.Series[str]:
    """Names of the scenarios, of a study whose scenes are made from templates those of the templates."""
    if "template" not in records:
        return records["scenario"]
    return records["template"].where(records["template"] != "", records["scenario"])
