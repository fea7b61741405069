"""Blocks worked off on this machine: in this process, or in guarded processes side by side."""

from __future__ import annotations

from concurrent.futures import CancelledError, ThreadPoolExecutor
from queue import SimpleQueue
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from isacbench.bench.plan.run_plan import BlockQueue
from isacbench.bench.store.provenance import Made
from isacbench.bench.workers.guarded_cells import Guard, Lane
from isacbench.bench.workers.process_server import start_process_server
from isacbench.bench.workers.workbench import Workbench

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block

N_AHEAD = 2
"""Calls that wait in a worker process: it goes on at once, while this one takes its answers."""


def work_here(job: Job, blocks: Sequence[Block], repeats: int | None = None) -> Generator[Made, None, None]:
    """Work off blocks in this process: easy to debug, but a plugin that hangs or dies takes all with it.

    With `repeats`, each estimate is timed so many times.
    """
    workbench = Workbench(job, repeats)
    # Threads make small batched algebra slower and its timing unrepeatable.
    with threadpool_limits(limits=1):
        for block in blocks:
            yield from workbench.work(block)


def work_alone(job: Job, blocks: Sequence[Block], guard: Guard, repeats: int) -> Generator[Made, None, None]:
    """Work off blocks in one guarded process and time each estimate `repeats` times, with nothing beside it.

    The process is idle while its answers are taken, and this one waits while it works.
    """
    start_process_server()
    with Lane(job, guard, repeats) as lane:
        yield from lane.work(blocks)


def work_guarded(job: Job, blocks: Sequence[Block], guard: Guard, n_jobs: int) -> Generator[Made, None, None]:
    """Work off blocks in guarded processes.

    Parameters
    ----------
    job : Job
    blocks : sequence of Block
    guard : Guard
        Limits of every cell.
    n_jobs : int
        Processes side by side.

    Yields
    ------
    Made
        In the order in which they are done.
    """
    start_process_server()
    queue = BlockQueue(blocks)
    done: SimpleQueue[Made | BaseException | None] = SimpleQueue()
    lanes = [Lane(job, guard) for _ in range(min(n_jobs, len(blocks)))]

    def work(lane: Lane) -> None:
        try:
            with lane:
                for made in lane.work(queue.blocks(), n_ahead=N_AHEAD):
                    done.put(made)
        except CancelledError:
            pass  # nobody waits for more
        except BaseException as error:
            done.put(error)
        done.put(None)

    with ThreadPoolExecutor(max(len(lanes), 1)) as threads:
        try:
            for lane in lanes:
                threads.submit(work, lane)
            n_working = len(lanes)
            while n_working:
                made = done.get()
                if made is None:
                    n_working -= 1
                elif isinstance(made, BaseException):
                    raise made
                else:
                    yield made
        finally:
            # All are told before any is waited for, so that a second interrupt finds them ending.
            for lane in lanes:
                lane.cancel()
