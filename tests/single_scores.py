"""Scores of two clouds as attributes, and the distance that they share by plain loops."""

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
