"""Guarded work: cells in a process of their own, with a deadline and a memory limit for each.

A plugin may raise, hang, exhaust memory, exit or die by a signal. Its cell then gets
a row that says so, a fresh process takes over, and other cells are not affected.
"""

from __future__ import annotations

import gc
import math
import resource
import time
import warnings
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Self

from isacbench.bench.cells.cell import describe_error
from isacbench.bench.store.provenance import Made
from isacbench.bench.store.resume import versions_now
from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.bench.workers.workbench import Workbench, is_to_time
from isacbench.errors import InputError, InputWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from isacbench.bench.cells.record import CellStatus
    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block

DEFAULT_TIMEOUT_S = 600.0
"""Default limit in s: an estimate that takes ten minutes hangs."""

OBSERVE_ATTEMPTS = 3
MIB = 2**20
PROCESS_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Guard:
    """Limits of every cell.

    Attributes
    ----------
    timeout_s : float or None
        Wall time of estimate and scores in s; None for no limit. In a run
        with timing, the first estimate has this limit. The repeats, and the
        one that measures memory, together have this limit times their number.
    memory_mib : float or None
        Memory in MiB that a cell may take in addition to what its process
        already holds; None for no limit.

    Raises
    ------
    InputError
        If a limit is not positive, or cannot be enforced on this system.
    """

    timeout_s: float | None = DEFAULT_TIMEOUT_S
    memory_mib: float | None = None

    def __post_init__(self) -> None:
        for option, limit, unit in (("timeout", self.timeout_s, "s"), ("memory", self.memory_mib, "MiB")):
            if limit is not None and not 0 < limit < math.inf:
                raise InputError(f"{option} {limit:g} {unit}: allowed is more than 0, and finite")
        if self.memory_mib is not None and not PROCESS_STATUS.exists():
            raise InputError("memory limits need Linux; run without one here")


