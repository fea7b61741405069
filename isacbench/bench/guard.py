"""Guarded work: cells in a process of their own, with a deadline and a memory limit for each.

A plugin may raise, hang, exhaust memory, exit or die by a signal: its cell gets
a row that says so, a fresh process takes over, and no other cell notices.
"""

from __future__ import annotations

import fcntl
import os
import resource
import signal
import sys
import time
from collections import deque
from concurrent.futures import CancelledError, wait
from concurrent.futures import TimeoutError as DeadlineError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import connection, parent_process
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Self

from pebble import ProcessExpired, ProcessPool
from threadpoolctl import threadpool_limits

from isacbench.bench.cell import describe_error
from isacbench.bench.resume import versions_now
from isacbench.bench.workbench import Made, Workbench
from isacbench.errors import InputError
from isacbench.processes import process_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    from isacbench.bench.job import Job
    from isacbench.bench.plan import Block
    from isacbench.bench.record import Status

__all__ = ["DEFAULT_TIMEOUT_S", "Guard", "Lane"]

DEFAULT_TIMEOUT_S = 600.0
"""Nothing that images a scene takes ten minutes, unless it hangs."""

OBSERVE_ATTEMPTS = 3
POLL_S = 0.2
GRACE_S = 2.0
END_S = 10.0
MIB = 2**20
F_SETSIG = 10
"""Of Linux: which signal tells of a file descriptor; Python has no name for it."""

PROCESS_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Guard:
    """Limits of every cell.

    Attributes
    ----------
    timeout_s : float or None
        Wall time of estimate and scores in s; None for no limit.
    memory_mib : float or None
        Memory in MiB that a cell may take beyond what its process holds
        before; None for no limit.

    Raises
    ------
    InputError
        If a limit is not positive, or cannot be enforced on this system.
    """

    timeout_s: float | None = DEFAULT_TIMEOUT_S
    memory_mib: float | None = None

    def __post_init__(self) -> None:
        for option, limit, unit in (("timeout", self.timeout_s, "s"), ("memory", self.memory_mib, "MiB")):
            if limit is not None and not limit > 0:
                raise InputError(f"{option} {limit:g} {unit}: allowed is more than 0")
        if self.memory_mib is not None and not PROCESS_STATUS.exists():
            raise InputError("memory: a limit can be enforced on Linux only; allowed here is a run without")


