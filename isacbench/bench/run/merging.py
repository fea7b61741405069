"""Merging of runs: shards of one run, or runs of one suite that differ in estimators, SNRs or trials.

Parts whose suites are equal, or differ in their estimators alone, are merged by
the plans that their manifests keep, so that no plugin has to be installed. If
suites have to be united otherwise, their cells are planned anew, with their plugins.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import TIMES, TIMING_COLUMNS, Results, typed
from isacbench.bench.kinds.population import PopulationSuite
from isacbench.bench.plan.job import Job
from isacbench.bench.plan.labels import labelled
from isacbench.bench.plan.manifest_plan import ENTRIES, restore_plan
from isacbench.bench.store import run_store
from isacbench.bench.store.resume import differing_versions, has_its_cloud
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import RUN_FILES, open_folder
from isacbench.bench.store.score_columns import SCORES, row_columns
from isacbench.bench.suites.scenario_digest import canonical_json
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import restore_suite
from isacbench.errors import InputError
from isacbench.plugins.discovery import local_plugins
from isacbench.specifications import spec_variants

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
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
        Trials of these cells.
    """

    scenario: str
    estimator: str
    params: str
    n_cells: int
    trials: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Merged:
    """Result of merging.

    Attributes
    ----------
    kind : str
        Kind of the suite.
    records : DataFrame
        All rows, in the order of the table.
    n_cells : int
        Cells of the whole run.
    gaps : list of Gap
        Cells that no part has.
    """

    kind: str
    records: pd.DataFrame
    n_cells: int
    gaps: list[Gap]


@dataclass(frozen=True, eq=False)
class _Part:
    """Run to be merged with others."""

    folder: Path
    manifest: Mapping[str, Any]
    results: Results
    rows: Rows

    @classmethod
    def read(cls, folder: Path) -> _Part:
        manifest, results = run_store.read_manifest(folder), run_store.read_results(folder)
        if missing := [key for key in run_store.RUN_KEYS if key not in manifest]:
            todo = "rescore" if missing[0] == SCORES else "resume"
            raise InputError(
                f"{folder}: its manifest has no {missing[0]} (written by an older isacbench); {todo} the run "
                "with this version first"
            )
        rows = Rows.of_tables(results.records, results.clouds, results.environments)
        if not has_its_cloud(rows).all():
            raise InputError(f"{folder}: damaged run: some clouds are missing; isacbench run restores them")
        return cls(folder, manifest, results, rows)


def merge(folders: Sequence[Path], out: Path, mix_versions: bool = False) -> Merged:
    """Merge runs into a new one that can be reported, compared and resumed.

    Parameters
    ----------
    folders : sequence of Path
        Runs of the same suite: name, kind, seed, metric, version of a population and contents of
        scenarios are equal; its lists are united.
    out : Path
        A new folder.
    mix_versions : bool
        True to allow rows of one estimator from several versions.

    Returns
    -------
    Merged

    Raises
    ------
    InputError
        If the parts do not belong together, or two of them disagree about a
        cell.
    """
    if out.is_dir() and RUN_FILES & {path.name for path in out.iterdir()}:
        raise InputError(f"{out}: holds a run; give a new folder")
    parts = [_Part.read(folder) for folder in folders]
    _require_one_suite(parts)
    plan, described = _whole(parts)
    rows = Rows.joined([part.rows for part in parts])
    if not mix_versions:
        _require_equal_versions(rows)
    positions = plan.positions(rows.records)
    if (positions < 0).any():
        first = rows.records[positions < 0].iloc[0]
        raise InputError(
            f"rows of {first['estimator']} with {first['params']} are not in the plan of the parts; install "
            "the version of the estimator that made them"
        )
    rows, positions = _united(rows, positions)
    suite, scenarios = restore_suite(described["suite"]), _scenarios(parts)
    results = Results(
        suite=suite,
        records=labelled(typed(rows.records, row_columns(suite, described[SCORES]["columns"]))),
        clouds=rows.clouds(),
        scenarios={name: scenarios[name] for name in described["scenarios"]},
        draws=_draws(parts, [scene["name"] for scene in described["scenes"]]),
        environments=rows.environments,
        started=datetime.now().astimezone(),
        wall_time_s=sum(part.results.wall_time_s for part in parts),
        interrupted=len(rows) < plan.n_cells,
    )
    earlier = chain.from_iterable(part.manifest.get("sessions", ()) for part in parts)
    sessions = sorted(earlier, key=lambda entry: entry["started"])
    options = {"merged": [str(folder) for folder in folders]}
    last = run_store.describe_session(results.started, results.wall_time_s, results.interrupted, options)
    with open_folder(out) as folder:
        run_store.write_results(results, folder)
        run_store.write_manifest(folder, described, results.environments, [*sessions, last])
    return Merged(suite.kind, results.records, plan.n_cells, _gaps(plan, positions))


