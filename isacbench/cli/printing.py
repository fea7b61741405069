"""What commands print: tables, scores, JSON and progress, and the report at the end of a run."""

from __future__ import annotations

import json
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

import typer

from isacbench.cli.app import say
from isacbench.visible import visible, visible_json

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    import pandas as pd

    from isacbench.bench.runner import Progress
    from isacbench.bench.suite import Kind
    from isacbench.report.aside import Aside
    from isacbench.report.tables import Grid

__all__ = ["print_grid", "print_json", "print_scores", "progress_bar", "report_run"]

MAX_TABLE_WIDTH = 1000


def report_run(folder: Path, records: pd.DataFrame, kind: Kind, aside: Aside | None = None) -> None:
    """Write and print the tables of a run, and draw its figures."""
    from isacbench.report.aside import Aside
    from isacbench.report.kinds import grids_of, write_tables

    for grid in grids_of(records, kind):
        print_grid(grid)
    tables = write_tables(folder, records, kind)
    with Aside() if aside is None else nullcontext(aside) as hand:
        figures = hand.draw_run(folder)
    say(f"{folder}: {', '.join(path.name for path in [*tables, *figures])}")


def print_grid(grid: Grid) -> None:
    """Print a table, in lines longer than the terminal rather than with cropped numbers."""
    from rich.console import Console

    from isacbench.report.tables import rich_table

    table = rich_table(grid)
    width = max(Console().width, Console(width=MAX_TABLE_WIDTH).measure(table).maximum)
    Console(width=width).print(table)


@contextmanager
def progress_bar(title: str, is_idle: bool = False) -> Iterator[Progress]:
    """Bar with the time left on stderr; silent where that is no terminal.

    An idle one draws when a cell is done and not while others work.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda done, total: None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns,
        console=console,
        transient=True,
        auto_refresh=not is_idle,
    ) as bar:
        task = bar.add_task(visible(title), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total, refresh=is_idle)


def print_scores(scores: Mapping[str, float]) -> None:
    """Print scores, a line each."""
    for name, value in scores.items():
        say(f"  {name:<16} {value:.6g}")


def print_json(content: object) -> None:
    """Print JSON, NaN refused."""
    typer.echo(visible_json(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)))
