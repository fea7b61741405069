"""Tables, summary and JSON of a comparison."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.bench.compare.comparison import verdict_counts
from isacbench.bench.compare.verdicts import VERDICTS
from isacbench.charts import Table, text_table
from isacbench.files.escaping import counted, shortened
from isacbench.report.comparisons.words import Wording

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    import pandas as pd

    from isacbench.bench.compare.comparison import Comparison
    from isacbench.bench.compare.verdicts import Tolerance

MAX_ROWS = 40
"""Rows of a table that somebody reads: of more, the worst verdicts are shown."""

CELLS_NAMED = 3
NAME_WIDTH = 40

SCENE_LINE = (
    "the scene is the unit: scores are averaged over its trials, and tests, intervals and probabilities are "
    "over scenes"
)


def compared_rows(comparison: Comparison, tolerance: Tolerance) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Choose the curves of a score, and its points that got worse or better.

    Parameters
    ----------
    tolerance : Tolerance
        Of the score.

    Returns
    -------
    curves, changed : DataFrame
        Without the point of a curve of one SNR, which is the curve.
    """
    curves, points = (
        table[table["metric"] == tolerance.metric] for table in (comparison.curves, comparison.points)
    )
    is_changed = points["verdict"].isin(["regression", "improvement"])
    return curves, points[(points["n_snr"] > 1) & is_changed]


def comparison_grids(comparison: Comparison) -> list[Table]:
    """Lay out every curve of a comparison, and the points that got worse or better.

    Returns
    -------
    list of Table
        For each score one of its curves and one of its changed points, without empty ones; and one of
        the scenes that changed most, where scenes were compared.
    """
    said = Wording(comparison)
    found = []
    for tolerance in comparison.tolerances:
        curves, changed = compared_rows(comparison, tolerance)
        for table, title in ((curves, "curves, means over all SNRs"), (changed, "points that changed")):
            if len(table):
                found.append(_grid(f"{tolerance}: {title}", table, tolerance, said))
    return [*found, _scene_grid(comparison.scenes, said)] if len(comparison.scenes) else found


def effect_lines(comparison: Comparison) -> list[str]:
    """Write the effect on each score in a line: both means, the change, and where it is better.

    Returns
    -------
    list of str
        A line for each score and pair of estimators.
    """
    said, found = Wording(comparison), []
    for tolerance in comparison.tolerances:
        curves, _ = compared_rows(comparison, tolerance)
        keys = ["estimator", "params", "new_estimator", "new_params"]
        for _, rows in curves[curves["n_pairs"] > 0].groupby(keys, sort=False):
            if said.unit == "scene":
                rows = rows.iloc[:1]  # all scenes
            base, new = rows["base_mean"].mean(), rows["new_mean"].mean()
            first = rows.to_dict("records")[0]
            relative = f", {100 * (new - base) / abs(base):+.0f} %" if base else ""
            n_better, n_equal = rows["is_better"].sum(), (rows["change"] == 0).sum()
            n_pairs, of, each = first["n_pairs"], len(rows), " a scene"
            if said.unit == "scene":
                n_better, n_equal, of, each = first["n_better"], first["n_equal"], n_pairs, ""
            few = ""
            if not np.isfinite(rows["smallest_effect"]).any():
                needed = f"{first['trials_needed']:g} needed"
                few = f"; {counted(n_pairs, said.unit)}{each}, too few for a test ({needed})"
            equal = f", equal on {n_equal}" if n_equal else ""
            where = f"better on {n_better} of {counted(of, 'scene')}{equal}{few}"
            name = shortened(said.name(first, before=" of "), NAME_WIDTH)
            found.append(f"{tolerance.metric}{name}: {new:.3g} against {base:.3g}{relative}, {where}")
    return found


def comparison_lines(comparison: Comparison) -> list[str]:
    """Write what tables do not show: cells that one side alone has, and what was not compared."""
    said = Wording(comparison)
    lines = [SCENE_LINE] if comparison.unit == "scene" else []
    lines += [
        line for cells, what in changed_cells(comparison, said) for line in cell_lines(cells, what, said)
    ]
    if comparison.cells.n_failed_both:
        lines.append(f"{counted(comparison.cells.n_failed_both, 'cell')} failed in both, left out")
    return [*lines, *comparison.notes]


