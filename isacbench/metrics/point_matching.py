"""The best matching of two sets of points in bounded memory, however many pairs are near."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST_PAIRS = 2**20
"""Pairs that are compared at once, at most."""

NEIGHBOURS = 16

UNIT = 2.0**44
"""Savings are whole numbers of 1 / UNIT: their sums are exact, and no rounding looks like a gain."""

STEPS = [2.0**32, 2.0**20, 2.0**10, 1.0]
"""Rounding of the savings, rough at first: else rivals would outbid each other by trifles."""

TIE = 3e-7
"""Width of a random coordinate by which points at one place find different neighbours."""


def matched_pairs(a: Floats, b: Floats, radius: float) -> tuple[Floats, Floats] | None:
    """Match points so that the sum of savings radius² - d² over the pairs is largest.

    Of more than a million pairs, nearest neighbours are the first candidates.
    Prices of the points tell which others are needed: a matching is best if no
    pair saves more than its points cost. The best offer to a point is its
    nearest neighbour if the root of the price is a further coordinate.

    Parameters
    ----------
    a, b : ndarray of float64, shapes (n, 3) and (m, 3)
    radius : float
        Distance from which on a pair saves nothing.

    Returns
    -------
    (ndarray of float64, ndarray of float64) or None
        Points of a and b (in any order of the two), pair by pair. The sum is
        exact, of more than a million pairs to 1e-12 radius² a point. None if a
        million candidates are too few.
    """
    if len(a) * len(b) <= MOST_PAIRS:
        costs = np.minimum(cdist(a, b, "sqeuclidean"), radius**2)
        i, j = linear_sum_assignment(costs)
        saves = costs[i, j] < radius**2
        return a[i[saves]], b[j[saves]]
    # In the order of a tree, every fourth point is a fair sample.
    few, many = sorted((points[cKDTree(points).indices] / radius for points in (a, b)), key=len)
    if len(few) > MOST_PAIRS or _offers(few, many, np.zeros(len(many)))[0].size > MOST_PAIRS:
        return None
    found = _priced_matching(few, many)
    return found and (radius * few[found[0]], radius * many[found[1]])


def _priced_matching(a: Floats, b: Floats) -> tuple[Indices, Indices, Floats] | None:
    """Find the best matching and prices of a, from the prices of a sample on."""
    prices, n = np.zeros(len(b)), len(a)
    if len(b) > NEIGHBOURS:
        sample = _priced_matching(a[::4], b[::4])
        if sample is None:
            return None
        prices = _offers(b, a[::4], sample[2], k=1)[2]
    i, j, bids = _offers(a, b, prices)
    pairs = j * n + i
    if len(b) < 2 * n:  # else many will be left alone
        j, i, _ = _offers(b, a, bids)
        pairs = np.concatenate([pairs, j * n + i])
    steps = STEPS
    while steps:
        step, pairs = steps[0], np.unique(pairs)
        if pairs.size > MOST_PAIRS:
            return None
        j, i = np.divmod(pairs, n)
        saved, bids, prices = (np.rint(part / step) * step for part in (_savings(a[i], b[j]), bids, prices))
        partners, worth, prices = _cheapest(i, j, saved, bids, prices)
        i, j, bids = _offers(a, b, prices)
        is_new = (bids > worth + 2 * step + 10)[i]
        pairs = np.concatenate([pairs, j[is_new] * n + i[is_new]])
        if not is_new.any():
            steps = steps[1:]
    is_matched = partners >= 0
    return np.flatnonzero(is_matched), partners[is_matched], bids


def _savings(a: Floats, b: Floats) -> Floats:
    """Whole numbers of 1 / UNIT that pairs of points save."""
    squares: Floats = np.square(a - b).sum(axis=1)
    return UNIT - np.rint(UNIT * squares)


def _offers(a: Floats, b: Floats, prices: Floats, k: int = NEIGHBOURS) -> tuple[Indices, Indices, Floats]:
    """Pairs of each point of a with the k best offers of b, and prices of a at which none is a gain."""
    tie = TIE * np.random.default_rng(0).random(max(len(a), len(b)))
    tree = cKDTree(np.column_stack([b, tie[: len(b)], np.sqrt(prices / UNIT)]))
    places = np.column_stack([a, tie[: len(a)], np.zeros(len(a))])
    distance, index = tree.query(places, k=range(1, min(k, len(b)) + 1), distance_upper_bound=1)
    i, rank = np.nonzero(np.asarray(distance) < 1)
    j = np.asarray(index)[i, rank]
    bids = np.zeros(len(a))
    np.maximum.at(bids, i, _savings(a[i], b[j]) - prices[j])
    return i, j, bids


def _cheapest(
    i: Indices, j: Indices, saved: Floats, bids: Floats, prices: Floats
) -> tuple[Indices, Floats, Floats]:
    """Match pairs, sorted by j, to save most: partners (-1: none), and prices of both sets that hold them."""
    n, (columns, starts, j) = len(bids), np.unique(j, return_index=True, return_inverse=True)
    m, own, costs = len(columns), np.arange(len(bids) + len(columns)), prices[columns]
    # The solver wants a full matching: a point left alone takes a double of its own, at its price, and the
    # doubles of a pair take each other for nothing. Bids and prices near the right ones make it quick.
    weights = np.concatenate([bids[i] + costs[j] - saved, np.zeros(i.size), bids, costs])
    ends = np.concatenate([i, n + j, own]), np.concatenate([j, m + i, np.roll(own, -m)])
    # It takes graphs with 32-bit indices alone, and reads a weight of zero as no edge.
    graph = csr_array((weights - weights.min() + UNIT, np.array(ends, np.int32)), shape=(n + m, n + m))
    partners = np.minimum(min_weight_full_bipartite_matching(graph)[1][:n], m)
    kept, is_kept = np.zeros(n), partners[i] == j
    kept[i[is_kept]] = saved[is_kept]
    least, gains = np.zeros(m + 1), saved - kept[i]  # the last price is that of no partner
    for _ in range(n if m else 0):
        risen = np.maximum(least[:-1], np.maximum.reduceat(gains + least[partners[i]], starts))
        if (risen == least[:-1]).all():
            break
        least[:-1] = risen
    prices = np.zeros(len(prices))
    prices[columns] = least[:-1]
    return np.append(columns, -1)[partners], kept - least[partners], prices
