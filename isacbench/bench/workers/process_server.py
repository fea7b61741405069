"""Server of worker processes: it has imported what they need, and nothing else."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import entry_points
from multiprocessing import (
    current_process,
    forkserver,
    get_all_start_methods,
    resource_tracker,
    spawn,
)
from multiprocessing.context import ForkServerContext, ForkServerProcess
from threading import Lock

from isacbench.bench.suites.suite_kinds import PLANNERS

PRELOADED = ["isacbench.bench.workers.guarded_cells", *PLANNERS]
"""Modules that the server imports once, besides the built-in plugins, so that a fresh worker starts fast."""

_server = forkserver.ForkServer()
"""Beside the one of the standard library, which processes of the caller may come from."""

_launching = Lock()


class _Process(ForkServerProcess):
    """Process that does not import the caller's script: what it needs of it travels by its code."""

    def start(self) -> None:
        """Start the process, also from a process of a pool, which may have no children or its own ways."""
        caller, connect = current_process(), forkserver.connect_to_new_process
        is_daemon, method = caller.daemon, vars(spawn)["get_start_method"]
        with _launching, _script_hidden():
            try:
                caller.daemon, forkserver.connect_to_new_process = False, _server.connect_to_new_process
                if method() not in get_all_start_methods():
                    vars(spawn)["get_start_method"] = lambda: "forkserver"
                super().start()
            finally:
                caller.daemon, forkserver.connect_to_new_process = is_daemon, connect
                vars(spawn)["get_start_method"] = method


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
def _preloaded() -> list[str]:
    """Modules that the server imports: what workers need."""
    built_in = {
        point.module
        for group in ("isacbench.estimators", "isacbench.detectors")
        for point in entry_points(group=group)
        if point.dist is not None and point.dist.name == "isacbench"
    }
    return [*PRELOADED, *sorted(built_in)]


def _after_fork() -> None:
    """Leave the server to the process that has started it: a fork of that one starts its own."""
    global _server, _launching
    with suppress(OSError, TypeError):
        os.close(getattr(_server, "_forkserver_alive_fd", None))  # type: ignore[arg-type]
    _server, _launching = forkserver.ForkServer(), Lock()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_after_fork)


def start_process_server() -> ForkServerContext:
    """Start the server unless it runs, and do not wait for what it imports.

    Returns
    -------
    ForkServerContext
        Context of processes that inherit neither threads nor locks, and that
        start in milliseconds.
    """
    _server.set_forkserver_preload(_preloaded())
    # The tracker unblocks these signals when it starts, and the server starts it where nothing has.
    resource_tracker.ensure_running()
    # Signals that end a run are for this process: the server inherits that they are blocked, and its workers
    # from it. What sends them to all processes would else leave nothing to make the report with.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        with _safe_path():
            _server.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return _Context()
