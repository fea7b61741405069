"""The tables of a run: those of its kind of suite, those of its times, and its failures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.cells.record import failed
from isacbench.bench.kinds.scores import MANY_SCENARIOS
from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.run_times import is_timed, stage_tables, summarise_points, summarise_stages, timed_rows
from isacbench.bench.store.manifest import command_to_show
from isacbench.bench.store.run_folder import cannot_be_written, replacing
from isacbench.bench.store.tables import without_formulas
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Column, Table, variants_in
from isacbench.errors import InputError
from isacbench.files.escaping import shortened
from isacbench.model.radio_coordinates import median_gain_db
from isacbench.model.scene import warned_before
from isacbench.report.tables import markdown

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.bench.store.run import Run

MOST_FAILURES = 20
NOTHING: Mapping[str, Any] = {}


def tables_of(rows: pd.DataFrame, kind: str = "imaging") -> list[Table]:
    """Tables of a run: those of its kind, and where it was timed those of its times."""
    if rows.empty:
        return []
    return KINDS[kind].tables(rows) + (stage_tables(rows) if is_timed(rows) else [])


def write_run_tables(run: Run) -> tuple[list[Path], list[Table]]:
    """Write ``summary.csv`` and ``summary.md`` into the folder of a run, and the tables of its times.

    ``summary.md`` ends with the reasons of failed cells, if there are any, and commands that repeat them.
    Of timed rows also ``stages.csv``, ``stages.md``, and of images ``pareto.csv``. Tables of these names are
    replaced; those of times are removed where no row is timed any more. Returned are the files, and the
    tables of `tables_of`.
    """
    rows, kind, folder = run.rows, KINDS[run.kind], run.folder
    is_empty, has_times = rows.empty, not rows.empty and is_timed(rows)
    tables, stages = [] if is_empty else kind.tables(rows), stage_tables(rows) if has_times else []
    written = _write(folder / "summary.csv", None if is_empty else kind.summary(rows))
    further = _gain_tables(run) + failure_tables(rows, run.manifest)
    written += _write(folder / "summary.md", tables + further)
    written += _write(folder / "stages.csv", summarise_stages(rows) if has_times else None)
    written += _write(folder / "stages.md", stages)
    if kind.has_images:
        written += _write(folder / "pareto.csv", summarise_points(timed_rows(rows)) if has_times else None)
    return written, tables + stages


def _gain_tables(run: Run) -> list[Table]:
    """SNR of a median scatterer after all gains.

    Nothing where no scenario is stored, trials draw, or some images sense with a part of the frame.
    """
    try:
        with warned_before():
            scenarios, draws = run.scenarios, run.draws
    except InputError:
        return []
    if not draws.empty or run.manifest["suite"].get("sensing", ["all"]) != ["all"]:
        return []
    gains_db = {name: median_gain_db(scenario) for name, scenario in scenarios.items()}
    rows: list[dict[str, str]] = [
        {"scenario": name, "gain": f"{gain_db:+.1f}"} for name, gain_db in gains_db.items()
    ]
    if len(gains_db) > MANY_SCENARIOS:
        extent = f"{min(gains_db.values()):+.1f} to {max(gains_db.values()):+.1f}"
        rows = [{"scenario": f"{len(gains_db)} scenarios", "gain": extent}]
    title = "SNR of a median scatterer after all gains, over the SNR of a resource element"
    return [Table(title, [Column("scenario", "scenario"), Column("dB", "gain")], rows, is_detail=True)]


def failure_tables(rows: pd.DataFrame, manifest: Mapping[str, Any] = NOTHING) -> list[Table]:
    """Count the failed cells of a run by reason, estimator and scenario, the most frequent first.

    With its manifest the table has a command for a cell of each row. Of more than twenty rows the last one
    counts what the others leave; long reasons are without their middle.
    """
    broken = rows[failed(rows)]
    if broken.empty:
        return []
    labels = estimator_labels(variants_in(rows))
    keys = ["reason", "status", "estimator", "params", "scenario"]
    groups = broken.assign(scene=broken["scenario"], scenario=_scenarios(broken)).groupby(keys, sort=False)
    first = {name: (name, "first") for name in ("scene", "snr_db", "trial")}
    counts = groups.agg(n_cells=("trial", "size"), **first).reset_index()
    counts = counts.sort_values("n_cells", ascending=False, kind="stable")
    counts["label"] = [labels[row["estimator"], row["params"]] for row in counts.to_dict("records")]
    counts["command"] = [_command(manifest, row) for row in counts.to_dict("records")]
    shown, rest = counts.head(MOST_FAILURES).to_dict("records"), counts["n_cells"].iloc[MOST_FAILURES:]
    if len(rest):
        shown.append({"reason": f"{len(rest)} further rows", "n_cells": rest.sum()})
    columns = [
        Column("reason", "reason", shortened),
        Column("status", "status"),
        Column("estimator", "label"),
        Column("scenario", "scenario"),
        Column("cells", "n_cells"),
    ]
    if (counts["command"] != "").any():  # no command repeats the cells of some kinds
        columns.append(Column("the first one again", "command"))
    return [Table(f"{len(broken)} of {len(rows)} cells failed", columns, shown)]


def _command(manifest: Mapping[str, Any], row: Mapping[Any, Any]) -> str:
    return command_to_show(manifest, row["scene"], row["label"], row["snr_db"], row["trial"])


def _scenarios(rows: pd.DataFrame) -> pd.Series[str]:
    """Names of the scenarios; where scenes are made from templates, those of the templates."""
    if "template" not in rows:
        return rows["scenario"]
    return rows["template"].where(rows["template"] != "", rows["scenario"])


def _write(path: Path, content: pd.DataFrame | list[Table] | None) -> list[Path]:
    """Replace a file, or remove an earlier one where there is nothing to write; return what was written."""
    if content is None or not len(content):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        return []
    with replacing(path) as temporary:
        if isinstance(content, list):
            text = "\n".join(map(markdown, content))
        else:
            text = without_formulas(content).to_csv(index=False)
        temporary.write_text(text, encoding="utf-8", newline="")
    return [path]
