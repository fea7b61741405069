"""Cell of a run: an estimator images an observation; the image is timed and scored."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.record import COLUMNS, N_STORED, Cell, Outcome, Record
from isacbench.bench.cells.scored_images import PAPER_ALONE, ScoredImage, image_reference
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import TruthEstimator, is_reference
from isacbench.plugins.discovery import error_place
from isacbench.streams import plugin_output

if TYPE_CHECKING:
    from isacbench.bench.cells.record import CellStatus
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Estimator
    from isacbench.plugins.scoring import Metrics

MAX_MESSAGE = 1000
"""Characters of an exception's message that a row keeps."""


@dataclass(frozen=True, eq=False)
class MeasuredImage:
    """Image from which a study derives columns.

    Attributes
    ----------
    scenario : Scenario
        With the scatterers that were observed.
    observation : Observation or None
        None for a stored cloud.
    estimator : Estimator or None
        None for a stored cloud.
    cloud : PointCloud
        Estimate from the observation.
    """

    scenario: Scenario
    observation: Observation | None
    estimator: Estimator | None
    snr_db: float
    cloud: PointCloud


Measure = Callable[[MeasuredImage], Mapping[str, Any]]
"""Function of a study that derives further columns of the row from an image."""


def run_cell(
    cell: Cell,
    scenario: Scenario,
    observation: Observation,
    estimator: Estimator,
    measure: Measure | None = None,
    metrics: Metrics = PAPER_ALONE,
) -> Outcome:
    """Estimate, time and score one cell. An exception of the estimator becomes the reason of the record.

    Parameters
    ----------
    cell : Cell
        Key of the row.
    scenario : Scenario
        Has the truth of the scores.
    measure : callable, optional
        Derives further columns.
    metrics : Metrics
        Score the image.
    """
    start = time.perf_counter()
    try:
        image = _imaged(estimator, scenario, observation, metrics)
        scored = time.perf_counter()
        shot = MeasuredImage(scenario, observation, estimator, cell.snr_db, image.cloud)
        extras = {} if measure is None else measure(shot)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed_by(error, cell, len(scenario.truth), time.perf_counter() - start)
    further = {name: value for name, value in image.scores.items() if name not in COLUMNS}
    record = Record(
        **vars(cell),
        status="ok" if len(image.cloud) else "no_detection",
        reason="",
        **{name: image.scores[name] for name in image.scores.keys() - further.keys()},
        time_estimate_s=image.time_estimate_s,
        time_score_s=image.time_score_s + time.perf_counter() - scored,
    )
    stored = {N_STORED: float(len(image.cloud))} if image.spreads else {}
    return Outcome(record, image.cloud, {**further, **image.spread_columns(), **stored, **extras})


def _imaged(
    estimator: Estimator, scenario: Scenario, observation: Observation, metrics: Metrics
) -> ScoredImage:
    """Image of an observation with its scores; of a reference, of the scenario."""
    if is_reference(estimator):
        return image_reference(estimator, scenario, metrics)
    start = time.process_time()
    cloud = estimate_cloud(estimator, observation, scenario.truth)
    time_s, estimated = time.process_time() - start, time.perf_counter()
    scores = metrics.score(CloudPair.of(scenario, cloud))
    return ScoredImage(cloud, scores, time_s, time.perf_counter() - estimated)


def failed_by(error: BaseException, cell: Cell, n_true: int, time_s: float) -> Outcome:
    """Row of a cell that ended in an exception.

    Parameters
    ----------
    n_true : int
        Points of the truth.
    time_s : float
        Time until then.

    Returns
    -------
    Outcome
        Of the status ``killed`` if memory ran out, else ``error``.
    """
    status: CellStatus = "killed" if isinstance(error, MemoryError) else "error"
    return failure(cell, status, describe_error(error), n_true, time_s)


def describe_error(error: BaseException) -> str:
    """Type and message of an exception in one line, with the place in a plugin that it comes from.

    Returns
    -------
    str
        Text that can be encoded as UTF-8.
    """
    try:
        message = str(error)
    except Exception as another:
        message = f"its message raised {type(another).__name__}"
    message = " ".join(message[:MAX_MESSAGE].split()) + ("..." if len(message) > MAX_MESSAGE else "")
    # A file name that is not UTF-8 contains surrogates, which no table can hold.
    message = message.replace("\0", "").encode(errors="backslashreplace").decode()
    told = f"{type(error).__name__}: {message}" if message else type(error).__name__
    place = error_place(error)
    return f"{told} ({place})" if place else told


def failure(cell: Cell, status: CellStatus, reason: str, n_true: int, time_s: float) -> Outcome:
    """Row of a cell that failed.

    Parameters
    ----------
    status : {"error", "timeout", "killed", "skipped"}
    n_true : int
        Points of the truth.
    time_s : float
        Time until then.

    Returns
    -------
    Outcome
        With an empty cloud.
    """
    record = Record(
        **vars(cell), status=status, reason=reason, n_true=n_true, n_estimated=0, time_estimate_s=time_s
    )
    return Outcome(record, PointCloud.empty())


def estimate_cloud(estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation, and check the shapes and values of the cloud.

    Parameters
    ----------
    truth : PointCloud
        Passed on only to an estimator with `needs_truth`.

    Raises
    ------
    TypeError
        If the estimator returns anything but a `PointCloud`.
    ValueError
        If the cloud has wrong shapes, NaN or infinities.
    """
    cloud = raw_cloud(estimator, observation, truth)
    # The constructor checks shapes and values, also of a cloud that a plugin has changed.
    return PointCloud(cloud.xyz, cloud.velocity, cloud.power)


def raw_cloud(estimator: Estimator, observation: Observation, truth: PointCloud) -> PointCloud:
    """Image an observation, without further checks of the cloud.

    Parameters
    ----------
    truth : PointCloud
        Passed on only to an estimator with `needs_truth`.

    Raises
    ------
    TypeError
        If the estimator returns anything but a `PointCloud`.
    ValueError
        If velocities are unknown.
    """
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
