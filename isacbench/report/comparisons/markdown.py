"""Comparison as Markdown: the summary of a job, or a comment on a change."""

from __future__ import annotations

from typing import TYPE_CHECKING

from isacbench.files.escaping import in_markdown, shortened
from isacbench.report.comparisons.comparison_tables import comparison_grids, comparison_lines, outcome_counts
from isacbench.report.comparisons.words import wording
from isacbench.report.tables.run_tables import Grid, markdown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isacbench.bench.compare.comparison import Comparison

MAX_CHARACTERS = 60_000
"""A comment on GitHub takes 65 536."""

MAX_LINE = 600
"""Characters of a line or a cell."""


def comparison_markdown(comparison: Comparison) -> str:
    """Write a comparison as Markdown of bounded length.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
        The verdict first, then the counts, what was compared, a table of
        curves and one of changed points for each score, cells and notes. What
        does not fit is left out, and said to be.
    """
    said = wording(comparison)
    lines = [*_head(said.outcome), _line(outcome_counts(comparison)), "", *_items(said.heading), ""]
    for grid in comparison_grids(comparison):
        lines += markdown(_shortened(grid)).split("\n")
    return _bounded(lines + _items(comparison_lines(comparison)))


def incomparable_markdown(base: str, new: str, reasons: Sequence[str]) -> str:
    """Write that two runs cannot be compared, with all reasons.

    Parameters
    ----------
    base, new : str
        Folders of the runs.
    reasons : sequence of str

    Returns
    -------
    str
    """
    return _bounded([*_head("not comparable"), *_items([f"base {base}", f"new {new}", *reasons])])


def _head(outcome: str) -> list[str]:
    return [f"### isacbench compare: {_line(outcome)}", ""]


def _items(texts: Sequence[str]) -> list[str]:
    return [f"- {_line(text)}" for text in texts]


def _line(text: str) -> str:
    return in_markdown(shortened(text, MAX_LINE))


def _shortened(grid: Grid) -> Grid:
    """Grid whose cells are bounded."""
    return grid._replace(rows=[[shortened(cell, MAX_LINE) for cell in row] for row in grid.rows])


def _bounded(lines: Sequence[str]) -> str:
    """Join the lines that fit."""
    kept, room = [], MAX_CHARACTERS
    for line in lines:
        room -= len(line) + 1
        if room < 0:
            kept += ["", "The rest is left out: it is too long. `isacbench compare --json` has all of it."]
            break
        kept.append(line)
    return "\n".join(kept) + "\n"
