"""Point cloud scores beside the paper's: chamfer, GOSPA, precision and recall."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from isacbench.errors import InputWarning, require
from isacbench.metrics.geometry import LARGEST, CloudPair, Floats, box_diagonal_m
from isacbench.metrics.point_matching import matched_pairs

if TYPE_CHECKING:
    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region

RADIUS_M = 1.0
"""Distance, where no scenario says another: up to it a point counts as right for precision and recall; from
it a true scatterer counts as missed and an estimated point as false in GOSPA, whose cut-off c it is."""


@dataclass(frozen=True)
class CloudScores:
    """Scores of how two clouds cover each other in x, y and z.

    Attributes
    ----------
    accuracy_m : float
        Mean over the estimated points of the distance to the nearest true scatterer.
    completeness_m : float
        Mean over the true scatterers of the distance to the nearest estimated point.
    gospa_m : float
        GOSPA with c = the radius, p = 2, α = 2.
    precision : float
        Share of the estimated points within the radius of a true scatterer.
    recall : float
        Share of the true scatterers within the radius of an estimated point.
    """

    accuracy_m: float
    completeness_m: float
    gospa_m: float
    precision: float
    recall: float

    @property
    def chamfer_m(self) -> float:
        """Mean of accuracy and completeness in metres."""
        return (self.accuracy_m + self.completeness_m) / 2


def cloud_scores(
    truth: PointCloud, estimate: PointCloud, region: Region | None = None, radius_m: float = RADIUS_M
) -> CloudScores:
    """Compare the positions of two clouds.

    The chamfer distance is that of reference [1]_ ("chamfer-L1"): the mean of
    accuracy and completeness, each a mean of plain, not squared, distances.
    An empty estimate scores the worst that a point inside the region could in
    accuracy and completeness, see `isacbench.metrics.geometry.box_diagonal_m`;
    0 in precision and recall; and c·sqrt(n_true / 2) in GOSPA, in which by its
    construction a false point is worse than none.

    Parameters
    ----------
    truth : PointCloud
        True scatterers, at least one.
    estimate : PointCloud
        Estimated points, possibly none.
    region : Region or None
        Where scatterers can be; None takes the reach of the paper's Table I.
    radius_m : float
        Distance in m within which a point counts as one of a scatterer.

    Returns
    -------
    CloudScores
        All finite but `gospa_m` of very dense clouds, see there.

    Raises
    ------
    InputError
        If the truth is empty, or the radius is no positive number.

    References
    ----------
    .. [1] L. Mescheder et al., "Occupancy Networks: Learning 3D
       Reconstruction in Function Space", CVPR 2019.
    """
    return pair_scores(CloudPair(truth, estimate), region, radius_m)


def pair_scores(pair: CloudPair, region: Region | None = None, radius_m: float = RADIUS_M) -> CloudScores:
    """Score a pair as `cloud_scores` does, with searches that other metrics share.

    Parameters
    ----------
    pair : CloudPair
    region : Region or None
    radius_m : float
        Distance in m within which a point counts as one of a scatterer.

    Returns
    -------
    CloudScores
    """
    require(1 / LARGEST <= radius_m <= LARGEST, "radius_m", radius_m, "a positive number of m")
    forward_m, backward_m = pair.truth_to_estimate_m, pair.estimate_to_truth_m
    gospa = _gospa_m(pair.truth.xyz, forward_m, pair.estimate.xyz, backward_m, radius_m)
    if not len(pair.estimate):
        diagonal_m = box_diagonal_m(pair.truth.xyz, region)
        return CloudScores(diagonal_m, diagonal_m, gospa, precision=0.0, recall=0.0)
    return CloudScores(
        accuracy_m=float(backward_m.mean()),
        completeness_m=float(forward_m.mean()),
        gospa_m=gospa,
        precision=float((backward_m <= radius_m).mean()),
        recall=float((forward_m <= radius_m).mean()),
    )


def gospa_m(truth: PointCloud, estimate: PointCloud, radius_m: float = RADIUS_M) -> float:
    """Generalised optimal sub-pattern assignment distance with c = the radius, p = 2, α = 2.

    The square root of the least Σd² over the pairs of a matching plus c²/2
    for every point of either cloud left alone. Exact, see
    `isacbench.metrics.point_matching.matched_pairs`.

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
        an `InputWarning` for clouds too dense to be matched: where the smaller
        one has more than some 50 000 points close to ones of the other.

    References
    ----------
    A. S. Rahmathullah, Á. F. García-Fernández, L. Svensson, "Generalized
    optimal sub-pattern assignment metric", FUSION 2017.

    Examples
    --------
    >>> from isacbench.model.cloud import PointCloud
    >>> truth = PointCloud(xyz=[[0, 0, 0], [9, 0, 0]], velocity=[0, 0], power=[1, 1])
    >>> gospa_m(truth, truth), gospa_m(truth, PointCloud.empty())
    (0.0, 1.0)
    """
    to_estimate_m = np.asarray(cKDTree(estimate.xyz).query(truth.xyz)[0])
    to_truth_m = np.asarray(cKDTree(truth.xyz).query(estimate.xyz)[0])
    return _gospa_m(truth.xyz, to_estimate_m, estimate.xyz, to_truth_m, radius_m)


def _gospa_m(
    truth: Floats, to_estimate_m: Floats, estimate: Floats, to_truth_m: Floats, radius_m: float
) -> float:
    """Compute the GOSPA distance of positions whose nearest distances are known."""
    pairs = matched_pairs(truth[to_estimate_m < radius_m], estimate[to_truth_m < radius_m], radius_m)
    if pairs is None:
        warnings.warn(
            f"GOSPA of {len(truth)} true and {len(estimate)} estimated points is left out (NaN): too many "
            f"pairs are within {radius_m:g} m; thin both clouds or choose a smaller radius",
            InputWarning,
            stacklevel=2,
        )
        return math.nan
    matched_m2 = float(np.square(pairs[0] - pairs[1]).sum())
    n_alone = len(truth) + len(estimate) - 2 * len(pairs[0])
    return math.sqrt(matched_m2 + radius_m**2 / 2 * n_alone)
