"""One-to-one assignments of points to scatterers, among the pairs that are near each other."""

from __future__ import annotations

import warnings
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

Indices = NDArray[np.intp]

MOST_PAIRS = 2**22
"""Pairs nearer than the radius that are compared: 0.5 GB; of some thousand points, seconds."""


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
    """Find all pairs of points within a radius.

    Parameters
    ----------
    first, second : cKDTree
        Points of two clouds.
    what : str
        The score, for the message.

    Returns
    -------
    Pairs or None
        None, with an `InputWarning`, where there are more than `MOST_PAIRS`.
    """
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
    n_rows = int(pairs.i[-1]) + 1
    starts = np.searchsorted(pairs.i, np.arange(n_rows + 1)).astype(np.int32)
    edges = np.ones(pairs.i.size, dtype=np.int8)
    graph = csr_array((edges, pairs.j.astype(np.int32), starts), shape=(n_rows, int(pairs.j.max()) + 1))
    return int((maximum_bipartite_matching(graph, perm_type="column") >= 0).sum())


def connected_pieces(places: Floats) -> list[Indices]:
    """Divide points into pieces: a point within 1 of another in all coordinates is in the same piece.

    Parameters
    ----------
    places : ndarray of float64, shape (n, k)

    Returns
    -------
    list of ndarray of int
        Indices of the points of each piece.
    """
    n = len(places)
    ends = cKDTree(places).query_pairs(1.0, p=np.inf, output_type="ndarray").astype(np.int32)
    graph = csr_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
    piece = connected_components(graph, directed=False)[1]
    order = np.argsort(piece, kind="stable")
    return np.split(order, np.cumsum(np.bincount(piece))[:-1]) if n else []
