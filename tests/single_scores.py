"""Scores of two clouds as attributes, and what they are held against: plain loops."""

import itertools
import math
from types import SimpleNamespace

from isacbench.plugins.scoring import score


def paper_scores(truth, estimate, region=None, velocity_bin_mps=None, **how):
    how |= {"region": region, "velocity_bin_mps": velocity_bin_mps}
    return SimpleNamespace(**score(truth, estimate, "paper", **how))


def repository_scores(truth, estimate, region=None):
    return SimpleNamespace(**score(truth, estimate, "repository", region=region))


def hausdorff_by_loops(a, b):
    return max(max(min(math.dist(p, q) for q in right) for p in left) for left, right in ((a, b), (b, a)))


def all_matchings(n, m):
    """Every one-to-one matching of n and m points, as pairs of indices."""
    for k in range(min(n, m) + 1):
        for rows in itertools.combinations(range(n), k):
            for columns in itertools.permutations(range(m), k):
                yield list(zip(rows, columns, strict=True))
