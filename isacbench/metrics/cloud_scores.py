"""Point cloud scores beside the paper's: chamfer, GOSPA, precision and recall."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree

from isacbench.checked_arrays import checked_array
from isacbench.errors import InputWarning, require
from isacbench.metrics.geometry import LARGEST, CloudPair, box_diagonal_m

if TYPE_CHECKING:
    from isacbench.model.cloud import PointCloud
    from isacbench.model.region import Region

Indices = NDArray[np.intp]

RADIUS_M = 1.0
"""Distance, where no scenario says another: up to it a point counts as right for precision and recall; from
it a true scatterer counts as missed and an estimated point as false in GOSPA, whose cut-off c it is."""

MOST_PAIRS = 2**22
"""Pairs nearer than the radius that GOSPA compares: 0.5 GB; of some thousand points, seconds."""


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
    radius_m = checked_array("radius_m", radius_m).item()
    require(1 / LARGEST <= radius_m <= LARGEST, "radius_m", radius_m, "a positive number of m")
    forward_m, backward_m = pair.truth_to_estimate_m, pair.estimate_to_truth_m
    gospa = _tree_gospa_m(pair.truth_tree, pair.estimate_tree, radius_m)
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
    for every point of either cloud left alone. Exact: a pair at c or farther
    is never better than two points left alone, so the matching is sought
    among the nearer pairs, which are few.

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
        an `InputWarning` where more than `MOST_PAIRS` pairs are nearer than c.

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
    return _tree_gospa_m(cKDTree(truth.xyz), cKDTree(estimate.xyz), radius_m)


def _tree_gospa_m(truth: cKDTree, estimate: cKDTree, radius_m: float) -> float:
    """Compute the GOSPA distance of the points of two trees."""
    n_near = int(truth.count_neighbors(estimate, radius_m))
    if n_near > MOST_PAIRS:
        warnings.warn(
            f"GOSPA of {truth.n} true and {estimate.n} estimated points is left out (NaN): {n_near} pairs "
            f"are within {radius_m:g} m, more than {MOST_PAIRS}; thin both clouds or choose a smaller radius",
            InputWarning,
            stacklevel=2,
        )
        return math.nan
    near = truth.sparse_distance_matrix(estimate, radius_m, output_type="ndarray")
    i, j = _best_matching(near["i"], near["j"], np.square(near["v"]), radius_m)
    matched_m2 = float(np.square(truth.data[i] - estimate.data[j]).sum())
    n_alone = truth.n + estimate.n - 2 * i.size
    return math.sqrt(matched_m2 + radius_m**2 / 2 * n_alone)


def _best_matching(
    i: Indices, j: Indices, squared_m2: NDArray[np.float64], radius_m: float
) -> tuple[Indices, Indices]:
    """Pick the pairs of the cheapest matching when a pair that is left out costs c².

    Every row gets a column of its own that costs c²: taking it leaves the row
    alone, so that a full matching of the rows, which the sparse solver wants,
    always exists.
    """
    if not i.size:
        return i, j
    rows, row = np.unique(i, return_inverse=True)
    columns, column = np.unique(j, return_inverse=True)
    own = np.arange(rows.size)
    # Beyond what other pairs of the matching can lose, c² changes nothing but rounds off what they cost.
    alone_m2 = min(radius_m**2, (rows.size + 1) * squared_m2.max() or np.inf)
    # The solver reads a weight of zero as no edge: more on top of all leaves the best matching the best.
    weights = np.concatenate([squared_m2, np.full(rows.size, alone_m2)]) + alone_m2
    # The solver takes graphs with 32-bit indices alone.
    ends = (
        np.concatenate([row, own]).astype(np.int32),
        np.concatenate([column, columns.size + own]).astype(np.int32),
    )
    graph = csr_array((weights, ends), shape=(rows.size, columns.size + rows.size))
    chosen_row, chosen_column = min_weight_full_bipartite_matching(graph)
    paired = chosen_column < columns.size
    return rows[chosen_row[paired]], columns[chosen_column[paired]]
