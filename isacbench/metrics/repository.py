"""The ``repository`` metric: what the code published with the paper computes, which is not its text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.metrics.geometry import CloudPair, projected_hausdorff_m
from isacbench.model.numerology import System
from isacbench.model.region import Region


@dataclass(frozen=True)
class Repository:
    """The deviation that the code published with the paper computes.

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

    References
    ----------
    The code published with arXiv 2310.06401; the score of an empty estimate
    is ours.
    """

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

        Returns
        -------
        dict of str to float
            All finite but what needs velocities where a cloud has none.
        """
        truth, estimate = pair.truth, pair.estimate
        if not pair.has_velocities:
            velocity = math.nan
        elif len(estimate):
            velocity = _velocity_deviation(truth.velocity, estimate.velocity)
        else:
            velocity = _worst_velocity(truth.velocity, pair.region)
        position = sum(projected_hausdorff_m(pair, axes) for axes in ((0,), (1,), (0, 2)))
        density = abs(len(estimate) - len(truth)) / len(truth)
        # Units are ignored, as in the published code.
        total = position + velocity + density
        return {"position": position, "velocity": velocity, "density": density, "deviation": total}


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
