"""Cells in this process, or guarded: in others, with a deadline and a memory limit for each.

A plugin may raise, hang, exhaust memory, exit or die by a signal. Its cell then gets
a row that says so, a fresh process takes over, and other cells are not affected.
"""

from __future__ import annotations

import copy
import gc
import math
import resource
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any, Self

from isacbench.bench.cells.cell import MIB, Found, failed_by, repeat, run_cell, seed_global_generators
from isacbench.bench.cells.record import SCORED, Row
from isacbench.bench.kinds.scenes import Entry, Scene, SharedObservation
from isacbench.bench.plan.run_plan import Block, BlockQueue, Job
from isacbench.bench.store.provenance import Environment, environment_id, environment_of
from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, InputWarning
from isacbench.process_state import process_state_kept

CHANGED = "ValueError: it changed the observation, which is read-only and which others meet as well"


class Workbench:
    """Scenes of a job in this process, out of reach of the plugins that work on them.

    With `repeats` each estimate is timed (`isacbench.bench.cells.cell`); without it times do not count.
    """

    def __init__(self, job: Job, repeats: int | None = None) -> None:
        # Plugins see a copy, and the next ones a fresh copy should they have changed it. Classes are not
        # copied: in this process they are the caller's.
        self.job, self._repeats = copy.deepcopy(job), repeats
        self._scenes: Sequence[Scene] = ()
        self._scene: Scene | None = None
        self._block: Block
        self._shared: SharedObservation
        self._digest = ""
        self._environments: dict[tuple[str, str], Environment] = {}

    @one_blas_thread()
    def observe(self, block: Block) -> dict[int, Row]:
        """Observe what the cells of a block share; return the row of each as far as it is known by now."""
        if not self._scenes:
            self._scenes = copy.deepcopy(self.job).plan.scenes
        scene = self._scenes[block.scene]
        if self._scene is not scene and self._scene is not None:
            self._scene.forget()
        self._scene, self._block, self._shared = scene, block, scene.observe(block.snr_db, block.trial)
        self._digest = self._shared.digest()
        return {entry: self.row(entry) for entry in block.entries}

    def row(self, entry: int) -> Row:
        """Row of an entry of the scene that was observed last, before it has worked on the observation."""
        chosen, shared = self._entry(entry), self._shared
        key = chosen.name, chosen.params
        if key not in self._environments:
            self._environments[key] = environment_of(chosen.plugin)
        environment = self._environments[key]
        known = {
            **shared.labels,
            **chosen.labels,
            **shared.key,
            "estimator": chosen.name,
            "params": chosen.params,
            "n_true": shared.n_true,
            "n_estimated": 0,
            "timing": self._repeats is not None,
            "environment": environment_id(environment),
        }
        return Row(known, environment)

    def image(self, entry: int, first: Row | None = None) -> Row:
        """Let an entry of the scene that was observed last work on the observation, and return its row.

        If it has changed the observation, which is read-only, that is a failure, and the observation is made
        anew for the others. If `first` is its row, repeats of the same are timed.
        """
        chosen, block = self._entry(entry), self._block
        row = self.row(entry) if first is None else first
        key = self._scenes[block.scene].name, block.trial, block.snr_db, chosen.name, chosen.params
        seed_generators = partial(seed_global_generators, self.job.suite.seed, *key)
        work = partial(self._shared.work, chosen.plugin)
        if first is not None:
            work = partial(self._time_repeats, chosen.plugin, first, seed_generators)
        start = time.perf_counter()
        with process_state_kept(), one_blas_thread():
            seed_generators()
            row = run_cell(row, work)
        if self._is_unchanged():
            return row
        row = row.failed("error", CHANGED, time.perf_counter() - start)
        self.start_over()
        return row

    def start_over(self) -> None:
        """Make anew what was observed last, and all that it was made from."""
        self._scenes, self._scene = (), None
        self.observe(self._block)

    def _time_repeats(self, plugin: Any, first: Row, before_each: Callable[[], None]) -> Found:
        """Columns of a row with the times of repeats, or of a failure if they give another result."""
        assert self._repeats is not None

        def prepare() -> SharedObservation:
            before_each()
            return self._shared.unread()

        answers, columns = repeat(prepare, lambda shared: shared.call(plugin), self._repeats)
        if differing := self._shared.n_differing(answers, first):
            reason = (
                f"{differing} of {len(answers)} repeats of the same estimate gave another result; "
                "only what repeats itself can be timed"
            )
            failure = first.failed("error", reason, columns["time_estimate_s"])
            return failure.found, failure.cloud
        return {**first.found, **columns}, first.cloud

    def _is_unchanged(self) -> bool:
        """Tell whether the next entry is shown what the last one was."""
        try:
            return self._shared.digest() == self._digest
        except Exception:  # an array may have become anything
            return False

    def _entry(self, entry: int) -> Entry[Any]:
        """Entry by its index in the whole plan, of which this process may have a part."""
        name, params, _ = self.job.keys[self._block.scene][entry]
        entries = self._scenes[self._block.scene].entries
        return next(one for one in entries if (one.name, one.params) == (name, params))


