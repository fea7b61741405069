"""Comparison of two runs or estimators for a page: regressions first, each with its worst cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.compare.scenes import compared_scenes
from isacbench.bench.compare.verdicts import VERDICTS, direction
from isacbench.bench.store.manifest import stored_columns
from isacbench.report.comparisons.comparison_tables import (
    changed_cells,
    comparison_lines,
    comparison_summary,
    effect_lines,
    json_rows,
)
from isacbench.report.comparisons.words import Wording

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from numpy.typing import NDArray

    from isacbench.bench.compare.comparison import Comparison
    from isacbench.charts import Variant
    from isacbench.report.html.joined_runs import JoinedRuns

CELL = ["scenario", "snr_db", "trial"]


def compared_content(comparison: Comparison, joined: JoinedRuns) -> tuple[dict[str, Any], NDArray[np.bool_]]:
    """Describe a comparison in terms of JSON.

    Parameters
    ----------
    joined : JoinedRuns
        The compared runs with all estimators named after their run, or the only run.

    Returns
    -------
    content : dict
        ``summary``, ``lines``, ``sides`` and ``rows``: curves and changed points, the worst verdict first,
        each with the numbers of both estimators in the page and the cell that got worse most.
    is_shown : ndarray of bool
        Rows of the joined runs that are such cells.
    """
    said = Wording(comparison)
    tables = []
    for table, what in ((comparison.curves, "curve"), (comparison.points, "point")):
        is_changed = table["verdict"].isin(["regression", "improvement"])
        kept = table if what == "curve" else table[(table["n_snr"] > 1) & is_changed]
        tables.append(kept.assign(what=what))
    rows = pd.concat(tables, ignore_index=True)
    order = np.lexsort((-rows["relative"].abs().fillna(0), rows["verdict"].map(VERDICTS.index)))
    groups = compared_scenes(joined.table.manifest, joined.table.rows["scenario"].astype(object))
    is_shown = np.zeros(len(joined.table.rows), dtype=np.bool_)
    found = []
    for row in json_rows(rows.iloc[order]):
        base, new = _numbers_of(row, comparison, joined)
        told = {str(name): value for name, value in row.items()} | {"base": base, "new": new, "worst": None}
        if base is not None and new is not None:
            scenes = groups.get(str(row["scenario"]), [str(row["scenario"])])
            cells, marked = _worst_cell(joined, row, scenes, base, new)
            told["worst"] = cells
            is_shown |= marked
        found.append(told)
    lost = [
        {"what": what, "n": len(cells), "cells": json_rows(cells.head(50))}
        for cells, what in changed_cells(comparison, said)
        if len(cells)
    ]
    content = {
        "summary": comparison_summary(comparison),
        "heading": [*said.heading, *effect_lines(comparison)],
        "lines": comparison_lines(comparison),
        "sides": list(said.sides),
        "unit": comparison.unit,
        "tolerances": [{"metric": one.metric, "text": str(one)} for one in comparison.tolerances],
        "rows": found,
        "lost": lost,
        "is_regression": bool(comparison.is_regression),
    }
    return content, is_shown


def _numbers_of(
    row: Mapping[Hashable, Any], comparison: Comparison, joined: JoinedRuns
) -> tuple[int | None, int | None]:
    """Numbers in the page of the two estimators of a curve."""
    if comparison.between is not None:
        first, second = comparison.between
        return _number(joined, first, 0), _number(joined, second, 0)
    old = str(row["estimator"]), str(row["params"])
    new = str(row["new_estimator"]), str(row["new_params"])
    return _number(joined, old, 0), _number(joined, new, len(joined.runs) - 1)


def _number(joined: JoinedRuns, variant: Variant, run: int) -> int | None:
    """Number in the page of an estimator of a run, under its own name or under that with its run."""
    names = list(joined.labels)
    for name in ((f"{variant[0]} ({joined.runs[run].label})", variant[1]), variant):
        if name in joined.labels:
            return names.index(name)
    return None


def _worst_cell(
    joined: JoinedRuns, row: Mapping[Hashable, Any], scenes: list[str], base: int, new: int
) -> tuple[dict[str, Any] | None, NDArray[np.bool_]]:
    """Cell in which a score got worse most, and its two rows."""
    records, names, metric = joined.table.rows, list(joined.labels), str(row["metric"])
    is_wanted = records["scenario"].isin(scenes)
    if row.get("snr_db") is not None:
        is_wanted &= records["snr_db"] == row["snr_db"]
    sides = [
        is_wanted & (records["estimator"] == names[side][0]) & (records["params"] == names[side][1])
        for side in (base, new)
    ]
    scores = [
        records[side].astype({"scenario": object}).set_index(CELL)[metric].astype(float) for side in sides
    ]
    change = (scores[1] - scores[0]).dropna()
    marked = np.zeros(len(records), dtype=np.bool_)
    if change.empty:
        return None, marked
    better = direction(metric, stored_columns(joined.table.manifest), records.columns)
    worst = change.index[int(np.argmax(change if better == "lower" else -change))]
    scenario, snr_db, trial = str(worst[0]), float(worst[1]), int(worst[2])
    place = (records["scenario"] == scenario) & (records["snr_db"] == snr_db) & (records["trial"] == trial)
    marked |= (place & (sides[0] | sides[1])).to_numpy()
    return {"scene": scenario, "snr_db": snr_db, "trial": trial}, marked
