"""Blocks worked off on a Dask cluster: the same guarded cells, on the workers of other machines.

A task is the blocks of one trial of a scene, which share its echo, or one block where trials are few. It has
guarded processes of its own: the Dask worker itself never imports a plugin, and a job arrives by content.
At the end, cells of tasks in which workers died run again one at a time, to find those that kill workers.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import pickle
import time
import uuid
import zlib
from collections import defaultdict, deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from distributed import Client, Future
from distributed.scheduler import KilledWorker

from isacbench.bench.cells.cell import Limits
from isacbench.bench.cells.plan import Block, Job, pieces
from isacbench.bench.cells.provenance import differing_versions
from isacbench.bench.cells.rows import Row
from isacbench.bench.cells.worker import Ready, Worker, work
from isacbench.charts import Variant
from isacbench.errors import InputError

WAIT_S = 30.0
"""Longest time in s that a run waits for an answer of the scheduler, or for a worker."""

POLL_S = 1.0
CLOSE_S = 5.0
TASKS_A_THREAD = 2
"""Tasks for each thread of a worker: one that runs, and one that waits, so that the thread is never idle."""

NOISY = ("distributed", "tornado", "asyncio")
"""Loggers that print what this module already reports as an error."""

GONE = "the scheduler is gone"


@dataclass(frozen=True)
class Order:
    """Job, limits and versions that each task of a run carries.

    Attributes
    ----------
    token : str
        Name by which workers know the run again.
    packed_parts : bytes
        `Job.parts`, which only the run's process can make: others import no plugin.
    versions : mapping of (str, str) to Any
        Versions that rows must have, by name and parameters of the entry; unless they may be mixed.
    """

    token: str
    packed_parts: bytes
    limits: Limits
    versions: Mapping[Variant, Any]
    mix_versions: bool

    @classmethod
    def of_job(cls, job: Job, limits: Limits, mix_versions: bool = False) -> Order:
        """Make the order for a job, with the versions of this process."""
        packed = zlib.compress(pickle.dumps(job.parts))
        return cls(uuid.uuid4().hex, packed, limits, job.plan.versions(), mix_versions)

    def require_fit(self, worker: Worker) -> None:
        """Refuse processes that lack a plugin, or would make other rows than the run's."""
        try:
            found = worker.versions()
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


# The functions below run in the Dask worker.

_busy: defaultdict[str, set[Worker]] = defaultdict(set)
"""Workers of this machine, by the token of their order."""


def make_rows(order: Order, blocks: Sequence[Block]) -> list[Row]:
    """Work on blocks: the Dask task. InputError if its processes lack a plugin or have another version."""
    # A nanny has made the Dask worker a daemon, which may not have children. And memory that goes back to
    # the system at once makes an estimator take more than twice as long.
    multiprocessing.current_process().daemon = False
    os.environ.pop("MALLOC_TRIM_THRESHOLD_", None)
    with Worker(pickle.loads(zlib.decompress(order.packed_parts)), order.limits) as worker:
        _busy[order.token].add(worker)
        try:
            order.require_fit(worker)
            return list(worker.rows(blocks))
        finally:
            _busy[order.token].discard(worker)


async def check_worker(order: Order) -> None:
    """Find out whether `make_rows` can start its processes, at the same time as the worker's tasks."""
    await asyncio.to_thread(make_rows, order, ())


async def stop(token: str) -> None:
    """End all processes of an order, at the same time as the worker's tasks."""
    for worker in _busy.pop(token, set()):
        await asyncio.to_thread(worker.stop)


# The functions below run in the process of the run.


def rows_on_cluster(
    job: Job, blocks: Sequence[Block], limits: Limits, address: str, mix_versions: bool = False
) -> Generator[Row, None, None]:
    """Work on blocks on the workers of a Dask scheduler; rows come in the order in which they are made.

    Scheduler and workers are checked before this returns. A cell that several workers in a row die of is
    ``killed``. InputError if there is no scheduler or no worker, or a worker lacks a plugin or has another
    version of it; also later, if the cluster is lost.
    """
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        cluster = _Cluster(address, Order.of_job(job, limits, mix_versions))
        stack.callback(cluster.leave)
        cluster.check()
        return _rows(cluster, job, blocks, stack.pop_all())


def _rows(
    cluster: _Cluster, job: Job, blocks: Sequence[Block], stack: ExitStack
) -> Generator[Row, None, None]:
    with stack:
        suspects: list[Block] = []
        for task, rows in cluster.work(pieces(blocks, cluster.n_tasks())):
            if rows is None:
                suspects += [block._replace(entries=(key,)) for block in task for key in block.entries]
            else:
                yield from rows
        # Any cell of a task may have killed the worker; one cell alone shows whether it does.
        for cell in suspects:
            for _, rows in cluster.work([(cell,)]):
                yield from _killed(job, cell) if rows is None else rows


