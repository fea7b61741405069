"""Tables of a run by its kind of suite."""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.store.csv_table import without_formulas
from isacbench.bench.store.run_folder import cannot_be_written, replacing
from isacbench.bench.store.run_store import read_scenes, recover_manifest
from isacbench.bench.studies.imaging_study import MANY_SCENARIOS
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.errors import InputError
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.model.scene import warned_before
from isacbench.report.tables.failures import failure_grids
from isacbench.report.tables.run_tables import Grid, markdown
from isacbench.report.tables.stage_tables import is_timed

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from isacbench.bench.suites.kind import Tables


def grids_of(records: pd.DataFrame, kind: str = "imaging") -> list[Grid]:
    """Lay out all tables of a run: those of its kind, and where it was timed those of its times.

    Parameters
    ----------
    records : DataFrame
        Rows of the run.
    kind : str
        Of its suite.

    Returns
    -------
    list of Grid
    """
    return [grid for tables in _by_stem(records, kind).values() for grid in _grids(tables, records)]


def write_run_tables(folder: Path, records: pd.DataFrame, kind: str = "imaging") -> list[Path]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run, and the tables of its times.

    ``summary.md`` ends with the reasons of failed cells, if there are any, and commands that repeat them.

    Parameters
    ----------
    folder : Path
        An existing folder. Tables of these names are replaced; those of
        times are removed where no row is timed any more.
    records : DataFrame
        Rows of the run.
    kind : str
        Of its suite.

    Returns
    -------
    list of Path
        Files that were written: ``stages.csv`` and ``stages.md``, too, where any row
        is timed, and of images ``pareto.csv``, as far as there is anything to put into them.
    """
    made, manifest = _by_stem(records, kind), recover_manifest(folder)
    written = []
    for stem in ("summary", *KINDS[kind].timed_tables):
        summary, grids = pd.DataFrame(), []
        if stem in made:
            summary, grids = resolve_name(made[stem].summary)(records), _grids(made[stem], records)
        if stem == "summary":
            grids += _gain_grids(folder, manifest) + failure_grids(records, manifest)
        csv = "" if summary.empty else without_formulas(summary).to_csv(index=False)
        written += _write(folder / f"{stem}.csv", csv)
        written += _write(folder / f"{stem}.md", "\n".join(map(markdown, grids)))
    return written


def _gain_grids(folder: Path, manifest: Mapping[str, Any]) -> list[Grid]:
    """SNR of a median scatterer after all gains.

    Nothing where no scenario is stored, trials draw, or some images sense with a part of the frame.
    """
    try:
        with warned_before():
            _, scenarios, draws = read_scenes(folder, manifest)
    except InputError:
        return []
    gains_db = {name: median_gain_db(scenario) for name, scenario in scenarios.items()}
    if len(gains_db) > MANY_SCENARIOS:
        low, high = min(gains_db.values()), max(gains_db.values())
        rows = [[f"{len(gains_db)} scenarios", f"{low:+.1f} to {high:+.1f}"]]
    else:
        rows = [[name, f"{gain_db:+.1f}"] for name, gain_db in gains_db.items()]
    title = "SNR of a median scatterer after all gains, over the SNR of a resource element"
    is_shown = draws.empty and manifest["suite"].get("sensing", ["all"]) == ["all"]
    return [Grid(title, ["scenario", "dB"], rows, is_detail=True)] if is_shown else []


def _by_stem(records: pd.DataFrame, kind: str) -> dict[str, Tables]:
    """Tables that the records have, by the stem of their files; none without records."""
    if records.empty:
        return {}
    return {"summary": KINDS[kind].tables, **(KINDS[kind].timed_tables if is_timed(records) else {})}


def _grids(tables: Tables, records: pd.DataFrame) -> list[Grid]:
    grids: list[Grid] = resolve_name(tables.grids)(records) if tables.grids else []
    return grids


def _write(path: Path, content: str) -> list[Path]:
    """Replace a file, or remove an earlier one where there is nothing to write; return what was written."""
    if not content:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        return []
    with replacing(path) as temporary:
        temporary.write_text(content, encoding="utf-8", newline="")
    return [path]
