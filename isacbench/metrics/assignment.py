"""One-to-one assignments of points to scatterers, and the distances made of them: GOSPA and OSPA."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import (
    connected_components,
    maximum_bipartite_matching,
    min_weight_full_bipartite_matching,
)
from scipy.spatial import cKDTree

from isacbench.checked_arrays import Floats, Mask
from isacbench.errors import InputWarning
from isacbench.metrics.geometry import RADIUS_M, CloudPair
from isacbench.model.cloud import PointCloud

Indices = NDArray[np.intp]

MOST_PAIRS = 2**22
"""Pairs nearer than the radius that are compared: 0.5 GB; of some thousand points, seconds."""


MANY_PAIRS = 2**15
"""Pairs of which SciPy's search for a largest matching can take minutes, where nearly all points have one."""

FEW = 8
"""Points of a cell among which neighbours are sought first."""


class Pairs(NamedTuple):
    """Pairs of points of two clouds.

    Attributes
    ----------
    i, j : ndarray of int, shape (n,)
        Indices of a point of the first and of the second cloud, i in ascending order.
    squared_m2 : ndarray of float64, shape (n,)
        Squared distances in m².
    """

    i: Indices
    j: Indices
    squared_m2: Floats

    def take(self, which: Mask | Indices) -> Pairs:
        """Select pairs."""
        return Pairs(self.i[which], self.j[which], self.squared_m2[which])


def near_pairs(first: cKDTree, second: cKDTree, radius_m: float, what: str) -> Pairs | None:
    """Find all pairs of points within a radius; None, with a warning, for more than `MOST_PAIRS`."""
    n_near = int(first.count_neighbors(second, radius_m))
    if n_near > MOST_PAIRS:
        warnings.warn(
            f"{what} of {first.n} true and {second.n} estimated points is left out (NaN): {n_near} pairs "
            f"are within {radius_m:g} m, more than {MOST_PAIRS}; thin the clouds",
            InputWarning,
            stacklevel=2,
        )
        return None
    near = first.sparse_distance_matrix(second, radius_m, output_type="ndarray")
    near = near[np.argsort(near["i"], kind="stable")]
    return Pairs(near["i"], near["j"], np.square(near["v"]))


def cheapest(pairs: Pairs, cost: Floats, alone: float) -> Indices:
    """Pick the pairs of the cheapest matching when a pair that is left out costs ``alone``.

    Parameters
    ----------
    pairs : Pairs
        From which the matching is picked.
    cost : ndarray of float64, shape (n,)
        Of each pair, 0 or more.
    alone : float
        Infinite for a matching of as many pairs as possible.

    Returns
    -------
    ndarray of int
        Indices of the picked pairs.

    Notes
    -----
    Every row gets a column of its own that costs ``alone``: taking it leaves the row
    alone, so that a full matching of the rows, which the sparse solver wants,
    always exists.
    """
    if not cost.size:
        return np.empty(0, dtype=np.intp)
    rows, row = np.unique(pairs.i, return_inverse=True)
    columns, column = np.unique(pairs.j, return_inverse=True)
    own = np.arange(rows.size)
    # Beyond what other pairs of the matching can lose, the price only rounds off what they cost.
    alone = min(alone, (rows.size + 1) * float(cost.max()) or 1.0)
    # The solver reads a weight of zero as no edge: more on top of all leaves the best matching the best.
    weights = np.concatenate([cost, np.full(rows.size, alone)]) + alone
    # The solver takes graphs with 32-bit indices alone.
    ends = (
        np.concatenate([row, own]).astype(np.int32),
        np.concatenate([column, columns.size + own]).astype(np.int32),
    )
    graph = csr_array((weights, ends), shape=(rows.size, columns.size + rows.size))
    chosen_row, chosen_column = min_weight_full_bipartite_matching(graph)
    paired = chosen_column < columns.size
    n_columns = columns.size
    wanted = chosen_row[paired].astype(np.intp) * n_columns + chosen_column[paired]
    return np.flatnonzero(np.isin(row * n_columns + column, wanted))


def most_pairs(pairs: Pairs) -> int:
    """Count the pairs of the largest one-to-one matching.

    Parameters
    ----------
    pairs : Pairs
        From which the matching is picked.
    """
    if not pairs.i.size:
        return 0
    if pairs.i.size > MANY_PAIRS:
        return cheapest(pairs, np.ones(pairs.i.size), math.inf).size
    n_rows = int(pairs.i[-1]) + 1
    starts = np.searchsorted(pairs.i, np.arange(n_rows + 1)).astype(np.int32)
    edges = np.ones(pairs.i.size, dtype=np.int8)
    graph = csr_array((edges, pairs.j.astype(np.int32), starts), shape=(n_rows, int(pairs.j.max()) + 1))
    return int((maximum_bipartite_matching(graph, perm_type="column") >= 0).sum())


def connected_pieces(places: Floats) -> list[Indices]:
    """Divide points into pieces: a point within 1 of another in all coordinates is in the same piece."""
    n = len(places)
    if not n:
        return []
    corners = np.floor(places)
    by_cell = np.lexsort(corners.T)
    is_first = np.append(True, (np.diff(corners[by_cell], axis=0) != 0).any(axis=1))
    start, cell = np.flatnonzero(is_first), np.cumsum(is_first) - 1
    size = np.diff(start, append=n)
    # A cell's points are one piece, so that few of each cell find most pieces without the pairs of all.
    few = by_cell[np.arange(n) - start[cell] < FEW]
    near = few[cKDTree(places[few]).query_pairs(1.0, p=np.inf, output_type="ndarray")]
    links = np.concatenate([near, np.column_stack([by_cell, n + cell])])
    piece = _components(links, n + start.size)
    if few.size < n:
        pairs = cKDTree(corners[by_cell[start]]).query_pairs(1.0, p=np.inf, output_type="ndarray")
        pairs = pairs[(size[pairs] > FEW).any(axis=1) & (piece[n + pairs[:, 0]] != piece[n + pairs[:, 1]])]
        touching = n + pairs[_touch(places[by_cell], start, size, pairs)]
        piece = _components(np.concatenate([links, touching]), n + start.size)
    order = np.argsort(piece[:n], kind="stable")
    return np.split(order, np.flatnonzero(np.diff(piece[order])) + 1)


def _touch(places: Floats, start: Indices, size: Indices, pairs: Indices) -> Indices:
    """Find pairs (n, 2) of cells that have points within 1; a cell's are ``size`` ones from ``start`` on."""
    sides = []
    for cell in pairs.T:
        n_points = size[cell]
        member = np.arange(n_points.sum()) + np.repeat(start[cell] - np.cumsum(n_points) + n_points, n_points)
        # A coordinate more keeps the pairs apart.
        sides.append(np.column_stack([places[member], np.repeat(3.0 * np.arange(cell.size), n_points)]))
    tree = cKDTree(np.unique(sides[0], axis=0))  # many at one place take a tree time in squares
    apart = tree.query(sides[1], p=np.inf, distance_upper_bound=np.nextafter(1, 2))[0]
    return np.unique(sides[1][np.isfinite(apart), -1] / 3).astype(np.intp)


def _components(links: Indices, n: int) -> Indices:
    """Number (n,) of the connected component of each of n things that links (m, 2) join."""
    ends = links.astype(np.int32)
    graph = csr_array((np.ones(len(links), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1])


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