def changed_cells(comparison: Comparison, said: Wording) -> list[tuple[pd.DataFrame, str]]:
    """List the cells that one side alone delivered, with words for them.

    Returns
    -------
    list of (DataFrame, str)
        First the two kinds that the new side lost.
    """
    cells, (base, new) = comparison.cells, said.sides
    return [
        (cells.new_failures, f"failed in {new} alone"),
        (cells.missing, f"missing in {new}"),
        (cells.repaired, f"failed in {base} alone"),
        (cells.added, f"missing in {base}"),
    ]


def comparison_summary(comparison: Comparison) -> str:
    """Write the outcome in one line, with the counts of verdicts."""
    return f"{Wording(comparison).outcome}: {outcome_counts(comparison)}"


def outcome_counts(comparison: Comparison) -> str:
    """Count verdicts of curves and points, and lost cells and scores."""
    said = Wording(comparison)
    points = comparison.points[comparison.points["n_snr"] > 1]
    parts = [
        f"of {counted(len(table), noun)} {verdict_counts(table, said.verdict)}"
        for table, noun in ((comparison.curves, "curve"), (points, "point"))
        if len(table)
    ]
    lost = changed_cells(comparison, said)[:2]
    parts += [f"{counted(len(cells), 'cell')} {what}" for cells, what in lost if len(cells)]
    if comparison.n_lost_scores:
        parts.append(f"{counted(comparison.n_lost_scores, 'score')} missing in {said.sides[1]}")
    return "; ".join(parts) or "nothing compared"


def comparison_content(comparison: Comparison) -> dict[str, Any]:
    """Describe a comparison in terms of JSON.

    Returns
    -------
    dict
        Numbers that are not finite are null.
    """
    cells, over_scenes = comparison.cells, comparison.unit == "scene"
    return {
        "comparable": True,
        "regression": comparison.is_regression,
        "base": {"folder": comparison.base, "version": comparison.base_version},
        "new": {"folder": comparison.new, "version": comparison.new_version},
        "between": comparison.between and [Wording(comparison).labels[one] for one in comparison.between],
        "alpha": comparison.alpha,
        "tolerances": [dataclasses.asdict(tolerance) for tolerance in comparison.tolerances],
        "curves": json_rows(comparison.curves),
        "points": json_rows(comparison.points),
        "cells": {
            "n_paired": cells.n_paired,
            "n_failed_both": cells.n_failed_both,
            **{
                name: json_rows(getattr(cells, name))
                for name in ("new_failures", "missing", "repaired", "added")
            },
            "n_lost_scores": comparison.n_lost_scores,
        },
        "notes": list(comparison.notes),
        **({"unit": comparison.unit, "scenes": json_rows(comparison.scenes)} if over_scenes else {}),
    }


def json_rows(table: pd.DataFrame) -> list[dict[Hashable, Any]]:
    """Convert a table to rows in terms of JSON, with null for what is missing or not finite."""
    values = table.astype(object).replace([np.inf, -np.inf], None)
    return values.where(values.notna(), None).to_dict("records")


def _grid(title: str, table: pd.DataFrame, tolerance: Tolerance, said: Wording) -> Table:
    """One row a curve or point, the worst verdicts first where they are too many for a screen."""
    if len(table) > MAX_ROWS:
        worst_first = table["verdict"].map(VERDICTS.index).argsort(kind="stable")
        left_out = verdict_counts(table.iloc[worst_first[MAX_ROWS:]], said.verdict)
        table, title = table.iloc[worst_first[:MAX_ROWS]], f"{title} ({left_out} more not shown)"
    is_points = "snr_db" in table
    unit = " [%]" if tolerance.is_relative else ""
    header = ["curve", *(["SNR [dB]"] if is_points else []), f"{said.unit}s", *said.heads]
    rows = [
        [
            f"{row['scenario']}{said.name(row, before=', ')}",
            *([f"{row['snr_db']:g}"] if is_points else []),
            str(row["n_pairs"]),
            *change_cells(row, tolerance),
            *([win_text(row)] if said.unit == "scene" else []),
            verdict_text(row, tolerance, said),
        ]
        for row in table.to_dict("records")
    ]
    wins = [f"P({said.heads[1]} better)"] if said.unit == "scene" else []
    return text_table(title, [*header, f"change{unit}", "95 % interval", "p", *wins, "verdict"], rows)


