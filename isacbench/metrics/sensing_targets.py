"""Metrics of 3GPP: missed detection, false alarms and accuracies of TR 38.765, categories of TS 22.137."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError, require, require_option
from isacbench.metrics.assignment import MOST_PAIRS, cheapest, near_pairs
from isacbench.metrics.descriptions import ScoreColumn, object_kind
from isacbench.metrics.geometry import CloudPair
from isacbench.metrics.object_scores import group_points
from isacbench.model.cloud import PointCloud
from isacbench.model.scene import Scenario

GATE_M = 22.6
"""6 m, a standard deviation along each axis, times the root of the 0.9973 quantile of chi-square with three
degrees of freedom, as in NIST's 5GNRad."""

Grouping = Literal["objects", "points"]
TargetClass = Literal["other", "pedestrian", "vehicle"]
ERRORS = "horizontal", "vertical", "radial velocity"


class Associations(NamedTuple):
    """Targets and detections of a drop, and what was associated.

    Attributes
    ----------
    n_targets, n_detections : int
    errors : ndarray of float64, shape (n, 3)
        Horizontal and vertical errors in m, and errors of the radial velocity in m/s, of the n detected
        targets, 0 or more; NaN for unknown velocities.
    """

    n_targets: int
    n_detections: int
    errors: Floats

    @property
    def missed_share(self) -> float:
        """Share of the targets without a detection; NaN without targets."""
        return 1 - len(self.errors) / self.n_targets if self.n_targets else math.nan

    @property
    def false_share(self) -> float:
        """Share of the detections without a target; 0 without detections, NaN without targets."""
        if not self.n_targets:
            return math.nan
        return 1 - len(self.errors) / self.n_detections if self.n_detections else 0.0


def associate(pair: CloudPair, gate_m: float = GATE_M, grouping: Grouping = "objects") -> Associations:
    """Associate detections and targets one to one: as many as possible, then at least squared distances.

    A target is an object of the scenario, but for clutter, at the mean of its scatterers. Where objects are
    not known each true point is one. A detection is an object that the points of the image are grouped into
    (`isacbench.metrics.object_scores.group_points`), at their mean weighted by power; or each point, as it is
    where the radio or velocities are not known.

    Parameters
    ----------
    gate_m : float
        Largest distance in m of a target and a detection that may be associated.
    grouping : {"objects", "points"}

    Raises
    ------
    InputError
        If more pairs lie within the gate than can be compared (`isacbench.metrics.assignment.MOST_PAIRS`).
    """
    targets = pair.remembered(_targets)
    detections = pair.remembered(_objects_found) if grouping == "objects" else pair.estimate
    trees = cKDTree(targets.xyz), cKDTree(detections.xyz)
    near = near_pairs(*trees, gate_m, "the association")
    if near is None:
        raise InputError(
            f"{len(targets)} targets and {len(detections)} detections: more than {MOST_PAIRS} pairs are "
            f"within {gate_m:g} m of each other; allowed are fewer points"
        )
    chosen = near.take(cheapest(near, near.squared_m2, math.inf))
    offset_m = detections.xyz[chosen.j] - targets.xyz[chosen.i]
    speed_mps = detections.velocity[chosen.j] - targets.velocity[chosen.i]
    errors = np.column_stack([np.hypot(*offset_m[:, :2].T), np.abs(offset_m[:, 2]), np.abs(speed_mps)])
    return Associations(len(targets), len(detections), errors)


def _targets(pair: CloudPair) -> PointCloud:
    return pair.truth if pair.scenario is None else targets_of(pair.scenario)


@lru_cache(maxsize=8)
def targets_of(scenario: Scenario) -> PointCloud:
    """Targets of a scenario, one point each: its objects, but for clutter, and scatterers of no object."""
    names = scenario.scatterers.objects or ("",) * len(scenario.scatterers)
    is_target = ~scenario.scatterers.is_clutter
    own = [name if object_kind(name) else f" {number}" for number, name in enumerate(names)]
    truth, groups = scenario.truth.select(is_target), np.array(own)[is_target]
    even = PointCloud(truth.xyz, truth.velocity, np.ones(len(truth)))
    return _centroids(even, np.unique(groups, return_inverse=True)[1])


