"""Guarded work: cells in a process of their own, with a deadline and a memory limit for each.

A plugin may raise, hang, exhaust memory, exit or die by a signal: its cell gets
a row that says so, a fresh process takes over, and no other cell notices.
"""

from __future__ import annotations

import gc
import math
import os
import resource
import time
import warnings
from collections import deque
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from threadpoolctl import threadpool_limits

from isacbench.bench.cells.cell import describe_error
from isacbench.bench.store.provenance import Made
from isacbench.bench.store.resume import versions_now
from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.bench.workers.workbench import Workbench, is_to_time
from isacbench.errors import InputError, InputWarning

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import TracebackType

    from pebble import ProcessFuture

    from isacbench.bench.cells.record import CellStatus
    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block

DEFAULT_TIMEOUT_S = 600.0
"""Nothing that images a scene takes ten minutes, unless it hangs."""

OBSERVE_ATTEMPTS = 3
MIB = 2**20
PROCESS_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Guard:
    """Limits of every cell.

    Attributes
    ----------
    timeout_s : float or None
        Wall time of estimate and scores in s; None for no limit. Where
        repeats are timed, the first estimate has it, and the others have
        it as many times over as there are.
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
            if limit is not None and not 0 < limit < math.inf:
                raise InputError(f"{option} {limit:g} {unit}: allowed is more than 0, and finite")
        if self.memory_mib is not None and not PROCESS_STATUS.exists():
            raise InputError("memory: a limit can be enforced on Linux only; allowed here is a run without")


class Lane:
    """One worker process, renewed when a cell costs it its life; a context manager.

    Parameters
    ----------
    job : Job
    guard : Guard
    repeats : int, optional
        How often each estimate is timed (`isacbench.bench.cells.timing`); without it
        times do not count.
    """

    def __init__(self, job: Job, guard: Guard, repeats: int | None = None) -> None:
        self._job, self._guard, self._repeats = job, guard, repeats
        self._process = GuardedProcess(_start_worker, job, repeats)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def process_id(self) -> int:
        """Number of the process, 0 where there is none yet."""
        return self._process.id

    def cancel(self) -> None:
        """Tell the lane to end its work, without waiting for it; from any thread."""
        self._process.cancel()

    def stop(self) -> None:
        """End the process for good, whatever it does; from any thread."""
        self._process.stop()

    def versions(self) -> dict[tuple[str, str], Any]:
        """Versions that rows of the process have, by name and parameters of the entry.

        Raises
        ------
        InputError
            If the process cannot have all entries.
        """
        try:
            return self._process.call(_versions, timeout_s=self._guard.timeout_s)
        except ProcessLostError as loss:
            raise InputError(f"loading the plugins: {loss.reason}") from loss

    def work(self, blocks: Iterable[Block], n_ahead: int = 0) -> Iterator[Made]:
        """Work off the cells of blocks; each yields a row, whatever becomes of it.

        Parameters
        ----------
        blocks : iterable of Block
            Taken from as the work goes on.
        n_ahead : int
            Calls that wait in the process while one is answered, so that it
            never does. Of those nothing comes if the iterator is left early.

        Raises
        ------
        CancelledError
            If the lane was stopped meanwhile.
        InputError
            If no process lives through observing a block.
        """
        steps = chain.from_iterable(map(_steps, blocks))
        waiting: deque[_Step] = deque()
        answers: deque[ProcessFuture[Any]] = deque()
        traces: dict[int, Made] = {}
        n_deaths = n_met = 0
        while True:
            waiting.extend(islice(steps, max(n_ahead + 1 - len(waiting), 0)))
            if not waiting:
                return
            try:
                answers.extend(self._schedule(step) for step in islice(waiting, len(answers), None))
                if waiting[0].entry is None:
                    observed: list[Made] = self._process.answer(answers[0])
            except ProcessLostError as loss:
                n_deaths += 1
                if n_deaths == OBSERVE_ATTEMPTS:
                    raise self._unobservable(waiting[0].block, loss) from loss
                answers.clear()
                if waiting[0].entry is not None:
                    waiting.appendleft(_observation(waiting[0].block, traces))
                continue
            step, answer = waiting.popleft(), answers.popleft()
            if step.entry is None:
                traces, n_deaths = dict(zip(step.block.entries, observed, strict=True)), 0
                continue
            trace = traces.pop(step.entry)
            made, has_observed = self._image(step.entry, answer, trace, is_first=n_met == 0)
            n_met = n_met + 1 if has_observed else 0
            if made is None:
                answers.clear()
                waiting.extendleft([step, _observation(step.block, (step.entry, *traces))])
                continue
            yield made
            if not has_observed:
                answers.clear()
                if traces:
                    waiting.appendleft(_observation(step.block, traces))

    def _schedule(self, step: _Step) -> ProcessFuture[Any]:
        if step.entry is None:
            return self._process.schedule(_observe, step.block)
        limits = self._guard
        return self._process.schedule(_image, step.entry, limits.memory_mib, timeout_s=limits.timeout_s)

    def _image(
        self, entry: int, answer: ProcessFuture[Any], trace: Made, is_first: bool
    ) -> tuple[Made | None, bool]:
        """Outcome of an image, and whether the process still has what it has observed.

        A process may die of what an earlier cell has left in it. Then there is
        no outcome yet: only a cell that is the first of its process is to blame.
        """
        start = time.perf_counter()
        try:
            made: Made = self._process.answer(answer, self._guard.timeout_s)
            if is_to_time(made, self._repeats):
                made = self._time_repeats(entry, made)
        except CancelledError:
            raise
        except ProcessLostError as loss:
            if loss.status == "killed" and not is_first:
                return None, False
            return _lost(trace, loss.status, loss.reason, time.perf_counter() - start), False
        except NothingObservedError:
            self._process.renew()
            if is_first:
                return _lost(trace, "killed", "the process ended before it began", 0.0), False
            return None, False
        except Exception as error:  # such as an answer that cannot be sent
            self._process.renew()
            return _lost(trace, "error", describe_error(error), time.perf_counter() - start), False
        if made.outcome.record.status == "killed":
            self._process.renew()  # what the plugin still holds must not be held against other cells
            return made, False
        return made, True

    def _time_repeats(self, entry: int, met: Made) -> Made:
        """Outcome of an image with the times of its repeats, which share their deadlines."""
        assert self._repeats is not None
        n, limits = self._repeats + 1, self._guard
        timeout_s = None if limits.timeout_s is None else n * limits.timeout_s
        try:
            return self._process.call(_time_repeats, entry, met, limits.memory_mib, timeout_s=timeout_s)
        except ProcessLostError as loss:
            raise ProcessLostError(loss.status, f"{loss.reason}, in {n} repeats") from loss

    def _unobservable(self, block: Block, loss: ProcessLostError) -> InputError:
        return InputError(
            f"scenario {self._job.plan.scenes[block.scene].name}, trial {block.trial}, {block.snr_db:g} dB: "
            f"{OBSERVE_ATTEMPTS} worker processes in a row did not live to observe it, the last: "
            f"{loss.reason}; allowed are a scenario that fits into memory and plugins that can be imported"
        )


class NothingObservedError(Exception):
    """The process is a fresh one: another has died since it observed."""


class _Step(NamedTuple):
    """A call of the worker process: to observe a block, or to let an entry image what was observed."""

    block: Block
    entry: int | None


def _observation(block: Block, of: Iterable[int]) -> _Step:
    """Step that observes a block once more, for some of its entries."""
    return _Step(block._replace(entries=tuple(of)), None)


def _steps(block: Block) -> Iterator[_Step]:
    return (_Step(block, entry) for entry in (None, *block.entries))


def _lost(trace: Made, status: CellStatus, reason: str, time_s: float) -> Made:
    """Row of a cell whose outcome did not come back."""
    record = replace(trace.outcome.record, status=status, reason=reason, time_estimate_s=time_s)
    return trace._replace(outcome=replace(trace.outcome, record=record))


# What follows runs in the worker process.

_job: Job | None = None
_repeats: int | None = None
_workbench: Workbench | None = None
_process_id = 0


def _start_worker(job: Job, repeats: int | None) -> None:
    global _job, _repeats, _workbench, _process_id
    # The process that plans the run draws the same scenes, and warns of them.
    warnings.simplefilter("ignore", InputWarning)
    _job, _repeats, _workbench, _process_id = job, repeats, None, os.getpid()


def _versions() -> dict[tuple[str, str], Any]:
    assert _job is not None
    return versions_now(_job.plan)


def _observe(block: Block) -> list[Made]:
    global _workbench
    if _workbench is None:
        assert _job is not None
        _workbench = Workbench(_job, _repeats)
        # Threads make small batched algebra slower and its timing unrepeatable; here for good.
        threadpool_limits(limits=1)
        # What is there for good need not be looked through each time that garbage is collected.
        gc.freeze()
    return _workbench.observe(block)


def _image(entry: int, memory_mib: float | None) -> Made:
    return _limited(entry, memory_mib, lambda workbench: workbench.image(entry))


def _time_repeats(entry: int, met: Made, memory_mib: float | None) -> Made:
    return _limited(entry, memory_mib, lambda workbench: workbench.time_repeats(entry, met))


def _limited(entry: int, memory_mib: float | None, act: Callable[[Workbench], Made]) -> Made:
    """Let an entry act within its limits; whatever it does becomes a row."""
    if _workbench is None or not _workbench.has_observed:
        raise NothingObservedError
    start = time.perf_counter()
    try:
        with _memory_limit(memory_mib):
            made = act(_workbench)
    except BaseException as error:  # such as KeyboardInterrupt, or no memory left to tell of no memory
        status: CellStatus = "killed" if isinstance(error, MemoryError) else "error"
        made = _workbench.failure_row(entry, status, describe_error(error), time.perf_counter() - start)
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
    limit = _data_bytes() + int(memory_mib * MIB)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
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
