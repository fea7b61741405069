"""Progress of long work: a bar on a terminal, and a line a minute elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console

from isacbench.files.escaping import visible

Progress = Callable[[int, int], None]
"""Function that is called after each piece of work, with the number of pieces done and of all."""

LINE_S = 60.0
"""Time between two lines of a log."""


@contextmanager
def progress_shown(title: str, noun: str = "cells", is_idle: bool = False) -> Iterator[Progress]:
    """Show progress on a terminal, or in the log that stderr leads to.

    `title` names the work, `noun` its pieces. With `is_idle` a bar is redrawn only when a piece is done. What
    is yielded is called after each piece.
    """
    console = Console(stderr=True)
    if console.is_terminal:
        with _bar(title, console, is_idle) as show:
            yield show
    else:
        # The console's file is a null device if stderr is closed.
        yield paced_progress(
            noun, lambda text: print(f"isacbench: {text}", file=console.file, flush=True), LINE_S
        )


def paced_progress(
    noun: str,
    tell: Callable[[str], object],
    period_s: float,
    clock: Callable[[], float] = time.monotonic,
) -> Progress:
    """Put progress into words, which `tell` takes, at most once in a period; `clock` has the time in s."""
    begun_s = told_s = clock()
    n_before: int | None = None

    def show(n_done: int, n_all: int) -> None:
        nonlocal told_s, n_before
        if n_before is None:
            n_before = n_done - 1  # done by an earlier call of the same run
        now_s = clock()
        if now_s - told_s < period_s:
            return
        told_s, elapsed_s = now_s, now_s - begun_s
        text = f"{n_done} of {n_all} {noun}, {_duration(elapsed_s)}"
        if n_done < n_all:
            text += f", about {_duration(elapsed_s * (n_all - n_done) / (n_done - n_before))} left"
        tell(text)

    return show


def _duration(time_s: float) -> str:
    return str(timedelta(seconds=round(time_s)))


@contextmanager
def _bar(title: str, console: Console, is_idle: bool) -> Iterator[Progress]:
    """Bar with the time left on a terminal, removed at the end."""
    from rich import progress
    from rich.markup import escape as rich_escape

    columns = *progress.Progress.get_default_columns(), progress.MofNCompleteColumn()
    with progress.Progress(*columns, console=console, transient=True, auto_refresh=not is_idle) as bar:
        task = bar.add_task(rich_escape(visible(title)), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total, refresh=is_idle)
