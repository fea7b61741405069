"""Findings of stress, for the terminal, for Markdown and as JSON."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.plan.labels import estimator_labels
from isacbench.checking.stress.runs.examining import BROKEN
from isacbench.report.tables.run_tables import Grid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.checking.stress.runs.stress_runs import Examined

CASE_WIDTH, TARGET_WIDTH = 64, 16

HEADER = f"{'case':<{CASE_WIDTH}} {'estimator':<{TARGET_WIDTH}} {'outcome':<8} {'drift':>8} {'time':>9}"


def line(examined: Examined) -> str:
    """A case in one line: case, estimator, outcome, worst relative drift, time.

    A finding says which promise is broken, how, and how to see it again, in lines of their own.
    """
    target, case = examined.task[:2]
    drift = "" if math.isnan(examined.worst.drift) else f"{examined.worst.drift:.1e}"
    shown = (
        f"{case.spec:<{CASE_WIDTH}} {target.spec:<{TARGET_WIDTH}} {examined.outcome:<8} {drift:>8} "
        f"{_time(examined.time_s):>9}"
    )
    if not examined.is_broken:
        return shown
    worst = examined.worst
    return f"{shown}\n    {worst.promise}: {worst.message}\n    {examined.reproduce}"


def _time(time_s: float) -> str:
    return "" if math.isnan(time_s) else f"{time_s:.2f} s" if time_s >= 1 else f"{1e3 * time_s:.1f} ms"


def family_grid(cases: pd.DataFrame) -> Grid:
    """Cases that kept their promises, of all that say something, by family and target.

    Parameters
    ----------
    cases : DataFrame
        From `isacbench.checking.stress.runs.stress_table.case_table`.
    """
    told = cases[cases["outcome"] != "skipped"]
    if told.empty:
        return Grid("cases that keep their promises", ["case"], [])
    families = told["case"].str.partition("[")[0]
    is_kept = pd.Series(~told["outcome"].isin(BROKEN), index=told.index)
    by_target = is_kept.groupby([families, _labels(told)], sort=False)
    kept, total = by_target.sum().unstack(), by_target.size().unstack()
    rows = [
        [str(family), *(_share(*counts) for counts in zip(kept.loc[family], total.loc[family], strict=True))]
        for family in total.index
    ]
    return Grid("cases that keep their promises", ["case", *map(str, total.columns)], rows)


def _share(kept: float, total: float) -> str:
    return f"{kept:.0f}/{total:.0f}" if total > 0 else ""


def promise_grid(promises: pd.DataFrame) -> Grid:
    """Largest drift of every promise over all cases that it was kept on, beside its bound, by target.

    Parameters
    ----------
    promises : DataFrame
        From `isacbench.checking.stress.runs.stress_table.promise_table`.
    """
    kept = promises[promises["outcome"] == "ok"]
    if kept.empty:
        return Grid("largest drift where the promise is kept", ["promise", "bound"], [])
    bounds = kept.groupby("promise", sort=False)["bound"].max()
    worst = kept["drift"].groupby([kept["promise"], _labels(kept)], sort=False).max().unstack()
    rows = [
        [str(promise), _drift(bounds[promise]), *(_drift(drift) for drift in worst.loc[promise])]
        for promise in bounds.index
    ]
    return Grid(
        "largest drift where the promise is kept", ["promise", "bound", *map(str, worst.columns)], rows
    )


def _labels(table: pd.DataFrame) -> pd.Series[Any]:
    """Name of every row's target, for people."""
    variants = list(zip(table["estimator"], table["params"], strict=True))
    labels = estimator_labels(variants)
    return pd.Series([labels[variant] for variant in variants], index=table.index, dtype=object)


def _drift(drift: float) -> str:
    return "" if math.isnan(drift) else f"{drift:.0e}" if drift else "0"


def summary(examined: Sequence[Examined]) -> str:
    """Counts of outcomes in one line."""
    counts = Counter(one.outcome for one in examined)
    cases = "1 case" if len(examined) == 1 else f"{len(examined)} cases"
    return f"{cases}: {', '.join(f'{n} {outcome}' for outcome, n in sorted(counts.items())) or 'none'}"


def searched(found: Sequence[Examined], n_examples: int, n_targets: int) -> str:
    """Say in one line what a search came to."""
    targets = "1 target" if n_targets == 1 else f"{n_targets} targets"
    findings = "no finding" if not found else "1 finding" if len(found) == 1 else f"{len(found)} findings"
    return f"searched {n_examples} cases a family for {targets}: {findings}"


def describe_stress(examined: Sequence[Examined]) -> dict[str, Any]:
    """Put what was found in terms of JSON.

    Returns
    -------
    dict
        ``cases``, each with ``kind``, ``case``, ``estimator``, ``outcome``,
        ``promise``, ``drift`` and ``bound`` (null where nothing was
        measured), ``time_s``, ``message``, ``reproduce``; ``counts`` of the
        outcomes.
    """
    return {
        "cases": [
            {
                "kind": one.task.target.kind,
                "case": one.task.case.spec,
                "estimator": one.task.target.spec,
                "outcome": one.outcome,
                "promise": one.worst.promise,
                "drift": _number(one.worst.drift),
                "bound": _number(one.worst.bound),
                "time_s": _number(one.time_s),
                "message": one.worst.message,
                "reproduce": one.reproduce,
            }
            for one in examined
        ],
        "counts": dict(sorted(Counter(one.outcome for one in examined).items())),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
