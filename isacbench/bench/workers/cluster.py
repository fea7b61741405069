"""Blocks worked off on a Dask cluster: the same guarded cells, on the workers of other machines.

A task is a few cells of one trial of a scene: after a while it comes back with
what it has made and what is left, so that rows arrive as they are made, a
worker that dies costs seconds, and no task is too long or too short, whatever
a cell costs. Which cells bring workers down is found out at the end, one at a
time.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from contextlib import ExitStack, contextmanager
from itertools import groupby
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from isacbench.bench.store.resume import versions_now
from isacbench.bench.workers.cluster_worker import (
    Batch,
    UnfitWorkerError,
    WorkOrder,
    check_worker,
    stop,
    work,
)
from isacbench.bench.workers.workbench import Workbench
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from distributed import Client, Future

    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Made
    from isacbench.bench.workers.cluster_worker import PackedOrder
    from isacbench.bench.workers.guarded_cells import Guard

WAIT_S = 30.0
"""How long a scheduler or the first worker may take to be there."""

ALLOWED = "allowed is the address of a running `dask scheduler`, such as tcp://10.0.0.1:8786"

POLL_S = 1.0
CLOSE_S = 5.0
TASKS_A_THREAD = 2
"""One that runs, and one that waits, so that no thread does."""

FAULTS_TOLD = 3
"""Workers that a message names, if many have a fault."""

NOISY = ("distributed", "tornado", "asyncio")
"""Loggers that tell on the terminal what becomes an error of ours."""


def work_on_cluster(
    job: Job, blocks: Sequence[Block], guard: Guard, address: str, mix_versions: bool = False
) -> Generator[Made, None, None]:
    """Work off blocks on the workers of a Dask scheduler.

    Cluster and workers are looked at before this returns.

    Parameters
    ----------
    job : Job
        Shipped by content.
    blocks : sequence of Block
    guard : Guard
        Limits of every cell.
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    mix_versions : bool
        Whether workers may have other versions than this process.

    Returns
    -------
    generator of Made
        In the order in which they are done. A cell with which one worker
        after the other dies is ``killed``.

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
    order = WorkOrder(job, guard, versions_now(job.plan), mix_versions).pack()
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        cluster = stack.enter_context(_connected(address, order))
        cluster.require_workers()
        cluster.check()
        return _work(cluster, job, blocks, stack.pop_all())


def _work(
    cluster: _Cluster, job: Job, blocks: Sequence[Block], stack: ExitStack
) -> Generator[Made, None, None]:
    suspects: list[Block] = []
    with stack:
        for piece, outcome in cluster.work(Backlog(blocks)):
            if outcome is None:
                suspects += _cells(piece)
            else:
                yield from outcome.made
        # Beside a cell that brings its worker down, others look as guilty. Alone only one does.
        for suspect in suspects:
            for (block,), outcome in cluster.work(Backlog([suspect])):
                yield from _killed(job, block) if outcome is None else outcome.made


class Backlog:
    """Blocks that wait for a worker, in pieces of one trial of a scene, whose echo and noise they share.

    Parameters
    ----------
    blocks : sequence of Block
    """

    def __init__(self, blocks: Sequence[Block]) -> None:
        self._pieces = deque(tuple(group) for _, group in groupby(blocks, key=lambda block: block[:2]))

    def __len__(self) -> int:
        """Number of pieces."""
        return len(self._pieces)

    def put_back(self, piece: tuple[Block, ...]) -> None:
        """Put what is left of a piece to the front."""
        if piece:
            self._pieces.appendleft(piece)

    def take(self, n_hands: int) -> tuple[Block, ...]:
        """Take the first piece; the longest ones are halved as long as there are fewer than hands."""
        while len(self._pieces) < n_hands:
            index, longest = max(enumerate(self._pieces), key=lambda found: len(found[1]))
            middle = (len(longest) + 1) // 2
            if middle == len(longest):
                break
            self._pieces[index] = longest[:middle]
            self._pieces.insert(index + 1, longest[middle:])
        return self._pieces.popleft()


