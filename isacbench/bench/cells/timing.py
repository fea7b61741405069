"""Run times of estimates that are repeated, with their stages and their memory.

An estimate is timed without echo and scores, on an observation that no
estimator has read before. The cell has been imaged once, so that code, caches
and memory are warm, and nothing else runs in the process. Garbage collection
is off, as in `timeit`. All repeats must give the same result, bit by bit.
"""

from __future__ import annotations

import gc
import math
import tracemalloc
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

DEFAULT_REPEATS = 5
"""The median of five repeats ignores two disturbed ones."""

MIB = 2**20


def repeats_wanted(timing: bool, repeats: int | None) -> int | None:
    """Number of repeats of a run: None if it is not timed, 5 if no number is wanted."""
    if repeats is not None and not timing:
        raise InputError(f"repeats = {repeats} needs timing; without it each cell is estimated once")
    if not timing:
        return None
    return DEFAULT_REPEATS if repeats is None else repeats


def repeat(
    prepare: Callable[[], Any], call: Callable[[Any], Any], n: int
) -> tuple[list[Any], dict[str, float]]:
    """Time a call that has run before `n` times, and watch its memory in one more repeat.

    `prepare` makes the input of each repeat and is not timed. Returned are the results of all repeats, and
    columns: the median processor time, and `isacbench.bench.cells.record.TIMING_COLUMNS`, the median of each
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
