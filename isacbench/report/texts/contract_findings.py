"""Findings of the contract check, for the terminal and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from isacbench.files.escaping import counted, visible, visible_lines

if TYPE_CHECKING:
    from isacbench.checking.plugin_check import CheckReport, PluginFindings

WORDS = {
    "ok": ("ok", "green"),
    "warning": ("warning", "yellow"),
    "failed": ("FAILED", "bold red"),
    "skipped": ("skipped", "dim"),
}
"""Word and colour of a status."""


def describe_checks(report: CheckReport) -> dict[str, Any]:
    """Findings in terms of JSON: of every plugin, and the number of every status."""
    plugins = [
        {
            "kind": plugin.kind,
            "name": plugin.name,
            "package": plugin.package,
            "findings": [
                {"check": finding.check, "status": finding.status, "message": finding.message}
                for finding in plugin.findings
            ],
        }
        for plugin in report.plugins
    ]
    return {"plugins": plugins, "counts": report.counts}


def print_findings(plugin: PluginFindings) -> None:
    """Print the findings about a plugin, a line a check."""
    console = _console()
    console.print(Text(visible(str(plugin)), style="bold"))
    table = Table.grid(padding=(0, 2))
    for finding in plugin.findings:
        word, colour = WORDS[finding.status]
        table.add_row(
            "",
            Text(word, style=colour),
            Text(visible(finding.check)),
            Text(visible_lines(finding.message)),
        )
    console.print(table)


def print_counts(report: CheckReport) -> None:
    """Print how many checks of all plugins ended how."""
    counts = ", ".join(f"{n} {WORDS[status][0]}" for status, n in report.counts.items() if n)
    _console().print(f"{counted(len(report.plugins), 'plugin')}: {counts}")


def _console() -> Console:
    return Console(soft_wrap=False, highlight=False)