def _objects_found(pair: CloudPair) -> PointCloud:
    if pair.scenario is None or not pair.estimate.has_velocity:
        return pair.estimate
    return _centroids(pair.estimate, group_points(pair.scenario, pair.estimate) - 1)


def _centroids(cloud: PointCloud, group: NDArray[np.intp]) -> PointCloud:
    """Means of groups of points, numbered from 0, weighted by power; sums of the power."""
    total = np.bincount(group, cloud.power)
    # Points without power weigh the same.
    weight = np.where(total[group] > 0, cloud.power, 1.0)
    columns = np.column_stack([cloud.xyz, cloud.velocity]).T
    sums = np.array([np.bincount(group, weight * column, total.size) for column in columns])
    means = (sums / np.bincount(group, weight, total.size)).T.reshape(-1, 4)
    return PointCloud(means[:, :3], means[:, 3], total)


def error_quantiles(errors: Floats, share: float) -> list[float]:
    """Quantiles of errors (n, 3), between neighbours linearly interpolated; NaN without any."""
    found: list[float] = (
        np.quantile(errors, share, axis=0).tolist() if len(errors) else [math.nan] * len(ERRORS)
    )
    return found


def _error_columns(share: float) -> tuple[ScoreColumn, ...]:
    """Columns of quantiles of the errors."""
    percent = round(100 * share)
    return tuple(
        ScoreColumn(
            f"{error.replace(' ', '_')}_error_p{percent}_{suffix}",
            f"{percent} % quantile of the {error} error of detected targets",
            unit,
            "lower",
            math.nan,
        )
        for error, (suffix, unit) in zip(ERRORS, [("m", "m"), ("m", "m"), ("mps", "m/s")], strict=True)
    )


