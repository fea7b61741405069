"""Tables of a stress run: a row a case, a row a check, kept in a folder of their own."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pandas as pd

import isacbench
from isacbench.bench.store.provenance import git_state, machine, package_versions
from isacbench.bench.store.run_folder import open_folder, replacing
from isacbench.checking.checks import Finding
from isacbench.checking.stress import CaseResult

KEY = ["kind", "case", "estimator", "params", "seed"]
CASE_COLUMNS = [*KEY, "outcome", "promise", "drift", "bound", "time_s", "message", "reproduce"]
CHECK_COLUMNS = [*KEY, "promise", "outcome", "drift", "bound", "time_s", "message"]

TABLE, PROMISES, ABOUT = "stress.csv", "promises.csv", "stress.json"


def case_table(results: Sequence[CaseResult]) -> pd.DataFrame:
    """A row a case and target, with the check that is broken, or came closest to its bound."""
    rows = [
        {
            **_columns(result, result.worst),
            "outcome": result.status,
            "time_s": result.time_s,
            "reproduce": result.reproduce,
        }
        for result in results
    ]
    return pd.DataFrame(rows, columns=CASE_COLUMNS)


def check_table(results: Sequence[CaseResult]) -> pd.DataFrame:
    """A row a check, case and target."""
    rows = [_columns(result, finding) for result in results for finding in result.findings]
    return pd.DataFrame(rows, columns=CHECK_COLUMNS)


def _columns(result: CaseResult, finding: Finding) -> dict[str, Any]:
    target, case, seed = result.task[:3]
    return {
        **dict(zip(KEY, (target.kind, case.spec, target.name, target.params, seed), strict=True)),
        "promise": finding.check,
        "outcome": finding.status,
        "drift": finding.difference,
        "bound": finding.bound,
        "time_s": finding.time_s,
        "message": finding.message,
    }


def write_stress_tables(folder: Path, results: Sequence[CaseResult], *, timeout_s: float) -> list[Path]:
    """Write both tables, and what made them, in place of older ones."""
    about = {
        "isacbench": isacbench.__version__,
        "git": git_state(),
        "python": platform.python_version(),
        "packages": package_versions(),
        "machine": machine(),
        "argv": sys.argv,
        "seeds": sorted({result.task.seed for result in results}),
        "timeout_s": timeout_s,
        "n_cases": len(results),
        "n_findings": sum(result.is_broken for result in results),
    }
    content = {
        TABLE: case_table(results).to_csv(index=False),
        PROMISES: check_table(results).to_csv(index=False),
        ABOUT: json.dumps(about, indent=2, ensure_ascii=False) + "\n",
    }
    for name, text in content.items():
        with replacing(folder / name) as path:
            path.write_text(text, encoding="utf-8")
    return [folder / name for name in content]


def open_stress_folder(folder: Path) -> AbstractContextManager[Path]:
    """Create the folder of a stress run, or enter one to replace its tables, and keep others out."""
    return open_folder(folder, {TABLE, PROMISES, ABOUT}, "a stress run")
