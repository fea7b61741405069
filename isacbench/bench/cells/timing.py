"""Run times that count: a cell's estimate repeated, with its stages, and the memory that it takes.

Timed is what an estimator does with an observation that nobody has touched:
no echo, no scores. The cell has been imaged once before, so that code, caches and
memory are warm, and nothing else runs in the process. The collector of
garbage stands still as it does in `timeit`. All repeats must end in the same
result, bit by bit: the time of another image would be another one.
"""

from __future__ import annotations

import gc
import math
import time
import tracemalloc
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from isacbench.bench.cells.cell import failed_by, failure
from isacbench.errors import InputError
from isacbench.instrument.stages import STAGES, StageClock

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from isacbench.bench.cells.record import Cell, Outcome

DEFAULT_REPEATS = 5
"""The median of five leaves two disturbed ones aside."""

MIB = 2**20

Input = TypeVar("Input")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Trial(Generic[Input, Result]):
    """What is timed.

    Attributes
    ----------
    prepare : callable
        Makes the input of one repeat; not timed.
    call : callable
        What is timed, of that input.
    """

    prepare: Callable[[], Input]
    call: Callable[[Input], Result]


@dataclass(frozen=True, eq=False)
class Repeats(Generic[Result]):
    """What repeats of a trial gave.

    Attributes
    ----------
    results : sequence
        Of all repeats, and last that of the one whose memory was watched.
    time_s, spread_s : float
        Median wall time of a repeat, and half the distance between the
        quartiles of all; of a single one there is no spread, NaN.
    stage_times_s : dict of str to float
        Median of each stage, 0 where it did not occur. They need not sum to
        `time_s`: some time belongs to no stage, and medians do not add.
    peak_memory_mib : float
        Most memory that a repeat had allocated at any time beyond what there
        was before, as far as Python and NumPy allocated it.
    """

    results: Sequence[Result]
    time_s: float
    spread_s: float
    stage_times_s: dict[str, float]
    peak_memory_mib: float

    def columns(self) -> dict[str, float]:
        """Values of the columns `isacbench.bench.cells.record.TIMING_COLUMNS`."""
        return {
            **{f"time_{name}_s": time_s for name, time_s in self.stage_times_s.items()},
            "time_spread_s": self.spread_s,
            "peak_memory_mib": self.peak_memory_mib,
        }


def repeats_wanted(timing: bool, repeats: int | None) -> int | None:
    """Number of repeats of a run: None where it is not timed, five unless another number is given.

    Raises
    ------
    InputError
        If a number is given for a run that is not timed.
    """
    if repeats is not None and not timing:
        raise InputError(f"repeats {repeats}: allowed with timing; without it each cell is estimated once")
    if not timing:
        return None
    return DEFAULT_REPEATS if repeats is None else repeats


def repeat(trial: Trial[Input, Result], n: int) -> Repeats[Result]:
    """Time a trial `n` times, and once more watch its memory.

    Parameters
    ----------
    trial : Trial
        Which has run before.
    n : int
        1 or more.

    Returns
    -------
    Repeats
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
        with _allocations() as peak_bytes:
            results.append(trial.call(prepared))
            peak_memory_mib = peak_bytes() / MIB
    totals_s = [clock.total_s for clock in clocks]
    lower_s, upper_s = np.quantile(totals_s, [0.25, 0.75])
    return Repeats(
        results,
        time_s=float(np.median(totals_s)),
        spread_s=float(upper_s - lower_s) / 2 if n > 1 else math.nan,
        stage_times_s={
            name: float(np.median([clock.seconds.get(name, 0.0) for clock in clocks])) for name in STAGES
        },
        peak_memory_mib=peak_memory_mib,
    )


def timed(
    outcome: Outcome,
    cell: Cell,
    trial: Trial[Input, Result],
    n: int,
    is_same: Callable[[Result], bool],
) -> Outcome:
    """Outcome of a cell with the times of its repeats; a failure where they fail or end otherwise.

    Parameters
    ----------
    outcome : Outcome
        Of the cell when it was imaged the first time.
    cell : Cell
    trial : Trial
        Of the same estimate.
    n : int
        Repeats.
    is_same : callable
        Whether the result of a repeat is the one that the outcome tells of.

    Returns
    -------
    Outcome
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
    return replace(outcome, record=record, extras={**outcome.extras, **repeats.columns()})


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Collect garbage now, and then not until the end."""
    was_enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def _allocations() -> Iterator[Callable[[], int]]:
    """Watch allocations; yields a function that tells their peak so far, in bytes."""
    was_tracing = tracemalloc.is_tracing()
    if not was_tracing:
        tracemalloc.start()
    tracemalloc.reset_peak()
    before, _ = tracemalloc.get_traced_memory()
    try:
        yield lambda: tracemalloc.get_traced_memory()[1] - before
    finally:
        if not was_tracing:
            tracemalloc.stop()
