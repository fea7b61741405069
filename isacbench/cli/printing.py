"""Tables, scores and JSON that commands print, and the report at the end of a run."""

from __future__ import annotations

import json
from contextlib import nullcontext
from typing import TYPE_CHECKING

import typer

from isacbench.cli.app import say
from isacbench.files.escaping import visible_json

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd

    from isacbench.report.figures.background_drawing import BackgroundDrawing
    from isacbench.report.tables.run_tables import Grid

MAX_TABLE_WIDTH = 1000


def report_run(
    folder: Path, records: pd.DataFrame, kind: str, drawing: BackgroundDrawing | None = None
) -> None:
    """Write and print the tables of a run, and draw its figures."""
    from isacbench.report.figures.background_drawing import BackgroundDrawing
    from isacbench.report.tables.tables_by_kind import grids_of, write_run_tables

    for grid in grids_of(records, kind):
        print_grid(grid)
    tables = write_run_tables(folder, records, kind)
    with BackgroundDrawing() if drawing is None else nullcontext(drawing) as hand:
        figures = hand.draw_run(folder)
    say(f"{folder}: {', '.join(path.name for path in [*tables, *figures])}")


def print_grid(grid: Grid) -> None:
    """Print a table, in lines longer than the terminal rather than with cropped numbers."""
    from rich.console import Console

    from isacbench.report.tables.run_tables import rich_table

    table = rich_table(grid)
    width = max(Console().width, Console(width=MAX_TABLE_WIDTH).measure(table).maximum)
    Console(width=width).print(table)


def print_scores(scores: Mapping[str, float]) -> None:
    """Print scores, a line each."""
    for name, value in scores.items():
        say(f"  {name:<16} {value:.6g}")


def print_json(content: object) -> None:
    """Print JSON, NaN refused."""
    typer.echo(visible_json(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)))
