"""Tables, scores and JSON that commands print, and the report at the end of a run."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import typer

from isacbench.cli.app import say
from isacbench.files.escaping import counted, visible_json

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

    from isacbench.charts import Table

PLAIN_WIDTH = 100


def report_run(folder: Path, records: pd.DataFrame, kind: str, with_page: bool = True) -> None:
    """Write the tables of a run, draw its figures and its page, and print all tables but details.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    records : DataFrame
        Rows of the run.
    kind : str
        Kind of its suite.
    with_page : bool
        Whether to write the page.
    """
    from isacbench.report.html.guarded_pages import draw_run_and_page
    from isacbench.report.run_tables import tables_of, write_run_tables

    written = [*write_run_tables(folder, records, kind), *draw_run_and_page(folder, with_page)]
    for table in tables_of(records, kind):
        if not table.is_detail:
            print_table(table)
    has_score = records.reindex(columns=["deviation", "gospa_m"]).notna()
    if n_dense := int((has_score["deviation"] & ~has_score["gospa_m"]).sum()):
        say(f"{counted(n_dense, 'cell')} without gospa_m: too many pairs of points within the radius")
    say(f"{folder}: {', '.join(path.name for path in written) or 'no cells, so no tables and no figures'}")


def print_table(table: Table) -> None:
    """Print a table within the width of the terminal or of COLUMNS, otherwise 100 characters."""
    from rich.console import Console

    from isacbench.report.table_texts import terminal_tables

    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console = Console(width=PLAIN_WIDTH)
    for laid_out in terminal_tables(table, console.width):
        console.print(laid_out)


def print_scores(scores: Mapping[str, float], spreads: Mapping[str, float] | None = None) -> None:
    """Print scores, a line each.

    Parameters
    ----------
    scores : mapping of str to float
    spreads : mapping of str to float, optional
        Spreads of some scores, by the same names.
    """
    for name, value in scores.items():
        spread = f" ±{spreads[name]:.3g}" if spreads and name in spreads else ""
        say(f"  {name:<16} {value:.6g}{spread}")


def print_json(content: object) -> None:
    """Print JSON; NaN is an error.

    Parameters
    ----------
    content : object
        Content that JSON can hold.
    """
    typer.echo(visible_json(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)))