class Lane:
    """One worker process, renewed when a cell costs it its life; a context manager.

    Parameters
    ----------
    job : Job
    guard : Guard
    """

    def __init__(self, job: Job, guard: Guard) -> None:
        self._job, self._guard = job, guard
        self._stopped = Event()
        self._renewing = Lock()
        self._pool = self._fresh_pool()
        self._process_id = 0
        """Of the process that is at work; 0 where there is none yet."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def cancel(self) -> None:
        """Tell the lane to end its work, without waiting for it; from any thread."""
        self._stopped.set()

    def stop(self) -> None:
        """End the process for good, whatever it does; from any thread."""
        self._stopped.set()
        with self._renewing:
            self._end_process()

    def versions(self) -> dict[tuple[str, str], Any]:
        """Versions that rows of the process have, by name and parameters of the contestant.

        Raises
        ------
        InputError
            If the process cannot have all contestants.
        """
        try:
            found: dict[tuple[str, str], Any] = self._call(_versions, timeout_s=self._guard.timeout_s)
        except (ProcessExpired, BrokenProcessPool) as death:
            raise InputError(f"loading the plugins, the process {_cause(death)}") from death
        except DeadlineError as error:
            raise InputError(f"loading the plugins took more than {self._guard.timeout_s:g} s") from error
        return found

    def work(self, block: Block) -> Iterator[Made]:
        """Work off the cells of a block; each yields a row, whatever becomes of it.

        Raises
        ------
        CancelledError
            If the lane was stopped meanwhile.
        InputError
            If no process lives through observing the block.
        """
        waiting = deque(block.contestants)
        while waiting:
            traces = deque(self._observe(block._replace(contestants=tuple(waiting))))
            while waiting and self._process_id:
                yield self._image(waiting.popleft(), traces.popleft())

    def _observe(self, block: Block) -> list[Made]:
        """Observe in the process; where the system kills it for want of memory, again in a fresh one."""
        for _ in range(OBSERVE_ATTEMPTS):
            try:
                if not self._process_id:
                    self._process_id = self._call(os.getpid)
                traces: list[Made] = self._call(_observe, block)
            except (ProcessExpired, BrokenProcessPool) as death:
                cause = _cause(death)
                self._renew()
            else:
                return traces
        raise InputError(
            f"scenario {self._job.plan.scenes[block.scene].name}, trial {block.trial}, {block.snr_db:g} dB: "
            f"{OBSERVE_ATTEMPTS} worker processes in a row did not live to observe it, the last one {cause}; "
            "allowed are a scenario that fits into memory, plugins that can be imported, and, in a script, "
            "a run below `if __name__ == '__main__':`"
        )

    def _image(self, contestant: int, trace: Made) -> Made:
        start = time.perf_counter()
        try:
            made: Made = self._call(
                _image, contestant, self._guard.memory_mib, timeout_s=self._guard.timeout_s
            )
        except CancelledError:
            raise
        except Exception as error:
            self._renew()
            return _lost(trace, *self._verdict(error), time.perf_counter() - start)
        if made.outcome.record.status == "killed":
            self._renew()  # what the plugin still holds must not be held against other cells
        return made

    def _call(self, function: Callable[..., Any], *args: Any, timeout_s: float | None = None) -> Any:
        """Call a function in the process; whatever ends the process is raised."""
        try:
            future = self._pool.schedule(function, args=args, timeout=timeout_s)
        except RuntimeError as error:
            self._refuse_if_stopped()
            raise BrokenProcessPool("The process ended while it had nothing to do") from error
        while not wait([future], timeout=POLL_S).done:
            self._refuse_if_stopped()
            # The pool tells of every death but one with code 0, though not at once.
            if not self._is_alive() and not wait([future], timeout=GRACE_S).done:
                self._refuse_if_stopped()
                raise ProcessExpired("Left", code=0)  # type: ignore[no-untyped-call]
        return future.result()

    def _verdict(self, error: BaseException) -> tuple[Status, str]:
        """Status and reason of a cell whose outcome did not come back."""
        if isinstance(error, DeadlineError):
            return "timeout", f"more than {self._guard.timeout_s:g} s"
        if isinstance(error, (ProcessExpired, BrokenProcessPool)):
            return "killed", f"the process {_cause(error)}"
        return "error", describe_error(error)

    def _is_alive(self) -> bool:
        """Whether the process is there."""
        try:
            os.kill(self._process_id, 0)
        except ProcessLookupError:
            return False
        return True

    def _renew(self) -> None:
        with self._renewing:
            self._end_process()
            self._refuse_if_stopped()
            self._pool = self._fresh_pool()

    def _refuse_if_stopped(self) -> None:
        if self._stopped.is_set():
            raise CancelledError

    def _end_process(self) -> None:
        """End the process and all that plugins have started from it."""
        self._pool.stop()  # type: ignore[no-untyped-call]
        if self._process_id:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process_id, signal.SIGKILL)
        self._process_id = 0
        # Where a process died half-way through an answer, the pool waits for the rest for ever: let it.
        end = Thread(target=self._pool.join, daemon=True)
        end.start()
        end.join(END_S)

    def _fresh_pool(self) -> ProcessPool:
        return ProcessPool(1, initializer=_start_worker, initargs=[self._job], context=process_context())


def _lost(trace: Made, status: Status, reason: str, time_s: float) -> Made:
    """Row of a cell whose outcome did not come back."""
    record = replace(trace.outcome.record, status=status, reason=reason, time_estimate_s=time_s)
    return trace._replace(outcome=replace(trace.outcome, record=record))


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


# What follows runs in the worker process.

_job: Job | None = None
_workbench: Workbench | None = None
_process_id = 0


def _start_worker(job: Job) -> None:
    global _job, _workbench, _process_id
    _job, _workbench, _process_id = job, None, os.getpid()
    os.setsid()  # a group of its own, so that what plugins start ends with it
    # A plugin that never returns to the interpreter must not outlive its deadline.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _die_with_parent()


def _die_with_parent() -> None:
    """Leave no process behind when the run is killed."""
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
    """Wait for the end of the parent, on every system, or if it has come before the rest was set up."""
    connection.wait([sentinel])
    os.killpg(0, signal.SIGKILL)


def _versions() -> dict[tuple[str, str], Any]:
    assert _job is not None
    return versions_now(_job.plan)


def _observe(block: Block) -> list[Made]:
    global _workbench
    if _workbench is None:
        assert _job is not None
        _workbench = Workbench(_job)
        # Threads make small batched algebra slower and its timing unrepeatable; here for good.
        threadpool_limits(limits=1)
    return _workbench.observe(block)


def _image(contestant: int, memory_mib: float | None) -> Made:
    assert _workbench is not None
    start = time.perf_counter()
    try:
        with _memory_limit(memory_mib):
            made = _workbench.image(contestant)
    except BaseException as error:  # such as KeyboardInterrupt, or no memory left to tell of no memory
        status: Status = "killed" if isinstance(error, MemoryError) else "error"
        made = _workbench.forfeit(contestant, status, describe_error(error), time.perf_counter() - start)
        _workbench.start_over()
    finally:
        if os.getpid() != _process_id:
            os._exit(1)  # a plugin has forked, and here comes its child
    record = made.outcome.record
    if memory_mib is None or record.status != "killed":
        return made
    record = replace(record, reason=f"more than {memory_mib:g} MiB: {record.reason}")
    return made._replace(outcome=replace(made.outcome, record=record))


@contextmanager
def _memory_limit(memory_mib: float | None) -> Iterator[None]:
    """Let this process allocate so much more and not a byte beyond."""
    if memory_mib is None:
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (_data_bytes() + int(memory_mib * MIB), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _data_bytes() -> int:
    """Private writable memory of this process, as RLIMIT_DATA counts it."""
    for line in PROCESS_STATUS.read_text().splitlines():
        if line.startswith("VmData:"):
            return int(line.split()[1]) * 1024
    raise RuntimeError(f"{PROCESS_STATUS} has no VmData")
