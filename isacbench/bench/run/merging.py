"""Merging of runs: shards of one run, or runs of one suite that differ in their estimators alone.

They are merged by the plans that their manifests keep, so that no plugin has to be installed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.record import TIMES, TIMING_COLUMNS, typed
from isacbench.bench.plan.run_plan import Plan
from isacbench.bench.store.manifest import (
    ENTRIES,
    RUN_KEYS,
    SCORES,
    build_manifest,
    describe_session,
    restore_plan,
    row_columns,
)
from isacbench.bench.store.provenance import differing_versions
from isacbench.bench.store.run import Run, Scenes
from isacbench.bench.store.run_folder import RUN_FILES, open_folder
from isacbench.bench.suites.scenario_digest import canonical_json
from isacbench.bench.suites.suite_kinds import restore_suite
from isacbench.errors import InputError
from isacbench.files.escaping import shortened
from isacbench.specifications import spec_variants

BESIDE = {"name", "kind", "seed", "version", "estimators", "scenarios", "metrics"}
"""Keys of a suite that are compared in other ways than by their values."""


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
    _require_one_suite(parts)
    described = _described(parts)
    plan, suite = restore_plan(described), restore_suite(described["suite"])
    together = Run.joined(parts)
    if not mix_versions:
        _require_equal_versions(together)
    positions = plan.positions(together.rows)
    if (positions < 0).any():
        first = together.rows[positions < 0].iloc[0]
        raise InputError(
            f"rows of {first['estimator']} with {first['params']} are not in the plan that the manifests of "
            "the parts describe"
        )
    together, positions = _without_repeats(together, positions)
    sessions = _sessions(parts, len(positions) < plan.n_cells)
    run = together.changed(
        label=str(out),
        rows=typed(together.rows, row_columns(suite, described[SCORES]["columns"])),
        manifest=build_manifest(described, together.environments, sessions),
        read_scenes=lambda: Scenes(suite, parts[0].scenarios, _draws(parts, described["scenes"])),
    )
    with open_folder(out) as folder:
        run.save(folder)
    return Merged(run, plan.n_cells, _gaps(plan, positions))


def _sessions(parts: Sequence[Run], is_partial: bool) -> list[dict[str, Any]]:
    """Calls that worked on the parts, and this one."""
    wall_time_s = sum(part.manifest["wall_time_s"] for part in parts)
    options = {"merged": [part.label for part in parts]}
    last = describe_session(datetime.now().astimezone(), wall_time_s, is_partial, options)
    earlier = chain.from_iterable(part.manifest.get("sessions", ()) for part in parts)
    return [*sorted(earlier, key=lambda entry: entry["started"]), last]


def _open(folder: Path) -> Run:
    """Open a part, of which nothing may be missing."""
    run = Run.open(folder)
    if missing := [key for key in RUN_KEYS if key not in run.manifest]:
        raise InputError(
            f"{folder}: its manifest has no {missing[0]} (written by an older isacbench); resume the run "
            "with this version first"
        )
    if (run.rows["deviation"].notna() & ~run.is_whole()).any():
        raise InputError(f"{folder}: damaged run: some clouds are missing; isacbench run restores them")
    return run


def _require_one_suite(parts: Sequence[Run]) -> None:
    """Refuse parts of different suites, seeds or metrics, or with different contents of a scenario."""
    known: dict[str, tuple[str, Any]] = {}
    for part in parts:
        for what, value in _facts(part):
            label, first = known.setdefault(what, (part.label, value))
            if value != first:
                one, other = (shortened("none" if it is None else str(it)) for it in (first, value))
                raise InputError(
                    f"{label} and {part.label}: {what} differs ({one}, {other}); only parts of one suite "
                    "can be merged: shards of one run, or runs that differ in their estimators alone"
                )


def _facts(part: Run) -> Iterator[tuple[str, Any]]:
    """Facts that must be equal in all parts that have them."""
    manifest, suite = part.manifest, part.suite
    yield from {"suite": suite.name, "kind": suite.kind, "seed": suite.seed}.items()
    metrics = manifest[SCORES]["metrics"]
    yield from ((f"metric {name!r}", metric) for name, metric in metrics.items())
    if hasattr(suite, "version"):
        yield "version of the population", suite.version
    for name, entry in manifest["scenarios"].items():
        yield f"content of scenario {name!r}", entry["content"]
    for entry in manifest["scenes"]:
        yield f"content of scene {entry['name']!r}", entry["content"]
    yield "metrics", ", ".join(sorted(metrics))
    yield from ((key, value) for key, value in suite.model_dump().items() if key not in BESIDE)
    yield "scenarios", ", ".join(manifest["scenarios"])  # by name: their paths differ from machine to machine


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


def _described(parts: Sequence[Run]) -> dict[str, Any]:
    """Description of the whole run: that of the first part, with the estimators of all."""
    first = parts[0].manifest
    described = {key: first[key] for key in RUN_KEYS}
    if all(part.manifest[key] == first[key] for part in parts for key in ("estimators", "scenes")):
        return described
    entries: dict[tuple[str, str], Any] = {}
    texts: dict[tuple[str, str], str] = {}
    for part in parts:
        own, scenes = part.manifest["estimators"], part.manifest["scenes"]
        spelled = [text for spec in part.suite.estimators for text, _ in spec_variants(spec)]
        if len(spelled) != len(own) or any(scene[ENTRIES] != [*range(len(own))] for scene in scenes):
            raise InputError(
                f"{part.label}: not all of its estimators meet every scene; only shards of one such run "
                "can be merged"
            )
        for text, entry in zip(spelled, own, strict=True):
            key = entry["name"], canonical_json(entry["params"])
            if text in texts.values() and key not in texts:
                raise InputError(
                    f"{parts[0].label} and {part.label}: the parameters of {text} differ, because different "
                    "versions wrote them"
                )
            entries.setdefault(key, entry)
            texts.setdefault(key, text)
    return {
        **described,
        "suite": {**first["suite"], "estimators": [*texts.values()]},
        "estimators": [*entries.values()],
        "scenes": [{**scene, ENTRIES: [*range(len(entries))]} for scene in first["scenes"]],
    }


def _without_repeats(run: Run, positions: NDArray[np.int64]) -> tuple[Run, NDArray[np.int64]]:
    """Rows in the order of the table, each cell once, timed if any part has timed it; and their positions."""
    order = np.lexsort([~run.rows["timing"].to_numpy(dtype=np.bool_), positions])
    run, positions = run.take(order), positions[order]
    is_again = np.diff(positions, prepend=-1) == 0
    (again,) = np.nonzero(is_again)
    _require_agreement(run.take(again - 1), run.take(again))
    return run.take(~is_again), positions[~is_again]


def _require_agreement(one: Run, other: Run) -> None:
    """Refuse different rows of the same cells, apart from times."""
    others = {*TIMES, *TIMING_COLUMNS, "timing", "environment", "label"}
    columns = [name for name in one.rows if name not in others]
    left, right = one.rows[columns], other.rows[columns]
    clouds = zip(one.points, other.points, strict=True)
    is_same = np.array([np.array_equal(cloud, again) for cloud, again in clouds], dtype=np.bool_)
    agree = ((left == right) | (left.isna() & right.isna())).all(axis=1) & is_same
    if not agree.all():
        cell = one.rows[~agree].iloc[0]
        raise InputError(
            f"two parts disagree about {cell['estimator']} on {cell['scenario']} at {cell['snr_db']:g} dB, "
            f"trial {cell['trial']}; rows of one cell must be equal"
        )


def _draws(parts: Sequence[Run], scenes: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Scatterers that the parts drew, each trial of a scene once, in the order of the table."""
    # A part that was killed has none; a table of none has other types, and so another digest.
    held = [part.draws.assign(part=n) for n, part in enumerate(parts) if len(part.draws)]
    if not held:
        return parts[0].draws
    draws = pd.concat(held, ignore_index=True)
    first = draws.groupby(["scenario", "trial"])["part"].transform("min")
    draws = draws[draws["part"] == first].drop(columns="part")
    scene = pd.Index([scene["name"] for scene in scenes]).get_indexer(pd.Index(draws["scenario"]))
    return draws.iloc[np.lexsort([draws["trial"].to_numpy(dtype=np.int64), scene])].reset_index(drop=True)


def _gaps(plan: Plan, positions: NDArray[np.int64]) -> list[Gap]:
    """Cells of a plan that no part has."""
    missing = np.ones(plan.n_cells, dtype=np.bool_)
    missing[positions] = False
    trials: dict[tuple[str, str, str], list[int]] = {}
    for block in plan.blocks(missing):
        for key in block.entries:
            trials.setdefault((block.scenario, *key), []).append(block.trial)
    return [Gap(*key, len(found), tuple(dict.fromkeys(found))) for key, found in trials.items()]
