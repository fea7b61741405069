"""Tables, summary and JSON of a comparison of two runs."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

from isacbench.bench.compare.comparison import VERDICTS, verdict_counts
from isacbench.files.escaping import counted
from isacbench.report.comparisons.words import wording
from isacbench.report.tables.run_tables import Grid

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    import pandas as pd

    from isacbench.bench.compare.comparison import Comparison
    from isacbench.bench.compare.tolerance import Tolerance
    from isacbench.report.comparisons.words import Wording

MAX_ROWS = 40
"""More rows of a table nobody reads: the worst verdicts come first then."""

CELLS_NAMED = 3


def comparison_grids(comparison: Comparison) -> list[Grid]:
    """Lay out every curve of a comparison, and the points that got worse or better.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    list of Grid
        For each score one of its curves, and one of points where there are
        any to tell of.
    """
    said = wording(comparison)
    found = []
    for tolerance in comparison.tolerances:
        curves = comparison.curves[comparison.curves["metric"] == tolerance.metric]
        # The point of a curve of one SNR is the curve.
        points = comparison.points[
            (comparison.points["metric"] == tolerance.metric) & (comparison.points["n_snr"] > 1)
        ]
        changed = points[points["verdict"].isin(["regression", "improvement"])]
        if len(curves):
            found.append(_grid(f"{tolerance}: curves, means over all SNRs", curves, tolerance, said))
        if len(changed):
            found.append(_grid(f"{tolerance}: points that changed", changed, tolerance, said))
    return found


def comparison_lines(comparison: Comparison) -> list[str]:
    """Say what tables do not: cells that failed, went missing or came, and what was not compared."""
    cells, said = comparison.cells, wording(comparison)
    words = said.words
    lines = [
        *cell_lines(cells.new_failures, words.failed, said),
        *cell_lines(cells.missing, words.missing, said),
        *cell_lines(cells.repaired, words.repaired, said),
        *cell_lines(cells.added, words.added, said),
    ]
    if cells.n_failed_both:
        lines.append(f"{counted(cells.n_failed_both, 'cell')} {words.failed_both}")
    return [*lines, *comparison.notes]


def comparison_summary(comparison: Comparison) -> str:
    """Say in one line whether the new side is worse, and count verdicts."""
    return f"{wording(comparison).outcome}: {outcome_counts(comparison)}"


def outcome_counts(comparison: Comparison) -> str:
    """Count verdicts of curves and points, and cells and scores that one side alone has."""
    said = wording(comparison)
    points = comparison.points[comparison.points["n_snr"] > 1]
    parts = [_counts(table, noun, said) for table, noun in ((comparison.curves, "curve"), (points, "point"))]
    for cells, what in (
        (comparison.cells.new_failures, said.words.failed),
        (comparison.cells.missing, said.words.missing),
    ):
        if len(cells):
            parts.append(f"{counted(len(cells), 'cell')} {what}")
    if comparison.n_lost_scores:
        parts.append(f"{counted(comparison.n_lost_scores, 'score')} {said.words.lost}")
    return "; ".join(part for part in parts if part) or "nothing compared"


def comparison_content(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison in terms of JSON; numbers that are not finite become null."""
    cells = comparison.cells
    return {
        "comparable": True,
        "regression": comparison.is_regression,
        "base": {"folder": comparison.base, "version": comparison.base_version},
        "new": {"folder": comparison.new, "version": comparison.new_version},
        "between": comparison.between and [wording(comparison).labels[one] for one in comparison.between],
        "alpha": comparison.alpha,
        "tolerances": [dataclasses.asdict(tolerance) for tolerance in comparison.tolerances],
        "curves": _rows(comparison.curves),
        "points": _rows(comparison.points),
        "cells": {
            "n_paired": cells.n_paired,
            "n_failed_both": cells.n_failed_both,
            "new_failures": _rows(cells.new_failures),
            "missing": _rows(cells.missing),
            "repaired": _rows(cells.repaired),
            "added": _rows(cells.added),
            "n_lost_scores": comparison.n_lost_scores,
        },
        "notes": list(comparison.notes),
    }


