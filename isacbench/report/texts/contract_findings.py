"""Findings of conformance checks, for the terminal and as JSON."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from isacbench.files.escaping import counted, visible, visible_lines

if TYPE_CHECKING:
    from isacbench.checking.contract import CheckReport, PluginFindings, Status

SHOWN: dict[Status, tuple[str, str]] = {
    "ok": ("ok", "green"),
    "warning": ("warning", "yellow"),
    "failed": ("FAILED", "bold red"),
    "skipped": ("skipped", "dim"),
}
"""Word and colour of a status."""


def describe_checks(report: CheckReport) -> dict[str, Any]:
    """Put findings in terms of JSON.

    Parameters
    ----------
    report : CheckReport

    Returns
    -------
    dict
        ``plugins``, each with ``kind``, ``name``, ``package`` and
        ``findings`` (``check``, ``status``, ``message``), and ``counts``, the
        number of findings of every status.
    """
    return {**dataclasses.asdict(report), "counts": report.counts}


def print_findings(plugin: PluginFindings) -> None:
    """Print the findings about a plugin, a line a check.

    Parameters
    ----------
    plugin : PluginFindings
    """
    console = _console()
    console.print(Text(visible(str(plugin)), style="bold"))
    table = Table.grid(padding=(0, 2))
    for finding in plugin.findings:
        word, colour = SHOWN[finding.status]
        table.add_row(
            "",
            Text(word, style=colour),
            Text(visible(finding.check)),
            Text(visible_lines(finding.message)),
        )
    console.print(table)


def print_counts(report: CheckReport) -> None:
    """Print how many checks of all plugins ended how.

    Parameters
    ----------
    report : CheckReport
    """
    counts = ", ".join(f"{n} {SHOWN[status][0]}" for status, n in report.counts.items() if n)
    _console().print(f"{counted(len(report.plugins), 'plugin')}: {counts}")


def _console() -> Console:
    return Console(soft_wrap=False, highlight=False)