def work_here(job: Job, blocks: Sequence[Block], repeats: int | None = None) -> Generator[Row, None, None]:
    """Work off blocks in this process: easy to debug, but a plugin that hangs or dies takes all with it."""
    workbench = Workbench(job, repeats)
    for block in blocks:
        for entry in workbench.observe(block):
            row = workbench.image(entry)
            is_to_time = repeats is not None and row.status in SCORED
            yield workbench.image(entry, row) if is_to_time else row


DEFAULT_TIMEOUT_S = 600.0
"""Default limit in s: an estimate that takes ten minutes hangs."""

OBSERVE_ATTEMPTS = 3
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
    of its own: whatever it does to it, no other estimator meets. With `repeats` each estimate
    is timed (`isacbench.bench.cells.cell`).
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
        """Read the versions of the code in the processes, by name and parameters of the entry.

        InputError if a process ends before it has loaded all plugins.
        """
        found: dict[tuple[str, str], Any] = {}
        for owner in self._parts:
            try:
                found |= self._process(owner).call(_versions, timeout_s=self._limits[0].timeout_s)
            except ProcessLostError as loss:
                raise InputError(f"loading the plugins: {loss.reason}") from loss
        return found

    def work(self, blocks: Iterable[Block]) -> Iterator[Row]:
        """Work off blocks, which are read one after the other: a row for each cell, also for one that failed.

        CancelledError if the lane was stopped meanwhile, InputError if no process survives observing a block.
        """
        for block in blocks:
            keys = self._keys[block.scene]
            for entry in block.entries:
                owner = keys[entry].owner
                own = block._replace(entries=tuple(one for one in block.entries if keys[one].owner == owner))
                yield self._process(owner).row(own, entry)

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


class _CellProcess(GuardedProcess):
    """One process for cells, replaced by a fresh one when a cell ends it."""

    def __init__(self, job: Job, guard: Guard, repeats: int | None) -> None:
        super().__init__(_start_worker, job, repeats)
        self._job, self._guard, self._repeats = job, guard, repeats
        self._n_cells = 0  # that the present process has worked on
        self._block: Block | None = None
        self._rows: dict[int, Row] = {}

    def renew(self) -> None:
        """End the process; the next call starts a fresh one."""
        self._n_cells = 0
        super().renew()

    def row(self, block: Block, entry: int) -> Row:
        """Row of a cell of a block that has none but cells of this process, also of one that failed."""
        while True:
            if block != self._block or not self._n_cells:
                self._rows, self._block = self._observe(block), block
            if (row := self._image(entry)) is not None:
                return row

    def _observe(self, block: Block) -> dict[int, Row]:
        """Observe a block; return rows to be used if no image comes back.

        Several attempts, because a process may also die of what earlier cells left.
        """
        for _ in range(OBSERVE_ATTEMPTS):
            try:
                return self.call(_observe, block)
            except ProcessLostError as error:
                loss = error
        raise InputError(
            f"scenario {self._job.plan.scenes[block.scene].name}, trial {block.trial}, {block.snr_db:g} dB: "
            f"{OBSERVE_ATTEMPTS} worker processes in a row died while simulating the observation; the last: "
            f"{loss.reason}; the scenario must fit into memory, and plugins must be importable"
        ) from loss

    def _image(self, entry: int) -> Row | None:
        """Image an entry; None if its process was killed and had worked on other cells before.

        Only the first cell of a process is blamed for its end; others are tried again.
        """
        start, is_first, during = time.perf_counter(), not self._n_cells, ""
        timeout_s, memory_mib = self._guard.timeout_s, self._guard.memory_mib
        self._n_cells += 1
        try:
            row = self.call(_image, entry, memory_mib, timeout_s=timeout_s)
            if self._repeats is not None and row.status in SCORED:
                n = self._repeats + 1  # which share one deadline
                timeout_s, during = timeout_s and n * timeout_s, f", in {n} repeats"
                row = self.call(_image, entry, memory_mib, row, timeout_s=timeout_s)
        except CancelledError:
            raise
        except ProcessLostError as loss:
            if loss.status == "killed" and not is_first:
                return None
            return self._rows[entry].failed(loss.status, loss.reason + during, time.perf_counter() - start)
        except Exception as error:  # such as an answer that cannot be sent
            self.renew()
            return failed_by(error, self._rows[entry], time.perf_counter() - start)
        if row.status == "killed":
            self.renew()  # memory that the plugin still holds must not count for other cells
        return row


