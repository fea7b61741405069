"""Guarded work: cells in a process of their own, with a deadline and a memory limit for each.

A plugin may raise, hang, exhaust memory, exit or die by a signal: its cell gets
a row that says so, a fresh process takes over, and no other cell notices.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import signal
import time
from collections import deque
from concurrent.futures import TimeoutError as DeadlineError
from concurrent.futures import wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import connection, parent_process
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Self

from pebble import ProcessExpired, ProcessPool
from threadpoolctl import threadpool_limits

from isacbench.bench.cell import describe_error
from isacbench.bench.resume import versions_now
from isacbench.bench.workbench import Made, Workbench
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import TracebackType

    from isacbench.bench.job import Job
    from isacbench.bench.plan import Block
    from isacbench.bench.record import Status

__all__ = ["DEFAULT_TIMEOUT_S", "Guard", "Lane", "lost", "start_process_server"]

DEFAULT_TIMEOUT_S = 600.0
"""Nothing that images a scene takes ten minutes, unless it hangs."""

OBSERVE_ATTEMPTS = 3
POLL_S = 0.2
GRACE_S = 2.0
MIB = 2**20
PRELOADED = ["isacbench.bench.guard", "isacbench.bench.studies", "isacbench_algorithms.cellwise"]
"""What the server of processes imports once, so that a fresh worker is there at once."""

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
        self._pool = self._fresh_pool()
        self._process_id = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """End the process, whatever it does; from any thread."""
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()

    def versions(self) -> dict[tuple[str, str], Any]:
        """Versions that rows of the process have, by name and parameters of the contestant.

        Raises
        ------
        InputError
            If the process cannot have all contestants.
        """
        try:
            future = self._pool.schedule(_versions, timeout=self._guard.timeout_s)
            found: dict[tuple[str, str], Any] = future.result()
        except ProcessExpired as death:
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
        """
        waiting = deque(block.contestants)
        while waiting:
            rest = block._replace(contestants=tuple(waiting))
            traces = deque(self._observe(rest))
            while waiting:
                made = self._image(waiting.popleft(), traces.popleft())
                yield made
                if made.outcome.record.status in ("timeout", "killed"):
                    break  # and observe again, in a fresh process

    def _observe(self, block: Block) -> list[Made]:
        """Observe in the process; where the system kills it for want of memory, once more in a fresh one."""
        for _ in range(OBSERVE_ATTEMPTS):
            try:
                self._process_id, made = self._pool.schedule(_observe, args=[block]).result()
            except ProcessExpired as death:
                cause = _cause(death)
            else:
                return made
        raise RuntimeError(f"scene {block.scene}, trial {block.trial}: observing it, the process {cause}")

    def _image(self, contestant: int, trace: Made) -> Made:
        start = time.perf_counter()
        future = self._pool.schedule(
            _image, args=[contestant, self._guard.memory_mib], timeout=self._guard.timeout_s
        )
        while not future.done() and self._is_alive():
            wait([future], timeout=POLL_S)
        # The pool tells of every other death, but not at once.
        if not wait([future], timeout=GRACE_S).done:
            self._renew()
            return lost(trace, "killed", "the process exited with code 0", time.perf_counter() - start)
        error = future.exception()
        if error is not None:
            return lost(trace, *self._verdict(error), time.perf_counter() - start)
        made: Made = future.result()
        if made.outcome.record.status == "killed":
            self._renew()  # what the plugin still holds must not be held against other cells
        return made

    def _verdict(self, error: BaseException) -> tuple[Status, str]:
        """Status and reason of a cell whose outcome did not come back."""
        if isinstance(error, DeadlineError):
            return "timeout", f"more than {self._guard.timeout_s:g} s"
        if isinstance(error, ProcessExpired):
            return "killed", f"the process {_cause(error)}"
        return "error", describe_error(error)

    def _is_alive(self) -> bool:
        """Whether the process is there; the pool does not notice one that leaves with code 0."""
        try:
            os.kill(self._process_id, 0)
        except ProcessLookupError:
            return False
        return True

    def _renew(self) -> None:
        self.stop()
        self._pool = self._fresh_pool()

    def _fresh_pool(self) -> ProcessPool:
        return ProcessPool(1, initializer=_start_worker, initargs=[self._job], context=_context())


def start_process_server() -> None:
    """Start the server that worker processes come from, which imports what they need meanwhile."""
    _context()
    from multiprocessing.forkserver import ensure_running

    ensure_running()


def _context() -> Any:
    """Fresh processes that inherit neither threads nor locks, and that start in milliseconds."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


def lost(trace: Made, status: Status, reason: str, time_s: float) -> Made:
    """Row of a cell whose outcome did not come back, made of what its observation left of it."""
    record = replace(trace.outcome.record, status=status, reason=reason, time_estimate_s=time_s)
    return trace._replace(outcome=replace(trace.outcome, record=record))


def _cause(death: ProcessExpired) -> str:
    """Say how a process ended."""
    if death.exitcode < 0:
        return f"died by {signal.Signals(-death.exitcode).name}"
    return f"exited with code {death.exitcode}"


# What follows runs in the worker process.

_job: Job | None = None
_workbench: Workbench | None = None


def _start_worker(job: Job) -> None:
    global _job, _workbench
    _job, _workbench = job, None
    # A plugin that never returns to the interpreter must not outlive its deadline.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    """Leave no process behind when the run is killed."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _versions() -> dict[tuple[str, str], Any]:
    assert _job is not None
    return versions_now(_job.plan)


def _observe(block: Block) -> tuple[int, list[Made]]:
    global _workbench
    if _workbench is None:
        assert _job is not None
        _workbench = Workbench(_job)
        # Threads make small batched algebra slower and its timing unrepeatable; here for good.
        threadpool_limits(limits=1)
    return os.getpid(), _workbench.observe(block)


def _image(contestant: int, memory_mib: float | None) -> Made:
    assert _workbench is not None
    with _memory_limit(memory_mib):
        made = _workbench.image(contestant)
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
