"""Guarded process: runs functions that may hang, exhaust memory or crash, and reports its loss.

The server of these processes has imported what they need, and nothing else.
"""

from __future__ import annotations

import fcntl
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import entry_points
from multiprocessing import (
    connection,
    current_process,
    forkserver,
    get_all_start_methods,
    parent_process,
    resource_tracker,
    spawn,
)
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, ForkServerProcess
from multiprocessing.process import BaseProcess
from threading import Event, Lock, Thread
from typing import Any, Literal, Self, TypeVar, cast

PRELOADED = "isacbench.bench.cells.worker"
"""Module that the server imports once, besides the built-in plugins, so that a fresh worker starts fast."""

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


@cache
def _preloaded() -> list[str]:
    """Modules that the server imports: what workers need."""
    built_in = {
        point.module
        for group in ("isacbench.estimators", "isacbench.detectors", "isacbench.metrics")
        for point in entry_points(group=group)
        if point.dist is not None and point.dist.name == "isacbench"
    }
    return [PRELOADED, *sorted(built_in)]


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

    Processes of the context inherit neither threads nor locks, and start in milliseconds.
    """
    _server.set_forkserver_preload(_preloaded())
    # The tracker unblocks these signals when it starts, and the server starts it where nothing has.
    resource_tracker.ensure_running()
    with _launching:  # threads that start it at the same time would find each other's environment
        # Signals that end a run are for this process: the server inherits that they are blocked, and its
        # workers from it. What sends them to all processes would else leave nothing to make the report with.
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        # Nor does it import anything from the working folder, which may hold another isacbench: a checkout.
        # Workers have the caller's path all the same.
        safe_path = os.environ.get("PYTHONSAFEPATH")
        os.environ["PYTHONSAFEPATH"] = "1"
        try:
            _server.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
            del os.environ["PYTHONSAFEPATH"]
            if safe_path is not None:
                os.environ["PYTHONSAFEPATH"] = safe_path
    return _Context()


GRACE_S = 2.0
"""Longest time in s from a broken connection to the end of its process."""

END_S = 10.0
"""Longest time in s to wait for the end of a killed process."""

F_SETSIG = 10
"""Command of Linux's fcntl that chooses the signal of a file descriptor; Python has no name for it."""

T = TypeVar("T")


class ProcessLostError(Exception):
    """The process was lost before it answered: its status in a row, and the reason in words."""

    def __init__(self, status: Literal["timeout", "killed"], reason: str) -> None:
        super().__init__(reason)
        self.status = status
        self.reason = reason


