"""Run times of estimates that are repeated, with their stages and their memory.

An estimate is timed without echo and scores, on an observation that no
estimator has read before. The cell has been imaged once, so that code, caches
and memory are warm, and nothing else runs in the process. Garbage collection
is off, as in `timeit`. All repeats must give the same result, bit by bit.
"""

from __future__ import annotations

import gc
import math
import time
import tracemalloc
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isacbench.bench.cells.cell import failed_by, failure
from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock

if TYPE_CHECKING:
    from collections.abc import Iterator

    from isacbench.bench.cells.record import Cell, Outcome

DEFAULT_REPEATS = 5
"""The median of five repeats ignores two disturbed ones."""

MIB = 2**20


class Trial(NamedTuple):
    """Work to be timed.

    Attributes
    ----------
    prepare : callable
        Makes the input of one repeat; not timed.
    call : callable
        Timed; takes that input.
    """

    prepare: Callable[[], Any]
    call: Callable[[Any], Any]


class Repeats(NamedTuple):
    """Results and times of the repeats of a trial.

    Attributes
    ----------
    results : list
        Of all timed repeats, and last that of the repeat whose memory was
        watched.
    time_s : float
        Median processor time of a repeat.
    columns : dict of str to float
        Values of `isacbench.bench.cells.record.TIMING_COLUMNS`: the median of
        each stage, 0 if it did not occur; half the distance between the
        quartiles of all times, NaN for one repeat; most memory that Python
        and NumPy had allocated at any time. Stages need not sum to `time_s`:
        some time belongs to no stage, and medians do not add.
    """

    results: list[Any]
    time_s: float
    columns: dict[str, float]


def repeats_wanted(timing: bool, repeats: int | None) -> int | None:
    """Number of repeats of a run.

    Parameters
    ----------
    timing : bool
        True for a run that is timed.
    repeats : int or None
        Wanted number.

    Returns
    -------
    int or None
        None for a run that is not timed, 5 if no number is wanted.

    Raises
    ------
    InputError
        If a number is given for a run that is not timed.
    """
    if repeats is not None and not timing:
        raise InputError(f"repeats = {repeats} needs timing; without it each cell is estimated once")
    if not timing:
        return None
    return DEFAULT_REPEATS if repeats is None else repeats


def repeat(trial: Trial, n: int) -> Repeats:
    """Time a trial `n` times, and watch its memory in one more repeat.

    Parameters
    ----------
    trial : Trial
        Has run before.
    n : int
        1 or more.
    """
    results, clocks = [], []
    with _no_garbage_collection():
        for _ in range(n):
            prepared = trial.prepare()
            with StageClock() as clock:
                result = trial.call(prepared)
            results.append(result)
            clocks.append(clock)
        prepared = trial.prepare()
        tracemalloc.start()
        try:
            results.append(trial.call(prepared))
            _, peak_bytes = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    totals_s = [clock.total_s for clock in clocks]
    lower_s, upper_s = np.quantile(totals_s, [0.25, 0.75])
    stages_s = {name: [clock.seconds.get(name, 0.0) for clock in clocks] for name in STAGES}
    columns = {
        **{f"time_{name}_s": float(np.median(times_s)) for name, times_s in stages_s.items()},
        "time_spread_s": float(upper_s - lower_s) / 2 if n > 1 else math.nan,
        "peak_memory_mib": peak_bytes / MIB,
    }
    return Repeats(results, float(np.median(totals_s)), columns)


def timed(outcome: Outcome, cell: Cell, trial: Trial, n: int, is_same: Callable[[Any], bool]) -> Outcome:
    """Time the repeats of a cell.

    Parameters
    ----------
    outcome : Outcome
        Outcome of the cell when it was imaged the first time.
    trial : Trial
        The same estimate.
    n : int
        Repeats.
    is_same : callable
        Tells if the result of a repeat is that of `outcome`.

    Returns
    -------
    Outcome
        With times; a failure if repeats fail or give another result.
    """
    start, n_true = time.perf_counter(), outcome.record.n_true
    try:
        repeats = repeat(trial, n)
        differing = sum(not is_same(result) for result in repeats.results)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed_by(error, cell, n_true, time.perf_counter() - start)
    if differing:
        reason = (
            f"{differing} of {len(repeats.results)} repeats of the same estimate gave another result; "
            "only what repeats itself can be timed"
        )
        return failure(cell, "error", reason, n_true, repeats.time_s)
    record = replace(outcome.record, time_estimate_s=repeats.time_s)
    return replace(outcome, record=record, extras={**outcome.extras, **repeats.columns})


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
