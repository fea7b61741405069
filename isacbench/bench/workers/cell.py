"""One cell: a plugin works on what its task has observed; whatever goes wrong is the reason of a failure.

Within a cell the process belongs to the plugin: random generators are seeded by the cell's key, BLAS has one
thread, memory has a limit, and what the plugin changes about the process is undone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from isacbench.bench.cells.cell import (
    MIB,
    content_digest,
    describe_error,
    repeat,
    seed_global_generators,
)
from isacbench.bench.cells.record import Row
from isacbench.bench.kinds.scenes import Entry, Shared, Task
from isacbench.bench.store.provenance import Environment, environment_id
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError
from isacbench.plugins.contracts import is_reference
from isacbench.process_state import process_state_kept

DEFAULT_TIMEOUT_S = 600.0
"""Default limit in s: an estimate that takes ten minutes hangs."""

PROCESS_STATUS = Path("/proc/self/status")
SEEDED_BY = "seed", "scenario", "trial", "snr_db", "estimator", "params"


@dataclass(frozen=True)
class Limits:
    """Limits of every cell in a worker.

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


def first_row(shared: Shared, entry: Entry[object], environment: Environment, is_timed: bool) -> Row:
    """Row of a cell before its plugin has worked."""
    known = {
        **shared.labels,
        **entry.labels,
        **shared.key,
        "estimator": entry.name,
        "params": entry.params,
        "n_true": shared.n_true,
        "n_estimated": 0,
        "timing": is_timed,
        "environment": environment_id(environment),
    }
    return Row(known, environment)


def run_cell(task: Task, shared: Shared, entry: Entry[object], row: Row, limits: Limits | None) -> Row:
    """Let a plugin work, and time and score its answer.

    Without limits it works in the caller's process, whose interrupts are the user's and pass.
    """

    def work() -> Row:
        start, plugin = time.process_time(), entry.plugin
        answer = None if is_reference(plugin) else task.call(shared, plugin)
        time_s = time.process_time() - start
        columns, cloud = task.score(shared, plugin, answer)
        found = {"reason": "", "time_estimate_s": time_s, **columns}
        answer_digest = content_digest(cloud if answer is None else answer)
        return replace(row, found=found, cloud=cloud, answer_digest=answer_digest)

    return _row_of(work, row, limits)


def time_repeats(
    task: Task, shared: Shared, entry: Entry[object], row: Row, n: int, limits: Limits | None
) -> Row:
    """Time a cell that has been worked on, without scores; it fails if its repeats give another answer."""

    def prepare() -> Shared:
        _seed(row)
        return shared.unread()

    def work() -> Row:
        answers, columns = repeat(prepare, lambda unread: task.call(unread, entry.plugin), n)
        n_differing = sum(content_digest(answer) != row.answer_digest for answer in answers)
        if n_differing:
            reason = (
                f"{n_differing} of {len(answers)} repeats of the same estimate gave another result; "
                "only what repeats itself can be timed"
            )
            return row.failed("error", reason, columns["time_estimate_s"])
        return replace(row, found={**row.found, **columns})

    return _row_of(work, row, limits)


def failed_by(error: BaseException, row: Row, time_s: float) -> Row:
    """Row of a cell that ended in an exception: ``killed`` if memory ran out, else ``error``."""
    return row.failed("killed" if isinstance(error, MemoryError) else "error", describe_error(error), time_s)


def _row_of(work: Callable[[], Row], row: Row, limits: Limits | None) -> Row:
    """Row that some work makes of a row, or that of a failure."""
    start, memory_mib = time.perf_counter(), None if limits is None else limits.memory_mib
    with process_state_kept(), one_blas_thread():
        _seed(row)
        try:
            with _memory_limit(memory_mib):
                return work()
        except BaseException as error:
            if limits is None and isinstance(error, KeyboardInterrupt):
                raise
            row = failed_by(error, row, time.perf_counter() - start)
    if memory_mib is None or row.status != "killed":
        return row
    reason = f"more than {memory_mib:g} MiB: {row.found['reason']}"
    return row.failed("killed", reason, row.found["time_estimate_s"])


def _seed(row: Row) -> None:
    seed_global_generators(*(row.known[name] for name in SEEDED_BY))


@contextmanager
def _memory_limit(memory_mib: float | None) -> Iterator[None]:
    """Limit the memory that this process may allocate in addition to what it holds."""
    if memory_mib is None:
        yield
        return
    import resource  # which other systems than Linux need not have

    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    # Private writable memory of this process, as the limit counts it.
    (line,) = (line for line in PROCESS_STATUS.read_text().splitlines() if line.startswith("VmData:"))
    limit = int(line.split()[1]) * 1024 + int(memory_mib * MIB)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))