def _scene_grid(scenes: pd.DataFrame, said: Wording) -> Table:
    """One row each scene that changed most."""
    rows = [
        [
            f"{row['scenario']}{said.name(row, before=', ')}",
            row["metric"],
            *(f"{row[side]:.4g}" for side in ("base", "new")),
            signed(row["change"]),
            f"{row['snr_db']:g}",
            str(row["trial"]),
        ]
        for row in scenes.to_dict("records")
    ]
    header = ["scene", "score", *said.heads, "change", "at SNR [dB]", "trial"]
    return text_table("scenes that changed most", header, rows)


def scene_lines(comparison: Comparison) -> list[str]:
    """Write the scenes that changed most, one line each."""
    if comparison.scenes.empty:
        return []
    grid = _scene_grid(comparison.scenes, Wording(comparison))
    return [
        f"changed most: {scene}: {score} {base} to {new}; most at {snr_db} dB, trial {trial}"
        for scene, score, base, new, _, snr_db, trial in grid.texts
    ]


def win_text(row: Mapping[Hashable, Any]) -> str:
    """Write the probability that the new side is better, with its interval.

    Parameters
    ----------
    row : mapping
        Curve or point over scenes.
    """
    if math.isnan(row["win_probability"]):
        return ""
    return f"{row['win_probability']:.2f} ({row['win_low']:.2f} to {row['win_high']:.2f})"


def change_cells(row: Mapping[Hashable, Any], tolerance: Tolerance) -> list[str]:
    """Write the numbers of a curve or point.

    Returns
    -------
    list of str
        Means of both sides, the change, its interval and the p-value.
    """
    name, scale = ("relative", 100.0) if tolerance.is_relative else ("change", 1.0)
    change, low, high = (scale * row[f"{name}{end}"] for end in ("", "_low", "_high"))
    interval = "" if math.isnan(low) else f"{signed(low)} to {signed(high)}"
    p_value = min(row["p_worse"], row["p_better"])
    shown_p = "<0.0001" if p_value < 1e-4 else f"{p_value:.2g}"
    return [f"{row['base_mean']:.4g}", f"{row['new_mean']:.4g}", signed(change), interval, shown_p]


def verdict_text(row: Mapping[Hashable, Any], tolerance: Tolerance, said: Wording) -> str:
    """Write the verdict of a curve or point, if inconclusive with the effect that it could have shown."""
    if row["verdict"] != "inconclusive":
        return said.verdict(row["verdict"])
    if not row["n_pairs"]:
        return "inconclusive: no pairs"
    if not math.isfinite(row["smallest_effect"]):
        return f"inconclusive: needs {row['trials_needed']} {said.unit}s"
    if not tolerance.is_relative:
        return f"inconclusive: shows {row['smallest_effect']:.2g}"
    relative = row["smallest_effect"] / abs(row["base_mean"]) if row["base_mean"] else math.inf
    return f"inconclusive: shows {100 * relative:.2g} %"


def signed(number: float) -> str:
    """Write a number with three digits and a sign; zero has none.

    Examples
    --------
    >>> signed(1.2345), signed(-0.0), signed(123.4)
    ('+1.23', '0', '+123')
    """
    return f"{number:+.3g}" if number else "0"


def cell_lines(cells: pd.DataFrame, what: str, said: Wording) -> list[str]:
    """Count some cells in a line that names the first few.

    Parameters
    ----------
    cells : DataFrame
        Table of `isacbench.bench.compare.pairs.CellChanges`.
    what : str
        Words for them.

    Returns
    -------
    list of str
        One line; none without cells.
    """
    if not len(cells):
        return []
    named = []
    for cell in cells.head(CELLS_NAMED).to_dict("records"):
        reason = f" ({': '.join(filter(None, [cell['status'], cell['reason']]))})"
        named.append(
            f"{said.name(cell, after=' on ')}{cell['scenario']} at {cell['snr_db']:g} dB, "
            f"trial {cell['trial']}{'' if cell['status'] == 'ok' else reason}"
        )
    more = "; ..." if len(cells) > CELLS_NAMED else ""
    return [f"{counted(len(cells), 'cell')} {what}: {'; '.join(named)}{more}"]