@dataclass(frozen=True)
class _TargetMetric(ABC):
    """Parameters of metrics of targets."""

    gate_m: float = GATE_M
    grouping: Grouping = "objects"

    scores_empty_truth: ClassVar[bool] = True
    columns: ClassVar[tuple[ScoreColumn, ...]] = ()

    def __post_init__(self) -> None:
        require(0 < self.gate_m < np.inf, "gate_m", self.gate_m, "a positive number of m")
        require_option(self, "grouping", get_args(Grouping))

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a drop."""
        values = self.values(associate(pair, self.gate_m, self.grouping))
        return dict(zip((column.name for column in self.columns), values, strict=True))

    @abstractmethod
    def values(self, found: Associations) -> Sequence[float]:
        """Compute the scores of a drop in the order of the columns."""


ACCURACY_SHARE = 0.9


@dataclass(frozen=True)
class NrIsac(_TargetMetric):
    """Missed detection, false alarms of both types and accuracies, as 3GPP counts them.

    A drop without targets has a score of Type 1 alone, one with targets all others. Over many drops, means of
    these columns are what the report states; its accuracies are quantiles over the detected targets of all
    drops, which suites of the kind ``drops`` give.

    Attributes
    ----------
    gate_m : float
        Largest distance in m of a target and a detection that may be associated. Errors beyond it do not
        occur: judge accuracies by it.
    grouping : {"objects", "points"}
        What a detection is: an object that points are grouped into, or each point.

    Raises
    ------
    InputError
        If the gate is no positive number, or the grouping is unknown.

    References
    ----------
    3GPP TR 38.765 V20.0.0, clauses 4.2, 6.2 and 6.3, by secondary sources (docs/3gpp.md).
    """

    name: ClassVar[str] = "nr-isac"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = (
        ScoreColumn("missed_detection", "share of targets without a detection", "", "lower", 1.0),
        ScoreColumn("false_alarm_type1", "any detection in a drop without targets", "", "lower", math.nan),
        ScoreColumn("false_alarm_type2", "share of detections that are no target", "", "lower", 0.0),
        *_error_columns(ACCURACY_SHARE),
    )

    def values(self, found: Associations) -> list[float]:
        """Compute the scores of a drop in the order of the columns."""
        type1 = math.nan if found.n_targets else float(found.n_detections > 0)
        return [found.missed_share, type1, found.false_share, *error_quantiles(found.errors, ACCURACY_SHARE)]


OBJECTIVES = dict(
    zip((column.name for column in NrIsac.columns), [0.05, 0.05, 0.05, 10.0, 10.0, 5.0], strict=True)
)
"""Objectives of TR 38.765 V20.0.0 for the columns of `NrIsac`."""


class Category(NamedTuple):
    """Limits of a sensing service category; None where it has none.

    Attributes
    ----------
    confidence : float
        Share of the detected targets that must be as accurate.
    horizontal_m, vertical_m, velocity_mps : float or None
    missed, false_alarm : float
        Largest shares of targets and of detections.
    """

    confidence: float
    horizontal_m: float
    vertical_m: float
    velocity_mps: float | None
    missed: float
    false_alarm: float

    def judged(self) -> Iterator[tuple[str, int, float]]:
        """Go through the limits of errors: name, column of the errors, and limit."""
        limits = self.horizontal_m, self.vertical_m, self.velocity_mps
        for place, (name, limit) in enumerate(zip(ERRORS, limits, strict=True)):
            if limit is not None:
                yield name, place, limit


VELOCITIES_MPS: dict[TargetClass, float] = {"other": 0.1, "pedestrian": 1.5, "vehicle": 15.0}
"""Accuracy of velocity in category 4."""


@dataclass(frozen=True)
class Ts22137(_TargetMetric):
    """Share of drops that alone keep the limits of sensing service categories 1 to 4, on a radial velocity.

    Whether an estimator keeps them, with intervals, is said of many drops by suites of the kind ``drops``.

    Attributes
    ----------
    gate_m, grouping
        See `NrIsac`.
    target : {"other", "pedestrian", "vehicle"}
        Targets, on which the velocity of category 4 depends.
    public_safety : bool
        Whether category 4 serves public safety, and its confidence is 99 %.

    Raises
    ------
    InputError
        If a parameter is none of these.

    References
    ----------
    3GPP TS 22.137, table of the performance requirements, by secondary sources (docs/3gpp.md).
    """

    target: TargetClass = "other"
    public_safety: bool = False

    name: ClassVar[str] = "ts22137"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = tuple(
        ScoreColumn(f"category_{number}", f"drop keeps the limits of category {number}", "", "higher", 0.0)
        for number in range(1, 5)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_option(self, "target", get_args(TargetClass))

    @property
    def categories(self) -> tuple[Category, ...]:
        """Categories 1 to 4."""
        fourth = 0.99 if self.public_safety else 0.95, 0.5, 0.5, VELOCITIES_MPS[self.target], 0.01, 0.03
        return (
            Category(0.95, 10.0, 10.0, None, 0.05, 0.02),
            Category(0.95, 2.0, 5.0, 1.0, 0.05, 0.05),
            Category(0.95, 1.0, 1.0, 1.0, 0.02, 0.02),
            Category(*fourth),
        )

    def values(self, found: Associations) -> list[float]:
        """Tell for each category whether the drop keeps all its limits, 1 or 0; NaN without targets."""
        if not found.n_targets:
            return [math.nan] * len(self.columns)
        return [float(_keeps(found, category)) for category in self.categories]


def _keeps(found: Associations, category: Category) -> bool:
    """Tell whether a drop with targets keeps all limits of a category."""
    errors = error_quantiles(found.errors, category.confidence)
    shares = found.missed_share <= category.missed and found.false_share <= category.false_alarm
    return shares and all(errors[place] <= limit for _, place, limit in category.judged())
