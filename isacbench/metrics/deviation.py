"""The ``paper`` metric: the imaging deviation of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from isacbench.metrics.geometry import CloudPair, projected_hausdorff_m
from isacbench.model.numerology import System

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region

HAUSDORFF_COLUMNS = ["hausdorff_xy_m", "hausdorff_xz_m", "hausdorff_yz_m"]
"""Hausdorff distances of the three projections, by the names of their columns."""

# Estimated points count as equally near if their distances differ by less than rounding may.
TIE_M = 1e-9
TIE_RATIO = 1e-12

# Root mean square speed, in velocity bins, up to which a scene is static: a mover exactly
# across the line of sight has a radial velocity of 1e-16 m/s, not of zero.
STATIC_BINS = 1e-9


@dataclass(frozen=True)
class Deviation:
    """The five components of the imaging deviation.

    Attributes
    ----------
    hausdorff_xy_m, hausdorff_xz_m, hausdorff_yz_m : float
        Symmetric Hausdorff distances of the projections in metres.
    density : float
        Relative error of the number of points, |n_estimated - n_true| / n_true.
    velocity_nmse : float
        Normalised mean square error of the radial velocity; NaN, as is the
        deviation, if a cloud has no velocities.
    """

    hausdorff_xy_m: float
    hausdorff_xz_m: float
    hausdorff_yz_m: float
    density: float
    velocity_nmse: float

    @property
    def hausdorff_sum_m(self) -> float:
        """Sum of the three Hausdorff distances in metres."""
        return self.hausdorff_xy_m + self.hausdorff_xz_m + self.hausdorff_yz_m

    @property
    def deviation(self) -> float:
        """Sum of all five components, units ignored as in the paper."""
        return self.hausdorff_sum_m + self.density + self.velocity_nmse


def paper_deviation(
    truth: PointCloud,
    estimate: PointCloud,
    region: Region | None = None,
    velocity_bin_mps: float | None = None,
) -> Deviation:
    """Score an estimate against the truth as the paper does.

    The velocity error of a true scatterer is v̂ - v, with v̂ the velocity of
    the estimated point nearest to it in x, y and z. Where several points are
    equally near, up to rounding, the smallest error counts. The score then
    does not depend on the order of points, and a truth with two speeds at one
    place scores zero against itself. The sum of squared errors is divided by
    Σv²; in a static scene, where Σv² = 0 up to rounding, by
    n_true · (velocity bin)².

    An empty estimate scores the diagonals of the region's projections, which no
    point inside the region exceeds, see `isacbench.metrics.geometry.box_diagonal_m`,
    and 1 for density and for velocity, which false points and wrong velocities
    can exceed.

    Parameters
    ----------
    truth : PointCloud
        True scatterers, at least one.
    estimate : PointCloud
        Estimated points, possibly none.
    region : Region or None
        Region that can hold scatterers; None takes the reach of the paper's
        Table I.
    velocity_bin_mps : float or None
        Velocity bin in m/s; None takes that of the paper's Table I.

    Returns
    -------
    Deviation
        All components finite but those that need velocities which a cloud lacks: they are NaN.

    Raises
    ------
    InputError
        If the truth is empty or the velocity bin is not positive.

    References
    ----------
    arXiv 2310.06401, section on the imaging deviation. The divisor of a
    static scene and the score of an empty estimate are ours: the paper leaves
    them undefined.

    Examples
    --------
    >>> from isacbench.model.cloud import PointCloud
    >>> truth = PointCloud(xyz=[[0, 0, 0]], velocity=[2], power=[1])
    >>> estimate = PointCloud(xyz=[[3, 4, 0]], velocity=[1], power=[1])
    >>> paper_deviation(truth, estimate)
    Deviation(hausdorff_xy_m=5.0, hausdorff_xz_m=3.0, hausdorff_yz_m=4.0, density=0.0, velocity_nmse=0.25)
    """
    bin_mps = System().velocity_bin_mps if velocity_bin_mps is None else velocity_bin_mps
    return pair_deviation(CloudPair(truth, estimate, region, bin_mps))


def pair_deviation(pair: CloudPair) -> Deviation:
    """Score a pair as `paper_deviation` does, with searches that other metrics share.

    Parameters
    ----------
    pair : CloudPair

    Returns
    -------
    Deviation
    """
    n_true = len(pair.truth)
    return Deviation(
        hausdorff_xy_m=projected_hausdorff_m(pair, (0, 1)),
        hausdorff_xz_m=projected_hausdorff_m(pair, (0, 2)),
        hausdorff_yz_m=projected_hausdorff_m(pair, (1, 2)),
        density=abs(len(pair.estimate) - n_true) / n_true,
        velocity_nmse=_velocity_nmse(pair),
    )


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


def _velocity_errors_mps(pair: CloudPair) -> NDArray[np.float64]:
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


def _nearest_differences(values: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Difference of each value from the nearest of the others, without sign."""
    ascending = np.concatenate([[-np.inf], np.sort(others), [np.inf]])
    above = np.searchsorted(ascending, values)
    nearest: NDArray[np.float64] = np.minimum(ascending[above] - values, values - ascending[above - 1])
    return nearest
