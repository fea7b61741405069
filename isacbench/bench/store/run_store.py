"""The store: a run's folder, complete enough to be scored, drawn and gone on with without running again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
import warnings
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd
import pyarrow as pa
from pydantic import ValidationError

import isacbench
from isacbench.bench.cells.record import CLOUD_KEYS, COLUMNS, DRAW_COLUMNS, Results, typed, with_added
from isacbench.bench.plan.manifest_plan import outline
from isacbench.bench.store.csv_table import without_formulas, write_csv_table
from isacbench.bench.store.journal import read_journal
from isacbench.bench.store.provenance import (
    blas_libraries,
    git_state,
    machine,
    package_versions,
    python_version,
)
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import replacing
from isacbench.bench.store.validation import (
    Manifest,
    require_described_scenarios,
    require_rows_that_fit,
    require_sound_records,
)
from isacbench.bench.suites.scenario_digest import (
    describe_scenario,
    digest,
    restore_scenario,
    scenario_digest,
    truth_table,
)
from isacbench.bench.suites.suite_kinds import kind_of, restore_suite
from isacbench.errors import InputError, InputWarning
from isacbench.files.checked_files import MANIFEST_BYTES, is_there, read_text, require_file, require_inside
from isacbench.files.toml_files import describe_mistake
from isacbench.metrics.score import METRIC_VERSION
from isacbench.model.cloud_files.point_files import POINT_COLUMNS
from isacbench.plugins.plugin_versions import plugin_version

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from isacbench.bench.plan.job import Job
    from isacbench.bench.store.provenance import Environment
    from isacbench.bench.suites.suite import Suite
    from isacbench.model.scene import Scenario

RECORDS, RECORDS_CSV = "results.parquet", "results.csv"
CLOUDS, TRUTH, MANIFEST = "clouds.parquet", "truth.parquet", "manifest.json"
DRAWS, JOURNAL = "draws.parquet", "journal.jsonl"

RUN_TABLES = frozenset({RECORDS, RECORDS_CSV, CLOUDS, TRUTH, MANIFEST, DRAWS, JOURNAL})
"""Files that a run consists of."""

DIGEST = "digest"
"""Key of the digest of a table's content in its file."""

RUN_KEYS = ("seed", "suite", "metric", "estimators", "scenarios", "scenes")
"""Keys of a manifest that say what the run consists of, whoever has worked on it."""

T = TypeVar("T")

DAMAGE = (
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    OSError,
    RecursionError,
    MemoryError,
    pa.ArrowException,
    pd.errors.InvalidIndexError,
)
"""What a damaged file ends in."""


@dataclasses.dataclass(frozen=True)
class Session:
    """One call that worked on a run.

    Attributes
    ----------
    started : datetime
        With its time zone.
    options : mapping of str to Any
        How it was run, in terms of JSON.
    """

    started: datetime
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def describe(self, wall_time_s: float, interrupted: bool) -> dict[str, Any]:
        """Describe it in terms of JSON."""
        return {
            "argv": [Path(sys.argv[0]).name, *sys.argv[1:]],
            "started": self.started.isoformat(timespec="seconds"),
            "wall_time_s": round(wall_time_s, 3),
            "interrupted": interrupted,
            **self.options,
        }


def describe_run(job: Job) -> dict[str, Any]:
    """Describe what a run consists of, in terms of JSON: what its manifest has under `RUN_KEYS`."""
    suite = job.suite
    return {
        "seed": suite.seed,
        "suite": suite.model_dump(),
        "metric": current_metric(),
        "estimators": [
            {"name": one.name, "params": json.loads(one.params), "packages": plugin_version(one.plugin)}
            for one in job.plan.entries
        ],
        "scenarios": {
            name: {**describe_scenario(scenario), "content": scenario_digest(scenario)}
            for name, scenario in job.scenarios.items()
        },
        "scenes": outline(job.plan),
    }


def write_manifest(
    folder: Path,
    run: Mapping[str, Any],
    environments: Mapping[str, Environment],
    sessions: list[dict[str, Any]],
) -> None:
    """Write what a run depends on, in place of an older manifest.

    Parameters
    ----------
    folder : Path
    run : mapping of str to Any
        What it consists of, as `describe_run` has it.
    environments : mapping of str to Environment
        By the names that rows have.
    sessions : list of dict
        All calls that worked on the run, the last one last.
    """
    last = sessions[-1]
    manifest = {
        "isacbench": isacbench.__version__,
        "git": git_state(),
        **{key: last[key] for key in ("argv", "started", "wall_time_s", "interrupted")},
        **run,
        "environments": dict(environments),
        "sessions": sessions,
        "python": python_version(),
        "packages": package_versions(),
        **machine(),
        "blas_threads": 1,
        "blas": blas_libraries(),
    }
    save_manifest(folder, manifest)


