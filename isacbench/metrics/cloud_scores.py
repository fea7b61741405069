"""Point cloud scores beside the paper's: chamfer, GOSPA, precision and recall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from isacbench.metrics.geometry import RADIUS_M, CloudPair, box_diagonal_m
from isacbench.metrics.gospa import pair_gospa

if TYPE_CHECKING:
    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region


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
    return pair_scores(CloudPair(truth, estimate, region, radius_m=radius_m))


def pair_scores(pair: CloudPair) -> CloudScores:
    """Score a pair as `cloud_scores` does, with searches that other metrics share.

    Parameters
    ----------
    pair : CloudPair

    Returns
    -------
    CloudScores
    """
    forward_m, backward_m = pair.truth_to_estimate_m, pair.estimate_to_truth_m
    gospa = pair.remembered(pair_gospa).distance_m
    if not len(pair.estimate):
        diagonal_m = box_diagonal_m(pair.truth.xyz, pair.region)
        return CloudScores(diagonal_m, diagonal_m, gospa, precision=0.0, recall=0.0)
    return CloudScores(
        accuracy_m=float(backward_m.mean()),
        completeness_m=float(forward_m.mean()),
        gospa_m=gospa,
        precision=float((backward_m <= pair.radius_m).mean()),
        recall=float((forward_m <= pair.radius_m).mean()),
    )
