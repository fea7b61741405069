"""Blocks of cells become rows: in the caller's process, or in guarded ones with limits for each cell.

A plugin may raise, hang, exhaust memory, exit or die by a signal. Its cell then gets a row that says so, a
fresh process takes over, and other cells are not affected.

`work` is the way of a cell wherever it runs. Its messages say how long the next one may take: the caller
waits for a `Ready` without a deadline, and for the first row after it, or after another row, until the limit.
"""

from __future__ import annotations

import copy
import gc
import time
import warnings
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import AbstractContextManager
from queue import SimpleQueue
from threading import Lock
from typing import Any, NamedTuple

from isacbench.bench.cells.cell import Limits, failed_by, first_row, run_cell, time_repeats
from isacbench.bench.cells.plan import Block, Job, Plan, pieces
from isacbench.bench.cells.process import GuardedProcess, ProcessLostError
from isacbench.bench.cells.rows import Row
from isacbench.bench.cells.task import Shared, Task
from isacbench.charts import Variant
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, InputWarning
from isacbench.plugins.code_digests import foreign_classes

CHANGED = "ValueError: it changed the observation, which is read-only and which others meet as well"

OBSERVE_ATTEMPTS = 3
"""Processes that may die while they observe a block: one may also die of what earlier cells left."""


PIECES_A_WORKER = 4
"""Pieces for each worker at least, so that none is idle for long while another has its last one."""


class Ready(NamedTuple):
    """The observation is made.

    `rows` are those of its cells as far as they are known by now. The process `is_fresh` if it has not
    worked on any cell yet.
    """

    rows: Mapping[Variant, Row]
    is_fresh: bool


class Repeating(NamedTuple):
    """An estimate is about to be repeated."""

    n: int


def work(
    job: Job, blocks: Iterable[Block], limits: Limits | None = None, repeats: int | None = None
) -> Iterator[Ready | Repeating | Row]:
    """Work on blocks, which are read one after the other: a row for each cell, whatever becomes of it.

    With `repeats` each estimate is timed; without it times do not count.
    """
    # Plugins work on a copy, and on a fresh one after one has changed it. Classes are not copied: in the
    # caller's process they are the caller's.
    plan = copy.deepcopy(job).plan
    environments, is_timed, is_fresh = plan.environments, repeats is not None, True
    foreign = {one.key for one in plan.entries if foreign_classes(one.plugin)}
    task: Task | None = None
    for block in blocks:
        if task is not None and task.name != block.scenario:
            task.forget()
        task, shared = _observe(plan, block)
        rows = {key: first_row(shared, task.entry(key), environments[key], is_timed) for key in block.entries}
        yield Ready(rows, is_fresh)
        for key, row in rows.items():
            before = shared.digest if key in foreign else ""
            row = run_cell(task, shared, task.entry(key), row, limits)
            if repeats is not None and row.is_scored:
                yield Repeating(repeats + 1)  # one more measures memory
                row = time_repeats(task, shared, task.entry(key), row, repeats, limits)
            if before and shared.has_changed():
                if row.is_scored:
                    row = row.failed("error", CHANGED, row.result["time_estimate_s"])
                plan = copy.deepcopy(job).plan
                task, shared = _observe(plan, block)
            is_fresh = False
            yield row


@one_blas_thread()
def _observe(plan: Plan, block: Block) -> tuple[Task, Shared]:
    task = plan.by_name[block.scenario]
    return task, task.observe(block.snr_db, block.trial)


def rows_here(job: Job, blocks: Sequence[Block], repeats: int | None = None) -> Generator[Row, None, None]:
    """Work in this process: easy to debug, but a plugin that hangs or dies takes all with it."""
    for message in work(job, blocks, repeats=repeats):
        if isinstance(message, Row):
            yield message


def rows_guarded(
    job: Job, blocks: Sequence[Block], limits: Limits, n_jobs: int, repeats: int | None = None
) -> Generator[Row, None, None]:
    """Work in guarded processes side by side; rows come in the order in which they are made.

    With `repeats`, each estimate is timed with no other process at work: there is one, which is idle while
    its rows are taken, and this one waits while it works.
    """
    if repeats is not None:
        with Worker(job.parts, limits, repeats) as worker:
            yield from worker.rows(blocks)
        return
    workers = [Worker(job.parts, limits) for _ in range(min(n_jobs, len(blocks)))]
    todo: dict[str, deque[tuple[Block, ...]]] = {}
    for piece in pieces(blocks, PIECES_A_WORKER * len(workers)):
        todo.setdefault(piece[0].scenario, deque()).append(piece)
    taking = Lock()
    done: SimpleQueue[Row | BaseException] = SimpleQueue()

    def work_off(worker: Worker) -> None:
        try:
            for row in worker.rows(_taken(todo, taking)):
                done.put(row)
        except BaseException as error:
            done.put(error)

    with ThreadPoolExecutor(max(len(workers), 1)) as threads:
        try:
            for worker in workers:
                threads.submit(work_off, worker)
            for _ in range(sum(len(block.entries) for block in blocks)):
                row = done.get()
                if isinstance(row, BaseException):
                    raise row
                yield row
        finally:
            for worker in workers:
                worker.stop()


