"""Tasks of a Dask worker: batches of blocks, each in a guarded process of its own.

The worker itself never imports a plugin: whatever one does, it does to a
guarded process. An order arrives by content.
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
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.bench.plan.job import Job
from isacbench.bench.store.resume import differing_versions, versions_now
from isacbench.bench.workers.guarded_cells import Guard, Lane
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Made

BATCH_S = 10.0
"""Time in s after which a task takes no other cell: long compared with the start of a process."""


@dataclass(frozen=True)
class WorkOrder:
    """Request of a run to every worker, small enough for each task to carry it.

    Attributes
    ----------
    token : str
        Name by which workers know the run again.
    guard : Guard
        Limits of every cell.
    versions : mapping of (str, str) to Any
        Versions that rows must have, by name and parameters of the entry.
    mix_versions : bool
        Whether rows of other versions are allowed.
    """

    token: str
    packed_job: bytes
    guard: Guard
    versions: Mapping[tuple[str, str], Any]
    mix_versions: bool = False

    @classmethod
    def of_job(cls, job: Job, guard: Guard, mix_versions: bool = False) -> WorkOrder:
        """Make the order for a job, with the versions of this process."""
        job.parts  # noqa: B018  which the worker itself cannot make, for it imports no plugin
        packed = zlib.compress(pickle.dumps(job))
        return cls(uuid.uuid4().hex, packed, guard, versions_now(job.plan), mix_versions)

    @contextmanager
    def lane(self) -> Iterator[Lane]:
        """Start a guarded process for the cells of the order, which ends with the context.

        Raises
        ------
        InputError
            If it lacks a plugin of the order, or has other versions.
        """
        _undo_nanny()
        with Lane(pickle.loads(zlib.decompress(self.packed_job)), self.guard) as lane:
            _busy[self.token].add(lane)
            try:
                self._require_fit(lane)
                yield lane
            finally:
                _busy[self.token].discard(lane)

    def _require_fit(self, lane: Lane) -> None:
        """Refuse a process that would make other rows than the run's."""
        try:
            found = lane.versions()
            for (name, params), wanted in self.versions.items():
                if (name, params) not in found:
                    there = " or ".join(params for other, params in found if other == name) or "none"
                    raise InputError(f"{name} has the parameters {there} instead of {params}")
                if found[name, params] != wanted and not self.mix_versions:
                    raise InputError(f"{name}: {', '.join(differing_versions(found[name, params], wanted))}")
        except InputError as error:
            raise InputError(
                f"{error}; install the same isacbench and plugins on all workers before starting them"
            ) from error


_busy: defaultdict[str, set[Lane]] = defaultdict(set)
"""Processes at work, by the token of their order."""


class Batch(NamedTuple):
    """Result of a task.

    Attributes
    ----------
    made : list of Made
        In the order of the cells.
    rest : tuple of Block
        Cells that there was no time for.
    """

    made: list[Made]
    rest: tuple[Block, ...]


def _undo_nanny() -> None:
    """Undo for the processes of cells what a nanny has done to this one."""
    # Daemons may not have children.
    multiprocessing.current_process().daemon = False
    # Memory that goes back to the system at once makes an estimator take more than twice as long.
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)


def work(order: WorkOrder, blocks: Sequence[Block]) -> Batch:
    """Work off blocks until `BATCH_S` is over: the Dask task.

    Raises
    ------
    InputError
        If this worker lacks a plugin, or has other versions.
    """
    start, made = time.monotonic(), []
    with order.lane() as lane:
        for index, block in enumerate(blocks):
            for n_done, one in enumerate(lane.work([block]), start=1):
                made.append(one)
                if time.monotonic() - start > BATCH_S:
                    rest = block._replace(entries=block.entries[n_done:]), *blocks[index + 1 :]
                    return Batch(made, tuple(one for one in rest if one.entries))
    return Batch(made, ())


async def check_worker(order: WorkOrder) -> None:
    """Start a process as `work` does, at the same time as the worker's tasks, to find out whether it can.

    Raises
    ------
    InputError
        As `work` does.
    """
    await asyncio.to_thread(work, order, ())


async def stop(token: str) -> None:
    """End all processes of an order, at the same time as the worker's tasks."""
    for lane in _busy.pop(token, set()):
        await asyncio.to_thread(lane.stop)
