"""The metrics ``paper`` and ``repository``: deviations of the paper's text and of its published code.

In every row, chamfer distance, GOSPA, precision and recall stand beside the deviation of the text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.checked_arrays import Floats
from isacbench.metrics.assignment import pair_gospa
from isacbench.metrics.descriptions import ScoreColumn
from isacbench.metrics.geometry import CloudPair, box_diagonal_m, projected_hausdorff_m
from isacbench.model.numerology import System
from isacbench.model.region import Region

PROJECTIONS = {"hausdorff_xy_m": (0, 1), "hausdorff_xz_m": (0, 2), "hausdorff_yz_m": (1, 2)}
"""Axes of the projections by the names of their Hausdorff distances."""

# Estimated points count as equally near if their distances differ by less than rounding may.
TIE_M = 1e-9
TIE_RATIO = 1e-12

# Root mean square speed, in velocity bins, up to which a scene is static: a mover exactly
# across the line of sight has a radial velocity of 1e-16 m/s, not of zero.
STATIC_BINS = 1e-9


@dataclass(frozen=True)
class Paper:
    """The paper's imaging deviation, and chamfer, GOSPA, precision and recall.

    The velocity error of a true scatterer is v̂ - v, with v̂ the velocity of
    the estimated point nearest to it in x, y and z. Where several points are
    equally near, up to rounding, the smallest error counts. The score then
    does not depend on the order of points, and a truth with two speeds at one
    place scores zero against itself. The sum of squared errors is divided by
    Σv²; in a static scene, where Σv² = 0 up to rounding, by
    n_true · (velocity bin)².

    An empty estimate scores the diagonals of the region and its projections, which no
    point inside the region exceeds, see `isacbench.metrics.geometry.box_diagonal_m`; 1 for density and
    velocity, which false points and wrong velocities can exceed; 0 in precision and recall; and
    c·sqrt(n_true / 2) in GOSPA, in which by its construction a false point is worse than none.

    References
    ----------
    arXiv 2310.06401, section on the imaging deviation. The divisor of a
    static scene and the score of an empty estimate are ours: the paper leaves
    them undefined. L. Mescheder et al., "Occupancy Networks: Learning 3D Reconstruction in Function
    Space", CVPR 2019: the chamfer distance ("chamfer-L1"), the mean of accuracy and completeness, each a mean
    of plain, not squared, distances.
    """

    name: ClassVar[str] = "paper"
    version: ClassVar[int] = 1
    columns: ClassVar[tuple[ScoreColumn, ...]] = (
        ScoreColumn("hausdorff_xy_m", "Hausdorff distance of the xy projections", "m"),
        ScoreColumn("hausdorff_xz_m", "Hausdorff distance of the xz projections", "m"),
        ScoreColumn("hausdorff_yz_m", "Hausdorff distance of the yz projections", "m"),
        ScoreColumn("hausdorff_sum_m", "sum of the three Hausdorff distances", "m"),
        ScoreColumn("density", "relative error of the number of points", "", "lower", 1.0),
        ScoreColumn("velocity_nmse", "normalised mean square error of the velocity", "", "lower", 1.0),
        ScoreColumn("deviation", "imaging deviation: sum of the three Hausdorff distances, density and NMSE"),
        ScoreColumn("chamfer_m", "chamfer distance, mean of both directions", "m"),
        ScoreColumn("gospa_m", "GOSPA distance with c = the radius, p = 2, α = 2", "m"),
        ScoreColumn(
            "precision", "share of estimated points within the radius of a scatterer", "", "higher", 0.0
        ),
        ScoreColumn("recall", "share of true scatterers within the radius of a point", "", "higher", 0.0),
    )

    def score(self, pair: CloudPair) -> dict[str, float]:
        """Score a pair.

        Returns
        -------
        dict of str to float
            All finite but `gospa_m` of very dense clouds, and what needs velocities where a cloud has none.
        """
        return {**deviation_scores(pair), **_coverage(pair)}


def deviation_scores(pair: CloudPair) -> dict[str, float]:
    """Score a pair by the imaging deviation and its components.

    Returns
    -------
    dict of str to float
        The first seven columns of `Paper`.
    """
    scores = {name: projected_hausdorff_m(pair, axes) for name, axes in PROJECTIONS.items()}
    n_true = len(pair.truth)
    scores["hausdorff_sum_m"] = sum(scores.values())
    scores["density"] = abs(len(pair.estimate) - n_true) / n_true
    scores["velocity_nmse"] = _velocity_nmse(pair)
    # Units are ignored, as in the paper.
    scores["deviation"] = scores["hausdorff_sum_m"] + scores["density"] + scores["velocity_nmse"]
    return scores


def _coverage(pair: CloudPair) -> dict[str, float]:
    """Measure the coverage of two clouds by each other: chamfer, GOSPA, precision and recall."""
    gospa_m = pair.remembered(pair_gospa).distance_m
    if not len(pair.estimate):
        worst_m = box_diagonal_m(pair.truth.xyz, pair.region)
        return {"chamfer_m": worst_m, "gospa_m": gospa_m, "precision": 0.0, "recall": 0.0}
    forward_m, backward_m = pair.truth_to_estimate_m, pair.estimate_to_truth_m
    return {
        "chamfer_m": float(backward_m.mean() + forward_m.mean()) / 2,
        "gospa_m": gospa_m,
        "precision": float((backward_m <= pair.radius_m).mean()),
        "recall": float((forward_m <= pair.radius_m).mean()),
    }


def _velocity_nmse(pair: CloudPair) -> float:
    """Energy of velocity errors over that of the true velocities; in a static scene, over one bin each."""
    if not pair.has_velocities:
        return math.nan
    if not len(pair.estimate):
        return 1.0
    n_true = len(pair.truth)
    energy = float(np.square(pair.truth.velocity).sum())
    if energy <= n_true * (STATIC_BINS * pair.velocity_bin_mps) ** 2:
        energy = n_true * pair.velocity_bin_mps**2
    return float(np.square(_velocity_errors_mps(pair)).sum()) / energy


def _velocity_errors_mps(pair: CloudPair) -> Floats:
    """Velocity error (n_true,) of the estimated point nearest to each scatterer; without sign for ties."""
    velocity, true_velocity = pair.estimate.velocity, pair.truth.velocity
    distance_m, index = pair.two_nearest_estimates
    errors = velocity[index[:, 0]] - true_velocity
    reach_m = distance_m[:, 0] * (1 + TIE_RATIO) + TIE_M
    has_ties = np.flatnonzero(distance_m[:, 1] <= reach_m)
    # Those at one place are searched for once.
    group = np.unique(pair.truth.xyz[has_ties], axis=0, return_inverse=True)[1].ravel()
    in_order = has_ties[np.argsort(group, kind="stable")]
    for here in np.split(in_order, np.cumsum(np.bincount(group))[:-1]) if has_ties.size else ():
        tied = pair.estimate_tree.query_ball_point(pair.truth.xyz[here[0]], reach_m[here[0]])
        errors[here] = _nearest_differences(true_velocity[here], velocity[tied])
    return errors


def _nearest_differences(values: Floats, others: Floats) -> Floats:
    """Difference of each value from the nearest of the others, without sign."""
    ascending = np.concatenate([[-np.inf], np.sort(others), [np.inf]])
    above = np.searchsorted(ascending, values)
    return np.minimum(ascending[above] - values, values - ascending[above - 1])


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
