"""Progress of long work: a bar on a terminal, a line in a notebook, and a line a minute elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from datetime import timedelta
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.files.escaping import visible

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console

Progress = Callable[[int, int], None]
"""Function that is called after each piece of work, with the number of pieces done and of all."""

LINE_S = 60.0
"""Time between two lines of a log."""

NOTEBOOK_S = 0.3
"""Time between two updates of a notebook, each of which is a message to the browser."""


@contextmanager
def progress_shown(title: str, noun: str = "cells", is_idle: bool = False) -> Iterator[Progress]:
    """Show progress below the cell of a notebook, on a terminal, or in the log that stderr leads to.

    Parameters
    ----------
    title : str
        Name of the work.
    noun : str
        Name of its pieces.
    is_idle : bool
        True to redraw a bar only when a piece is done, and not in between.

    Yields
    ------
    Progress
        To be called after each piece.
    """
    from rich.console import Console

    display, console = notebook_display(), Console(stderr=True)
    if display is not None:
        yield paced_progress(noun, _notebook_line(title, display), NOTEBOOK_S, with_ends=True)
    elif console.is_terminal:
        with _bar(title, console, is_idle) as show:
            yield show
    else:
        # The console's file is a null device if stderr is closed.
        yield paced_progress(
            noun, lambda text, *_: print(f"isacbench: {text}", file=console.file, flush=True), LINE_S
        )


def notebook_display() -> Callable[..., Any] | None:
    """Find the function that shows objects below the cell of a notebook.

    Returns
    -------
    callable or None
        ``IPython.display.display`` in the kernel of a notebook. None elsewhere: in scripts, in
        Python's own shell, and in IPython on a terminal.
    """
    ipython = sys.modules.get("IPython")  # a kernel has loaded it already
    shell = None if ipython is None else ipython.get_ipython()
    if getattr(shell, "kernel", None) is None:
        return None
    display: Callable[..., Any] = import_module("IPython.display").display
    return display


def paced_progress(
    noun: str,
    tell: Callable[[str, int, int], object],
    period_s: float,
    with_ends: bool = False,
    clock: Callable[[], float] = time.monotonic,
) -> Progress:
    """Put progress into words, at most once in a period.

    Parameters
    ----------
    noun : str
        Name of the pieces.
    tell : callable
        Takes the text, the number of pieces done and of all.
    period_s : float
        Time between two texts.
    with_ends : bool
        True to tell the first and the last piece in any case.
    clock : callable
        Returns the time in s.

    Returns
    -------
    Progress
    """
    begun_s = clock()
    told_s = -math.inf if with_ends else begun_s
    n_before: int | None = None

    def show(n_done: int, n_all: int) -> None:
        nonlocal told_s, n_before
        if n_before is None:
            n_before = n_done - 1  # done by an earlier call of the same run
        now_s = clock()
        if now_s - told_s < period_s and not (with_ends and n_done == n_all):
            return
        told_s, elapsed_s = now_s, now_s - begun_s
        text = f"{n_done} of {n_all} {noun}, {_duration(elapsed_s)}"
        if n_done < n_all:
            text += f", about {_duration(elapsed_s * (n_all - n_done) / (n_done - n_before))} left"
        tell(text, n_done, n_all)

    return show


def _duration(time_s: float) -> str:
    return str(timedelta(seconds=round(time_s)))


class _Line(NamedTuple):
    """Line of a notebook: a bar with text, or the text alone."""

    text: str
    n_done: int
    n_all: int

    def __repr__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return f'<progress value="{self.n_done}" max="{self.n_all}"></progress> {escape(self.text)}'


def _notebook_line(title: str, display: Callable[..., Any]) -> Callable[[str, int, int], None]:
    """Line below the cell of a notebook, which appears with the first text and changes in place."""
    handle: Any = None

    def show(text: str, n_done: int, n_all: int) -> None:
        nonlocal handle
        line = _Line(f"{visible(title)}: {text}", n_done, n_all)
        if handle is None:
            handle = display(line, display_id=True)
        else:
            handle.update(line)

    return show


@contextmanager
def _bar(title: str, console: Console, is_idle: bool) -> Iterator[Progress]:
    """Bar with the time left on a terminal, removed at the end."""
    from rich import progress
    from rich.markup import escape as rich_escape

    columns = *progress.Progress.get_default_columns(), progress.MofNCompleteColumn()
    with progress.Progress(*columns, console=console, transient=True, auto_refresh=not is_idle) as bar:
        task = bar.add_task(rich_escape(visible(title)), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total, refresh=is_idle)
