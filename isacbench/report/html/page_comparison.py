"""Comparison of two runs or estimators for a page: regressions first, each with its worst cell."""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.compare.comparison import Comparison, direction
from isacbench.bench.compare.scenes import compared_scenes
from isacbench.bench.compare.verdicts import VERDICTS
from isacbench.bench.store.manifest import stored_columns
from isacbench.charts import Variant, rows_of
from isacbench.report.comparison import ComparisonReport, Row
from isacbench.report.html.joined_runs import KEY, JoinedRuns
from isacbench.report.tables import json_rows


def compared_content(comparison: Comparison, joined: JoinedRuns) -> tuple[dict[str, Any], NDArray[np.bool_]]:
    """Describe a comparison in terms of JSON, and tell which rows of the joined runs it shows.

    `joined` are the compared runs with all estimators named after their run, or the only run. The content
    has ``rows``: curves and changed points, the worst verdict first, each with the numbers of both estimators
    in the page and the cell that got worse most. Rows of the joined runs that are such cells are shown.
    """
    report = ComparisonReport(comparison)
    tables = [comparison.curves.assign(what="curve"), report.changed_points().assign(what="point")]
    rows = pd.concat(tables, ignore_index=True)
    order = np.lexsort((-rows["relative"].abs().fillna(0), rows["verdict"].map(VERDICTS.index)))
    groups = compared_scenes(joined.table.manifest, joined.table.rows["scenario"].astype(object))
    is_shown = np.zeros(len(joined.table.rows), dtype=np.bool_)
    found = []
    for row in json_rows(rows.iloc[order]):
        first, second = comparison.between or (
            (row["estimator"], row["params"]),
            (row["new_estimator"], row["new_params"]),
        )
        sides = _variant_in(joined, first, 0), _variant_in(joined, second, len(joined.runs) - 1)
        base, new = (None if side is None else list(joined.labels).index(side) for side in sides)
        worst = None
        if sides[0] is not None and sides[1] is not None:
            scenes = groups.get(row["scenario"], [row["scenario"]])
            worst = _worst_cell(joined, row, scenes, sides[0], sides[1], is_shown)
        found.append({**row, "base": base, "new": new, "worst": worst})
    lost = [
        {"what": what, "n": len(cells), "cells": json_rows(cells.head(50))}
        for cells, what in report.lost + report.gained
        if len(cells)
    ]
    content = {
        "summary": report.summary(),
        "heading": [*report.heading, *report.effect_lines()],
        "lines": report.lines(),
        "sides": list(report.sides),
        "unit": comparison.unit,
        "tolerances": [{"metric": one.metric, "text": str(one)} for one in comparison.tolerances],
        "rows": found,
        "lost": lost,
        "is_regression": bool(comparison.is_regression),
    }
    return content, is_shown


def _variant_in(joined: JoinedRuns, variant: Variant, run: int) -> Variant | None:
    """Estimator of a run as the page has it, under its own name or under that with its run."""
    names = (f"{variant[0]} ({joined.runs[run].label})", variant[1]), variant
    return next((name for name in names if name in joined.labels), None)


def _worst_cell(
    joined: JoinedRuns, row: Row, scenes: list[str], base: Variant, new: Variant, is_shown: NDArray[np.bool_]
) -> dict[str, Any] | None:
    """Cell in which a score got worse most; its two rows are marked as shown."""
    records, metric = joined.table.rows, row["metric"]
    wanted = records[records["scenario"].isin(scenes)]
    if row.get("snr_db") is not None:
        wanted = wanted[wanted["snr_db"] == row["snr_db"]]
    sides = [rows_of(wanted, variant)[[*KEY, metric]].reset_index() for variant in (base, new)]
    pairs = sides[0].merge(sides[1], on=KEY, suffixes=("_base", "_new"))
    change = pairs[f"{metric}_new"].astype(float) - pairs[f"{metric}_base"].astype(float)
    if change.isna().all():
        return None
    better = direction(metric, stored_columns(joined.table.manifest), records.columns)
    worst = pairs.iloc[change.argmax() if better == "lower" else change.argmin()]
    is_shown[[worst["index_base"], worst["index_new"]]] = True
    return {"scene": worst["scenario"], "snr_db": float(worst["snr_db"]), "trial": int(worst["trial"])}
