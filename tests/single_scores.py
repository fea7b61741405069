"""Scores of two clouds as attributes."""

from types import SimpleNamespace

from isacbench.plugins.scoring import score


def paper_scores(truth, estimate, region=None, velocity_bin_mps=None, **how):
    how |= {"region": region, "velocity_bin_mps": velocity_bin_mps}
    return SimpleNamespace(**score(truth, estimate, "paper", **how))


def repository_scores(truth, estimate, region=None):
    return SimpleNamespace(**score(truth, estimate, "repository", region=region))
