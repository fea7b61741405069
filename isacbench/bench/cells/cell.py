"""Cell of a run: an estimator, detector or receiver works on an observation; the answer is scored and timed.

The clouds of a reference follow from the scenario alone. They are scored once for all SNRs and trials of a
scenario in a process. Each cell has random numbers of its own, and changed data are noticed.

An estimate is timed without echo and scores, on an observation that no estimator has read before. The cell
has been imaged once, so that code, caches and memory are warm, and nothing else runs in the process. Garbage
collection is off, as in `timeit`. All repeats must give the same result, bit by bit.
"""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import math
import random
import time
import tracemalloc
import zlib
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.bench.suites.scenario_digest import digest, scenario_digest
from isacbench.instrument.stages import STAGES, StageClock
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.realisations import SPREAD_COLUMNS, score_realisations
from isacbench.model.cloud import PointCloud
from isacbench.model.observation import Observation
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import Estimator, ReferenceEstimator, TruthEstimator
from isacbench.plugins.discovery import error_place
from isacbench.plugins.registry import canonical_params
from isacbench.plugins.scoring import PAPER_ALONE, Metrics
from isacbench.process_state import plugin_output


def seed_global_generators(*key: object) -> None:
    """Seed the global random generators by a key: a plugin that uses them gives the same everywhere."""
    seed = zlib.crc32(repr(key).encode())
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002, a plugin may use the global one


def array_digest(array: NDArray[Any]) -> str:
    """Digest of an array that shows whether the array has changed.

    It consists of the sums of columns over the first and the second half of the rows, which are read as
    words of 8 bytes. A changed bit changes it, and so do changed signs and a reversed order; rows that
    change places within a half do not. It takes a tenth of the time of a checksum.
    """
    total = hashlib.sha256(repr((array.shape, array.dtype.str)).encode())
    raw = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    n_whole = raw.size // 8 * 8
    total.update(raw[n_whole:].tobytes())
    if n_whole:
        words = raw[:n_whole].view(np.uint64)
        table = words.reshape(-1, 1) if words.size % len(array) else words.reshape(len(array), -1)
        # A half of odd length: sign changes of an even number of rows can cancel.
        cut = len(table) // 2 | 1
        for half in (table[:cut], table[cut:]):
            total.update(half.sum(axis=0, dtype=np.uint64).tobytes())
    return total.hexdigest()


def content_digest(part: object) -> str:
    """Digest of an observation or an answer, with all digits of its numbers, whatever its ``repr`` shows."""
    if isinstance(part, np.ndarray):
        return array_digest(part)
    if dataclasses.is_dataclass(part) and not isinstance(part, type):
        values = [content_digest(getattr(part, one.name)) for one in dataclasses.fields(part)]
        return digest([type(part).__name__, *values])
    return repr(part)


KEPT = 32
"""Scored images of references that a process keeps."""


@dataclass(frozen=True, eq=False)
class ScoredImage:
    """Realisation whose deviation is nearest to the mean, with the scores of all and the times of both.

    Attributes
    ----------
    scores : mapping of str to Any
        Columns of the metrics, means over the realisations.
    spreads : mapping of str to float
        Standard deviations over the realisations, by score.
    time_estimate_s, time_score_s : float
        Of all realisations when they were made.
    """

    cloud: PointCloud
    scores: Mapping[str, Any]
    spreads: Mapping[str, float]
    time_estimate_s: float
    time_score_s: float

    def columns(self) -> dict[str, Any]:
        """Columns of a row with the means and their spreads."""
        return {**self.scores, **{SPREAD_COLUMNS[name]: one for name, one in self.spreads.items()}}


@dataclass(frozen=True)
class _Reference:
    """Reference and scenario, equal to others of the same content."""

    content: tuple[Hashable, ...]
    reference: ReferenceEstimator = field(compare=False)
    scenario: Scenario = field(compare=False)
    metrics: Metrics


def image_reference(
    reference: ReferenceEstimator, scenario: Scenario, metrics: Metrics = PAPER_ALONE
) -> ScoredImage:
    """Score the realisations of a reference against the scenario that they are made from.

    What is returned is remembered for an equal reference and an equal scenario. TypeError if a realisation is
    no `PointCloud`.
    """
    objects = scenario.scatterers.objects
    content = type(reference), canonical_params(reference), scenario_digest(scenario), objects
    return _imaged(_Reference(content, reference, scenario, metrics))


@lru_cache(maxsize=KEPT)
def _imaged(asked: _Reference) -> ScoredImage:
    start, scenario = time.process_time(), asked.scenario
    clouds = list(asked.reference.realisations(scenario, scenario.truth))
    for cloud in clouds:
        if not isinstance(cloud, PointCloud):
            raise TypeError(f"realisations() must return PointClouds, not {type(cloud).__name__}")
    time_s, imaged = time.process_time() - start, time.perf_counter()
    pairs = [CloudPair.of(scenario, cloud) for cloud in clouds]
    scores = score_realisations(pairs, PAPER_ALONE.score, asked.metrics.score)
    time_score_s = time.perf_counter() - imaged
    return ScoredImage(clouds[scores.nearest], scores.means, scores.spreads, time_s, time_score_s)


MIB = 2**20


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


MAX_MESSAGE = 1000
"""Characters of an exception's message that a row keeps."""

Found = tuple[Mapping[str, Any], PointCloud]
"""Columns that come out of a cell, and its cloud, empty where there is none."""


@dataclass(frozen=True, eq=False)
class Image:
    """Image from which a kind of suite derives columns.

    Attributes
    ----------
    scenario : Scenario
        With the scatterers that were observed.
    observation, estimator : optional
        None for a stored cloud.
    cloud : PointCloud
        Estimate from the observation.
    """

    scenario: Scenario
    observation: Observation | None
    estimator: Estimator | None
    snr_db: float
    cloud: PointCloud


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


def estimate_cloud(estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation, and check the shapes and values of the cloud.

    `truth` is passed on only to an estimator with `needs_truth`. TypeError if the estimator returns anything
    but a `PointCloud`; ValueError if the cloud has wrong shapes, NaN or infinities.
    """
    cloud = raw_cloud(estimator, observation, truth)
    # The constructor checks shapes and values, also of a cloud that a plugin has changed.
    return PointCloud(cloud.xyz, cloud.velocity, cloud.power)


def raw_cloud(estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation as `estimate_cloud` does, without further checks than its type and velocities."""
    with plugin_output():
        if isinstance(estimator, TruthEstimator) and estimator.needs_truth:
            cloud = estimator.estimate(observation, truth)
        else:
            cloud = estimator.estimate(observation)
    if not isinstance(cloud, PointCloud):
        raise TypeError(f"estimate() must return a PointCloud, not {type(cloud).__name__}")
    if not cloud.has_velocity:
        raise ValueError("estimate() must return a finite velocity of each point, which a row needs, not NaN")
    return cloud
