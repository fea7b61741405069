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

    from isacbench.bench.store.run import Run
    from isacbench.charts import Table

PLAIN_WIDTH = 100


def report_run(run: Run, with_page: bool = True) -> None:
    """Write the tables of a run, draw its figures and its page, and print all tables but details."""
    from isacbench.report.run_report import write_report

    written, tables = write_report(run, with_page)
    for table in tables:
        if not table.is_detail:
            print_table(table)
    has_score = run.rows.reindex(columns=["deviation", "gospa_m"]).notna()
    if n_dense := int((has_score["deviation"] & ~has_score["gospa_m"]).sum()):
        say(f"{counted(n_dense, 'cell')} without gospa_m: too many pairs of points within the radius")
    say(f"{run.label}: {', '.join(path.name for path in written) or 'no cells, so no tables and no figures'}")


def print_table(table: Table) -> None:
    """Print a table within the width of the terminal or of COLUMNS, otherwise 100 characters."""
    from rich.console import Console

    from isacbench.report.tables import terminal_tables

    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console = Console(width=PLAIN_WIDTH)
    for laid_out in terminal_tables(table, console.width):
        console.print(laid_out)


def print_scores(scores: Mapping[str, float], spreads: Mapping[str, float] | None = None) -> None:
    """Print scores, a line each, with the spreads of those that have any."""
    for name, value in scores.items():
        spread = f" ±{spreads[name]:.3g}" if spreads and name in spreads else ""
        say(f"  {name:<16} {value:.6g}{spread}")


def print_json(content: object) -> None:
    """Print JSON; NaN is an error."""
    typer.echo(visible_json(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)))
