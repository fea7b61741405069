"""Log of looks at reporting scenes: what was looked at once can be tuned on."""

from __future__ import annotations

import csv
from datetime import date
from pathlib import Path

import isacbench
from isacbench.bench.cells.provenance import git_state
from isacbench.bench.suites.suite import Suite
from isacbench.model.scenes.scene_families import family_specs, is_family_spec, use_of_seed

LOG = Path(isacbench.__file__).parents[1] / "results" / "looks.csv"
"""In a checkout; a package that is installed has none."""


def record_look(suite: Suite, log: Path = LOG) -> Path | None:
    """Record that a suite looks at scenes for reporting, in a checkout of isacbench, whose log exists.

    The same look, with the same estimators and code on the same day, is recorded once. Returned is the log
    where something was added.
    """
    specs = [spec for text in suite.scenarios if is_family_spec(text) for spec in family_specs(text)]
    seeds = [spec.parameters.seed for spec in specs if use_of_seed(spec.parameters.seed) == "reporting"]
    if not seeds or not log.exists():
        return None
    commit = str((git_state() or {}).get("commit") or "")[:10]
    look = [date.today().isoformat(), suite.name, min(seeds), max(seeds), len(seeds)]
    row = [*map(str, look), " ".join(suite.estimators), commit]
    with log.open("r+", newline="", encoding="utf-8") as file:
        if row in list(csv.reader(file)):
            return None
        csv.writer(file, lineterminator="\n").writerow(row)
    return log
