"""Writers of tables: for the terminal, as Markdown and as JSON."""

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from isacbench.charts import Table
from isacbench.files.escaping import escape_control, in_markdown

LONGEST_HEADING, LONGEST_WORDS = 24, 10
LONGEST_NUMBER = 40


def terminal_tables(table: Table, width: int) -> list[RichTable]:
    """Lay out a table for a terminal of some width, in characters.

    Without room it leaves out optional columns, then shows parts one below the other, and last breaks lines.
    """
    for most in sorted({column.optional for column in table.columns}, reverse=True):
        shorter = replace(table, columns=[column for column in table.columns if column.optional <= most])
        if _fits(shorter, width):
            return [_rich_table(shorter)]
    names = [column for column in shorter.columns if column.part == 0]
    parts: list[Table] = []
    for part in dict.fromkeys(column.part for column in shorter.columns if column.part):
        own = [column for column in shorter.columns if column.part == part]
        longer = replace(shorter, columns=[*parts[-1].columns, *own]) if parts else None
        if longer is not None and _fits(longer, width):
            parts[-1] = longer
        else:
            parts.append(replace(shorter, columns=[*names, *own]))
    return [_rich_table(one, no_wrap=_fits(one, width)) for one in parts]


def _fits(table: Table, width: int) -> bool:
    return Console(width=100 * width).measure(_rich_table(replace(table, title=""))).maximum <= width


def _rich_table(table: Table, no_wrap: bool = True) -> RichTable:
    laid_out = RichTable(
        title=Text(escape_control(table.title)) if table.title else None,
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    rows = table.texts
    for place, heading in enumerate(table.headings):
        is_left = place == 0 or any(len(row[place]) > LONGEST_NUMBER for row in rows)
        laid_out.add_column(
            # Text, not a string: brackets are parameters and units here, never markup.
            Text(_stacked(escape_control(heading))),
            justify="left" if is_left else "right",
            no_wrap=no_wrap,
            overflow="ellipsis" if no_wrap else "fold",
        )
    for row in rows:
        # Of a pair of estimators, the second one stands below the first.
        laid_out.add_row(*(Text(escape_control(text).replace(" → ", "\n  → ")) for text in row))
    return laid_out


def _stacked(name: str) -> str:
    """Heading on several lines: unit and score below, and long parameters one bracket a line."""
    label, *below = name.replace(" [", ": [").split(": ")
    if len(label) > LONGEST_HEADING:
        label = label.replace("[", "\n[")
    elif below and len(label) > LONGEST_WORDS and "[" not in label:
        label = label.replace(" ", "\n")
    return "\n".join([label, *below])


def markdown(table: Table) -> str:
    """Write a table in Markdown below its title."""
    rule = ["---"] + ["--:"] * (len(table.columns) - 1)
    header, *rows = ([in_markdown(text) for text in texts] for texts in (table.headings, *table.texts))
    lines = [f"| {' | '.join(texts)} |" for texts in (header, rule, *rows)]
    return "\n".join([f"**{in_markdown(table.title)}**", "", *lines, ""])


def json_rows(table: pd.DataFrame) -> list[dict[Hashable, Any]]:
    """Convert a table to rows in terms of JSON, with null for what is missing or not finite."""
    values = table.astype(object).replace([np.inf, -np.inf], None)
    return values.where(values.notna(), None).to_dict("records")


def signed(number: float) -> str:
    """Write a number with three digits and a sign; zero has none.

    Examples
    --------
    >>> signed(1.2345), signed(-0.0), signed(123.4)
    ('+1.23', '0', '+123')
    """
    return f"{number:+.3g}" if number else "0"
