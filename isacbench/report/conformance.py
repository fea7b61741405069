"""What conformance checks found, for the terminal and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from isacbench.registry import distribution
from isacbench.visible import visible, visible_lines

if TYPE_CHECKING:
    from isacbench.conformance import Finding, Status
    from isacbench.registry import Kind

__all__ = ["describe_checks", "print_checks"]

Findings = Mapping[tuple["Kind", str], Sequence["Finding"]]

SHOWN: dict[Status, tuple[str, str]] = {
    "ok": ("ok", "green"),
    "warning": ("warning", "yellow"),
    "failed": ("FAILED", "bold red"),
    "skipped": ("skipped", "dim"),
}
"""Word and colour of a status."""


def describe_checks(found: Findings) -> dict[str, Any]:
    """Put findings in terms of JSON.

    Parameters
    ----------
    found : mapping of (kind, name) to sequence of Finding

    Returns
    -------
    dict
        ``plugins``, each with ``kind``, ``name``, ``package`` and
        ``findings`` (``check``, ``status``, ``message``), and ``counts``, the
        number of findings of every status.
    """
    return {
        "plugins": [
            {
                "kind": kind,
                "name": name,
                "package": distribution(kind, name),
                "findings": [vars(finding) for finding in findings],
            }
            for (kind, name), findings in found.items()
        ],
        "counts": _counts(found),
    }


def print_checks(found: Findings) -> None:
    """Print findings: a line a check, and a line of counts.

    Parameters
    ----------
    found : mapping of (kind, name) to sequence of Finding
    """
    console = Console(soft_wrap=False, highlight=False)
    for (kind, name), findings in found.items():
        console.print(Text(visible(f"{kind} {name} ({distribution(kind, name)})"), style="bold"))
        table = Table.grid(padding=(0, 2))
        for finding in findings:
            word, colour = SHOWN[finding.status]
            table.add_row(
                "",
                Text(word, style=colour),
                Text(visible(finding.check)),
                Text(visible_lines(finding.message)),
            )
        console.print(table)
    counts = ", ".join(f"{n} {SHOWN[status][0]}" for status, n in _counts(found).items() if n)
    plugins = "1 plugin" if len(found) == 1 else f"{len(found)} plugins"
    console.print(f"{plugins}: {counts}")


def _counts(found: Findings) -> dict[Status, int]:
    counted = Counter(finding.status for findings in found.values() for finding in findings)
    return {status: counted[status] for status in SHOWN}
