"""The application: group of commands, exit codes, and all that commands print."""

from __future__ import annotations

import atexit
import gc
import json
import os
import sys
import threading
import warnings
from collections.abc import Mapping
from contextlib import suppress
from enum import IntEnum
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from isacbench import __version__
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import escape_control, escape_json, escape_lines, plural
from isacbench.process_state import own_output

if TYPE_CHECKING:
    from isacbench.bench.store.run import Run
    from isacbench.charts import Table
    from isacbench.report.drawing import DrawingProcess

PLAIN_WIDTH = 100


class Exit(IntEnum):
    """Exit codes."""

    USAGE = 2
    FAILED_CELLS = 3
    REGRESSION = 4
    NOT_COMPARABLE = 5
    INTERRUPTED = 130  # 128 + SIGINT, as in shells
    TERMINATED = 143  # 128 + SIGTERM


class _Group(TyperGroup):
    """Group of commands in which bad input ends with one line on stderr and exit code 2.

    So do other errors of the system and of values; ``python -X dev -m isacbench`` shows where they come from.
    """

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the arguments name, with warnings about input as one line on stderr."""

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                say(f"isacbench: warning: {message}", err=True)
            else:
                show_with_source(message, category, *where, **more)

        show_with_source = warnings.showwarning
        try:
            with warnings.catch_warnings():
                warnings.showwarning = show
                return super().invoke(ctx)
        except InputError as error:
            fail(str(error), Exit.USAGE)
        except (OSError, ValueError, LookupError, TypeError) as error:
            if sys.flags.dev_mode:
                raise
            fail(f"{type(error).__name__}: {error} (`python -X dev -m isacbench` shows where)", Exit.USAGE)


app = typer.Typer(
    name="isacbench",
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Benchmark the accuracy and the speed of radar imaging with 5G downlink signals.",
)


def main() -> None:
    """Run the command line; a thread that a plugin has left does not keep it from ending."""
    atexit.register(gc.freeze)  # a last search for garbage would take a third of a second
    try:
        with own_output():
            app()
    except SystemExit as ending:
        others = set(threading.enumerate()) - {threading.main_thread()}
        if all(thread.daemon for thread in others):
            raise
        for stream in filter(None, (sys.stdout, sys.stderr)):
            with suppress(OSError):  # whose reader is gone
                stream.flush()
        os._exit(ending.code if isinstance(ending.code, int) else int(ending.code is not None))


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"isacbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def say(*messages: str, err: bool = False) -> None:
    """Print messages on stdout or stderr, a line each, with control characters escaped."""
    for message in messages:
        typer.echo(escape_control(message), err=err)


def say_lines(message: str) -> None:
    """Print several lines, with other control characters escaped."""
    typer.echo(escape_lines(message))


def fail(message: str, code: int) -> NoReturn:
    """End the command with one line on stderr and an exit code."""
    say(f"isacbench: {message}", err=True)
    raise typer.Exit(code)


def print_json(content: object) -> None:
    """Print JSON; NaN is an error."""
    typer.echo(escape_json(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)))


def print_scores(scores: Mapping[str, float], spreads: Mapping[str, float] | None = None) -> None:
    """Print scores, a line each, with the spreads of those that have any."""
    for name, value in scores.items():
        spread = f" ±{spreads[name]:.3g}" if spreads and name in spreads else ""
        say(f"  {name:<16} {value:.6g}{spread}")


def print_tables(*tables: Table) -> None:
    """Print tables within the width of the terminal or of COLUMNS, otherwise 100 characters."""
    from rich.console import Console

    from isacbench.report.tables import terminal_tables

    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console = Console(width=PLAIN_WIDTH)
    for laid_out in chain.from_iterable(terminal_tables(table, console.width) for table in tables):
        console.print(laid_out)


def report_run(run: Run, with_page: bool = True, helper: DrawingProcess | None = None) -> None:
    """Write the tables of a run, draw its figures and its page, and print all tables but details."""
    from isacbench.report.run_report import write_report

    written, tables = write_report(run, with_page, helper)
    print_tables(*(table for table in tables if not table.is_detail))
    has_score = run.rows.reindex(columns=["deviation", "gospa_m"]).notna()
    if n_dense := int((has_score["deviation"] & ~has_score["gospa_m"]).sum()):
        say(f"{plural(n_dense, 'cell')} without gospa_m: too many pairs of points within the radius")
    say(f"{run.label}: {', '.join(path.name for path in written) or 'no cells, so no tables and no figures'}")
