"""The manifest of a run: what was run and scored, by which calls, in which environments, and its plan."""

from __future__ import annotations

import json
import math
import platform
import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from threadpoolctl import threadpool_info

import isacbench
from isacbench.bench.cells.plan import Job, Plan
from isacbench.bench.cells.provenance import Environment, git_state, machine, package_versions
from isacbench.bench.cells.rows import COLUMNS
from isacbench.bench.cells.task import Entry
from isacbench.bench.store.run_folder import MANIFEST, atomic_write, damage_named
from isacbench.bench.suites.scenario_digest import canonical_json, describe_scenario, scenario_digest
from isacbench.bench.suites.suite import Suite
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputError
from isacbench.files.checked_files import MANIFEST_BYTES, path_exists, read_text, require_inside, require_utf8
from isacbench.files.escaping import escape_control
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.model.scene import Scenario
from isacbench.model.scenes.scene_families import spelled_scenarios
from isacbench.plugins.code_digests import plugin_version
from isacbench.plugins.scoring import Metrics, object_kinds
from isacbench.specifications import parse_spec

SCORES = "scores"
"""Key of a manifest with the metrics and their columns."""


def describe_scores(metrics: Metrics, scenarios: Iterable[Scenario]) -> dict[str, Any]:
    """Describe metrics and their columns for a manifest; scenarios have the kinds of objects."""
    kinds = sorted({kind for scenario in scenarios for kind in object_kinds(scenario)})
    columns = {name: asdict(column) for name, column in metrics.columns(kinds).items()}
    for column in columns.values():
        if column["empty"] is not None and math.isnan(column["empty"]):
            column["empty"] = "none"  # JSON has no NaN
    return {"metrics": metrics.described(), "columns": columns}


def stored_columns(manifest: Mapping[str, Any]) -> dict[str, ScoreColumn]:
    """Columns of the scores of a run by their names in rows, as its manifest describes them."""
    return {
        name: ScoreColumn(**{**column, "empty": math.nan if column["empty"] == "none" else column["empty"]})
        for name, column in manifest[SCORES]["columns"].items()
    }


def row_columns(suite: Suite, described: Mapping[str, Any]) -> dict[str, Any]:
    """Columns that the rows of a run have besides `COLUMNS`, each with its value for rows without it.

    `described` are its scores, as `describe_scores` or `stored_columns` have them, by the names of columns.
    """
    scores = {name: math.nan for name in described if name not in COLUMNS}
    return {"label": "", **kind_of(suite).columns, **scores}


def require_same_scores(manifest: Mapping[str, Any], suite: Suite) -> None:
    """Refuse a run whose cells were scored by other metrics, or other versions of them, naming the metric."""
    if SCORES not in manifest:  # missing or damaged
        if suite.metrics is None:
            return
        raise InputError(
            f"{MANIFEST} is missing or damaged: it is not known by which metrics its cells were scored; use "
            "--rerun all, or a new folder"
        )
    wanted, stored = kind_of(suite).metrics_of(suite).described(), manifest[SCORES]["metrics"]
    for name in wanted | stored:
        if wanted.get(name) != stored.get(name):
            found, now = (
                spell_metric(each[name]) if name in each else "not at all" for each in (stored, wanted)
            )
            raise InputError(
                f"its cells were scored by the metric {name}: {found}, wanted: {now}; "
                + ("rescore it first (isacbench rescore)" if name in wanted else f"add --metric {name}")
                + ", or use a new folder"
            )


def spell_metric(metric: Mapping[str, Any]) -> str:
    """Spell version and parameters of a metric."""
    params = "".join(f", {key} = {value}" for key, value in metric["params"].items())
    return f"version {metric['version']}{params}"


RUN_KEYS = ("seed", "suite", SCORES, "estimators", "scenarios", "scenes")
"""Keys of a manifest that describe the content of the run, not the calls that worked on it."""

CALL = ("argv", "started", "wall_time_s", "interrupted")
"""Facts of the last call that a manifest has beside the list of all calls."""

BLAS = "user_api", "internal_api", "version", "architecture"
"""Facts of a linear algebra library."""

ENTRIES = "contestants"
"""Key of a scene's entries in a manifest, as version 0.1 wrote it."""


