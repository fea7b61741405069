"""The table of a stress run: a row a case, a row a promise, kept in a folder of its own."""

from __future__ import annotations

import json
import platform
import sys
from typing import TYPE_CHECKING, Any

import pandas as pd

import isacbench
from isacbench.bench.folder import open_folder, replacing
from isacbench.bench.provenance import git_state, machine, package_versions

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from isacbench.stress.running import Examined

__all__ = ["PROMISES", "TABLE", "case_table", "promise_table", "write_tables"]

TABLE, PROMISES, ABOUT = "stress.csv", "promises.csv", "stress.json"


def case_table(examined: Sequence[Examined]) -> pd.DataFrame:
    """A row a case and target.

    Returns
    -------
    DataFrame
        ``kind``, ``case``, ``estimator`` (or detector), ``params``,
        ``outcome``, ``promise`` (the one that is broken, or came closest to
        its bound), ``drift`` and ``bound`` of it, ``time_s``, ``message`` and
        ``reproduce``.
    """
    rows = [
        {
            **_key(one),
            "outcome": one.outcome,
            "promise": one.worst.promise,
            "drift": one.worst.drift,
            "bound": one.worst.bound,
            "time_s": one.time_s,
            "message": one.worst.message,
            "reproduce": one.reproduce,
        }
        for one in examined
    ]
    return pd.DataFrame(rows)


def promise_table(examined: Sequence[Examined]) -> pd.DataFrame:
    """A row a promise, case and target: how the promise fared."""
    return pd.DataFrame([{**_key(one), **verdict._asdict()} for one in examined for verdict in one.verdicts])


def _key(one: Examined) -> dict[str, Any]:
    target, case, seed = one.task
    return {
        "kind": target.kind,
        "case": case.spec,
        "estimator": target.name,
        "params": target.params,
        "seed": seed,
    }


def write_tables(folder: Path, examined: Sequence[Examined], *, timeout_s: float) -> list[Path]:
    """Write both tables, and what made them, into a folder that is new or holds older ones.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If the folder holds something else, or cannot be written.
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
    with open_folder(folder, {*content}, "a stress run"):
        for name, text in content.items():
            with replacing(folder / name) as path:
                path.write_text(text, encoding="utf-8")
    return [folder / name for name in content]
