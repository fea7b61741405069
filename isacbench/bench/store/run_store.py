"""Store of a run: writes and reads its folder, which holds all that scoring, drawing and resuming need."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
import sys
import warnings
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd

import isacbench
from isacbench.bench.cells.record import (
    CLOUD_KEYS,
    COLUMNS,
    DRAW_COLUMNS,
    Results,
    require_sound_records,
    typed,
    with_added,
)
from isacbench.bench.plan.labels import labelled
from isacbench.bench.plan.manifest_plan import outline
from isacbench.bench.store.csv_table import without_formulas, write_csv_table
from isacbench.bench.store.journal import read_journal
from isacbench.bench.store.provenance import (
    blas_libraries,
    git_state,
    machine,
    package_versions,
    plugin_version,
)
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import replacing
from isacbench.bench.store.score_columns import (
    SCORES,
    describe_scores,
    metrics_of,
    row_columns,
    stored_columns,
)
from isacbench.bench.suites.scenario_digest import (
    describe_scenario,
    digest,
    restore_scenario,
    scenario_digest,
    truth_table,
)
from isacbench.bench.suites.suite_kinds import restore_suite
from isacbench.errors import AccessError, InputError, InputWarning
from isacbench.files.checked_files import (
    MANIFEST_BYTES,
    is_there,
    read_text,
    require_file,
    require_inside,
    require_utf8,
)
from isacbench.files.escaping import quoted, visible
from isacbench.model.cloud_files.columns import POINT_COLUMNS
from isacbench.model.scenes.scene_families import spelled_scenarios

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
"""Files of a run."""

DIGEST = "digest"
"""Attribute of a table's file that holds the digest of its content."""

RUN_KEYS = ("seed", "suite", SCORES, "estimators", "scenarios", "scenes")
"""Keys of a manifest that describe the content of the run, not the calls that worked on it."""

T = TypeVar("T")

DAMAGE = (ValueError, TypeError, LookupError, OSError)
"""Exceptions that reading a damaged file raises."""