def _taken(todo: dict[str, deque[tuple[Block, ...]]], taking: Lock) -> Iterator[Block]:
    """Blocks of the pieces, by scenario, that a thread takes: of a scenario of its own while there is one.

    What follows from a scenario alone, as the scores of its oracle, is then seldom made by several workers.
    """
    own: deque[tuple[Block, ...]] = deque()
    while True:
        with taking:
            own = own or max(todo.values(), key=len)
            if not own:
                return
            piece = own.popleft()
        yield from piece


class Worker(AbstractContextManager["Worker"]):
    """Processes for the parts of a job, one of which works at a time; a context manager.

    Estimators of isacbench share a process, and each class of somebody else has one of its own: whatever it
    does to its process reaches no other estimator.
    """

    def __init__(
        self, parts: Mapping[frozenset[Variant], Job], limits: Limits, repeats: int | None = None
    ) -> None:
        self._limits = limits
        self._processes = {
            keys: GuardedProcess(_start, part, limits, repeats) for keys, part in parts.items()
        }
        self._at_work: GuardedProcess | None = None

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the processes for good, also in the middle of a cell; may be called from any thread."""
        for process in self._processes.values():
            process.stop()

    def versions(self) -> dict[Variant, Any]:
        """Read the versions of the code in the processes, by name and parameters of the entry.

        InputError if a process ends before it has loaded all plugins.
        """
        found: dict[Variant, Any] = {}
        for process in self._processes.values():
            try:
                found |= process.call(_versions, timeout_s=self._limits.timeout_s)
            except ProcessLostError as loss:
                raise InputError(f"loading the plugins: {loss.reason}") from loss
        return found

    def rows(self, blocks: Iterable[Block]) -> Iterator[Row]:
        """Work on blocks, which are read one after the other: a row for each cell, also for one that failed.

        CancelledError if the worker was stopped meanwhile, InputError if no process survives observing.
        """
        for block in blocks:
            for keys, process in self._processes.items():
                own = tuple(key for key in block.entries if key in keys)
                if own:
                    self._turn_to(process)
                    yield from rows_of(process, block._replace(entries=own), self._limits.timeout_s)

    def _turn_to(self, process: GuardedProcess) -> None:
        """Let one process work, while all others pause, threads of plugins included."""
        if process is not self._at_work:
            if self._at_work is not None:
                self._at_work.pause()
            process.go_on()
            self._at_work = process


def rows_of(process: GuardedProcess, block: Block, timeout_s: float | None) -> Iterator[Row]:
    """Rows of a block from a process, which is replaced by a fresh one where a cell ends it."""
    left = block.entries
    while left:
        ready = _ready(process, block._replace(entries=left))
        is_first = ready.is_fresh
        while left and process.has_begun:
            row = _next_row(process, ready.rows[left[0]], timeout_s, is_first)
            if row is None:
                break
            if row.status == "killed":
                process.renew()  # memory that the plugin still holds must not count for other cells
            left, is_first = left[1:], False
            yield row


def _ready(process: GuardedProcess, block: Block) -> Ready:
    """Let a process observe a block."""
    for _ in range(OBSERVE_ATTEMPTS):
        try:
            return process.call(_begin, block)
        except ProcessLostError as error:
            loss = error
    raise InputError(
        f"scenario {block.scenario}, trial {block.trial}, {block.snr_db:g} dB: {OBSERVE_ATTEMPTS} worker "
        f"processes in a row died while simulating the observation; the last: {loss.reason}; the scenario "
        "must fit into memory, and plugins must be importable"
    ) from loss


def _next_row(process: GuardedProcess, row: Row, timeout_s: float | None, is_first: bool) -> Row | None:
    """Take the row of a cell from a process; None if it died and had worked on other cells before.

    Only the first cell of a process is blamed for its end; others are tried again.
    """
    start, limit_s, during = time.perf_counter(), timeout_s, ""
    while True:
        try:
            message = process.call(_next_message, timeout_s=limit_s)
        except CancelledError:
            raise
        except ProcessLostError as loss:
            if loss.status == "killed" and not is_first:
                return None
            return row.failed(loss.status, loss.reason + during, time.perf_counter() - start)
        except Exception as error:  # such as a row that cannot be sent
            process.renew()
            return failed_by(error, row, time.perf_counter() - start)
        if isinstance(message, Row):
            return message
        limit_s, during = timeout_s and message.n * timeout_s, f", in {message.n} repeats"


# The functions below run in the worker's process.

_job: Job
_blocks: deque[Block] = deque()
_messages: Iterator[Any]


def _start(job: Job, limits: Limits, repeats: int | None) -> None:
    global _job, _messages
    # The process that plans the run draws the same scenes, and warns of them.
    warnings.simplefilter("ignore", InputWarning)
    _job, _messages = job, work(job, iter(_blocks.popleft, None), limits, repeats)
    gc.freeze()  # permanent objects need not be searched at every garbage collection


def _versions() -> dict[Variant, Any]:
    return _job.plan.versions()


def _begin(block: Block) -> Ready:
    _blocks.append(block)
    ready: Ready = next(_messages)
    return ready


def _next_message() -> Repeating | Row:
    message: Repeating | Row = next(_messages)
    return message