class Lane:
    """Worker processes for cells, one of which works at a time; a context manager.

    Estimators of isacbench share a process. One with classes of somebody else has a process
    of its own: whatever it does to it, no other estimator meets.

    Parameters
    ----------
    repeats : int, optional
        Number of timed repeats of each estimate (`isacbench.bench.cells.timing`);
        without it times are not measured for comparison.
    """

    def __init__(self, job: Job, guard: Guard, repeats: int | None = None) -> None:
        # Here, for the threads that work may not know of plugin files.
        self._parts, self._keys = job.parts, job.keys
        self._limits, self._is_stopped = (guard, repeats), False
        self._processes: dict[tuple[str, ...], _CellProcess] = {}
        self._at_work: _CellProcess | None = None
        self._changing = Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the processes for good, also in the middle of a call; may be called from any thread."""
        with self._changing:
            self._is_stopped = True
            processes = list(self._processes.values())
        for process in processes:
            process.stop()

    def versions(self) -> dict[tuple[str, str], Any]:
        """Read the versions of the code in a process.

        Returns
        -------
        dict of (str, str) to Any
            By name and parameters of the entry.

        Raises
        ------
        InputError
            If the process ends before it has loaded all plugins.
        """
        found: dict[tuple[str, str], Any] = {}
        for owner in self._parts:
            found |= self._process(owner).versions()
        return found

    def work(self, blocks: Iterable[Block]) -> Iterator[Made]:
        """Process the cells of blocks.

        Parameters
        ----------
        blocks : iterable of Block
            Read one after the other as the work goes on.

        Yields
        ------
        Made
            A row for each cell, also for one that failed.

        Raises
        ------
        CancelledError
            If the lane was stopped meanwhile.
        InputError
            If no process survives observing a block.
        """
        for block in blocks:
            keys = self._keys[block.scene]
            for entry in block.entries:
                owner = keys[entry].owner
                own = block._replace(entries=tuple(one for one in block.entries if keys[one].owner == owner))
                yield self._process(owner).made(own, entry)

    def _process(self, owner: tuple[str, ...]) -> _CellProcess:
        """Process of the classes of somebody else; all others pause, threads of plugins included."""
        with self._changing:
            if self._is_stopped:
                raise CancelledError
            if owner not in self._processes:
                self._processes[owner] = _CellProcess(self._parts[owner], *self._limits)
        process = self._processes[owner]
        if process is not self._at_work:
            if self._at_work is not None:
                self._at_work.pause()
            process.go_on()
            self._at_work = process
        return process


class _CellProcess:
    """One process for cells, replaced by a fresh one when a cell ends it."""

    def __init__(self, job: Job, guard: Guard, repeats: int | None) -> None:
        self._job, self._guard, self._repeats = job, guard, repeats
        self._process = GuardedProcess(_start_worker, job, repeats)
        self.stop, self.pause, self.go_on = self._process.stop, self._process.pause, self._process.go_on
        self._n_met = 0  # cells that the present process has worked on
        self._block: Block | None = None
        self._traces: dict[int, Made] = {}

    def versions(self) -> dict[tuple[str, str], Any]:
        """Versions of the code in the process, by name and parameters of the entry."""
        try:
            return self._process.call(_versions, timeout_s=self._guard.timeout_s)
        except ProcessLostError as loss:
            raise InputError(f"loading the plugins: {loss.reason}") from loss

    def made(self, block: Block, entry: int) -> Made:
        """Row of a cell of a block that has none but cells of this process, also of one that failed."""
        made = None
        while made is None:
            if block != self._block or not self._n_met:
                self._traces, self._block = self._observe(block), block
            made = self._image(entry, self._traces[entry])
        return made

    def _observe(self, block: Block) -> dict[int, Made]:
        """Observe a block; return a row for each entry, used if its image does not come back.

        Several attempts, because a process may also die of what earlier cells left.
        """
        for _ in range(OBSERVE_ATTEMPTS):
            try:
                return dict(zip(block.entries, self._process.call(_observe, block), strict=True))
            except ProcessLostError as error:
                loss = error
                self._n_met = 0
        raise InputError(
            f"scenario {self._job.plan.scenes[block.scene].name}, trial {block.trial}, {block.snr_db:g} dB: "
            f"{OBSERVE_ATTEMPTS} worker processes in a row died while simulating the observation; the last: "
            f"{loss.reason}; the scenario must fit into memory, and plugins must be importable"
        ) from loss

    def _image(self, entry: int, trace: Made) -> Made | None:
        """Image an entry; None if its process was killed and had worked on other cells before.

        Only the first cell of a process is blamed for its end; others are tried again.
        """
        start, is_first = time.perf_counter(), not self._n_met
        self._n_met += 1
        try:
            limits = self._guard
            made = self._process.call(_image, entry, limits.memory_mib, timeout_s=limits.timeout_s)
            if is_to_time(made, self._repeats):
                made = self._time_repeats(entry, made)
        except CancelledError:
            raise
        except ProcessLostError as loss:
            self._n_met = 0
            if loss.status == "killed" and not is_first:
                return None
            return _lost(trace, loss.status, loss.reason, time.perf_counter() - start)
        except Exception as error:  # such as an answer that cannot be sent
            self._renew()
            return _lost(trace, "error", describe_error(error), time.perf_counter() - start)
        if made.outcome.record.status == "killed":
            self._renew()  # memory that the plugin still holds must not count for other cells
        return made

    def _renew(self) -> None:
        self._process.renew()
        self._n_met = 0

    def _time_repeats(self, entry: int, met: Made) -> Made:
        """Time the repeats of an image; they share one deadline."""
        assert self._repeats is not None
        n, limits = self._repeats + 1, self._guard
        timeout_s = None if limits.timeout_s is None else n * limits.timeout_s
        try:
            return self._process.call(_time_repeats, entry, met, limits.memory_mib, timeout_s=timeout_s)
        except ProcessLostError as loss:
            raise ProcessLostError(loss.status, f"{loss.reason}, in {n} repeats") from loss


def _lost(trace: Made, status: CellStatus, reason: str, time_s: float) -> Made:
    """Row of a cell whose outcome did not come back."""
    return _changed(trace, status=status, reason=reason, time_estimate_s=time_s)


def _changed(made: Made, **changes: Any) -> Made:
    """Copy of an outcome with a changed record."""
    record = replace(made.outcome.record, **changes)
    return made._replace(outcome=replace(made.outcome, record=record))


# The functions below run in the worker process.

_job: Job | None = None
_repeats: int | None = None
_workbench: Workbench | None = None


def _start_worker(job: Job, repeats: int | None) -> None:
    global _job, _repeats
    # The process that plans the run draws the same scenes, and warns of them.
    warnings.simplefilter("ignore", InputWarning)
    _job, _repeats = job, repeats


def _versions() -> dict[tuple[str, str], Any]:
    assert _job is not None
    return versions_now(_job.plan)


def _observe(block: Block) -> list[Made]:
    global _workbench
    if _workbench is None:
        assert _job is not None
        _workbench = Workbench(_job, _repeats)
        # Permanent objects need not be searched at every garbage collection.
        gc.freeze()
    return _workbench.observe(block)


def _image(entry: int, memory_mib: float | None) -> Made:
    return _limited(entry, memory_mib, lambda workbench: workbench.image(entry))


def _time_repeats(entry: int, met: Made, memory_mib: float | None) -> Made:
    return _limited(entry, memory_mib, lambda workbench: workbench.time_repeats(entry, met))


def _limited(entry: int, memory_mib: float | None, act: Callable[[Workbench], Made]) -> Made:
    """Run an action on an entry within its memory limit; a failure becomes a row."""
    assert _workbench is not None
    start = time.perf_counter()
    try:
        with _memory_limit(memory_mib):
            made = act(_workbench)
    except BaseException as error:  # also KeyboardInterrupt, and MemoryError while an error is handled
        status: CellStatus = "killed" if isinstance(error, MemoryError) else "error"
        made = _workbench.failure_row(entry, status, describe_error(error), time.perf_counter() - start)
        _workbench.start_over()
    record = made.outcome.record
    if memory_mib is None or record.status != "killed":
        return made
    return _changed(made, reason=f"more than {memory_mib:g} MiB: {record.reason}")


@contextmanager
def _memory_limit(memory_mib: float | None) -> Iterator[None]:
    """Limit the memory that this process may allocate in addition to what it holds."""
    if memory_mib is None:
        yield
        return
    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = _data_bytes() + int(memory_mib * MIB)
    resource.setrlimit(
        resource.RLIMIT_DATA, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard)
    )
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))


def _data_bytes() -> int:
    """Private writable memory of this process, as RLIMIT_DATA counts it."""
    (line,) = (line for line in PROCESS_STATUS.read_text().splitlines() if line.startswith("VmData:"))
    return int(line.split()[1]) * 1024
