"""Cell of a run: an estimator, detector or receiver works on an observation, and what it finds is scored."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from isacbench.bench.cells.record import Row
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import TruthEstimator
from isacbench.plugins.discovery import error_place
from isacbench.streams import plugin_output

if TYPE_CHECKING:
    from isacbench.model.observation import Observation
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import Estimator

MAX_MESSAGE = 1000
"""Characters of an exception's message that a row keeps."""

Found = tuple[Mapping[str, Any], PointCloud]
"""Columns that come out of a cell, and its cloud, empty where there is none."""


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


def run_cell(row: Row, work: Callable[[], Found]) -> Row:
    """Fill the row of a cell with what its work yields. An exception becomes the reason of a failure."""
    start = time.perf_counter()
    try:
        found, cloud = work()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        return failed_by(error, row, time.perf_counter() - start)
    return replace(row, found={"reason": "", **found}, cloud=cloud)


def failed_by(error: BaseException, row: Row, time_s: float) -> Row:
    """Row of a cell that ended in an exception: ``killed`` if memory ran out, else ``error``."""
    return row.failed("killed" if isinstance(error, MemoryError) else "error", describe_error(error), time_s)


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
