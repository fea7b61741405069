"""Joining runs: shards of one run, or runs of one suite that differ in estimators, SNRs, trials.

Parts of equal suites are joined by the outline that each manifest keeps, so
that no plugin has to be installed where they are joined. Only the cells of
suites that are united have to be planned anew, with their plugins.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import TIMES, TIMING_COLUMNS, Results, typed
from isacbench.bench.plan.job import Job
from isacbench.bench.plan.manifest_plan import restore_plan
from isacbench.bench.store.resume import differing_versions, has_its_cloud
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import RUN_FILES, open_folder
from isacbench.bench.store.run_store import (
    RUN_KEYS,
    Session,
    describe_run,
    read_manifest,
    read_results,
    write_manifest,
    write_results,
)
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import kind_of, restore_suite
from isacbench.errors import InputError
from isacbench.files.escaping import quoted
from isacbench.plugins.discovery import local_plugins
from isacbench.plugins.specifications import spec_variants

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from isacbench.bench.plan.run_plan import Plan
    from isacbench.model.scene import Scenario

SPECIFICATIONS = ("estimators", "detectors")
"""Keys of a suite whose entries may be grids."""


class Gap(NamedTuple):
    """Cells of an estimator on a scene that no part has.

    Attributes
    ----------
    scenario, estimator, params : str
    n_cells : int
    trials : tuple of int
        In which some are missing.
    """

    scenario: str
    estimator: str
    params: str
    n_cells: int
    trials: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Merged:
    """What became of the parts.

    Attributes
    ----------
    kind : str
        Of the suite.
    records : DataFrame
        All rows, in the order of the table.
    n_cells : int
        Cells of the whole run.
    gaps : list of Gap
        What is missing.
    """

    kind: str
    records: pd.DataFrame
    n_cells: int
    gaps: list[Gap]


@dataclass(frozen=True, eq=False)
class _Part:
    """A run to be joined with others."""

    folder: Path
    manifest: Mapping[str, Any]
    results: Results
    rows: Rows

    @classmethod
    def read(cls, folder: Path) -> _Part:
        manifest, results = read_manifest(folder), read_results(folder)
        contents = (
            f"scenarios.{name}.content"
            for name, entry in manifest["scenarios"].items()
            if "content" not in entry
        )
        if missing := [*(key for key in RUN_KEYS if key not in manifest), *contents]:
            raise InputError(
                f"{folder}: its manifest has no {missing[0]}, as an older isacbench left it; "
                "allowed is a run that this one has gone on with"
            )
        n_described, n_named = len(results.scenarios), len(results.suite.scenarios)
        if n_described != n_named:
            raise InputError(
                f"{folder}: damaged run: its manifest describes {n_described} scenarios, "
                f"its suite names {n_named}"
            )
        rows = Rows.of_tables(results.records, results.clouds, results.environments)
        if not has_its_cloud(rows).all():
            raise InputError(
                f"{folder}: damaged run: some clouds are missing; run it again, which makes them"
            )
        return cls(folder, manifest, results, rows)


def merge(folders: Sequence[Path], out: Path, mix_versions: bool = False) -> Merged:
    """Join runs into a new one that can be reported, compared and gone on with.

    Parameters
    ----------
    folders : sequence of Path
        Runs of the same suite: name, kind, seed, metric and contents of
        scenarios are equal; its lists are united.
    out : Path
        A new folder.
    mix_versions : bool
        Whether rows of one estimator may be of several versions.

    Returns
    -------
    Merged

    Raises
    ------
    InputError
        If the parts do not belong together, naming what differs, or two of
        them disagree about a cell.
    """
    _require_new(out)
    parts = [_Part.read(folder) for folder in folders]
    _require_equal_runs(parts)
    _require_equal_contents(parts)
    plan, described = _whole(parts)
    rows = Rows.joined([part.rows for part in parts])
    if not mix_versions:
        _require_equal_versions(rows)
    positions = plan.positions(rows.records)
    if (positions < 0).any():
        first = rows.records[positions < 0].iloc[0]
        raise InputError(
            f"{first['estimator']} with {first['params']} is not what the suites of the parts mean here; "
            "allowed is the version of it that the parts were made with"
        )
    rows, positions = _united(rows, positions)
    results = _results(parts, rows, described, len(rows) < plan.n_cells)
    session = Session(results.started, {"merged": [str(folder) for folder in folders]})
    sessions = sorted(
        chain.from_iterable(part.manifest.get("sessions", ()) for part in parts),
        key=lambda entry: entry["started"],
    )
    with open_folder(out) as folder:
        write_results(results, folder)
        last = session.describe(results.wall_time_s, results.interrupted)
        write_manifest(folder, described, results.environments, [*sessions, last])
    return Merged(results.suite.kind, results.records, plan.n_cells, list(_gaps(plan, positions)))


def _require_new(out: Path) -> None:
    if out.is_dir() and RUN_FILES & {path.name for path in out.iterdir()}:
        raise InputError(f"{out}: holds a run; allowed is a new folder")


def _require_equal_runs(parts: Sequence[_Part]) -> None:
    first = parts[0]
    for part in parts[1:]:
        ours, theirs = first.results.suite, part.results.suite
        for what, one, other in (
            ("suite", ours.name, theirs.name),
            ("kind", ours.kind, theirs.kind),
            ("seed", ours.seed, theirs.seed),
            ("metric", first.manifest["metric"], part.manifest["metric"]),
        ):
            if one != other:
                raise InputError(
                    f"{first.folder} and {part.folder}: {what} {one} and {other}; allowed are parts "
                    "of one suite"
                )


def _require_equal_contents(parts: Sequence[_Part]) -> None:
    """Refuse parts that mean different things by the name of a scenario or a scene."""
    known: dict[str, tuple[Path, str]] = {}
    for part in parts:
        templates = {name: entry["content"] for name, entry in part.manifest["scenarios"].items()}
        scenes = {f"{scene['name']} ": scene["content"] for scene in part.manifest["scenes"]}
        for name, content in {**templates, **scenes}.items():
            folder, other = known.setdefault(name, (part.folder, content))
            if content != other:
                raise InputError(
                    f"{folder} and {part.folder}: the scenario {name.strip()!r} has another content in each; "
                    "allowed are parts of one suite"
                )


def _require_equal_versions(rows: Rows) -> None:
    """Refuse rows of an estimator that several versions have made."""
    known: dict[tuple[str, str], dict[str, Any]] = {}
    made = rows.records[["environment", "estimator", "params"]].drop_duplicates()
    for name, estimator, params in made.itertuples(index=False):
        versions: dict[str, Any] = rows.environments.get(name, {}).get("versions", {})
        other = known.setdefault((estimator, params), versions)
        if versions != other:
            raise InputError(
                f"{estimator}: some rows were made by {', '.join(differing_versions(other, versions))}; "
                "allowed are rows of one version, or --mix-versions"
            )


def _whole(parts: Sequence[_Part]) -> tuple[Plan, dict[str, Any]]:
    """Plan of all parts together, and what the manifest says of it."""
    suites, first = [_with_names(part) for part in parts], parts[0]
    if all(suite == suites[0] for suite in suites[1:]):
        for part in parts[1:]:
            if part.manifest["scenes"] != first.manifest["scenes"] or _variants(part) != _variants(first):
                raise InputError(
                    f"{first.folder} and {part.folder}: of equal suites different versions have made "
                    "different cells; allowed are parts with the same parameters and SNRs"
                )
        return restore_plan(first.manifest), {key: first.manifest[key] for key in RUN_KEYS}
    suite = _union(suites)
    scenarios: dict[str, Scenario] = {}
    for part in parts:
        scenarios |= {name: found for name, found in part.results.scenarios.items() if name not in scenarios}
    try:
        job = Job(suite, {name: scenarios[name] for name in suite.scenarios}, local_plugins())
        plan = job.plan
    except InputError as error:
        raise InputError(f"the suites of the parts cannot be united: {error}") from error
    described = describe_run(job)
    described["suite"]["scenarios"] = _paths(parts, suite.scenarios)
    return plan, described


def _with_names(part: _Part) -> Suite:
    """Suite with the names of its scenarios: a path is another one on each machine."""
    return part.results.suite.model_copy(update={"scenarios": tuple(part.results.scenarios)})


def _paths(parts: Sequence[_Part], names: Sequence[str]) -> list[str]:
    """Scenarios as the first part that has them calls them."""
    paths: dict[str, str] = {}
    for part in parts:
        for name, path in zip(part.results.scenarios, part.results.suite.scenarios, strict=True):
            paths.setdefault(name, path)
    return [paths[name] for name in names]


def _variants(part: _Part) -> list[Any]:
    return [(entry["name"], entry["params"]) for entry in part.manifest["estimators"]]


def _union(suites: Sequence[Suite]) -> Suite:
    """Suite with the lists of all, in the order of the parts, and the most trials."""
    contents = [suite.model_dump() for suite in suites]
    united = dict(contents[0])
    for key, first in contents[0].items():
        values = [content[key] for content in contents]
        if all(value == first for value in values):
            continue
        if key == "trials":
            united[key] = max(values)
        elif all(values):
            united[key] = _united_list(values, key in SPECIFICATIONS)
        else:
            raise InputError(f"the suites of the parts cannot be united: only some have {key}")
    return restore_suite(united)


def _united_list(lists: Sequence[Sequence[Any]], are_specifications: bool) -> tuple[Any, ...]:
    """Entries of all lists; numbers that rise in each of them rise."""
    if are_specifications:
        lists = [[text for spec in specs for text, _ in spec_variants(spec)] for specs in lists]
    united = tuple(dict.fromkeys(chain.from_iterable(lists)))
    rise = all(isinstance(value, float) for value in united) and all(
        list(values) == sorted(values) for values in lists
    )
    return tuple(sorted(united)) if rise else united


def _united(rows: Rows, positions: NDArray[np.int64]) -> tuple[Rows, NDArray[np.int64]]:
    """Rows in the order of the table, each cell once, timed if any part has timed it; and their positions."""
    order = np.lexsort([~rows.records["timing"].to_numpy(dtype=np.bool_), positions])
    is_first = np.diff(positions[order], prepend=-1) != 0
    first_of = order[is_first][np.cumsum(is_first) - 1]
    again, before = order[~is_first], first_of[~is_first]
    _require_agreement(rows.take(before), rows.take(again))
    return rows.take(order[is_first]), positions[order[is_first]]


def _require_agreement(one: Rows, other: Rows) -> None:
    """Refuse rows of the same cells that say different things, times apart."""
    others = {*TIMES, *TIMING_COLUMNS, "timing", "environment"}
    columns = [name for name in one.records if name not in others]
    left, right = one.records[columns], other.records[columns]
    agree = ((left == right) | (left.isna() & right.isna())).all(axis=1).to_numpy(copy=True)
    agree &= one.n_points == other.n_points
    if agree.all():
        of_row = np.repeat(np.arange(len(one)), one.n_points)
        agree[of_row[(one.points != other.points).any(axis=1)]] = False
    if not agree.all():
        cell = one.records[~agree].iloc[0]
        raise InputError(
            f"two parts disagree about {cell['estimator']} on {cell['scenario']} at {cell['snr_db']:g} dB, "
            f"trial {cell['trial']}; allowed are equal rows of a cell, or one"
        )


def _results(
    parts: Sequence[_Part], rows: Rows, described: Mapping[str, Any], is_incomplete: bool
) -> Results:
    suite = restore_suite(described["suite"])
    scenarios: dict[str, Scenario] = {}
    for part in parts:
        scenarios |= {name: found for name, found in part.results.scenarios.items() if name not in scenarios}
    return Results(
        suite=suite,
        records=typed(rows.records, kind_of(suite).columns),
        clouds=rows.clouds(),
        scenarios={name: scenarios[name] for name in described["scenarios"]},
        draws=_draws(parts, [scene["name"] for scene in described["scenes"]]),
        environments=rows.environments,
        started=datetime.now().astimezone(),
        wall_time_s=sum(part.results.wall_time_s for part in parts),
        interrupted=is_incomplete,
    )


def _draws(parts: Sequence[_Part], scenes: Sequence[str]) -> pd.DataFrame:
    """What parts drew, each trial of a scene once, in the order of the table."""
    drawn: dict[tuple[str, int], pd.DataFrame] = {}
    for part in parts:
        for key, table in part.results.draws.groupby(["scenario", "trial"], sort=False):
            if key[0] not in scenes:
                raise InputError(
                    f"{part.folder}: damaged run: it has draws of {quoted(key[0])}; "
                    "allowed are scenes of its manifest"
                )
            drawn.setdefault(cast("tuple[str, int]", key), table)
    order = sorted(drawn, key=lambda key: (scenes.index(key[0]), key[1]))
    if not order:
        return parts[0].results.draws
    return pd.concat([drawn[key] for key in order], ignore_index=True)


def _gaps(plan: Plan, positions: NDArray[np.int64]) -> Iterator[Gap]:
    """What is missing of a plan."""
    missing = np.ones(plan.n_cells, dtype=np.bool_)
    missing[positions] = False
    trials: dict[tuple[str, str, str], list[int]] = {}
    for block in plan.blocks(missing):
        scene = plan.scenes[block.scene]
        for index in block.entries:
            one = scene.entries[index]
            trials.setdefault((scene.name, one.name, one.params), []).append(block.trial)
    for key, found in trials.items():
        yield Gap(*key, len(found), tuple(dict.fromkeys(found)))
