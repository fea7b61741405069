"""Merging of runs: shards of one run, or runs of one suite that differ in their estimators alone.

They are merged by the plans that their manifests keep, so that no plugin has to be installed.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.bench.cells.plan import Plan
from isacbench.bench.cells.provenance import differing_versions
from isacbench.bench.cells.rows import TIMES, TIMING_COLUMNS, typed
from isacbench.bench.store.manifest import (
    ENTRIES,
    RUN_KEYS,
    SCORES,
    build_manifest,
    describe_session,
    restore_plan,
    row_columns,
)
from isacbench.bench.store.run import Run, Scenes
from isacbench.bench.store.run_folder import RUN_FILES, open_folder
from isacbench.bench.suites.scenario_digest import canonical_json
from isacbench.bench.suites.suite_kinds import restore_suite
from isacbench.errors import InputError
from isacbench.files.escaping import shortened
from isacbench.specifications import spec_variants


class Gap(NamedTuple):
    """Cells of an estimator on a scene that no part has, and their trials."""

    scenario: str
    estimator: str
    params: str
    n_cells: int
    trials: tuple[int, ...]


class Merged(NamedTuple):
    """The whole run, rows in the order of the table, how many cells it has, and those that no part has."""

    run: Run
    n_cells: int
    gaps: list[Gap]


def merge(folders: Sequence[Path], out: Path, mix_versions: bool = False) -> Merged:
    """Merge runs into a new one that can be reported, compared and resumed.

    The parts are runs of the same suite, of which only the estimators may differ. Rows of one estimator from
    several versions are refused unless `mix_versions`, and so are parts that disagree about a cell.
    """
    if out.is_dir() and RUN_FILES & {path.name for path in out.iterdir()}:
        raise InputError(f"{out}: holds a run; give a new folder")
    parts = [_open(folder) for folder in folders]
    for part in parts[1:]:
        _require_same_suite(parts[0], part)
    described = _describe_whole(parts)
    plan, suite = restore_plan(described), restore_suite(described["suite"])
    joined = Run.joined(parts)
    if not mix_versions:
        _require_equal_versions(joined)
    positions = plan.positions(joined.rows)
    if (positions < 0).any():
        first = joined.rows[positions < 0].iloc[0]
        raise InputError(
            f"rows of {first['estimator']} with {first['params']} are not in the plan that the manifests of "
            "the parts describe"
        )
    joined, positions = _each_cell_once(joined, positions)
    # Each part has the draws of the whole suite, or none if it was killed.
    draws = max((part.draws for part in parts), key=len)
    sessions = sorted(
        (one for part in parts for one in part.manifest.get("sessions", ())), key=lambda one: one["started"]
    )
    wall_time_s = sum(part.manifest["wall_time_s"] for part in parts)
    options = {"merged": [part.label for part in parts]}
    is_partial = len(positions) < plan.n_cells
    sessions.append(describe_session(datetime.now().astimezone(), wall_time_s, is_partial, options))
    run = joined.changed(
        label=str(out),
        rows=typed(joined.rows, row_columns(suite, described[SCORES]["columns"])),
        manifest=build_manifest(described, joined.environments, sessions),
        read_scenes=lambda: Scenes(suite, parts[0].scenarios, draws),
    )
    with open_folder(out) as folder:
        run.save(folder)
    return Merged(run, plan.n_cells, _gaps(plan, positions))


def _open(folder: Path) -> Run:
    """Open a part, of which nothing may be missing."""
    run = Run.open(folder)
    run.require_described(RUN_KEYS)
    run.require_clouds()
    return run


def _require_same_suite(first: Run, other: Run) -> None:
    """Refuse runs that differ in more than their estimators, naming what differs."""
    one, another = _suite_of(first), _suite_of(other)
    for what in one | another:
        if one.get(what) != another.get(what):
            values = (
                shortened("none" if (it := each.get(what)) is None else str(it)) for each in (one, another)
            )
            raise InputError(
                f"{first.label} and {other.label}: {what} differs ({', '.join(values)}); only parts of one "
                "suite can be merged: shards of one run, or runs that differ in their estimators alone"
            )


def _suite_of(run: Run) -> dict[str, Any]:
    """Everything of the suite of a run but its estimators; paths of scenarios differ between machines."""
    manifest, suite = run.manifest, run.suite.model_dump(exclude={"estimators", "scenarios", "metrics"})
    return {
        "suite": suite.pop("name"),
        **{key: suite.pop(key) for key in ("kind", "seed")},
        **{f"metric {name!r}": metric for name, metric in manifest[SCORES]["metrics"].items()},
        **{f"content of scenario {name!r}": one["content"] for name, one in manifest["scenarios"].items()},
        **{f"content of scene {one['name']!r}": one["content"] for one in manifest["scenes"]},
        **suite,
    }


def _require_equal_versions(run: Run) -> None:
    """Refuse rows of an estimator from several versions."""
    known: dict[tuple[str, str], dict[str, Any]] = {}
    made = run.rows[["environment", "estimator", "params"]].drop_duplicates()
    for name, estimator, params in made.itertuples(index=False):
        versions: dict[str, Any] = run.environments.get(name, {}).get("versions", {})
        other = known.setdefault((estimator, params), versions)
        if versions != other:
            raise InputError(
                f"{estimator}: some rows were made by {', '.join(differing_versions(other, versions))}; "
                "merge rows of one version, or use --mix-versions"
            )


def _describe_whole(parts: Sequence[Run]) -> dict[str, Any]:
    """Description of the whole run: that of the first part, with the estimators of all."""
    first = parts[0].manifest
    described = {key: first[key] for key in RUN_KEYS}
    if all(part.manifest[key] == first[key] for part in parts for key in ("estimators", "scenes")):
        return described
    known: dict[tuple[str, str], tuple[str, dict[str, Any]]] = {}
    for part in parts:
        own, scenes = part.manifest["estimators"], part.manifest["scenes"]
        texts = [text for spec in part.suite.estimators for text, _ in spec_variants(spec)]
        if len(texts) != len(own) or any(scene[ENTRIES] != [*range(len(own))] for scene in scenes):
            raise InputError(
                f"{part.label}: not all of its estimators meet every scene; only shards of one such run "
                "can be merged"
            )
        for text, entry in zip(texts, own, strict=True):
            variant = entry["name"], canonical_json(entry["params"])
            if variant not in known and any(text == other for other, _ in known.values()):
                raise InputError(
                    f"{parts[0].label} and {part.label}: the parameters of {text} differ, because different "
                    "versions wrote them"
                )
            known.setdefault(variant, (text, entry))
    return {
        **described,
        "suite": {**first["suite"], "estimators": [text for text, _ in known.values()]},
        "estimators": [entry for _, entry in known.values()],
        "scenes": [{**scene, ENTRIES: [*range(len(known))]} for scene in first["scenes"]],
    }


def _each_cell_once(run: Run, positions: NDArray[np.int64]) -> tuple[Run, NDArray[np.int64]]:
    """Rows in the order of the table, timed ones if there are, and their positions; refuse disagreement."""
    order = np.lexsort([~run.rows["timing"].to_numpy(dtype=np.bool_), positions])
    run, positions = run.take(order), positions[order]
    is_again = np.diff(positions, prepend=-1) == 0
    rows = run.rows.drop(columns=["timing", "environment", "label", *TIMES, *TIMING_COLUMNS], errors="ignore")
    again = rows[is_again]
    before = rows.iloc[np.flatnonzero(is_again) - 1].set_axis(again.index)
    differs = ((before != again) & ~(before.isna() & again.isna())).any(axis=1)
    for place, is_other in zip(np.flatnonzero(is_again).tolist(), differs, strict=True):
        if is_other or not np.array_equal(run.points[place - 1], run.points[place]):
            cell = run.rows.loc[place]
            raise InputError(
                f"two parts disagree about {cell['estimator']} on {cell['scenario']} at "
                f"{cell['snr_db']:g} dB, trial {cell['trial']}; rows of one cell must be equal"
            )
    return run.take(~is_again), positions[~is_again]


def _gaps(plan: Plan, positions: NDArray[np.int64]) -> list[Gap]:
    """Cells of a plan that no part has."""
    missing = np.ones(plan.n_cells, dtype=np.bool_)
    missing[positions] = False
    trials: dict[tuple[str, str, str], list[int]] = {}
    for block in plan.blocks(missing):
        for key in block.entries:
            trials.setdefault((block.scenario, *key), []).append(block.trial)
    return [Gap(*key, len(found), tuple(dict.fromkeys(found))) for key, found in trials.items()]
