"""Findings of stress, for the terminal, for Markdown and as JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pandas as pd

from isacbench.bench.plan.labels import estimator_labels
from isacbench.charts import Table, text_table
from isacbench.checking.stress.runs.examining import BROKEN
from isacbench.checking.stress.runs.stress_runs import Examined
from isacbench.checking.stress.runs.stress_table import case_table
from isacbench.files.escaping import counted

CASE_WIDTH, TARGET_WIDTH = 64, 16

HEADER = f"{'case':<{CASE_WIDTH}} {'estimator':<{TARGET_WIDTH}} {'outcome':<8} {'drift':>8} {'time':>9}"


def line(examined: Examined) -> str:
    """Write a case in one line: case, estimator, outcome, worst relative drift, time.

    Parameters
    ----------
    examined : Examined

    Returns
    -------
    str
        Of a finding, two more lines: the broken promise, and the command
        that shows it again.
    """
    target, case = examined.task[:2]
    worst, time_s = examined.worst, examined.time_s
    drift = "" if math.isnan(worst.drift) else f"{worst.drift:.1e}"
    took = "" if math.isnan(time_s) else f"{time_s:.2f} s" if time_s >= 1 else f"{1e3 * time_s:.1f} ms"
    shown = (
        f"{case.spec:<{CASE_WIDTH}} {target.spec:<{TARGET_WIDTH}} {examined.outcome:<8} {drift:>8} {took:>9}"
    )
    finding = f"\n    {worst.promise}: {worst.message}\n    {examined.reproduce}"
    return shown + finding if examined.is_broken else shown


def family_grid(cases: pd.DataFrame) -> Table:
    """Tabulate the cases that kept their promises, by family and target.

    Parameters
    ----------
    cases : DataFrame
        From `isacbench.checking.stress.runs.stress_table.case_table`.

    Returns
    -------
    Table
        Kept and all cases, the skipped ones left out.
    """
    told = cases[cases["outcome"] != "skipped"]
    families = told["case"].str.partition("[")[0]
    kept = (~told["outcome"].isin(BROKEN)).groupby([families, _labels(told)], sort=False)
    shares = kept.agg(lambda one: f"{one.sum()}/{one.size}").unstack(fill_value="")
    rows = [[str(family), *shares.loc[family]] for family in shares.index]
    return text_table("cases that keep their promises", ["case", *map(str, shares.columns)], rows)


def promise_grid(promises: pd.DataFrame) -> Table:
    """Tabulate the largest drift of every promise over the cases that keep it, by target.

    Parameters
    ----------
    promises : DataFrame
        From `isacbench.checking.stress.runs.stress_table.promise_table`.

    Returns
    -------
    Table
        With the largest bound of every promise.
    """
    kept = promises[promises["outcome"] == "ok"]
    bounds = kept.groupby("promise", sort=False)["bound"].max()
    worst = kept["drift"].groupby([kept["promise"], _labels(kept)], sort=False).max().unstack()
    rows = [[str(name), *map(_drift, (bounds[name], *worst.loc[name]))] for name in bounds.index]
    header = ["promise", "bound", *map(str, worst.columns)]
    return text_table("largest drift where the promise is kept", header, rows)


def _labels(table: pd.DataFrame) -> pd.Series[Any]:
    """Name of every row's target, for people."""
    variants = list(zip(table["estimator"], table["params"], strict=True))
    labels = estimator_labels(variants)
    return pd.Series([labels[variant] for variant in variants], index=table.index, dtype=object)


def _drift(drift: float) -> str:
    return "" if math.isnan(drift) else f"{drift:.0e}" if drift else "0"


def summary(examined: Sequence[Examined]) -> str:
    """Count outcomes in one line.

    Parameters
    ----------
    examined : sequence of Examined

    Returns
    -------
    str
    """
    counts = sorted(Counter(one.outcome for one in examined).items())
    return (
        f"{counted(len(examined), 'case')}: {', '.join(f'{n} {outcome}' for outcome, n in counts) or 'none'}"
    )


def searched(found: Sequence[Examined], n_examples: int, n_targets: int) -> str:
    """Summarise a search in one line.

    Parameters
    ----------
    found : sequence of Examined
    n_examples : int
        Cases drawn a family and target.
    n_targets : int

    Returns
    -------
    str
    """
    findings = counted(len(found), "finding") if found else "no finding"
    return f"searched {n_examples} cases a family for {counted(n_targets, 'target')}: {findings}"


def describe_stress(examined: Sequence[Examined]) -> dict[str, Any]:
    """Put findings in terms of JSON.

    Parameters
    ----------
    examined : sequence of Examined

    Returns
    -------
    dict
        ``cases``, each with ``kind``, ``case``, ``estimator``, ``outcome``,
        ``promise``, ``drift`` and ``bound`` (null where nothing was
        measured), ``time_s``, ``message``, ``reproduce``; ``counts`` of the
        outcomes.
    """
    cases = case_table(examined).drop(columns=["params", "seed"])
    cases["estimator"] = [one.task.target.spec for one in examined]
    cases = cases.astype(object).where(~cases.isin([math.nan, math.inf]), None)
    counts = Counter(one.outcome for one in examined)
    return {"cases": cases.to_dict("records"), "counts": dict(sorted(counts.items()))}