class _Cluster:
    """A scheduler and its workers, as far as a run has to do with them."""

    def __init__(self, client: Client, address: str, order: PackedOrder) -> None:
        self._client, self._address, self._order = client, address, order
        self._done: SimpleQueue[Future[Batch]] = SimpleQueue()
        self._running: dict[Future[Batch], tuple[Block, ...]] = {}
        self._last_alive_s = time.monotonic()
        self._is_lost = False

    def require_workers(self) -> None:
        """Wait for the first worker.

        Raises
        ------
        InputError
            If none has come after `WAIT_S`.
        """
        deadline_s = time.monotonic() + WAIT_S
        while not self._count_threads():
            if time.monotonic() > deadline_s:
                raise InputError(f"dask {self._address}: {self._no_worker()}")
            time.sleep(POLL_S / 10)

    def check(self) -> None:
        """Have every worker try whether it can do what the run asks.

        Raises
        ------
        InputError
            Naming workers that cannot, and why.
        """
        answers = self._client.run(check_worker, self._order, on_error="return")
        faults = [f"worker {worker}: {_fault(error)}" for worker, error in answers.items() if error]
        if faults:
            raise InputError(_refusal(self._address, faults))

    def work(self, backlog: Backlog) -> Iterator[tuple[tuple[Block, ...], Batch | None]]:
        """Work off a backlog; yields pieces and what became of them, None where workers died of them."""
        while backlog or self._running:
            n_tasks = TASKS_A_THREAD * max(self._n_threads(), 1)
            while backlog and len(self._running) < n_tasks:
                self._submit(backlog.take(n_tasks - len(self._running)))
            future = self._next_done()
            piece, outcome = self._running.pop(future), self._outcome(future)
            if outcome is not None:
                backlog.put_back(outcome.rest)
            yield piece, outcome

    def leave(self) -> None:
        """Let go of all that still runs, and of what workers keep; a cluster that is lost does so itself."""
        if not self._is_lost:
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

    def _outcome(self, future: Future[Batch]) -> Batch | None:
        """Result of a task; None if it came to the end of the scheduler's patience with workers that died."""
        from distributed.scheduler import KilledWorker

        while future.status != "error":
            if future.status == "cancelled":
                raise self._lost("the scheduler is gone")
            try:
                batch = future.result(timeout=POLL_S)
            except OSError:  # of which a TimeoutError is one: whoever had the result may have died
                self._n_threads()
            except Exception:
                if future.status not in ("error", "cancelled"):
                    raise
            else:
                return batch
        error = future.exception()
        if isinstance(error, KilledWorker):
            return None
        if isinstance(error, UnfitWorkerError | ImportError | AttributeError):
            raise InputError(_refusal(self._address, [f"a later worker: {_fault(error)}"])) from error
        assert error is not None
        raise error

    def _n_threads(self) -> int:
        """Threads of all workers at the moment.

        Raises
        ------
        InputError
            If there is no scheduler, or for a while has been no worker.
        """
        n_threads, now_s = self._count_threads(), time.monotonic()
        if n_threads:
            self._last_alive_s = now_s
        elif now_s - self._last_alive_s > WAIT_S:
            raise self._lost(self._no_worker())
        return n_threads

    def _count_threads(self) -> int:
        try:
            if self._client.status == "running":
                return sum(self._client.nthreads().values())
        except OSError as error:
            raise self._lost("the scheduler is gone") from error
        raise self._lost("the scheduler is gone")

    def _no_worker(self) -> str:
        return f"no worker for {WAIT_S:g} s; start some with `dask worker {self._address}`"

    def _lost(self, what: str) -> InputError:
        self._is_lost = True
        return InputError(
            f"dask {self._address}: {what}; the rows so far are kept in the run's folder, "
            "and the same run into it goes on with the rest"
        )


@contextmanager
def _connected(address: str, order: PackedOrder) -> Iterator[_Cluster]:
    """Client of a scheduler that leaves nothing behind."""
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "dask: the package `distributed` is missing; pip install 'isacbench[distributed]', here and "
            "where workers run"
        ) from error
    _require_scheduler(address)
    client = Client(address, timeout=WAIT_S, set_as_default=False)
    cluster = _Cluster(client, address, order)
    try:
        yield cluster
    finally:
        cluster.leave()


def _require_scheduler(address: str) -> None:
    """Refuse an address at which there is no scheduler: a client would never let go of it."""
    from distributed.utils import LoopRunner

    try:
        kind = LoopRunner().run_sync(_kind_of_server, address)
    except OSError as error:
        raise InputError(f"dask {address}: no scheduler answered within {WAIT_S:g} s; {ALLOWED}") from error
    except (ValueError, TypeError) as error:
        raise InputError(f"dask {address!r}: no address ({error}); {ALLOWED}") from error
    if kind != "Scheduler":
        raise InputError(f"dask {address}: it is the address of a {kind}; {ALLOWED}")


async def _kind_of_server(address: str) -> str:
    """What a Dask server at an address is: ``Scheduler``, ``Worker`` or ``Nanny``."""
    from distributed import Security, rpc

    connection = Security().get_connection_args("client")
    async with rpc(address, timeout=WAIT_S, connection_args=connection) as server:
        identity = await asyncio.wait_for(server.identity(), WAIT_S)
    return str(identity["type"])


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask logs off the terminal."""
    loggers = [logging.getLogger(name) for name in NOISY]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    except InputError:
        loggers.clear()  # a client that has lost its scheduler goes on complaining in the background
        raise
    finally:
        for logger, level in zip(loggers, levels, strict=False):
            logger.setLevel(level)


def _refusal(address: str, faults: Sequence[str]) -> str:
    more = f"; and {len(faults) - FAULTS_TOLD} more" if len(faults) > FAULTS_TOLD else ""
    return (
        f"dask {address}: {'; '.join(faults[:FAULTS_TOLD])}{more}; allowed are workers with the isacbench "
        "and the plugins of this process, installed before they were started"
    )


def _fault(error: Any) -> str:
    """Say what keeps a worker from working; one that cannot even read the question has another isacbench."""
    if isinstance(error, InputError):
        return str(error)
    return f"has no isacbench that could be used ({type(error).__name__}: {error})"


def _cells(piece: Sequence[Block]) -> list[Block]:
    """Blocks of one cell each."""
    return [block._replace(entries=(one,)) for block in piece for one in block.entries]


def _killed(job: Job, block: Block) -> Iterator[Made]:
    """Rows of cells that nothing else is left of; what they would have observed is observed here."""
    workbench = Workbench(job)
    workbench.observe(block)
    for entry in block.entries:
        yield workbench.failure_row(entry, "killed", "one Dask worker after the other died with it", 0.0)
