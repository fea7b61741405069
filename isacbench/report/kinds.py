"""Which tables belong to which kind of suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from isacbench.bench import detection, efficiency, resolution
from isacbench.bench.folder import replacing
from isacbench.report import study_tables, tables
from isacbench.report.stage_tables import is_timed, stage_grids, summarise_stages
from isacbench.report.tables import Grid, markdown

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.suite import Kind

__all__ = ["TABLES", "Tables", "grids_of", "write_tables"]


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


def grids_of(records: pd.DataFrame, kind: Kind = "imaging") -> list[Grid]:
    """All tables of a run for people: those of its kind, and those of its stages where it was timed."""
    return TABLES[kind].grids(records) + (stage_grids(records) if is_timed(records) else [])


def write_tables(folder: Path, records: pd.DataFrame, kind: Kind = "imaging") -> list[Path]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run, and of stages likewise.

    Parameters
    ----------
    folder : Path
        An existing folder; tables of these names are replaced.
    records : DataFrame
        Rows of the run.
    kind : {"imaging", "efficiency", "resolution", "detection"}
        Of its suite.

    Returns
    -------
    list of Path
        What was written: ``stages.csv`` and ``stages.md``, too, where any row is timed.
    """
    paths = _write(folder, "summary", TABLES[kind], records)
    if is_timed(records):
        paths += _write(folder, "stages", Tables(summarise_stages, stage_grids), records)
    return paths


def _write(folder: Path, name: str, tables: Tables, records: pd.DataFrame) -> list[Path]:
    paths = [folder / f"{name}.csv", folder / f"{name}.md"]
    with replacing(paths[0]) as path:
        tables.summarise(records).to_csv(path, index=False)
    with replacing(paths[1]) as path:
        path.write_text("\n".join(map(markdown, tables.grids(records))), encoding="utf-8")
    return paths
