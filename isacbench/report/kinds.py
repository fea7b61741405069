"""Which tables belong to which kind of suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from isacbench.bench import detection, efficiency, resolution
from isacbench.bench.folder import replacing
from isacbench.report import budgets, pareto, study_tables, tables
from isacbench.report.tables import Grid, markdown

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.suite import Kind

__all__ = ["TABLES", "TIMED_TABLES", "Tables", "all_grids", "write_tables"]


class Tables(NamedTuple):
    """What a kind of suite makes of its records: a summary for a spreadsheet, and grids for people."""

    summarise: Callable[[pd.DataFrame], pd.DataFrame]
    grids: Callable[[pd.DataFrame], list[Grid]]


TABLES: dict[Kind, Tables] = {
    "imaging": Tables(tables.summarise, tables.grids),
    "efficiency": Tables(efficiency.summarise, study_tables.efficiency_grids),
    "resolution": Tables(resolution.summarise, study_tables.resolution_grids),
    "detection": Tables(detection.summarise, study_tables.detection_grids),
}


TIMED_TABLES: dict[Kind, dict[str, Tables]] = {
    "imaging": {
        "pareto": Tables(pareto.summarise, lambda _: []),
        "budgets": Tables(budgets.summarise_budgets, budgets.budget_grids),
    }
}
"""What is made beside the summary of records whose time counts, by the stem of its files."""


def all_grids(records: pd.DataFrame, kind: Kind = "imaging") -> list[Grid]:
    """Lay out everything that is printed of a run.

    Parameters
    ----------
    records : DataFrame
        Rows of the run.
    kind : {"imaging", "efficiency", "resolution", "detection"}
        Of its suite.

    Returns
    -------
    list of Grid
    """
    return [grid for made in _by_stem(kind).values() for grid in made.grids(records)]


def write_tables(folder: Path, records: pd.DataFrame, kind: Kind = "imaging") -> list[Path]:
    """Write the tables of a run into its folder: ``summary.csv`` and ``summary.md``, and what is timed.

    Parameters
    ----------
    folder : Path
        An existing folder. Tables of these names are replaced, and removed
        where the records have nothing for them any more.
    records : DataFrame
        Rows of the run.
    kind : {"imaging", "efficiency", "resolution", "detection"}
        Of its suite.

    Returns
    -------
    list of Path
        What was written. Of images whose time counts also ``pareto.csv``,
        ``budgets.csv`` and ``budgets.md``.
    """
    written = []
    for stem, made in _by_stem(kind).items():
        summary, grids = made.summarise(records), made.grids(records)
        csv = None if summary.empty else summary.to_csv(index=False)
        text = "\n".join(map(markdown, grids)) or None
        for path, content in ((folder / f"{stem}.csv", csv), (folder / f"{stem}.md", text)):
            if content is None:
                path.unlink(missing_ok=True)
                continue
            with replacing(path) as temporary:
                temporary.write_text(content, encoding="utf-8", newline="")
            written.append(path)
    return written


def _by_stem(kind: Kind) -> dict[str, Tables]:
    """Tables of a kind by the stem of their files."""
    return {"summary": TABLES[kind], **TIMED_TABLES.get(kind, {})}