def save_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Put a manifest in place of an older one."""
    with replacing(folder / MANIFEST) as path:
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        # Names of files that are no UTF-8 have halves of characters, which JSON spells as Python does.
        path.write_text(text, encoding="utf-8", errors="backslashreplace")


def write_results(results: Results, folder: Path) -> None:
    """Write the tables of a run into its folder.

    Parameters
    ----------
    results : Results
    folder : Path
        An existing folder.
    """
    write_truth(folder, results.scenarios)
    if len(results.draws):
        _write_parquet(results.draws, folder / DRAWS)
    write_rows(folder, results.records, results.clouds)
    with replacing(folder / RECORDS_CSV) as path:
        write_csv_table(without_formulas(results.records), path)


def write_rows(folder: Path, records: pd.DataFrame, clouds: pd.DataFrame) -> None:
    """Write rows and clouds, as far as they are made, in place of older ones."""
    _write_parquet(clouds, folder / CLOUDS)
    _write_parquet(records, folder / RECORDS)


def write_truth(folder: Path, scenarios: Mapping[str, Scenario]) -> None:
    """Write the scatterers of some scenarios."""
    tables = [truth_table(scenario) for scenario in scenarios.values()]
    _write_parquet(pd.concat(tables, ignore_index=True), folder / TRUTH)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a run.

    Raises
    ------
    InputError
        If there is none, or it is damaged.
    """
    path = folder / MANIFEST
    if not is_there(path):
        raise _no_run(folder, MANIFEST)
    try:
        require_inside(path, folder)
        manifest = json.loads(read_text(path, MANIFEST_BYTES))
        if not isinstance(manifest, dict):
            raise ValueError("not a table")
        Manifest.model_validate(manifest)
    except ValidationError as error:
        raise _damaged(folder, f"{MANIFEST}: {describe_mistake(error, Manifest)}") from error
    except DAMAGE as error:
        raise _damaged(folder, f"{MANIFEST}: {_told(error)}") from error
    return manifest


def require_metric(folder: Path) -> None:
    """Refuse a run that was scored by another version of the metric; a manifest that is damaged says nothing.

    Raises
    ------
    InputError
        If it was.
    """
    metric = _lenient(lambda: read_manifest(folder)["metric"], folder / MANIFEST)
    if metric is not None and metric != current_metric():
        raise InputError(
            f"its cells were scored by version {metric.get('version')} of the metric, not {METRIC_VERSION}; "
            "allowed is to rescore it first (isacbench rescore), or a new folder"
        )


def current_metric() -> dict[str, Any]:
    """Name and version of the metric that this isacbench scores by, in terms of JSON."""
    return {"name": "paper", "version": METRIC_VERSION}


def read_sessions(folder: Path) -> list[dict[str, Any]]:
    """Calls that have worked on a run so far; none where its manifest is missing or damaged."""
    sessions = _lenient(lambda: read_manifest(folder)["sessions"], folder / MANIFEST)
    return sessions if isinstance(sessions, list) else []


def read_rows(folder: Path) -> Rows:
    """Read every row that a folder holds and that is not damaged, of a killed run as well.

    Returns
    -------
    Rows
        Of rows of the same cell, the last one counts.

    Warns
    -----
    InputWarning
        If something is damaged, and its rows or clouds are lost.
    """
    environments = _lenient(lambda: read_manifest(folder)["environments"], folder / MANIFEST) or {}
    clouds = _lenient(lambda: _read_clouds(folder), folder / CLOUDS)
    found = _lenient(
        lambda: Rows.of_tables(
            _read_records(folder), _no_clouds() if clouds is None else clouds, environments
        ),
        folder / RECORDS,
    )
    parts = [] if found is None else [found]
    if is_there(folder / JOURNAL):
        parts.append(_read_journal(folder / JOURNAL))
    return Rows.joined(parts)


def read_results(folder: Path) -> Results:
    """Read a run back from its folder; of one that was killed the rows that it made.

    Raises
    ------
    InputError
        If the folder does not hold a run, or a damaged one.

    Warns
    -----
    InputWarning
        If lines of the journal of a run that was killed are damaged.
    """
    manifest = read_manifest(folder)
    rows = read_sound_rows(folder, manifest)
    suite, scenarios, draws = read_scenes(folder, manifest)
    with _damage_told(folder):
        return Results(
            suite=suite,
            records=rows.records,
            clouds=rows.clouds(),
            scenarios=scenarios,
            draws=draws,
            environments=rows.environments,
            started=datetime.fromisoformat(manifest["started"]),
            wall_time_s=manifest["wall_time_s"],
            interrupted=manifest["interrupted"],
        )


def read_sound_rows(folder: Path, manifest: Mapping[str, Any], with_clouds: bool = True) -> Rows:
    """Read the rows of a run, one a cell, with the types that every table of its suite's kind has.

    Parameters
    ----------
    folder : Path
    manifest : mapping of str to Any
        As `read_manifest` returns it.
    with_clouds : bool
        Whether to read the clouds; those of a run that was killed are read with its rows in any case.

    Returns
    -------
    Rows

    Raises
    ------
    InputError
        If there are none, or damaged ones.

    Warns
    -----
    InputWarning
        If lines of the journal of a run that was killed are damaged.
    """
    has_table, journal = is_there(folder / RECORDS), folder / JOURNAL
    if not has_table and not is_there(journal):
        raise _no_run(folder, RECORDS)
    with _damage_told(folder):
        parts = []
        if has_table:
            clouds = _read_clouds(folder) if with_clouds else _no_clouds()
            parts.append(Rows.of_tables(_read_records(folder), clouds, manifest["environments"]))
        if is_there(journal):
            parts.append(_read_journal(journal))
        rows = Rows.joined(parts)
        require_sound_records(rows.records)
        rows = rows.take(~rows.records.duplicated(CLOUD_KEYS, keep="last").to_numpy())
        columns = kind_of(restore_suite(manifest["suite"])).columns
        records = typed(rows.records, columns)
        require_described_scenarios(records, manifest)
        return dataclasses.replace(rows, records=records)