def _require_one_suite(parts: Sequence[_Part]) -> None:
    """Refuse parts of different suites, seeds or metrics, or with different contents of a scenario."""
    known: dict[str, tuple[Path, Any]] = {}
    for part in parts:
        suite, manifest = part.results.suite, part.manifest
        facts = {"suite": suite.name, "kind": suite.kind, "seed": suite.seed}
        facts |= {f"metric {name!r}": metric for name, metric in manifest[SCORES]["metrics"].items()}
        if isinstance(suite, PopulationSuite):
            facts["version of the population"] = suite.version
        for name, entry in manifest["scenarios"].items():
            facts[f"content of scenario {name!r}"] = entry["content"]
        for entry in manifest["scenes"]:
            facts[f"content of scene {entry['name']!r}"] = entry["content"]
        for what, value in facts.items():
            folder, first = known.setdefault(what, (part.folder, value))
            if value != first:
                raise InputError(
                    f"{folder} and {part.folder}: {what} differs ({first}, {value}); only parts of one suite "
                    "can be merged"
                )


def _require_equal_versions(rows: Rows) -> None:
    """Refuse rows of an estimator from several versions."""
    known: dict[tuple[str, str], dict[str, Any]] = {}
    made = rows.records[["environment", "estimator", "params"]].drop_duplicates()
    for name, estimator, params in made.itertuples(index=False):
        versions: dict[str, Any] = rows.environments.get(name, {}).get("versions", {})
        other = known.setdefault((estimator, params), versions)
        if versions != other:
            raise InputError(
                f"{estimator}: some rows were made by {', '.join(differing_versions(other, versions))}; "
                "merge rows of one version, or use --mix-versions"
            )


def _whole(parts: Sequence[_Part]) -> tuple[Plan, dict[str, Any]]:
    """Plan of all parts together, and its description for the manifest."""
    suites, first = [_with_names(part) for part in parts], parts[0]
    if all(suite == suites[0] for suite in suites):
        for part in parts:
            if part.manifest["scenes"] != first.manifest["scenes"] or _variants(part) != _variants(first):
                raise InputError(
                    f"{first.folder} and {part.folder}: the suites are equal, but their parameters or SNRs "
                    "differ, because different versions wrote them"
                )
        return restore_plan(first.manifest), {key: first.manifest[key] for key in run_store.RUN_KEYS}
    if (joined := _with_all_estimators(parts)) is not None:
        return restore_plan(joined), joined
    scenarios = _scenarios(parts)
    paths: dict[str, str] = {}
    for part in reversed(parts):
        paths |= run_store.scenario_texts(part.manifest)
    try:
        suite = _union(suites)
        job = Job(suite, {name: scenarios[name] for name in suite.scenarios}, local_plugins())
        described = run_store.describe_run(job)
    except InputError as error:
        raise InputError(f"the suites of the parts cannot be united: {error}") from error
    described["suite"]["scenarios"] = [paths[name] for name in suite.scenarios]
    return job.plan, described


def _with_all_estimators(parts: Sequence[_Part]) -> dict[str, Any] | None:
    """Description of the first part with the estimators of all; None if parts differ in more than these."""
    first = parts[0].manifest
    entries: dict[tuple[str, str], Any] = {}
    texts: dict[tuple[str, str], str] = {}
    for part in parts:
        own = part.manifest["estimators"]
        spelled = [text for spec in part.results.suite.estimators for text, _ in spec_variants(spec)]
        if len(spelled) != len(own) or not _differ_in_estimators_alone(part, parts[0]):
            return None
        for text, entry in zip(spelled, own, strict=True):
            key = entry["name"], canonical_json(entry["params"])
            entries.setdefault(key, entry)
            texts.setdefault(key, text)
    scenes = [{**scene, ENTRIES: [*range(len(entries))]} for scene in first["scenes"]]
    suite = {**first["suite"], "estimators": [*texts.values()]}
    shared = {key: first[key] for key in run_store.RUN_KEYS}
    return {**shared, "suite": suite, "estimators": [*entries.values()], "scenes": scenes}


