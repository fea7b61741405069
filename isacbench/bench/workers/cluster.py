"""Blocks processed on a Dask cluster: the same guarded cells, on the workers of other machines.

A task is a few cells of one trial of a scene. After a while it returns the rows
that it has made and the cells that are left. So rows arrive as they are made, the
loss of a worker costs seconds, and tasks take the same time whatever a cell costs.
At the end, cells of tasks in which workers died run again one at a time, to find
those that kill workers.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from contextlib import ExitStack, contextmanager, suppress
from itertools import groupby
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from isacbench.bench.workers.cluster_worker import Batch, WorkOrder, check_worker, stop, work
from isacbench.bench.workers.workbench import Workbench
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from distributed import Client, Future

    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Made
    from isacbench.bench.workers.guarded_cells import Guard

WAIT_S = 30.0
"""Longest time in s that a run waits for an answer of the scheduler, or for a worker."""

POLL_S = 1.0
CLOSE_S = 5.0
TASKS_A_THREAD = 2
"""Tasks for each thread of a worker: one that runs, and one that waits, so that the thread is never idle."""

NOISY = ("distributed", "tornado", "asyncio")
"""Loggers that print what this module already reports as an error."""


def work_on_cluster(
    job: Job, blocks: Sequence[Block], guard: Guard, address: str, mix_versions: bool = False
) -> Generator[Made, None, None]:
    """Process blocks on the workers of a Dask scheduler.

    Scheduler and workers are checked before this returns.

    Parameters
    ----------
    job : Job
        Sent to the workers with all its content.
    guard : Guard
        Limits of every cell.
    address : str
        Address of the scheduler, such as ``tcp://10.0.0.1:8786``.
    mix_versions : bool
        Whether workers may have other versions than this process.

    Returns
    -------
    generator of Made
        In the order in which cells are done. A cell that several workers in a
        row die of is ``killed``.

    Raises
    ------
    InputError
        If the package `distributed` is missing, there is no scheduler or no
        worker, or a worker lacks a plugin or has another version of it; from
        the generator also if the cluster is lost meanwhile.
    """
    if not blocks:
        nothing: tuple[Made, ...] = ()
        return (made for made in nothing)
    order = WorkOrder.of_job(job, guard, mix_versions)
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        cluster = stack.enter_context(_connected(address, order))
        cluster.check()
        return _work(cluster, job, blocks, stack.pop_all())


def _work(
    cluster: _Cluster, job: Job, blocks: Sequence[Block], stack: ExitStack
) -> Generator[Made, None, None]:
    suspects: list[Block] = []
    with stack:
        for piece, batch in cluster.work(blocks):
            if batch is None:
                suspects += [block._replace(entries=(entry,)) for block in piece for entry in block.entries]
            else:
                yield from batch.made
        # Any cell of a task may have killed the worker; one cell alone shows whether it does.
        for suspect in suspects:
            for (block,), batch in cluster.work([suspect]):
                yield from _killed(job, block) if batch is None else batch.made


def _killed(job: Job, block: Block) -> Iterator[Made]:
    """Rows of cells that killed their workers; the scene is observed here, because a row needs it."""
    workbench = Workbench(job)
    workbench.observe(block)
    for entry in block.entries:
        yield workbench.failure_row(entry, "killed", "several Dask workers died in this cell", 0.0)


def take_piece(pieces: deque[tuple[Block, ...]], n_wanted: int) -> tuple[Block, ...]:
    """Take the first piece of the work, or a part of it if there are fewer pieces than wanted.

    Parameters
    ----------
    pieces : deque of tuple of Block
        Not empty; what is taken is removed from it.

    Examples
    --------
    >>> pieces = deque([(1, 2, 3)])
    >>> take_piece(pieces, 2), take_piece(pieces, 1)
    ((1, 2), (3,))
    """
    piece = pieces.popleft()
    size = math.ceil(len(piece) / max(n_wanted - len(pieces), 1))
    if size < len(piece):
        pieces.appendleft(piece[size:])
    return piece[:size]


class _Cluster:
    """Workers of a scheduler: checks them, gives them tasks, and notices their loss."""

    def __init__(self, client: Client, address: str, order: WorkOrder) -> None:
        self._client, self._address, self._order = client, address, order
        self._done: SimpleQueue[Future[Batch]] = SimpleQueue()
        self._running: dict[Future[Batch], tuple[Block, ...]] = {}
        self._last_alive_s = time.monotonic()
        self._is_lost = False

    def check(self) -> None:
        """Wait for a worker, and check on every worker that it can do the work.

        Raises
        ------
        InputError
            If there is no worker, or one cannot do the work, with the reason.
        """
        try:
            self._client.wait_for_workers(1, timeout=WAIT_S)
        except TimeoutError as error:
            raise InputError(f"dask {self._address}: {self._no_worker()}") from error
        answers = self._client.run(check_worker, self._order, on_error="return")
        for worker, fault in answers.items():
            if fault is not None:
                raise self._refused(f"worker {worker}", fault)

    def work(self, blocks: Sequence[Block]) -> Iterator[tuple[tuple[Block, ...], Batch | None]]:
        """Process blocks in pieces; the blocks of a piece share echo and noise of one trial of a scene.

        Yields pieces, each with its batch, or with None if workers died in it.
        """
        pieces = deque(tuple(group) for _, group in groupby(blocks, key=lambda block: block[:2]))
        while pieces or self._running:
            n_tasks = TASKS_A_THREAD * max(self._n_threads(), 1)
            while pieces and len(self._running) < n_tasks:
                self._submit(take_piece(pieces, n_tasks - len(self._running)))
            future = self._next_done()
            piece, batch = self._running.pop(future), self._batch(future)
            if batch is not None and batch.rest:
                pieces.appendleft(batch.rest)
            yield piece, batch

    def leave(self) -> None:
        """Cancel running tasks and clear what workers keep; a lost cluster needs neither."""
        if not self._is_lost:
            with suppress(OSError):  # the scheduler ends at this moment
                self._client.cancel(list(self._running))
                self._client.run(stop, self._order.token, on_error="ignore")
        self._client.close(timeout=CLOSE_S)

    def _submit(self, piece: tuple[Block, ...]) -> None:
        future = self._client.submit(work, self._order, piece, pure=False, key=None)
        self._running[future] = piece
        future.add_done_callback(self._done.put)

    def _next_done(self) -> Future[Batch]:
        while True:
            try:
                return self._done.get(timeout=POLL_S)
            except Empty:
                self._n_threads()

    def _batch(self, future: Future[Batch]) -> Batch | None:
        """Result of a task; None if more workers died in it than the scheduler allows."""
        from distributed.scheduler import KilledWorker

        while future.status not in ("error", "cancelled"):
            try:
                batch = future.result(timeout=POLL_S)
            except OSError:  # such as TimeoutError: the worker that had the result may have died
                self._n_threads()
            except Exception:
                if future.status == "finished":
                    raise
            else:
                return batch
        if future.status == "cancelled":
            raise self._lost("the scheduler is gone")
        error = future.exception()
        assert error is not None
        if isinstance(error, KilledWorker):
            return None
        if isinstance(error, InputError | ImportError | AttributeError):
            raise self._refused("a worker", error)
        raise error

    def _n_threads(self) -> int:
        """Present number of threads of all workers; raises an error if the cluster is lost."""
        try:
            if self._client.status != "running":
                raise OSError
            n_threads = int(sum(self._client.nthreads().values()))
        except OSError as error:
            raise self._lost("the scheduler is gone") from error
        now_s = time.monotonic()
        if n_threads:
            self._last_alive_s = now_s
        elif now_s - self._last_alive_s > WAIT_S:
            raise self._lost(self._no_worker())
        return n_threads

    def _no_worker(self) -> str:
        return f"no worker for {WAIT_S:g} s; start some with `dask worker {self._address}`"

    def _lost(self, what: str) -> InputError:
        self._is_lost = True
        return InputError(
            f"dask {self._address}: {what}; the rows so far are kept in the run's folder, "
            "and the same command resumes the run"
        )

    def _refused(self, worker: str, error: BaseException) -> InputError:
        """Error for a worker that cannot work; one that cannot even read the order has another isacbench."""
        if isinstance(error, InputError):
            return InputError(f"dask {self._address}: {worker}: {error}")
        return InputError(
            f"dask {self._address}: {worker} has no usable isacbench "
            f"({type(error).__name__}: {error}); install the isacbench of this process there"
        )


@contextmanager
def _connected(address: str, order: WorkOrder) -> Iterator[_Cluster]:
    """Connection to a scheduler, which leaves nothing on it."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "dask: the package `distributed` is missing; pip install 'isacbench[distributed]', here and "
            "where workers run"
        ) from error
    try:
        client = Client(address, timeout=WAIT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # no answer, no address, another server's address
        raise InputError(
            f"dask {address}: no scheduler there ({error}); give the address of a running "
            "`dask scheduler`, such as tcp://10.0.0.1:8786"
        ) from error
    cluster = _Cluster(client, address, order)
    try:
        yield cluster
    finally:
        cluster.leave()


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
