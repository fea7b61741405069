"""Server of worker processes: it has imported what they need, and nothing else."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.forkserver import ensure_running
from multiprocessing.process import BaseProcess
from threading import Lock
from typing import TYPE_CHECKING

from isacbench.bench.suites.suite_kinds import PLANNERS

if TYPE_CHECKING:
    from multiprocessing.popen_forkserver import Popen

PRELOADED = ["isacbench.bench.workers.guarded_cells", *PLANNERS]
"""Modules that the server imports once, besides the built-in plugins, so that a fresh worker starts fast."""

_hiding = Lock()


class _Process(ForkServerProcess):
    """Process that does not import the caller's script: what it needs of it travels by its code."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Popen:  # noqa: N802, the name that multiprocessing calls
        with _hiding, _script_hidden():
            return ForkServerProcess._Popen(process_obj)


class _Context(ForkServerContext):
    Process = _Process


@contextmanager
def _script_hidden() -> Iterator[None]:
    """Let ``__main__`` look like that of a console, which multiprocessing does not import in processes.

    A script then needs no ``if __name__ == "__main__":``, and one that is read
    from a pipe, of which there is no file to import, has workers as well.
    """
    main: dict[str, object] = vars(sys.modules["__main__"])
    hidden: dict[str, object] = {name: main.pop(name) for name in ("__spec__", "__file__") if name in main}
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(hidden)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let Python processes that are started import nothing from the working folder.

    It may hold another ``isacbench``: a checkout. Workers have the caller's path all the same.
    """
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


@cache
def _context() -> ForkServerContext:
    """Context whose server has imported what workers need."""
    built_in = {
        point.module
        for group in ("isacbench.estimators", "isacbench.detectors")
        for point in entry_points(group=group)
        if point.dist is not None and point.dist.name == "isacbench"
    }
    context = _Context()
    context.set_forkserver_preload([*PRELOADED, *sorted(built_in)])
    return context


def start_process_server() -> ForkServerContext:
    """Start the server unless it runs, and do not wait for what it imports.

    Returns
    -------
    ForkServerContext
        Context of processes that inherit neither threads nor locks, and that
        start in milliseconds.
    """
    context = _context()
    # The tracker unblocks these signals when it starts, and the server starts it where nothing has.
    resource_tracker.ensure_running()
    # Signals that end a run are for this process: the server inherits that they are blocked, and its workers
    # from it. What sends them to all processes would else leave nothing to make the report with.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        with _safe_path():
            ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return context
