"""One cell: a plugin works on what its task has observed; whatever goes wrong is the reason of a failure.

Within a cell the process belongs to the plugin: random generators are seeded by the cell's key, BLAS has one
thread, memory has a limit, and what the plugin changes about the process is undone.

An estimate is timed without echo and scores, on an observation that no estimator has read before. The cell
has been imaged once, so that code, caches and memory are warm, and nothing else runs in the process. Garbage
collection is off, as in `timeit`. All repeats must give the same result, bit by bit.
"""

from __future__ import annotations

import gc
import math
import random
import time
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from isacbench.bench.cells.provenance import Environment, environment_id
from isacbench.bench.cells.rows import Row
from isacbench.bench.cells.task import Entry, Shared, Task, content_digest
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock
from isacbench.plugins.contracts import is_reference
from isacbench.plugins.discovery import error_place
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
    labels = {
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
    return Row(labels, environment)


def run_cell(task: Task, shared: Shared, entry: Entry[object], row: Row, limits: Limits | None) -> Row:
    """Let a plugin work, and time and score its answer.

    Without limits it works in the caller's process, whose interrupts are the user's and pass.
    """

    def work() -> Row:
        start, plugin = time.process_time(), entry.plugin
        answer = None if is_reference(plugin) else task.call(shared, plugin)
        time_s = time.process_time() - start
        columns, cloud = task.score(shared, plugin, answer)
        result = {"reason": "", "time_estimate_s": time_s, **columns}
        answer_digest = content_digest(cloud if answer is None else answer)
        return replace(row, result=result, cloud=cloud, answer_digest=answer_digest)

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
        return replace(row, result={**row.result, **columns})

    return _row_of(work, row, limits)


def failed_by(error: BaseException, row: Row, time_s: float, memory_mib: float | None = None) -> Row:
    """Row of a cell that ended in an exception: ``killed`` if memory ran out, else ``error``."""
    if not isinstance(error, MemoryError):
        return row.failed("error", describe_error(error), time_s)
    limit = "" if memory_mib is None else f"more than {memory_mib:g} MiB: "
    return row.failed("killed", limit + describe_error(error), time_s)


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
            return failed_by(error, row, time.perf_counter() - start, memory_mib)


def _seed(row: Row) -> None:
    seed_global_generators(*(row.labels[name] for name in SEEDED_BY))


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


def seed_global_generators(*key: object) -> None:
    """Seed the global random generators by a key: a plugin that uses them gives the same everywhere."""
    seed = zlib.crc32(repr(key).encode())
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002, a plugin may use the global one


MIB = 2**20


def repeat(
    prepare: Callable[[], Any], call: Callable[[Any], Any], n: int
) -> tuple[list[Any], dict[str, float]]:
    """Time a call that has run before `n` times, and watch its memory in one more repeat.

    `prepare` makes the input of each repeat and is not timed. Returned are the results of all repeats, and
    columns: the median processor time, and `isacbench.bench.cells.rows.TIMING_COLUMNS`, the median of each
    stage, 0 if it did not occur; half the distance between the quartiles of all times, NaN for one repeat;
    and the most memory that Python and NumPy had allocated at any time. Stages need not sum to the whole:
    some time belongs to no stage, and medians do not add.
    """
    results, clocks = [], []
    with _no_garbage_collection():
        for _ in range(n):
            prepared = prepare()
            with StageClock() as clock:
                result = call(prepared)
            results.append(result)
            clocks.append(clock)
        prepared = prepare()
        tracemalloc.start()
        try:
            results.append(call(prepared))
            _, peak_bytes = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    lower_s, median_s, upper_s = np.quantile([clock.total_s for clock in clocks], [0.25, 0.5, 0.75])
    stages_s = {name: [clock.seconds.get(name, 0.0) for clock in clocks] for name in STAGES}
    return results, {
        "time_estimate_s": float(median_s),
        **{f"time_{name}_s": float(np.median(times_s)) for name, times_s in stages_s.items()},
        "time_spread_s": float(upper_s - lower_s) / 2 if n > 1 else math.nan,
        "peak_memory_mib": peak_bytes / MIB,
    }


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Collect garbage now, and turn collection off until the end."""
    was_enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


MAX_MESSAGE = 1000
"""Characters of an exception's message that a row keeps."""


def describe_error(error: BaseException) -> str:
    """Type and message of an exception in one line of UTF-8, with the place in a plugin that raised it."""
    try:
        message = str(error)
    except Exception as another:
        message = f"its message raised {type(another).__name__}"
    message = " ".join(message[:MAX_MESSAGE].split()) + ("..." if len(message) > MAX_MESSAGE else "")
    # A file name that is not UTF-8 contains surrogates, which no table can hold.
    message = message.replace("\0", "").encode(errors="backslashreplace").decode()
    text = f"{type(error).__name__}: {message}" if message else type(error).__name__
    place = error_place(error)
    return f"{text} ({place})" if place else text