def describe_session(
    started: datetime, wall_time_s: float, interrupted: bool, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Describe a call that worked on a run for its manifest.

    Parameters
    ----------
    started : datetime
        With its time zone.
    wall_time_s : float
    interrupted : bool
    options : mapping of str to Any
        Options of the call in terms of JSON.

    Returns
    -------
    dict
        In terms of JSON.
    """
    return {
        "argv": [visible(one) for one in (Path(sys.argv[0]).name, *sys.argv[1:])],
        "started": started.isoformat(timespec="seconds"),
        "wall_time_s": round(wall_time_s, 3),
        "interrupted": interrupted,
        **options,
    }


def describe_run(job: Job) -> dict[str, Any]:
    """Describe the content of a run for its manifest.

    Parameters
    ----------
    job : Job

    Returns
    -------
    dict
        Values of `RUN_KEYS` in terms of JSON.
    """
    suite = job.suite
    return {
        "seed": suite.seed,
        "suite": suite.model_dump(),
        SCORES: describe_scores(metrics_of(suite), job.scenarios.values()),
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


def scenario_texts(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Look up how the suite of a run spells each scenario: a name, a generated scene or a path.

    Parameters
    ----------
    manifest : mapping of str to Any

    Returns
    -------
    dict of str to str
        By the scenarios' names.

    Raises
    ------
    InputError
        If the suite does not list the scenarios that are described.
    """
    names, texts = list(manifest["scenarios"]), spelled_scenarios(manifest["suite"]["scenarios"])
    if len(names) != len(texts):
        raise InputError(
            f"{MANIFEST}: {len(names)} scenarios are described, but the suite lists {len(texts)}"
        )
    return dict(zip(names, texts, strict=True))


def write_manifest(
    folder: Path,
    run: Mapping[str, Any],
    environments: Mapping[str, Environment],
    sessions: list[dict[str, Any]],
) -> None:
    """Write the manifest of a run, in place of an older one.

    Parameters
    ----------
    folder : Path
    run : mapping of str to Any
        Content of the run, as `describe_run` returns it.
    environments : mapping of str to Environment
        By the names in the column ``environment``.
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
        "python": platform.python_version(),
        "packages": package_versions(),
        **machine(),
        "blas_threads": 1,
        "blas": blas_libraries(),
    }
    save_manifest(folder, manifest)


def save_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write a manifest as it is, in place of an older one.

    Parameters
    ----------
    folder : Path
    manifest : mapping of str to Any
        In terms of JSON.
    """
    with replacing(folder / MANIFEST) as path:
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        # A file name that is not UTF-8 contains surrogates, which JSON escapes in the same way as Python.
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
    """Write rows and clouds, in place of older ones.

    Parameters
    ----------
    folder : Path
    records : DataFrame
    clouds : DataFrame
        One row for each point, with the key of its cell.
    """
    _write_parquet(clouds, folder / CLOUDS)
    _write_parquet(records, folder / RECORDS)


def write_truth(folder: Path, scenarios: Mapping[str, Scenario]) -> None:
    """Write the scatterers of the scenarios of a run.

    Parameters
    ----------
    folder : Path
    scenarios : mapping of str to Scenario
        By name.
    """
    tables = [truth_table(scenario) for scenario in scenarios.values()]
    _write_parquet(pd.concat(tables, ignore_index=True), folder / TRUTH)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a run.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If there is none, or it is damaged.
    """
    path = folder / MANIFEST
    require_utf8(folder)
    if not is_there(path):
        raise InputError(
            f"{folder}: not the folder of a run, {MANIFEST} missing; give one that isacbench run wrote"
        )
    require_inside(path, folder)
    try:
        manifest: dict[str, Any] = dict(json.loads(read_text(path, MANIFEST_BYTES)))
    except AccessError:
        raise
    except DAMAGE as error:
        raise InputError(f"{folder}: damaged run: {MANIFEST}: {_told(error)}") from error
    return manifest


def recover_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a run that is to be resumed, as far as it can be read.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    dict
        Empty if the manifest is missing or damaged.

    Warns
    -----
    InputWarning
        If it is damaged.
    """
    return _attempt(lambda _: read_manifest(folder), folder / MANIFEST) or {}


def read_rows(
    folder: Path, manifest: Mapping[str, Any], is_strict: bool = False, with_clouds: bool = True
) -> Rows:
    """Read all rows of a folder, including those of a run that was killed.

    Parameters
    ----------
    folder : Path
    manifest : mapping of str to Any
        As `read_manifest` or `recover_manifest` returns it.
    is_strict : bool
        True to raise if a table is damaged, False to leave it out.
    with_clouds : bool
        False to leave out the clouds, except those of a journal.

    Returns
    -------
    Rows
        If a cell has several rows, the last one counts.

    Raises
    ------
    ValueError, TypeError, LookupError, OSError
        If a table is damaged and `is_strict`.

    Warns
    -----
    InputWarning
        If something is damaged, and its rows or clouds are left out.
    """
    records = _attempt(_read_records, folder / RECORDS, is_strict)
    clouds = _attempt(read_table, folder / CLOUDS, is_strict) if with_clouds else None
    if clouds is None:
        clouds = pd.DataFrame(columns=[*CLOUD_KEYS, *POINT_COLUMNS])
    environments = manifest.get("environments", {})
    parts = [] if records is None else [Rows.of_tables(records, clouds, environments)]
    if is_there(folder / JOURNAL):
        rows, n_torn = read_journal(folder / JOURNAL)
        if n_torn:
            _warn_of_damage(folder / JOURNAL, f"{n_torn} lines")
        parts.append(rows)
    return Rows.joined(parts)


def read_results(folder: Path) -> Results:
    """Read a run from its folder; of a run that was killed, the rows that it has made.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    Results

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
    """Read the rows of a run, one for each cell, with the column types of its kind of suite.

    Parameters
    ----------
    folder : Path
    manifest : mapping of str to Any
        As `read_manifest` returns it.
    with_clouds : bool
        False to leave out the clouds, except those of a journal.

    Returns
    -------
    Rows

    Raises
    ------
    InputError
        If there are no rows, or damaged ones.

    Warns
    -----
    InputWarning
        If lines of the journal of a run that was killed are damaged.
    """
    if not is_there(folder / RECORDS) and not is_there(folder / JOURNAL):
        raise InputError(f"{folder}: has no rows, {RECORDS} is missing; isacbench run into it makes them")
    with _damage_told(folder):
        rows = read_rows(folder, manifest, True, with_clouds)
        rows = rows.take(~rows.records.duplicated(CLOUD_KEYS, keep="last").to_numpy())
        records = labelled(
            typed(rows.records, row_columns(restore_suite(manifest["suite"]), stored_columns(manifest)))
        )
        require_sound_records(records)
        require_described_scenarios(records, manifest)
        return dataclasses.replace(rows, records=records)


def read_scenes(folder: Path, manifest: Mapping[str, Any]) -> tuple[Suite, dict[str, Scenario], pd.DataFrame]:
    """Read the suite of a run, its scenarios, and the scatterers that its trials drew.

    Parameters
    ----------
    folder : Path
    manifest : mapping of str to Any
        As `read_manifest` returns it.

    Returns
    -------
    suite : Suite
    scenarios : dict of str to Scenario
        By name.
    draws : DataFrame
        One row for each scatterer; empty if the trials drew none.

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
        draws = _attempt(read_table, folder / DRAWS, is_strict=True)
        if draws is None:
            draws = pd.DataFrame(columns=DRAW_COLUMNS)
        return restore_suite(manifest["suite"]), scenarios, draws


def read_table(path: Path) -> pd.DataFrame:
    """Read a table and verify that it is as it was written.

    Parameters
    ----------
    path : Path

    Returns
    -------
    DataFrame

    Raises
    ------
    ValueError
        If it is damaged.
    InputError
        If it is not a file, or is a symbolic link out of its folder.
    """
    require_inside(path, path.parent)
    require_file(path)
    try:
        with path.open("rb") as file:
            table = pd.read_parquet(file, page_checksum_verification=True)
    except Exception as error:  # Arrow raises many types for a damaged file, without a number of the system
        if isinstance(error, MemoryError) or getattr(error, "errno", None) is not None:
            raise AccessError(f"{path}: cannot be read: {error}") from error
        raise ValueError(f"{path.name}: {type(error).__name__}: {error}") from error
    # The checksums of pages do not cover the description of the table.
    if DIGEST in table.attrs and table.attrs[DIGEST] != _table_digest(table):
        raise ValueError(f"{path.name}: its content does not match its digest")
    table.attrs = {}
    return table


def require_described_scenarios(records: pd.DataFrame, manifest: Mapping[str, Any]) -> None:
    """Refuse records of scenarios that the manifest does not describe.

    Parameters
    ----------
    records : DataFrame
    manifest : mapping of str to Any
        With ``suite`` and ``scenarios``.

    Raises
    ------
    InputError
        Naming the scenarios.
    """
    # Studies that derive scenes from a scenario name it in the column template, empty for a link's user.
    names = records["template" if "template" in records else "scenario"].dropna().unique()
    described = manifest["scenarios"]
    missing = set(names) - {"", *described, *manifest["suite"].get("maps", ())}
    if missing:
        raise InputError(
            f"its rows name the scenarios {quoted(sorted(missing))}, which its manifest does not describe; "
            f"allowed are {quoted(sorted(described))}"
        )


@contextmanager
def _damage_told(folder: Path) -> Iterator[None]:
    """Turn errors in reading a damaged folder into an `InputError` that names it."""
    try:
        yield
    except AccessError:
        raise
    except DAMAGE as error:
        raise InputError(f"{folder}: damaged run: {_told(error)}") from error


def _told(error: Exception) -> str:
    """Message of an exception, preceded by its type unless it is an `InputError`."""
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


def _attempt(read: Callable[[Path], T], path: Path, is_strict: bool = False) -> T | None:
    """Read a file. None if it is missing; if it is damaged, raise (`is_strict`) or warn and return None."""
    if not is_there(path):
        return None
    try:
        return read(path)
    except DAMAGE as error:
        if is_strict or isinstance(error, AccessError):
            raise
        _warn_of_damage(path, _told(error))
        return None


def _read_records(path: Path) -> pd.DataFrame:
    records = with_added(read_table(path))
    if missing := [name for name in COLUMNS if name not in records]:
        raise ValueError(f"{path.name} has no column {missing[0]}")
    if records.duplicated(CLOUD_KEYS).any():
        raise ValueError(f"{path.name} has several rows of a cell")
    return records


def _write_parquet(table: pd.DataFrame, path: Path) -> None:
    signed = table.copy(deep=False)
    signed.attrs = {DIGEST: _table_digest(table)}
    with replacing(path) as temporary:
        signed.to_parquet(temporary, index=False, write_page_checksum=True)


def _table_digest(table: pd.DataFrame) -> str:
    """Digest of the names and values of a table."""
    rows = pd.util.hash_pandas_object(table, index=False).to_numpy()
    return digest([list(table.columns), len(table), hashlib.sha256(rows.tobytes()).hexdigest()])


def _warn_of_damage(path: Path, what: str) -> None:
    warnings.warn(
        f"{path}: damaged, its cells are left out and run again ({what})", InputWarning, stacklevel=2
    )