def read_scenes(folder: Path, manifest: Mapping[str, Any]) -> tuple[Suite, dict[str, Scenario], pd.DataFrame]:
    """Read the suite of a run, its scenarios by name, and the scatterers that its trials drew.

    Raises
    ------
    InputError
        If they are missing or damaged.
    """
    with _damage_told(folder):
        truth = read_table(folder / TRUTH)
        scenarios = {
            name: restore_scenario(name, described, truth[truth["scenario"] == name])
            for name, described in manifest["scenarios"].items()
        }
        return restore_suite(manifest["suite"]), scenarios, _read_draws(folder / DRAWS)


@contextmanager
def _damage_told(folder: Path) -> Iterator[None]:
    """Raise what a damaged file ends in as the user's error, which names the folder."""
    try:
        yield
    except DAMAGE as error:
        raise _damaged(folder, _told(error)) from error


def _damaged(folder: Path, what: str) -> InputError:
    return InputError(f"{folder}: damaged run: {what}")


def _told(error: BaseException) -> str:
    """What is wrong, in words; of what nobody has worded, the type as well."""
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def _read_journal(path: Path) -> Rows:
    """Rows of a journal whose lines are whole."""
    rows, n_torn = read_journal(path)
    if n_torn:
        _warn_of_damage(path, f"{n_torn} lines")
    return rows


def _write_parquet(table: pd.DataFrame, path: Path) -> None:
    signed = table.copy(deep=False)
    signed.attrs = {DIGEST: _table_digest(table)}
    with replacing(path) as temporary:
        signed.to_parquet(temporary, index=False, write_page_checksum=True)


def _read_records(folder: Path) -> pd.DataFrame:
    records = with_added(read_table(folder / RECORDS))
    # Runs from before rows told where they come from, or from before a column was added, have columns less.
    before = {"timing": False, "scenario_content": "", "environment": ""}
    if missing := [name for name in COLUMNS if name not in records and name not in before]:
        raise KeyError(f"{RECORDS} has no column {missing[0]}")
    unknown = pd.DataFrame(before, index=records.index)
    return pd.concat([records, unknown[unknown.columns.difference(records.columns)]], axis=1)


def _read_clouds(folder: Path) -> pd.DataFrame:
    return read_table(folder / CLOUDS) if is_there(folder / CLOUDS) else _no_clouds()


def _no_clouds() -> pd.DataFrame:
    return pd.DataFrame(columns=[*CLOUD_KEYS, *POINT_COLUMNS])


def read_table(path: Path) -> pd.DataFrame:
    """Read a table that is as it was written.

    Raises
    ------
    ValueError
        If it is damaged, or says that it has far more rows than its file can
        hold.
    InputError
        If it is no file, or a symbolic link out of its folder.
    """
    require_inside(path, path.parent)
    require_file(path)
    try:
        require_rows_that_fit(path)
        table = pd.read_parquet(path, page_checksum_verification=True)
    except Exception as error:  # a damaged description of a table may end in anything
        raise ValueError(f"{path.name}: {type(error).__name__}: {error}") from error
    # Pages have checksums of their own, the description of the table has not.
    if DIGEST in table.attrs and table.attrs[DIGEST] != _table_digest(table):
        raise ValueError(f"{path.name}: the digest of its content is another one")
    table.attrs = {}
    return table


def _table_digest(table: pd.DataFrame) -> str:
    """Digest of the names and values of a table."""
    rows = pd.util.hash_pandas_object(table, index=False).to_numpy()
    return digest([list(table.columns), len(table), hashlib.sha256(rows.tobytes()).hexdigest()])


def _read_draws(path: Path) -> pd.DataFrame:
    """Scatterers that a study drew; most draw none, and write no file."""
    return read_table(path) if is_there(path) else pd.DataFrame(columns=DRAW_COLUMNS)


def _lenient(read: Callable[[], T], path: Path) -> T | None:
    """Read what is there; None where it is not, or damaged, which is told."""
    if not is_there(path):
        return None
    try:
        return read()
    except DAMAGE as error:
        _warn_of_damage(path, _told(error))
        return None


def _warn_of_damage(path: Path, what: str) -> None:
    warnings.warn(
        f"{path}: damaged, its cells are left out and run again ({what})", InputWarning, stacklevel=2
    )


def _no_run(folder: Path, missing: str) -> InputError:
    return InputError(
        f"{folder}: not the folder of a run, {missing} missing; allowed is a folder that isacbench run wrote"
    )
