"""A process for code that nobody vouches for: it may hang, exhaust memory or die, and its caller is told."""

from __future__ import annotations

import fcntl
import math
import os
import signal
import sys
import time
from concurrent.futures import CancelledError, wait
from concurrent.futures import TimeoutError as DeadlineError
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import connection, parent_process
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

from pebble import ProcessExpired, ProcessPool

from isacbench.bench.workers.process_server import process_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from pebble import ProcessFuture

POLL_S = 0.2
GRACE_S = 2.0
ENDED_S = 0.5
"""Longest time in which the pool says that it has ended the process at its deadline."""

END_S = 10.0
F_SETSIG = 10
"""Of Linux: which signal tells of a file descriptor; Python has no name for it."""

T = TypeVar("T")


class ProcessLostError(Exception):
    """The process did not live to answer, or was not let.

    Attributes
    ----------
    status : {"timeout", "killed"}
    reason : str
        In words.
    """

    def __init__(self, status: Literal["timeout", "killed"], reason: str) -> None:
        super().__init__(reason)
        self.status = status
        self.reason = reason


class GuardedProcess:
    """One process that functions are called in, replaced when it is lost; a context manager.

    Whatever ends it, what plugins have started from it ends as well; so does
    all when this process ends.

    Parameters
    ----------
    begin : callable
        Called first of all in every fresh process.
    *args : object
        Its arguments.
    """

    def __init__(self, begin: Callable[..., None], *args: object) -> None:
        self._begin = begin, *args
        self._stopped = Event()
        self._renewing = Lock()
        self._pool = self._fresh_pool()
        self._asked_id: ProcessFuture[int] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def id(self) -> int:
        """Number of the process, 0 where none has answered yet."""
        asked = self._asked_id
        return asked.result() if asked is not None and asked.done() and not asked.exception() else 0

    def cancel(self) -> None:
        """Tell the process to end, without waiting for it; from any thread."""
        self._stopped.set()

    def stop(self) -> None:
        """End the process for good, whatever it does; from any thread."""
        self._stopped.set()
        with self._renewing:
            self._end()

    def renew(self) -> None:
        """Put a fresh process in place of this one."""
        with self._renewing:
            self._end()
            self._refuse_if_stopped()
            self._pool = self._fresh_pool()

    def call(self, function: Callable[..., T], *args: object, timeout_s: float | None = None) -> T:
        """Call a function in the process and wait for its answer.

        Parameters
        ----------
        function : callable
        *args : object
        timeout_s : float or None
            Longest time in s, counted from the moment when it begins.

        Returns
        -------
        object
            What the function returns.

        Raises
        ------
        ProcessLostError
            If there is no answer; the next call finds a fresh process.
        CancelledError
            If the process was stopped meanwhile.
        Exception
            Whatever the function raises.
        """
        return self.answer(self.schedule(function, *args, timeout_s=timeout_s), timeout_s)

    def schedule(
        self, function: Callable[..., T], *args: object, timeout_s: float | None = None
    ) -> ProcessFuture[T]:
        """Have a function called in the process, and go on meanwhile; `answer` waits for it."""
        try:
            return self._submit(function, *args, timeout_s=timeout_s)
        except RuntimeError:  # the process ended while it had nothing to do
            self._refuse_if_stopped()
            self.renew()
            return self._submit(function, *args, timeout_s=timeout_s)

    def answer(self, future: ProcessFuture[T], timeout_s: float | None = None) -> T:
        """Wait for what was scheduled, as `call` does."""
        died_s = math.inf
        try:
            while not wait([future], timeout=POLL_S).done:
                self._refuse_if_stopped()
                if not self._is_alive():
                    died_s = time.monotonic()
                    break
            # The pool tells of every death but one with code 0, though not at once.
            return future.result(timeout=None if died_s == math.inf else GRACE_S)
        except CancelledError:
            raise
        except DeadlineError as error:
            was_dead_s = time.monotonic() - died_s
            self._refuse_if_stopped()
            self.renew()
            if was_dead_s > ENDED_S:
                raise ProcessLostError("killed", "the process exited with code 0") from error
            raise ProcessLostError("timeout", f"more than {timeout_s:g} s") from error
        except (ProcessExpired, BrokenProcessPool) as error:
            if isinstance(error, ProcessExpired) and error.exitcode == -signal.SIGTERM:
                # What ends a job sends the signal to all its processes: this one may be about to stop, too.
                self._stopped.wait(GRACE_S)
            self.renew()
            raise ProcessLostError("killed", f"the process {_cause(error)}") from error

    def _submit(self, function: Callable[..., T], *args: object, timeout_s: float | None) -> ProcessFuture[T]:
        if self._asked_id is None:
            self._asked_id = self._pool.schedule(os.getpid)
        return self._pool.schedule(function, args=args, timeout=timeout_s)

    def _is_alive(self) -> bool:
        """Whether the process is there, as far as its number is known."""
        try:
            os.kill(self.id, 0)
        except ProcessLookupError:
            return False
        return True

    def _refuse_if_stopped(self) -> None:
        if self._stopped.is_set():
            raise CancelledError

    def _end(self) -> None:
        """End the process and all that has been started from it."""
        process_id = 0 if self._asked_id is None or self._asked_id.cancelled() else self.id
        self._pool.stop()  # type: ignore[no-untyped-call]
        if process_id:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process_id, signal.SIGKILL)
        self._asked_id = None
        # Where a process died half-way through an answer, the pool waits for the rest for ever: let it.
        end = Thread(target=self._pool.join, daemon=True)
        end.start()
        end.join(END_S)

    def _fresh_pool(self) -> ProcessPool:
        return ProcessPool(1, initializer=_begin, initargs=self._begin, context=process_context())


def _cause(death: ProcessExpired | BrokenProcessPool) -> str:
    """Say how a process ended."""
    if isinstance(death, BrokenProcessPool):
        return f"ended without an answer: {death.__cause__ or death}"
    if death.exitcode < 0:
        return f"died by {_signal_name(-death.exitcode)}"
    return f"exited with code {death.exitcode}"


def _signal_name(number: int) -> str:
    """Name of a signal; those of real time have none."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


# What follows runs in the process.


def _begin(begin: Callable[..., None], *args: Any) -> None:
    os.setsid()  # a group of its own, so that what plugins start ends with it
    # A plugin that never returns to the interpreter must not outlive its deadline.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    _die_with_parent()
    begin(*args)


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
    """Wait for the end of the caller, on every system, or if it has come before the rest was set up."""
    connection.wait([sentinel])
    os.killpg(0, signal.SIGKILL)
