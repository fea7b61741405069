"""Distances of two sets of points that count what is missed and what is false: GOSPA and OSPA."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.spatial import cKDTree

from isacbench.metrics.assignment import cheapest, near_pairs
from isacbench.metrics.geometry import RADIUS_M, CloudPair
from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class Gospa:
    """The optimal matching of two clouds with p = 2 and α = 2, and what it leaves alone.

    Attributes
    ----------
    radius_m : float
        Cut-off c in m.
    localisation_m2 : float
        Σd² of the matched pairs; NaN where there are too many pairs to compare.
    """

    radius_m: float
    n_true: int
    n_estimated: int
    n_matched: int
    localisation_m2: float

    @property
    def distance_m(self) -> float:
        """GOSPA: the root of Σd² plus c²/2 for every point left alone."""
        n_alone = self.n_true + self.n_estimated - 2 * self.n_matched
        return math.sqrt(self.localisation_m2 + self.radius_m**2 / 2 * n_alone)

    @property
    def shares(self) -> tuple[float, float, float]:
        """Localisation, missed and false parts of GOSPA², over that of an empty image, c²/2 a scatterer."""
        unit = 1 if math.isfinite(self.localisation_m2) else math.nan
        return (
            self.localisation_m2 / (self.radius_m**2 / 2) / self.n_true,
            unit * (self.n_true - self.n_matched) / self.n_true,
            unit * (self.n_estimated - self.n_matched) / self.n_true,
        )

    @property
    def ospa_m(self) -> float:
        """OSPA with the same c and p: the matching that is best for GOSPA with α = 2 is its best one, too.

        Both lose c² less d² with a pair that is left out.
        """
        n = max(self.n_true, self.n_estimated)
        return math.sqrt((self.localisation_m2 + self.radius_m**2 * (n - self.n_matched)) / n)


def pair_gospa(pair: CloudPair) -> Gospa:
    """Match the points of a pair as GOSPA does.

    Returns
    -------
    Gospa
        Exact: a pair at c or farther is never better than two points left alone, so the matching is sought
        among the nearer pairs, which are few.
    """
    return _gospa(pair.truth_tree, pair.estimate_tree, pair.radius_m)


def _gospa(truth: cKDTree, estimate: cKDTree, radius_m: float) -> Gospa:
    near = near_pairs(truth, estimate, radius_m, "GOSPA")
    if near is None:
        return Gospa(radius_m, truth.n, estimate.n, 0, math.nan)
    matched = near.take(cheapest(near, near.squared_m2, radius_m**2))
    return Gospa(radius_m, truth.n, estimate.n, matched.i.size, float(matched.squared_m2.sum()))


def gospa_m(truth: PointCloud, estimate: PointCloud, radius_m: float = RADIUS_M) -> float:
    """Generalised optimal sub-pattern assignment distance with c = the radius, p = 2, α = 2.

    The square root of the least Σd² over the pairs of a matching plus c²/2
    for every point of either cloud left alone.

    Parameters
    ----------
    truth, estimate : PointCloud
        Any number of points each.
    radius_m : float
        Cut-off c in m.

    Returns
    -------
    float
        Distance in metres, at most c·sqrt((n_true + n_estimated) / 2). NaN with
        an `InputWarning` where more than `isacbench.metrics.assignment.MOST_PAIRS` pairs are nearer than c.

    References
    ----------
    A. S. Rahmathullah, Á. F. García-Fernández, L. Svensson, "Generalized
    optimal sub-pattern assignment metric", FUSION 2017. D. Schuhmacher, B.-T. Vo, B.-N. Vo, "A consistent
    metric for performance evaluation of multi-object filters", IEEE Trans. Signal Process. 56 (2008): OSPA.

    Examples
    --------
    >>> from isacbench.model.cloud import PointCloud
    >>> truth = PointCloud(xyz=[[0, 0, 0], [9, 0, 0]], velocity=[0, 0], power=[1, 1])
    >>> gospa_m(truth, truth), gospa_m(truth, PointCloud.empty())
    (0.0, 1.0)
    """
    return _gospa(cKDTree(truth.xyz), cKDTree(estimate.xyz), radius_m).distance_m