def work_guarded(
    job: Job, blocks: Sequence[Block], guard: Guard, n_jobs: int, repeats: int | None = None
) -> Generator[Row, None, None]:
    """Work off blocks in guarded processes side by side; rows come in the order in which they are done.

    With `repeats`, each estimate is timed with no other process at work: there is one, which is idle while
    its answers are taken, and this one waits while it works.
    """
    if repeats is not None:
        with Lane(job, guard, repeats) as lane:
            yield from lane.work(blocks)
        return
    queue = BlockQueue(blocks)
    done: SimpleQueue[Row | BaseException] = SimpleQueue()
    lanes = [Lane(job, guard) for _ in range(min(n_jobs, len(blocks)))]

    def work(lane: Lane) -> None:
        try:
            for row in lane.work(queue.blocks()):
                done.put(row)
        except BaseException as error:
            done.put(error)

    with ThreadPoolExecutor(max(len(lanes), 1)) as threads:
        try:
            for lane in lanes:
                # A lane may need the plugin files that are registered for this thread alone.
                threads.submit(copy_context().run, work, lane)
            for _ in range(sum(len(block.entries) for block in blocks)):
                row = done.get()
                if isinstance(row, BaseException):
                    raise row
                yield row
        finally:
            for lane in lanes:
                lane.stop()


# The functions below run in the worker process.

_workbench: Workbench


def _start_worker(job: Job, repeats: int | None) -> None:
    global _workbench
    # The process that plans the run draws the same scenes, and warns of them.
    warnings.simplefilter("ignore", InputWarning)
    _workbench = Workbench(job, repeats)
    gc.freeze()  # permanent objects need not be searched at every garbage collection


def _versions() -> dict[tuple[str, str], Any]:
    return _workbench.job.plan.versions()


def _observe(block: Block) -> dict[int, Row]:
    return _workbench.observe(block)


def _image(entry: int, memory_mib: float | None, first: Row | None = None) -> Row:
    """Work on an entry within its memory limit; a failure becomes a row."""
    start = time.perf_counter()
    try:
        with _memory_limit(memory_mib):
            row = _workbench.image(entry, first)
    except BaseException as error:  # also KeyboardInterrupt, and MemoryError while an error is handled
        row = failed_by(error, _workbench.row(entry), time.perf_counter() - start)
        _workbench.start_over()
    if memory_mib is None or row.status != "killed":
        return row
    reason = f"more than {memory_mib:g} MiB: {row.found['reason']}"
    return row.failed("killed", reason, row.found["time_estimate_s"])


@contextmanager
def _memory_limit(memory_mib: float | None) -> Iterator[None]:
    """Limit the memory that this process may allocate in addition to what it holds."""
    if memory_mib is None:
        yield
        return
    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    # Private writable memory of this process, as the limit counts it.
    (line,) = (line for line in PROCESS_STATUS.read_text().splitlines() if line.startswith("VmData:"))
    limit = int(line.split()[1]) * 1024 + int(memory_mib * MIB)
    resource.setrlimit(
        resource.RLIMIT_DATA, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard)
    )
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))