def describe_session(
    started: datetime, wall_time_s: float, interrupted: bool, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Describe a call that worked on a run, with its options in terms of JSON."""
    return {
        "argv": [escape_control(one) for one in (Path(sys.argv[0]).name, *sys.argv[1:])],
        "started": started.isoformat(timespec="seconds"),
        "wall_time_s": round(wall_time_s, 3),
        "interrupted": interrupted,
        **options,
    }


def describe_run(job: Job) -> dict[str, Any]:
    """Describe the content of a run: the values of `RUN_KEYS`."""
    suite, plan = job.suite, job.plan
    index = {one.key: number for number, one in enumerate(plan.entries)}
    return {
        "seed": suite.seed,
        "suite": suite.model_dump(),
        SCORES: describe_scores(kind_of(suite).metrics_of(suite), job.scenarios.values()),
        "estimators": [
            {"name": one.name, "params": json.loads(one.params), "packages": plugin_version(one.plugin)}
            for one in plan.entries
        ],
        "scenarios": {
            name: {**describe_scenario(scenario), "content": scenario_digest(scenario)}
            for name, scenario in job.scenarios.items()
        },
        "scenes": [
            {
                "name": task.name,
                "content": task.content,
                "snr_db": list(task.snr_db),
                ENTRIES: [index[one.key] for one in task.entries],
            }
            for task in plan.tasks
        ],
    }


def build_manifest(
    run: Mapping[str, Any], environments: Mapping[str, Environment], sessions: list[dict[str, Any]]
) -> dict[str, Any]:
    """Build the manifest of a run, as it will be read.

    `run` has the values of `RUN_KEYS`, `environments` are by the names in the column ``environment``, and the
    last of `sessions` is the call that works on the run now.
    """
    manifest = {
        "isacbench": isacbench.__version__,
        "git": git_state(),
        **dict.fromkeys(CALL),
        **run,
        "environments": {},
        "sessions": [],
        "python": platform.python_version(),
        "packages": package_versions(),
        **machine(),
        "blas_threads": 1,
        "blas": [{key: library.get(key) for key in BLAS} for library in threadpool_info()],
    }
    read: dict[str, Any] = json.loads(json.dumps(with_sessions(manifest, environments, sessions)))
    return read


def with_sessions(
    manifest: Mapping[str, Any], environments: Mapping[str, Environment], sessions: list[dict[str, Any]]
) -> dict[str, Any]:
    """Put environments and calls into a manifest, in place of those that it has."""
    last = {key: sessions[-1][key] for key in CALL}
    return {**manifest, **last, "environments": dict(environments), "sessions": sessions}


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write a manifest, in place of an older one."""
    with atomic_write(folder / MANIFEST) as path:
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        # A file name that is not UTF-8 contains surrogates, which JSON escapes in the same way as Python.
        path.write_text(text, encoding="utf-8", errors="backslashreplace")


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a run. InputError if there is none, or it is damaged."""
    path = folder / MANIFEST
    require_utf8(folder)
    if not path_exists(path):
        raise InputError(
            f"{folder}: not the folder of a run, {MANIFEST} missing; give one that isacbench run wrote"
        )
    require_inside(path, folder)
    with damage_named(folder, f"{MANIFEST}: "):
        return dict(json.loads(read_text(path, MANIFEST_BYTES)))


def scenario_texts(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Look up how the suite of a run spells each scenario: a name, a generated scene or a path."""
    names, texts = list(manifest["scenarios"]), spelled_scenarios(manifest["suite"]["scenarios"])
    if len(names) != len(texts):
        raise InputError(
            f"{MANIFEST}: {len(names)} scenarios are described, but the suite lists {len(texts)}"
        )
    return dict(zip(names, texts, strict=True))


def command_to_show(
    manifest: Mapping[str, Any], scenario: str, estimator: str, snr_db: float, trial: int
) -> str:
    """Spell the command that takes the image of a cell, with plugin files as when the run was made.

    It is empty for a scene that only the suite of the run makes, and where there is no manifest.

    Examples
    --------
    >>> run = {"seed": 0, "scenarios": {"town": {}}, "suite": {"scenarios": ["made/town.toml"]}}
    >>> command_to_show(run, "town", "music2d", 10.0, 0)
    'isacbench image -s made/town.toml -e music2d --snr 10'
    """
    text = scenario_texts(manifest).get(scenario) if manifest else None
    if text is None:
        return ""
    words = ["isacbench", "image", "-s", text, "-e", estimator, "--snr", f"{snr_db:.10g}"]
    numbers = {"--trial": int(trial), "--seed": int(manifest["seed"])}
    words += [word for name, number in numbers.items() if number for word in (name, str(number))]
    paths: dict[str, str] = {}
    for session in manifest.get("sessions", ()):
        paths |= session.get("plugins", {})
    name = parse_spec(estimator).name
    entries = [one for one in manifest.get("estimators", ()) if one["name"] == name]
    for file in dict.fromkeys(file for one in entries for file in one["packages"]):
        words += ["--plugin", paths[file]] if file in paths else []
    return shlex.join(words)


def restore_plan(manifest: Mapping[str, Any]) -> Plan:
    """Build the plan of a run from its manifest.

    Its scenes have name, content, SNRs and entries without plugins: enough to find the places of rows, and
    not to observe.
    """
    entries = [
        Entry(entry["name"], canonical_json(entry["params"]), None) for entry in manifest["estimators"]
    ]
    scenes: list[Any] = [
        SimpleNamespace(**{**scene, "entries": [entries[index] for index in scene[ENTRIES]]})
        for scene in manifest["scenes"]
    ]
    return Plan(scenes, manifest["suite"]["trials"])