class GuardedProcess:
    """One process that calls functions in turn, replaced when it is lost; a context manager.

    Processes that plugins have started in it end with it, for whatever reason
    it ends. All of them end when the calling process ends.

    Parameters
    ----------
    begin : callable
        Called first in every fresh process.
    *args : object
        Its arguments.

    Attributes
    ----------
    has_begun : bool
        Whether there is a process, in which `begin` was called.
    """

    def __init__(self, begin: Callable[..., None], *args: object) -> None:
        self.has_begun = False
        self._begin = begin, *args
        self._stopped = Event()
        self._changing = Lock()
        self._process: BaseProcess | None = None
        self._connection: Connection

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process for good, also in the middle of a call; may be called from any thread."""
        self._stopped.set()
        self._end()

    def renew(self) -> None:
        """End the process; the next call starts a fresh one. CancelledError if it was stopped meanwhile."""
        self._end()
        self._refuse_if_stopped()

    def pause(self) -> None:
        """Stop the process, and all that was started in it, until `go_on`; on Linux alone.

        Elsewhere a process that is stopped would not end with the calling one.
        """
        if sys.platform == "linux":
            self._signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Go on after `pause`."""
        self._signal(signal.SIGCONT)

    def call(self, function: Callable[..., T], *args: object, timeout_s: float | None = None) -> T:
        """Call a function in the process and return its answer, or raise whatever it raises.

        `timeout_s` is the longest time, counted once the process is ready. ProcessLostError if there is no
        answer; the next call starts a fresh process. CancelledError if the process was stopped meanwhile.
        """
        with self._changing:
            self._refuse_if_stopped()
            if self._process is None:
                context = start_process_server()
                self._connection, theirs = context.Pipe()
                # A daemon ends with this process, even where it is not stopped.
                self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
                self._process.start()
                theirs.close()
        if not self.has_begun:
            self._ask(None, *self._begin)
            self.has_begun = True
        return cast("T", self._ask(timeout_s, function, *args))

    def _ask(self, timeout_s: float | None, *call: object) -> Any:
        """Send a call, and wait for its answer or the end of the process."""
        if (process := self._process) is None:
            raise CancelledError  # it was stopped meanwhile
        with suppress(BrokenPipeError, ConnectionResetError):  # of a process that has ended
            self._connection.send(call)
        ready = connection.wait([self._connection, process.sentinel], timeout_s)
        if not ready:
            self.renew()
            raise ProcessLostError("timeout", f"more than {timeout_s:g} s")
        received = None
        if self._connection in ready:
            with suppress(EOFError, OSError):
                received = self._connection.recv()
        if received is not None:
            is_result, answer = received
            if is_result:
                return answer
            raise answer
        process.join(GRACE_S)
        if process.exitcode == -signal.SIGTERM:
            # A scheduler that ends a job signals all its processes: the caller may be about to stop, too.
            self._stopped.wait(GRACE_S)
        self.renew()
        raise ProcessLostError("killed", f"the process {_cause(process.exitcode)}")

    def _signal(self, number: int) -> None:
        with self._changing:
            if self._process is not None:
                _signal_group(self._process, number)

    def _end(self) -> None:
        """End the process and all processes that were started in it."""
        with self._changing:
            process, self._process, self.has_begun = self._process, None, False
            if process is not None:
                _signal_group(process, signal.SIGKILL)
                process.kill()  # which may not have a group yet
                process.join(END_S)

    def _refuse_if_stopped(self) -> None:
        if self._stopped.is_set():
            raise CancelledError


def _signal_group(process: BaseProcess, number: int) -> None:
    if process.pid is not None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)


def _cause(code: int | None) -> str:
    """Say how a process ended."""
    if code is None:
        return "ended without an answer"
    if code < 0:
        names = {number.value: number.name for number in signal.Signals}
        return f"died by {names.get(-code, f'signal {-code}')}"  # real-time signals have no names
    return f"exited with code {code}"


# The functions below run in the guarded process.


def _serve(calls: Connection) -> None:
    """Set up the process, and work in it."""
    os.setsid()  # a group of its own, so that what plugins start ends with it
    with suppress(OSError):
        os.dup2(2, 1)  # standard output is the caller's, whatever a plugin or a library in C prints
    sys.stdout = sys.stderr
    current_process().daemon = False  # a plugin may have processes of its own
    # The process server blocks SIGTERM; a plugin and the processes that it starts get the default back.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    _die_with_parent()
    _answer(calls)


def _answer(calls: Connection) -> None:
    """Call functions as they come, and answer with their results or exceptions."""
    process_id = os.getpid()
    while True:
        try:
            function, *arguments = calls.recv()
        except EOFError:  # the caller has ended
            return
        answer: tuple[bool, Any]
        try:
            answer = True, function(*arguments)
        except Exception as error:
            answer = False, error
        except BaseException as error:  # which would end the caller
            answer = False, RuntimeError(f"{type(error).__name__}: {error}")
        if os.getpid() != process_id:
            os._exit(1)  # a plugin has forked, and this is its child
        try:
            calls.send(answer)
        except Exception as error:  # an answer that cannot be sent
            calls.send((False, error))


def _die_with_parent() -> None:
    """Leave no process behind when the caller is killed."""
    parent = parent_process()
    assert parent is not None
    if sys.platform == "linux":
        # The system itself kills the group, even if a plugin never returns to the interpreter.
        fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, -os.getpid())
        fcntl.fcntl(parent.sentinel, F_SETSIG, signal.SIGKILL)
        flags = fcntl.fcntl(parent.sentinel, fcntl.F_GETFL)
        fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, flags | os.O_ASYNC)
    Thread(target=_wait_for_end, args=[parent.sentinel], daemon=True).start()


def _wait_for_end(sentinel: int) -> None:
    """Kill the group when the caller ends: on other systems than Linux, or if it ended before the setup."""
    connection.wait([sentinel])
    os.killpg(0, signal.SIGKILL)
