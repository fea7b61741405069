"""Progress of long work: a bar on a terminal, a line in a notebook, and a line a minute elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.files.escaping import visible

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console

Progress = Callable[[int, int], None]
"""Called after each piece of work with the number of pieces done and the number of all."""

Clock = Callable[[], float]

LINE_S = 60.0
"""Time between two lines, where a log is likely to be kept."""

NOTEBOOK_S = 0.3
"""Time between two updates of a notebook, each of which is a message to the browser."""

MINUTE_S, HOUR_S = 60, 3600


@contextmanager
def progress_shown(title: str, noun: str = "cells", is_idle: bool = False) -> Iterator[Progress]:
    """Show progress in the way that suits what stderr leads to, or the notebook.

    Parameters
    ----------
    title : str
        Name of the work.
    noun : str
        Name of its pieces.
    is_idle : bool
        Whether a bar is drawn only when a piece is done, and not while others work.

    Yields
    ------
    Progress
        To be called after each piece.
    """
    display = notebook_display()
    if display is not None:
        line = NotebookLine(title, noun, display)
        try:
            yield line
        finally:
            line.close()
        return
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with _bar(title, console, is_idle) as show:
            yield show
    else:
        # The console knows a stderr that is closed.
        yield MinuteLines(noun, lambda text: print(text, file=console.file, flush=True))


def notebook_display() -> Callable[..., Any] | None:
    """Find what shows objects below a notebook's cell.

    Returns
    -------
    callable or None
        ``IPython.display.display`` in the kernel of a notebook, None elsewhere: in scripts, in
        Python's own shell, and in IPython on a terminal.
    """
    ipython = sys.modules.get("IPython")  # never imported here: in a kernel it is loaded already
    shell = None if ipython is None else ipython.get_ipython()
    if getattr(shell, "kernel", None) is None:
        return None
    display: Callable[..., Any] = import_module("IPython.display").display
    return display


class MinuteLines:
    """Progress as a line a minute, each told when the first piece after it is done.

    Parameters
    ----------
    noun : str
    write : callable
        Takes each line.
    clock : callable
        Gives the time in s.
    """

    def __init__(self, noun: str, write: Callable[[str], object], clock: Clock = time.monotonic) -> None:
        self._pace = _Pace(noun, clock)
        self._write = write
        self._clock = clock
        self._told_s = clock()

    def __call__(self, n_done: int, n_all: int) -> None:
        """Take note of a piece that is done."""
        text = self._pace.told(n_done, n_all)
        now_s = self._clock()
        if now_s - self._told_s >= LINE_S:
            self._told_s = now_s
            self._write(f"isacbench: {text}")


class NotebookLine:
    """Progress as a line below a notebook's cell, which appears with the first piece and changes in place.

    Parameters
    ----------
    title, noun : str
    display : callable
        As ``IPython.display.display``.
    clock : callable
        Gives the time in s.
    """

    def __init__(
        self, title: str, noun: str, display: Callable[..., Any], clock: Clock = time.monotonic
    ) -> None:
        self._title = visible(title)
        self._pace = _Pace(noun, clock)
        self._clock = clock
        self._display = display
        self._handle: Any = None
        self._line = _Line("", 0, 0)
        self._shown_s = clock()

    def __call__(self, n_done: int, n_all: int) -> None:
        """Take note of a piece that is done."""
        self._line = _Line(f"{self._title}: {self._pace.told(n_done, n_all)}", n_done, n_all)
        if self._handle is None:
            self._handle = self._display(self._line, display_id=True)
        elif self._clock() - self._shown_s >= NOTEBOOK_S:
            self._handle.update(self._line)
        else:
            return
        self._shown_s = self._clock()

    def close(self) -> None:
        """Show how far the work has come in the end, if anything was done."""
        if self._handle is not None:
            self._handle.update(self._line)


class _Line(NamedTuple):
    """Line of a notebook: a bar and words, or the words alone."""

    text: str
    n_done: int
    n_all: int

    def __repr__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return f'<progress value="{self.n_done}" max="{self.n_all}"></progress> {escape(self.text)}'


class _Pace:
    """Pieces done so far, the time that they took, and the time that is left at this pace."""

    def __init__(self, noun: str, clock: Clock) -> None:
        self._noun = noun
        self._clock = clock
        self._begun_s = clock()
        self._n_before: int | None = None

    def told(self, n_done: int, n_all: int) -> str:
        """Write all that in words."""
        if self._n_before is None:
            self._n_before = n_done - 1  # done by an earlier call, which this one goes on with
        elapsed_s = self._clock() - self._begun_s
        told = f"{n_done} of {n_all} {self._noun}, {_duration(elapsed_s)}"
        if n_done == n_all:
            return told
        left_s = elapsed_s * (n_all - n_done) / (n_done - self._n_before)
        return f"{told}, about {_duration(left_s)} left"


def _duration(time_s: float) -> str:
    """Write a time as people say it: 45 s, 3 min, 2 h 5 min."""
    if time_s < MINUTE_S:
        return f"{time_s:.0f} s"
    if time_s < HOUR_S:
        return f"{time_s / MINUTE_S:.0f} min"
    hours, minutes = divmod(round(time_s / MINUTE_S), HOUR_S // MINUTE_S)
    return f"{hours} h {minutes} min"


@contextmanager
def _bar(title: str, console: Console, is_idle: bool) -> Iterator[Progress]:
    """Bar with the time left on a terminal, gone at the end."""
    from rich import progress

    columns = (
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeRemainingColumn(),
    )
    with progress.Progress(*columns, console=console, transient=True, auto_refresh=not is_idle) as bar:
        task = bar.add_task(visible(title), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total, refresh=is_idle)
