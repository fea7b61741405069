"""Tables of a stress run: a row a case, a row a promise, kept in a folder of their own."""

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
from isacbench.checking.stress.runs.examining import Verdict
from isacbench.checking.stress.runs.stress_runs import Examined

KEY = ["kind", "case", "estimator", "params", "seed"]
CASE_COLUMNS = [*KEY, "outcome", "promise", "drift", "bound", "time_s", "message", "reproduce"]

TABLE, PROMISES, ABOUT = "stress.csv", "promises.csv", "stress.json"


def case_table(examined: Sequence[Examined]) -> pd.DataFrame:
    """Tabulate cases.

    Returns
    -------
    DataFrame
        A row a case and target: ``kind``, ``case``, ``estimator`` (or
        detector), ``params``, ``seed``, ``outcome``, ``promise`` (the one that
        is broken, or came closest to its bound), ``drift`` and ``bound`` of
        it, ``time_s``, ``message`` and ``reproduce``.
    """
    rows = [
        {
            **_key(one),
            **one.worst._asdict(),
            "outcome": one.outcome,
            "time_s": one.time_s,
            "reproduce": one.reproduce,
        }
        for one in examined
    ]
    return pd.DataFrame(rows, columns=CASE_COLUMNS)


def promise_table(examined: Sequence[Examined]) -> pd.DataFrame:
    """Tabulate promises.

    Returns
    -------
    DataFrame
        A row a promise, case and target: the key columns of `case_table`, and
        the fields of `Verdict`.
    """
    rows = [{**_key(one), **verdict._asdict()} for one in examined for verdict in one.verdicts]
    return pd.DataFrame(rows, columns=[*KEY, *Verdict._fields])


def _key(one: Examined) -> dict[str, Any]:
    target, case, seed = one.task[:3]
    return dict(zip(KEY, (target.kind, case.spec, target.name, target.params, seed), strict=True))


def write_stress_tables(folder: Path, examined: Sequence[Examined], *, timeout_s: float) -> list[Path]:
    """Write both tables, and what made them, in place of older ones.

    Parameters
    ----------
    timeout_s : float
        Longest time of a case in s, recorded.

    Raises
    ------
    InputError
        If they cannot be written.
    """
    about = {
        "isacbench": isacbench.__version__,
        "git": git_state(),
        "python": platform.python_version(),
        "packages": package_versions(),
        "machine": machine(),
        "argv": sys.argv,
        "seeds": sorted({one.task.seed for one in examined}),
        "timeout_s": timeout_s,
        "n_cases": len(examined),
        "n_findings": sum(one.is_broken for one in examined),
    }
    content = {
        TABLE: case_table(examined).to_csv(index=False),
        PROMISES: promise_table(examined).to_csv(index=False),
        ABOUT: json.dumps(about, indent=2, ensure_ascii=False) + "\n",
    }
    for name, text in content.items():
        with replacing(folder / name) as path:
            path.write_text(text, encoding="utf-8")
    return [folder / name for name in content]


def open_stress_folder(folder: Path) -> AbstractContextManager[Path]:
    """Create the folder of a stress run, or enter one whose tables are to be replaced, and keep others out.

    Raises
    ------
    InputError
        If it cannot be created, holds something else, or another run writes
        into it.
    """
    return open_folder(folder, {TABLE, PROMISES, ABOUT}, "a stress run")
