"""Findings of checks and of stress, for the terminal, for Markdown and as JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from isacbench.bench.labels import estimator_labels
from isacbench.charts import Table, text_table
from isacbench.checking.plugin_check import CheckReport, PluginFindings
from isacbench.checking.stress import BROKEN, CaseResult, case_table
from isacbench.files.escaping import escape_control, escape_lines, plural
from isacbench.report.tables import json_rows

WORDS = {
    "ok": ("ok", "green"),
    "warning": ("warning", "yellow"),
    "failed": ("FAILED", "bold red"),
    "skipped": ("skipped", "dim"),
}
"""Word and colour of a status."""


def describe_checks(report: CheckReport) -> dict[str, Any]:
    """Findings in terms of JSON: of every plugin, and the number of every status."""
    keys = "check", "status", "message"
    plugins = [
        vars(plugin) | {"findings": [{key: getattr(one, key) for key in keys} for one in plugin.findings]}
        for plugin in report.plugins
    ]
    return {"plugins": plugins, "counts": report.counts}


def print_findings(plugin: PluginFindings) -> None:
    """Print the findings about a plugin, a line a check."""
    table = RichTable.grid(padding=(0, 2))
    for finding in plugin.findings:
        word, colour = WORDS[finding.status]
        message = escape_lines(finding.message)
        table.add_row("", Text(word, style=colour), Text(escape_control(finding.check)), Text(message))
    console = Console(soft_wrap=False, highlight=False)
    console.print(Text(escape_control(str(plugin)), style="bold"))
    console.print(table)


def counts_line(report: CheckReport) -> str:
    """Count how many checks of all plugins ended how."""
    counts = ", ".join(f"{n} {WORDS[status][0]}" for status, n in report.counts.items() if n)
    return f"{plural(len(report.plugins), 'plugin')}: {counts}"


CASE_WIDTH, TARGET_WIDTH = 64, 16

HEADER = f"{'case':<{CASE_WIDTH}} {'estimator':<{TARGET_WIDTH}} {'outcome':<8} {'drift':>8} {'time':>9}"


def line(result: CaseResult) -> str:
    """Write a case in one line: case, estimator, outcome, worst relative difference, time.

    Of a broken one, two more lines: the check that failed, and the command that shows it again.
    """
    target, case = result.task[:2]
    worst, time_s = result.worst, result.time_s
    difference = "" if math.isnan(worst.difference) else f"{worst.difference:.1e}"
    took = "" if math.isnan(time_s) else f"{time_s:.2f} s" if time_s >= 1 else f"{1e3 * time_s:.1f} ms"
    names = f"{case.spec:<{CASE_WIDTH}} {target.spec:<{TARGET_WIDTH}}"
    finding = f"\n    {worst.check}: {worst.message}\n    {result.reproduce}" if result.is_broken else ""
    return f"{names} {result.status:<8} {difference:>8} {took:>9}{finding}"


def family_grid(cases: pd.DataFrame) -> Table:
    """Tabulate how many cases of a `case_table` are kept, of those not skipped, by family and target."""
    made = cases[cases["outcome"] != "skipped"]
    families = made["case"].str.partition("[")[0]
    kept = (~made["outcome"].isin(BROKEN)).groupby([families, _labels(made)], sort=False)
    shares = kept.agg(lambda one: f"{one.sum()}/{one.size}").unstack(fill_value="")
    rows = [[str(family), *shares.loc[family]] for family in shares.index]
    return text_table("cases that keep their promises", ["case", *map(str, shares.columns)], rows)


def promise_grid(checks: pd.DataFrame) -> Table:
    """Tabulate the largest bound of every check of a `check_table`, and the largest difference by target."""
    kept = checks[checks["outcome"] == "ok"]
    bounds = kept.groupby("promise", sort=False)["bound"].max()
    worst = kept["drift"].groupby([kept["promise"], _labels(kept)], sort=False).max().unstack()
    rows = [[str(name), *map(_number, (bounds[name], *worst.loc[name]))] for name in bounds.index]
    header = ["promise", "bound", *map(str, worst.columns)]
    return text_table("largest drift where the promise is kept", header, rows)


def _labels(table: pd.DataFrame) -> pd.Series[Any]:
    """Name of every row's target, for people."""
    variants = list(zip(table["estimator"], table["params"], strict=True))
    labels = estimator_labels(variants)
    return pd.Series([labels[variant] for variant in variants], index=table.index, dtype=object)


def _number(difference: float) -> str:
    return "" if math.isnan(difference) else f"{difference:.0e}" if difference else "0"


def summary(results: Sequence[CaseResult]) -> str:
    """Count outcomes in one line."""
    counts = sorted(Counter(result.status for result in results).items())
    return f"{plural(len(results), 'case')}: {', '.join(f'{n} {status}' for status, n in counts) or 'none'}"


def describe_stress(results: Sequence[CaseResult]) -> dict[str, Any]:
    """Cases in terms of JSON, null where nothing was measured, and the number of every outcome."""
    cases = case_table(results).drop(columns=["params", "seed"])
    cases["estimator"] = [result.task.target.spec for result in results]
    counts = Counter(result.status for result in results)
    return {"cases": json_rows(cases), "counts": dict(sorted(counts.items()))}
