"""Blocks worked off on this machine: in this process, or in guarded processes side by side."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from queue import SimpleQueue
from typing import TYPE_CHECKING

from isacbench.bench.plan.run_plan import BlockQueue
from isacbench.bench.workers.guarded_cells import Guard, Lane
from isacbench.bench.workers.workbench import Workbench

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from isacbench.bench.plan.job import Job
    from isacbench.bench.plan.run_plan import Block
    from isacbench.bench.store.provenance import Made


def work_here(job: Job, blocks: Sequence[Block], repeats: int | None = None) -> Generator[Made, None, None]:
    """Work off blocks in this process: easy to debug, but a plugin that hangs or dies takes all with it.

    Parameters
    ----------
    repeats : int, optional
        How often each estimate is timed; without it times do not count.
    """
    workbench = Workbench(job, repeats)
    for block in blocks:
        yield from workbench.work(block)


def work_alone(job: Job, blocks: Sequence[Block], guard: Guard, repeats: int) -> Generator[Made, None, None]:
    """Work off blocks and time each estimate, in one guarded process with no other one at work.

    The process is idle while its answers are taken, and this one waits while it works.

    Parameters
    ----------
    guard : Guard
        Limits of every cell.
    repeats : int
        How often each estimate is timed.
    """
    with Lane(job, guard, repeats) as lane:
        yield from lane.work(blocks)


def work_guarded(job: Job, blocks: Sequence[Block], guard: Guard, n_jobs: int) -> Generator[Made, None, None]:
    """Work off blocks in guarded processes.

    Parameters
    ----------
    guard : Guard
        Limits of every cell.
    n_jobs : int
        Processes side by side.

    Yields
    ------
    Made
        In the order in which they are done.
    """
    queue = BlockQueue(blocks)
    done: SimpleQueue[Made | BaseException] = SimpleQueue()
    lanes = [Lane(job, guard) for _ in range(min(n_jobs, len(blocks)))]
    n_left = sum(len(block.entries) for block in blocks)

    def work(lane: Lane) -> None:
        try:
            for made in lane.work(queue.blocks()):
                done.put(made)
        except BaseException as error:
            done.put(error)

    with ThreadPoolExecutor(max(len(lanes), 1)) as threads:
        try:
            for lane in lanes:
                # A lane may need the plugin files that are registered for this thread alone.
                threads.submit(copy_context().run, work, lane)
            for _ in range(n_left):
                made = done.get()
                if isinstance(made, BaseException):
                    raise made
                yield made
        finally:
            for lane in lanes:
                lane.stop()