def _differ_in_estimators_alone(one: _Part, other: _Part) -> bool:
    """Tell whether two parts are equal up to their estimators, all of which meet every scene."""
    facts = []
    for part in (one, other):
        every = [*range(len(part.manifest["estimators"]))]
        scenes = part.manifest["scenes"]
        if any(scene[ENTRIES] != every for scene in scenes):
            return False
        outline = [(scene["name"], scene["content"], scene["snr_db"]) for scene in scenes]
        facts.append((_with_names(part).model_copy(update={"estimators": ()}), outline))
    return facts[0] == facts[1]


def _scenarios(parts: Sequence[_Part]) -> dict[str, Scenario]:
    """Scenarios by name, each of the first part that has it."""
    return {name: scenario for part in reversed(parts) for name, scenario in part.results.scenarios.items()}


def _with_names(part: _Part) -> Suite:
    """Suite with the names of its scenarios, whose paths are different on each machine."""
    return part.results.suite.model_copy(update={"scenarios": tuple(part.results.scenarios)})


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
            raise InputError(f"only some have {key}")
    return restore_suite(united)


def _united_list(lists: Sequence[Sequence[Any]], are_specifications: bool) -> tuple[Any, ...]:
    """Entries of all lists, sorted if they are numbers."""
    if are_specifications:
        lists = [[text for spec in specs for text, _ in spec_variants(spec)] for specs in lists]
    united = tuple(dict.fromkeys(chain.from_iterable(lists)))
    return tuple(sorted(united)) if all(isinstance(value, float) for value in united) else united


def _united(rows: Rows, positions: NDArray[np.int64]) -> tuple[Rows, NDArray[np.int64]]:
    """Rows in the order of the table, each cell once, timed if any part has timed it; and their positions."""
    order = np.lexsort([~rows.records["timing"].to_numpy(dtype=np.bool_), positions])
    rows, positions = rows.take(order), positions[order]
    is_again = np.diff(positions, prepend=-1) == 0
    (again,) = np.nonzero(is_again)
    _require_agreement(rows.take(again - 1), rows.take(again))
    return rows.take(~is_again), positions[~is_again]


def _require_agreement(one: Rows, other: Rows) -> None:
    """Refuse different rows of the same cells, apart from times."""
    others = {*TIMES, *TIMING_COLUMNS, "timing", "environment", "label"}
    columns = [name for name in one.records if name not in others]
    left, right = one.records[columns], other.records[columns]
    agree = ((left == right) | (left.isna() & right.isna())).all(axis=1) & (one.n_points == other.n_points)
    if agree.all():
        of_row = np.repeat(np.arange(len(one)), one.n_points)
        agree[of_row[(one.points != other.points).any(axis=1)]] = False
    if not agree.all():
        cell = one.records[~agree].iloc[0]
        raise InputError(
            f"two parts disagree about {cell['estimator']} on {cell['scenario']} at {cell['snr_db']:g} dB, "
            f"trial {cell['trial']}; rows of one cell must be equal"
        )


def _draws(parts: Sequence[_Part], scenes: Sequence[str]) -> pd.DataFrame:
    """Scatterers that the parts drew, each trial of a scene once, in the order of the table."""
    draws = pd.concat([part.results.draws.assign(part=n) for n, part in enumerate(parts)], ignore_index=True)
    first = draws.groupby(["scenario", "trial"])["part"].transform("min")
    draws = draws[draws["part"] == first].drop(columns="part")
    scene = pd.Index(scenes).get_indexer(pd.Index(draws["scenario"]))
    return draws.iloc[np.lexsort([draws["trial"].to_numpy(dtype=np.int64), scene])].reset_index(drop=True)


def _gaps(plan: Plan, positions: NDArray[np.int64]) -> list[Gap]:
    """Cells of a plan that no part has."""
    missing = np.ones(plan.n_cells, dtype=np.bool_)
    missing[positions] = False
    trials: dict[tuple[str, str, str], list[int]] = {}
    for block in plan.blocks(missing):
        scene = plan.scenes[block.scene]
        for index in block.entries:
            one = scene.entries[index]
            trials.setdefault((scene.name, one.name, one.params), []).append(block.trial)
    return [Gap(*key, len(found), tuple(dict.fromkeys(found))) for key, found in trials.items()]
