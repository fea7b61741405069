"""Tables of a run by its kind of suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from isacbench.bench.store.csv_table import without_formulas
from isacbench.bench.store.run_folder import cannot_be_written, replacing
from isacbench.bench.studies import (
    detection_study,
    efficiency_study,
    link_study,
    resolution_study,
)
from isacbench.report.tables import budgets, link_tables, pareto, run_tables, study_tables
from isacbench.report.tables.failures import failure_grids
from isacbench.report.tables.run_tables import Grid, markdown
from isacbench.report.tables.stage_tables import is_timed, stage_grids, summarise_stages

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.suites.suite import StudyKind


class Tables(NamedTuple):
    """What a kind of suite makes of its records: a summary for a spreadsheet, and grids for people."""

    summarise: Callable[[pd.DataFrame], pd.DataFrame]
    grids: Callable[[pd.DataFrame], list[Grid]]


TABLES: dict[StudyKind, Tables] = {
    "imaging": Tables(run_tables.summarise_scores, run_tables.grids),
    "efficiency": Tables(efficiency_study.summarise_efficiency, study_tables.efficiency_grids),
    "resolution": Tables(resolution_study.summarise_resolution, study_tables.resolution_grids),
    "detection": Tables(detection_study.summarise_detection, study_tables.detection_grids),
    "link": Tables(link_study.summarise_link, link_tables.link_grids),
}

ALL_TIMED = {"stages": Tables(summarise_stages, stage_grids)}
IMAGES_TIMED = {
    # Every point, as the figure of the frontier has it, which people look at.
    "pareto": Tables(pareto.summarise_times, lambda _: []),
    "budgets": Tables(budgets.summarise_budgets, budgets.budget_grids),
}

TIMED_TABLES: dict[StudyKind, dict[str, Tables]] = {
    "imaging": ALL_TIMED | IMAGES_TIMED,
    "efficiency": ALL_TIMED,
    "resolution": ALL_TIMED,
    "detection": ALL_TIMED,
    "link": ALL_TIMED,
}
"""What is made beside the summary where any row is timed, by the stem of its files."""


def grids_of(records: pd.DataFrame, kind: StudyKind = "imaging") -> list[Grid]:
    """All tables of a run for people: those of its kind, and where it was timed those of its times."""
    return [grid for made in _by_stem(records, kind).values() for grid in made.grids(records)]


def write_run_tables(folder: Path, records: pd.DataFrame, kind: StudyKind = "imaging") -> list[Path]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run, and what is made of times.

    ``summary.md`` ends with the reasons of failed cells, if there are any.

    Parameters
    ----------
    folder : Path
        An existing folder. Tables of these names are replaced; those of
        times go where no row is timed any more.
    records : DataFrame
        Rows of the run.
    kind : {"imaging", "efficiency", "resolution", "detection", "link"}
        Of its suite.

    Returns
    -------
    list of Path
        What was written: ``stages.csv`` and ``stages.md``, too, where any row
        is timed, and of images ``pareto.csv``, ``budgets.csv`` and
        ``budgets.md``, as far as there is anything to put into them.
    """
    made = _by_stem(records, kind)
    written = []
    for stem in ("summary", *TIMED_TABLES[kind]):
        summary, grids = pd.DataFrame(), []
        if stem in made:
            summary, grids = made[stem].summarise(records), made[stem].grids(records)
        if stem == "summary":
            grids = [*grids, *failure_grids(records)]
        text = "\n".join(map(markdown, grids))
        written += _write(folder / f"{stem}.csv", _csv(summary))
        written += _write(folder / f"{stem}.md", text)
    return written


def _csv(summary: pd.DataFrame) -> str:
    return "" if summary.empty else without_formulas(summary).to_csv(index=False)


def _by_stem(records: pd.DataFrame, kind: StudyKind) -> dict[str, Tables]:
    """Tables that there are, by the stem of their files."""
    return {"summary": TABLES[kind], **(TIMED_TABLES[kind] if is_timed(records) else {})}


def _write(path: Path, content: str) -> list[Path]:
    """Replace a file, or remove an earlier one where there is nothing to write; what was written."""
    if not content:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        return []
    with replacing(path) as temporary:
        temporary.write_text(content, encoding="utf-8", newline="")
    return [path]
