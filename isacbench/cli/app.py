"""The application: group of commands, exit codes, messages."""

from __future__ import annotations

import os
import sys
import threading
import warnings
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from isacbench import __version__
from isacbench.errors import InputError, InputWarning
from isacbench.files.escaping import visible, visible_lines
from isacbench.streams import own_output

EXIT_USAGE = 2
EXIT_FAILED_CELLS = 3
EXIT_REGRESSION = 4
EXIT_NOT_COMPARABLE = 5
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as in shells
EXIT_TERMINATED = 143  # 128 + SIGTERM


class _Group(TyperGroup):
    """Group of commands in which bad input ends with one line on stderr and exit code 2."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the arguments name, with warnings about input as one line on stderr."""
        show_with_source = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, InputWarning):
                say(f"isacbench: warning: {message}", err=True)
            else:
                show_with_source(message, category, *where, **more)

        try:
            with warnings.catch_warnings():
                warnings.showwarning = show
                return super().invoke(ctx)
        except InputError as error:
            fail(str(error), EXIT_USAGE)


app = typer.Typer(
    name="isacbench",
    cls=_Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Benchmark the accuracy and the speed of radar imaging with 5G downlink signals.",
)


def main() -> None:
    """Run the command line."""
    with own_output():
        try:
            app()
        except SystemExit as ending:
            others = set(threading.enumerate()) - {threading.main_thread()}
            if all(thread.daemon for thread in others):
                raise
            # A thread that a plugin has left would keep the process for ever.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(ending.code if isinstance(ending.code, int) else 0)


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


def say(message: str, err: bool = False) -> None:
    """Print one line, with control characters escaped.

    Parameters
    ----------
    err : bool
        Whether to print on stderr instead of stdout.
    """
    typer.echo(visible(message), err=err)


def say_lines(message: str) -> None:
    """Print several lines, with control characters escaped."""
    typer.echo(visible_lines(message))


def fail(message: str, code: int) -> NoReturn:
    """End the command with one line on stderr.

    Parameters
    ----------
    code : int
        Exit code.

    Raises
    ------
    typer.Exit
        Always.
    """
    say(f"isacbench: {message}", err=True)
    raise typer.Exit(code)