def _rows(table: pd.DataFrame) -> list[dict[Hashable, Any]]:
    """Rows with null for what is no number or not finite."""
    return [
        {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in row.items()
        }
        for row in table.to_dict("records")
    ]


def _grid(title: str, table: pd.DataFrame, tolerance: Tolerance, said: Wording) -> Grid:
    """One row a curve or point, the worst verdicts first where they are too many for a screen."""
    if len(table) > MAX_ROWS:
        rank = table["verdict"].map({verdict: index for index, verdict in enumerate(VERDICTS)})
        left_out = table.iloc[rank.argsort(kind="stable")[MAX_ROWS:]]
        table = table.iloc[rank.argsort(kind="stable")[:MAX_ROWS]]
        title = f"{title} ({verdict_counts(left_out, said.verdict)} more not shown)"
    with_snr = "snr_db" in table
    header = ["curve", *(["SNR [dB]"] if with_snr else []), "trials"]
    header += [
        said.words.base,
        said.words.new,
        f"change{' [%]' if tolerance.is_relative else ''}",
        "95 % interval",
        "p",
        "verdict",
    ]
    rows = []
    for row in table.to_dict("records"):
        place = [f"{row['scenario']}{said.name(row, before=', ')}"]
        place += [f"{row['snr_db']:g}"] if with_snr else []
        rows.append(
            [*place, str(row["n_pairs"]), *change_cells(row, tolerance), verdict_text(row, tolerance, said)]
        )
    return Grid(title, header, rows)


def change_cells(row: Mapping[Hashable, Any], tolerance: Tolerance) -> list[str]:
    """Write the means of both sides, the change with its interval, and the p-value of a curve or point."""
    name, scale = ("relative", 100.0) if tolerance.is_relative else ("change", 1.0)
    change, low, high = (scale * row[f"{name}{end}"] for end in ("", "_low", "_high"))
    interval = "" if math.isnan(low) else f"{_signed(low)} to {_signed(high)}"
    p_value = min(row["p_worse"], row["p_better"])
    shown_p = "<0.0001" if p_value < 1e-4 else f"{p_value:.2g}"
    return [f"{row['base_mean']:.4g}", f"{row['new_mean']:.4g}", _signed(change), interval, shown_p]


def verdict_text(row: Mapping[Hashable, Any], tolerance: Tolerance, said: Wording) -> str:
    """Write the verdict of a curve or point, and what an inconclusive one would take."""
    if row["verdict"] != "inconclusive":
        return said.verdict(row["verdict"])
    if not row["n_pairs"]:
        return "inconclusive: no pairs"
    if not math.isfinite(row["smallest_effect"]):
        return f"inconclusive: needs {row['trials_needed']} trials"
    if not tolerance.is_relative:
        return f"inconclusive: shows {row['smallest_effect']:.2g}"
    relative = row["smallest_effect"] / abs(row["base_mean"]) if row["base_mean"] else math.inf
    return f"inconclusive: shows {100 * relative:.2g} %"


def _signed(number: float) -> str:
    """Three digits and a sign; zero has none.

    Examples
    --------
    >>> _signed(1.2345), _signed(-0.0), _signed(123.4)
    ('+1.23', '0', '+123')
    """
    return f"{number:+.3g}" if number else "0"


def _counts(table: pd.DataFrame, noun: str, said: Wording) -> str:
    """Number of curves or points by verdict."""
    return f"of {counted(len(table), noun)} {verdict_counts(table, said.verdict)}" if len(table) else ""


def cell_lines(cells: pd.DataFrame, what: str, said: Wording) -> list[str]:
    """Count some cells in a line that names the first few; without cells there is no line."""
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