def _killed(job: Job, cell: Block) -> Iterator[Row]:
    """Row of a cell that workers die of; it is observed here, for what a row says of its observation."""
    ready = next(work(job, [cell]))
    assert isinstance(ready, Ready)
    for row in ready.rows.values():
        yield row.failed("killed", "several Dask workers died in this cell", 0.0)


class _Cluster:
    """Workers of a scheduler: checks them, gives them tasks, and notices their loss."""

    def __init__(self, address: str, order: Order) -> None:
        self._address, self._order = address, order
        try:
            self._client = Client(address, timeout=WAIT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:  # no answer, no address, another server's address
            raise self._error(
                f"no scheduler there ({error}); give the address of a running `dask scheduler`, such as "
                "tcp://10.0.0.1:8786"
            ) from error
        self._running: dict[Future[list[Row]], Sequence[Block]] = {}
        self._last_alive_s = time.monotonic()
        self._is_lost = False

    def check(self) -> None:
        """Wait for a worker; InputError if there is none, or one cannot do the work, with the reason."""
        try:
            self._client.wait_for_workers(1, timeout=WAIT_S)
        except TimeoutError as error:
            raise self._error(self._no_worker()) from error
        faults = self._client.run(check_worker, self._order, on_error="return")
        for worker, fault in faults.items():
            if fault is not None:
                raise self._refused(f"worker {worker}", fault)

    def work(self, tasks: Sequence[Sequence[Block]]) -> Iterator[tuple[Sequence[Block], list[Row] | None]]:
        """Work on tasks; yields them with their rows, or with None if workers died in one."""
        waiting, done = deque(tasks), SimpleQueue[Future[list[Row]]]()
        while waiting or self._running:
            n_tasks = self.n_tasks()
            while waiting and len(self._running) < n_tasks:
                task = waiting.popleft()
                future = self._client.submit(make_rows, self._order, task, pure=False, key=None)
                self._running[future] = task
                future.add_done_callback(done.put)
            with suppress(Empty):
                future = done.get(timeout=POLL_S)
                yield self._running.pop(future), self._rows_of(future)

    def n_tasks(self) -> int:
        """Tasks that workers have at a time; InputError if the cluster is lost."""
        try:
            if self._client.status != "running":
                raise OSError
            n_threads = int(sum(self._client.nthreads().values()))
        except OSError as error:
            raise self._lost(GONE) from error
        now_s = time.monotonic()
        if n_threads:
            self._last_alive_s = now_s
        elif now_s - self._last_alive_s > WAIT_S:
            raise self._lost(self._no_worker())
        return TASKS_A_THREAD * max(n_threads, 1)

    def leave(self) -> None:
        """Cancel running tasks and end their processes; a lost cluster needs neither."""
        if not self._is_lost:
            with suppress(OSError):  # the scheduler ends at this moment
                self._client.cancel(list(self._running))
                self._client.run(stop, self._order.token, on_error="ignore")
        self._client.close(timeout=CLOSE_S)

    def _rows_of(self, future: Future[list[Row]]) -> list[Row] | None:
        """Rows of a task; None if more workers died in it than the scheduler allows."""
        while future.status not in ("error", "cancelled"):
            try:
                return future.result(timeout=POLL_S)
            except OSError:  # such as TimeoutError: the worker that had the result may have died
                self.n_tasks()
            except Exception:
                if future.status == "finished":
                    raise
        if future.status == "cancelled":
            raise self._lost(GONE)
        error = future.exception()
        assert error is not None
        if isinstance(error, KilledWorker):
            return None
        if isinstance(error, InputError | ImportError | AttributeError):
            raise self._refused("a worker", error)
        raise error

    def _no_worker(self) -> str:
        return f"no worker for {WAIT_S:g} s; start some with `dask worker {self._address}`"

    def _lost(self, what: str) -> InputError:
        self._is_lost = True
        return self._error(
            f"{what}; the rows so far are kept in the run's folder, and the same command resumes the run"
        )

    def _refused(self, worker: str, error: BaseException) -> InputError:
        """Error for a worker that cannot work; one that cannot even read the order has another isacbench."""
        if isinstance(error, InputError):
            return self._error(f"{worker}: {error}")
        return self._error(
            f"{worker} has no usable isacbench ({type(error).__name__}: {error}); "
            "install the isacbench of this process there"
        )

    def _error(self, text: str) -> InputError:
        return InputError(f"dask {self._address}: {text}")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the logs of Dask off the terminal."""
    levels = {logger: logger.level for logger in map(logging.getLogger, NOISY)}
    for logger in levels:
        logger.setLevel(logging.CRITICAL + 1)
    yield
    # Levels stay after an error: a client that has lost its scheduler still logs in the background.
    for logger, level in levels.items():
        logger.setLevel(level)
