"""The ``repository`` metric: what the code published with the paper computes, which is not its text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from isacbench.metrics.descriptions import ScoreColumn
from isacbench.metrics.geometry import CloudPair, projected_hausdorff_m
from isacbench.model.numerology import System

if TYPE_CHECKING:
    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RepositoryDeviation:
    """The three components of the published code's deviation.

    Attributes
    ----------
    position : float
        Symmetric Hausdorff distance of x alone, plus that of y alone, plus
        that of the (x, z) projection, in metres.
    velocity : float
        Mean over the paired velocities of half their distance, in m/s.
    density : float
        Relative error of the number of points, |n_estimated - n_true| / n_true.
    """

    position: float
    velocity: float
    density: float

    @property
    def deviation(self) -> float:
        """Sum of the three components, units ignored as in the published code."""
        return self.position + self.velocity + self.density


def repository_deviation(
    truth: PointCloud, estimate: PointCloud, region: Region | None = None
) -> RepositoryDeviation:
    """Score an estimate against the truth as the published code does.

    Velocities are compared without regard to place: of the distinct estimated
    velocities the most frequent are kept, as many as the truth has distinct
    ones (of equally frequent ones the lower); both lists, sorted descending,
    are paired in order, and the population standard deviation of each pair,
    half its distance, is averaged. With fewer estimated than true velocities
    only the highest true ones find a partner.

    An empty estimate scores the diagonals of the three projections of the
    region, see `isacbench.metrics.geometry.box_diagonal_m`, and half the width
    of the interval that holds the region's speeds, the true velocities and
    zero, at least a velocity bin of the paper's Table I: neither is exceeded
    inside the region. Its density is 1.

    Parameters
    ----------
    truth : PointCloud
        True scatterers, at least one.
    estimate : PointCloud
        Estimated points, possibly none.
    region : Region or None
        Where scatterers can be and how fast; None takes the reach and the
        unambiguous speeds of the paper's Table I.

    Returns
    -------
    RepositoryDeviation
        All components finite; the velocity is NaN if a cloud has none.

    Raises
    ------
    InputError
        If the truth is empty.

    References
    ----------
    The code published with arXiv 2310.06401; the score of an empty estimate
    is ours.

    Examples
    --------
    >>> from isacbench.model.cloud import PointCloud
    >>> truth = PointCloud(xyz=[[0, 0, 0]], velocity=[2], power=[1])
    >>> estimate = PointCloud(xyz=[[3, 4, 0]], velocity=[1], power=[1])
    >>> repository_deviation(truth, estimate)
    RepositoryDeviation(position=10.0, velocity=0.5, density=0.0)
    """
    return pair_repository(CloudPair(truth, estimate, region))


def pair_repository(pair: CloudPair) -> RepositoryDeviation:
    """Score a pair as `repository_deviation` does.

    Parameters
    ----------
    pair : CloudPair

    Returns
    -------
    RepositoryDeviation
    """
    truth, estimate = pair.truth, pair.estimate
    if not pair.has_velocities:
        velocity = math.nan
    elif len(estimate):
        velocity = _velocity_deviation(truth.velocity, estimate.velocity)
    else:
        velocity = _worst_velocity(truth.velocity, pair.region)
    return RepositoryDeviation(
        position=sum(projected_hausdorff_m(pair, axes) for axes in ((0,), (1,), (0, 2))),
        velocity=velocity,
        density=abs(len(estimate) - len(truth)) / len(truth),
    )


def _velocity_deviation(true_mps: Floats, estimated_mps: Floats) -> float:
    """Mean half distance of the distinct velocities, paired in descending order."""
    distinct = np.unique(true_mps)[::-1]
    candidates, counts = np.unique(estimated_mps, return_counts=True)
    # A stable sort of ascending candidates leaves the lower of equally frequent ones in front.
    kept = candidates[np.argsort(-counts, kind="stable")[: distinct.size]]
    return float(np.abs(distinct[: kept.size] - np.sort(kept)[::-1]).mean() / 2)


def _worst_velocity(true_mps: Floats, region: Region | None) -> float:
    """Half the width of the interval of the true velocities, the region's speeds and zero, or of a bin."""
    radio = System()
    speeds = np.array([-1, 1]) * radio.unambiguous_speed_mps if region is None else region.speed_mps
    return max(float(np.ptp([true_mps.min(), true_mps.max(), *speeds, 0.0])), radio.velocity_bin_mps) / 2


@dataclass(frozen=True)
class Repository:
    """The deviation that the code published with the paper computes."""

    name: ClassVar[str] = "repository"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = (
        ScoreColumn("position", "Hausdorff distances of x, of y and of the xz projections, summed", "m"),
        ScoreColumn("velocity", "mean standard deviation of the paired distinct velocities", "m/s"),
        ScoreColumn("density", "relative error of the number of points", "", "lower", 1.0),
        ScoreColumn("deviation", "deviation of the published code: sum of position, velocity and density"),
    )

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair.

        Parameters
        ----------
        pair : CloudPair

        Returns
        -------
        dict of str to float
        """
        found = pair_repository(pair)
        return {column.name: float(getattr(found, column.name)) for column in self.columns}
