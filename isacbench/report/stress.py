"""What stress found, for the terminal, for Markdown and as JSON."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from isacbench.report.tables import Grid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.stress.running import Examined

__all__ = ["HEADER", "describe_stress", "family_grid", "line", "promise_grid", "searched", "summary"]

CASE_WIDTH, TARGET_WIDTH = 64, 16

HEADER = f"{'case':<{CASE_WIDTH}} {'estimator':<{TARGET_WIDTH}} {'outcome':<8} {'drift':>8} {'time':>9}"


def line(examined: Examined) -> str:
    """A case in one line: case, estimator, outcome, worst relative drift, time.

    A finding says which promise is broken, how, and how to see it again, in lines of their own.
    """
    target, case, _ = examined.task
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


def family_grid(examined: Sequence[Examined]) -> Grid:
    """Cases that kept their promises, of all, by family and target."""
    families = list(dict.fromkeys(one.task.case.name for one in examined))
    targets = list(dict.fromkeys(one.task.target.spec for one in examined))
    kept: Counter[tuple[str, str]] = Counter()
    total: Counter[tuple[str, str]] = Counter()
    for one in examined:
        if one.outcome != "skipped":
            key = one.task.case.name, one.task.target.spec
            total[key] += 1
            kept[key] += not one.is_broken
    rows = [
        [
            family,
            *(
                f"{kept[family, target]}/{total[family, target]}" if total[family, target] else ""
                for target in targets
            ),
        ]
        for family in families
    ]
    return Grid("cases that keep their promises", ["case", *targets], rows)


def promise_grid(examined: Sequence[Examined]) -> Grid:
    """Largest drift of every promise over all cases that it was kept on, beside its bound, by target."""
    targets = list(dict.fromkeys(one.task.target.spec for one in examined))
    bounds: dict[str, float] = {}
    worst: dict[tuple[str, str], float] = {}
    for one in examined:
        for verdict in one.verdicts:
            if verdict.outcome == "ok":
                key = verdict.promise, one.task.target.spec
                bounds[verdict.promise] = max(verdict.bound, bounds.get(verdict.promise, 0.0))
                worst[key] = max(verdict.drift, worst.get(key, 0.0))
    rows = [
        [promise, _drift(bound), *(_drift(worst.get((promise, target))) for target in targets)]
        for promise, bound in bounds.items()
    ]
    return Grid("largest drift where the promise is kept", ["promise", "bound", *targets], rows)


def _drift(drift: float | None) -> str:
    return "" if drift is None else f"{drift:.0e}" if drift else "0"


def summary(examined: Sequence[Examined]) -> str:
    """Counts of outcomes in one line."""
    counts = Counter(one.outcome for one in examined)
    return f"{len(examined)} cases: {', '.join(f'{n} {outcome}' for outcome, n in sorted(counts.items()))}"


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
