"""Which tables belong to which kind of suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import pandas as pd

from isacbench.bench import detection, efficiency, resolution
from isacbench.bench.folder import replacing
from isacbench.report import study_tables, tables
from isacbench.report.tables import Grid, markdown

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.suite import Kind

__all__ = ["TABLES", "Tables", "write_tables"]


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


def write_tables(folder: Path, records: pd.DataFrame, kind: Kind = "imaging") -> list[Path]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run.

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
        What was written.
    """
    paths = [folder / "summary.csv", folder / "summary.md"]
    with replacing(paths[0]) as path:
        TABLES[kind].summarise(records).to_csv(path, index=False)
    with replacing(paths[1]) as path:
        path.write_text("\n".join(map(markdown, TABLES[kind].grids(records))), encoding="utf-8")
    return paths
