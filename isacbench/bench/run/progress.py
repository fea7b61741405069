"""Progress of long work: a bar on a terminal, and a line a minute elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import partial

from isacbench.files.escaping import escape_control

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
    from rich.console import Console  # only where it is needed: it takes a while

    console = Console(stderr=True)
    if not console.is_terminal:
        # The console's file is a null device if stderr is closed.
        say = partial(print, file=console.file, flush=True)
        yield paced_progress(noun, lambda text: say(f"isacbench: {text}"), LINE_S)
        return
    from rich import markup, progress

    columns = *progress.Progress.get_default_columns(), progress.MofNCompleteColumn()
    with progress.Progress(*columns, console=console, transient=True, auto_refresh=not is_idle) as bar:
        task = bar.add_task(markup.escape(escape_control(title)), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total, refresh=is_idle)


def paced_progress(
    noun: str,
    say: Callable[[str], object],
    period_s: float,
    clock: Callable[[], float] = time.monotonic,
) -> Progress:
    """Put progress into words for `say`, at most once in a period; `clock` has the time in s."""
    begin_s = last_s = clock()
    n_before: int | None = None

    def show(n_done: int, n_all: int) -> None:
        nonlocal last_s, n_before
        if n_before is None:
            n_before = n_done - 1  # done by an earlier call of the same run
        now_s = clock()
        if now_s - last_s < period_s:
            return
        last_s, elapsed_s = now_s, now_s - begin_s
        text = f"{n_done} of {n_all} {noun}, {_duration(elapsed_s)}"
        if n_done < n_all:
            text += f", about {_duration(elapsed_s * (n_all - n_done) / (n_done - n_before))} left"
        say(text)

    return show


def _duration(time_s: float) -> str:
    return str(timedelta(seconds=round(time_s)))
