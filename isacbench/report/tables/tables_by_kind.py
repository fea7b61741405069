"""Tables of a run by its kind of suite."""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING

import pandas as pd

from isacbench.bench.store.run_folder import cannot_be_written, replacing
from isacbench.bench.store.tables import without_formulas
from isacbench.bench.studies.imaging_study import MANY_SCENARIOS
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.errors import InputError
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.model.scene import warned_before
from isacbench.report.tables.failures import failure_grids
from isacbench.report.tables.run_tables import Grid, markdown
from isacbench.report.tables.stage_tables import is_timed

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.store.run import Run
    from isacbench.bench.suites.kind import Tables


def grids_of(records: pd.DataFrame, kind: str = "imaging") -> list[Grid]:
    """Lay out all tables of a run: those of its kind, and where it was timed those of its times."""
    return [grid for tables in _by_stem(records, kind).values() for grid in _grids(tables, records)]


def write_run_tables(run: Run) -> tuple[list[Path], list[Grid]]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run, and the tables of its times.

    ``summary.md`` ends with the reasons of failed cells, if there are any, and commands that repeat them.
    Tables of these names are replaced; those of times (``stages`` and, of images, ``pareto``) are removed
    where no row is timed any more. Returned are the files, and the tables that `grids_of` lays out.
    """
    made = _by_stem(run.rows, run.kind)
    written: list[Path] = []
    every: list[Grid] = []
    for stem in ("summary", *KINDS[run.kind].timed_tables):
        summary, grids = pd.DataFrame(), list[Grid]()
        if stem in made:
            summary, grids = resolve_name(made[stem].summary)(run.rows), _grids(made[stem], run.rows)
            every += grids
        if stem == "summary":
            grids = [*grids, *_gain_grids(run), *failure_grids(run.rows, run.manifest)]
        csv = "" if summary.empty else without_formulas(summary).to_csv(index=False)
        written += _write(run.folder / f"{stem}.csv", csv)
        written += _write(run.folder / f"{stem}.md", "\n".join(map(markdown, grids)))
    return written, every


def _gain_grids(run: Run) -> list[Grid]:
    """SNR of a median scatterer after all gains.

    Nothing where no scenario is stored, trials draw, or some images sense with a part of the frame.
    """
    try:
        with warned_before():
            scenarios, draws = run.scenarios, run.draws
    except InputError:
        return []
    gains_db = {name: median_gain_db(scenario) for name, scenario in scenarios.items()}
    if len(gains_db) > MANY_SCENARIOS:
        low, high = min(gains_db.values()), max(gains_db.values())
        rows = [[f"{len(gains_db)} scenarios", f"{low:+.1f} to {high:+.1f}"]]
    else:
        rows = [[name, f"{gain_db:+.1f}"] for name, gain_db in gains_db.items()]
    title = "SNR of a median scatterer after all gains, over the SNR of a resource element"
    is_shown = draws.empty and run.manifest["suite"].get("sensing", ["all"]) == ["all"]
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
