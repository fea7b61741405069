"""A Dask worker's side of a run: batches of blocks, in guarded processes that stay from batch to batch.

The worker itself never imports a plugin: whatever one does, it does to a
process of its own. All that arrives here is an order, by content.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import pickle
import time
import uuid
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock, Timer
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.bench.plan.job import Job
from isacbench.bench.store.resume import differing_versions
from isacbench.bench.workers.guarded_cells import Guard, Lane
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Made

BATCH_S = 2.0
"""What a worker that dies loses at most, bar the cell that it is at; long beside the cost of a task."""

IDLE_S = 60.0
"""A process that waits longer for its run's next batch was left behind by a run that was killed."""


class UnfitWorkerError(InputError):
    """A worker lacks a plugin of a run, or has other versions."""


@dataclass(frozen=True)
class WorkOrder:
    """What a run asks of every worker.

    Attributes
    ----------
    job : Job
    guard : Guard
        Limits of every cell.
    versions : mapping of (str, str) to Any
        Versions that rows must have, by name and parameters of the entry.
    mix_versions : bool
        Whether rows of other versions will do.
    """

    job: Job
    guard: Guard
    versions: Mapping[tuple[str, str], Any]
    mix_versions: bool = False

    def pack(self) -> PackedOrder:
        """Pack it so that every task can carry it, and give it a token of its own."""
        return PackedOrder(uuid.uuid4().hex, zlib.compress(pickle.dumps(self)))

    def require_versions(self, found: Mapping[tuple[str, str], Any]) -> None:
        """Refuse a process that would make other rows than the run's.

        Parameters
        ----------
        found : mapping of (str, str) to Any
            Versions that its rows would have, as in `versions`.

        Raises
        ------
        InputError
            Naming the first entry that differs, what is there, and what
            is wanted.
        """
        for (name, params), wanted in self.versions.items():
            if (name, params) not in found:
                there = " or ".join(params for other, params in found if other == name)
                raise InputError(f"{name} has the parameters {there or 'none'} instead of {params}")
            if found[name, params] != wanted and not self.mix_versions:
                raise InputError(f"{name}: {', '.join(differing_versions(found[name, params], wanted))}")


class PackedOrder(NamedTuple):
    """An order on its way.

    Attributes
    ----------
    token : str
        By which workers know it again.
    content : bytes
    """

    token: str
    content: bytes

    def unpack(self) -> WorkOrder:
        """Unpack it."""
        order: WorkOrder = pickle.loads(zlib.decompress(self.content))
        return order


class Batch(NamedTuple):
    """What became of a task.

    Attributes
    ----------
    made : list of Made
        In the order of the cells.
    rest : tuple of Block
        Cells that there was no time for.
    """

    made: list[Made]
    rest: tuple[Block, ...]


class Lanes:
    """Guarded processes of one Dask worker: one for each thread that works, kept for the run's next batch.

    Parameters
    ----------
    idle_s : float
        After so many seconds without work a process ends.
    """

    def __init__(self, idle_s: float = IDLE_S) -> None:
        self._idle_s = idle_s
        self._lock = Lock()
        self._idle: defaultdict[str, dict[Lane, Timer]] = defaultdict(dict)
        self._busy: defaultdict[str, set[Lane]] = defaultdict(set)

    @contextmanager
    def lane(self, order: PackedOrder) -> Iterator[Lane]:
        """Lend a process for an order; of an exception it does not survive.

        Raises
        ------
        UnfitWorkerError
            If it lacks a plugin of the order, or has other versions.
        """
        lane = self._idle_lane(order.token) or self._fresh_lane(order)
        try:
            yield lane
        except BaseException:
            self._forget(order.token, lane)
            lane.stop()
            raise
        self._put_back(order.token, lane)

    def stop(self, token: str) -> None:
        """End all processes of an order, whatever they do."""
        with self._lock:
            idle, busy = self._idle.pop(token, {}), self._busy.pop(token, set())
        for timer in idle.values():
            timer.cancel()
        for lane in [*idle, *busy]:
            lane.stop()

    def _idle_lane(self, token: str) -> Lane | None:
        with self._lock:
            if not self._idle[token]:
                return None
            lane, timer = self._idle[token].popitem()
            self._busy[token].add(lane)
        timer.cancel()
        return lane

    def _fresh_lane(self, packed: PackedOrder) -> Lane:
        _undo_nanny()
        order = packed.unpack()
        lane = Lane(order.job, order.guard)
        with self._lock:
            self._busy[packed.token].add(lane)
        try:
            order.require_versions(lane.versions())
        except BaseException as error:
            self._forget(packed.token, lane)
            lane.stop()
            if isinstance(error, InputError):
                raise UnfitWorkerError(str(error)) from error
            raise
        return lane

    def _put_back(self, token: str, lane: Lane) -> None:
        timer = Timer(self._idle_s, self._expire, [token, lane])
        timer.daemon = True
        with self._lock:
            was_stopped = lane not in self._busy[token]
            if not was_stopped:
                self._busy[token].remove(lane)
                self._idle[token][lane] = timer
                timer.start()
        if was_stopped:
            lane.stop()

    def _expire(self, token: str, lane: Lane) -> None:
        with self._lock:
            was_idle = self._idle[token].pop(lane, None) is not None
        if was_idle:
            lane.stop()

    def _forget(self, token: str, lane: Lane) -> None:
        with self._lock:
            self._busy[token].discard(lane)


def _undo_nanny() -> None:
    """Undo for the processes of cells what a nanny has done to this one."""
    # Daemons may not have children.
    multiprocessing.current_process().daemon = False
    # Memory that goes back to the system at once makes an estimator take more than twice as long.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)


_lanes = Lanes()


def work(order: PackedOrder, blocks: Sequence[Block]) -> Batch:
    """Work off blocks until `BATCH_S` is over: the Dask task.

    Raises
    ------
    UnfitWorkerError
        If this worker lacks a plugin, or has other versions.
    """
    start, made = time.monotonic(), []
    with _lanes.lane(order) as lane:
        for index, block in enumerate(blocks):
            for n_done, one in enumerate(lane.work([block]), start=1):
                made.append(one)
                if time.monotonic() - start > BATCH_S:
                    return Batch(made, _without(n_done, blocks[index:]))
    return Batch(made, ())


async def check_worker(order: PackedOrder) -> None:
    """Start a process as `work` does, beside the worker's tasks, and so find out whether it can.

    Raises
    ------
    UnfitWorkerError
        As `work` does.
    """
    await asyncio.to_thread(_start, order)


async def stop(token: str) -> None:
    """End all processes of an order, beside the worker's tasks."""
    await asyncio.to_thread(_lanes.stop, token)


def _start(order: PackedOrder) -> None:
    with _lanes.lane(order):
        pass


def _without(n_done: int, blocks: Sequence[Block]) -> tuple[Block, ...]:
    """Blocks without the first cells of the first one."""
    first, *others = blocks
    waiting = first.entries[n_done:]
    return (first._replace(entries=waiting), *others) if waiting else tuple(others)
