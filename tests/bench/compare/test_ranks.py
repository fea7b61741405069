import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.compare.significance import rank_sets

MEANS = np.array([0.0, 0.0, 0.0, 0.5, 1.0])
"""Some are equal."""


def normal_scores(rng, n_scenes):
    """Correlated, because scenes differ in difficulty, and with unequal spreads."""
    return MEANS + 2 * rng.normal(size=(n_scenes, 1)) + rng.normal(size=(n_scenes, 5)) * [0.5, 1, 2, 1, 0.5]


def scaled_scores(rng, n_scenes):
    """Every scene has a difficulty that multiplies means and spreads."""
    difficulty = np.exp(0.7 * rng.normal(size=(n_scenes, 1)))
    return difficulty * (1 + MEANS + rng.normal(size=(n_scenes, 5)) * [0.2, 0.3, 0.5, 0.3, 0.3])


def null_scores(rng, n_scenes):
    """All means are equal, which leaves no room for false claims."""
    return rng.normal(size=(n_scenes, 1)) + rng.normal(size=(n_scenes, 5)) * [0.1, 0.3, 1, 2, 3]


LAWS = {"normal": (normal_scores, MEANS), "scaled": (scaled_scores, MEANS), "null": (null_scores, 0 * MEANS)}


def gamma_scores(rng, n_scenes):
    """Unequally skewed scores of equal means."""
    shapes = np.array([0.1, 0.5, 1, 2, 4])
    return rng.normal(size=(n_scenes, 1)) + rng.gamma(shapes, 1 / shapes, (n_scenes, 5))


def failing_scores(rng, n_scenes):
    """Equal means, with failures in 5 to 50 % of scenes, the rarer the larger."""
    share = np.array([0.05, 0.1, 0.2, 0.3, 0.5])
    base = (5 + 3 * rng.gamma(2, 1, (n_scenes, 1))) * np.exp(0.1 * rng.normal(size=(n_scenes, 5)))
    return base + (rng.random((n_scenes, 5)) < share) * rng.exponential(2 / share, (n_scenes, 5))


SKEWED = {"gamma": (gamma_scores, 0 * MEANS), "failing": (failing_scores, 0 * MEANS)}


def coverage(law, n_scenes, n_runs):
    """Share of runs in which the set of every estimator holds all ranks that ties allow it."""
    draw, means = (LAWS | SKEWED)[law]
    lowest = 1 + (means[:, None] > means).sum(axis=1)
    highest = (means[:, None] >= means).sum(axis=1)
    rng = np.random.default_rng(n_scenes)
    held = 0
    for _ in range(n_runs):
        sets = rank_sets(draw(rng, n_scenes))
        held += bool(np.all((sets.low <= lowest) & (highest <= sets.high)))
    return held / n_runs


def below_nominal(n_runs):
    """95 % less three standard errors of the simulation."""
    return 0.95 - 3 * np.sqrt(0.95 * 0.05 / n_runs)


@pytest.mark.parametrize("law", ["normal", "null"])
def test_all_sets_together_hold_the_true_ranks_in_95_per_cent_of_all_runs(law):
    assert coverage(law, 20, 60) >= below_nominal(60)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "least"), [*((law, below_nominal(1000)) for law in LAWS), *((law, 0.8) for law in SKEWED)]
)
@pytest.mark.parametrize("n_scenes", [6, 20, 100])
def test_they_do_so_with_few_and_many_scenes_but_less_often_with_rare_large_failures(law, least, n_scenes):
    found = coverage(law, n_scenes, 1000)
    print(law, n_scenes, found)  # docs/rank.md quotes them
    assert found >= least


@given(st.integers(0, 2**32 - 1), st.permutations(range(4)))
def test_sets_follow_the_estimators_whatever_their_order_and_the_difficulty_of_scenes(seed, order):
    rng = np.random.default_rng(seed)
    scores = rng.normal([0, 0.5, 1.0, 2.0], size=(12, 4))
    sets = rank_sets(scores)
    moved = rank_sets(8 * scores[:, order] + rng.integers(-9, 9, (12, 1)))
    assert moved.low.tolist() == sets.low[list(order)].tolist()
    assert moved.high.tolist() == sets.high[list(order)].tolist()


@given(st.integers(0, 2**32 - 1))
def test_stepdown_sets_lie_within_those_of_simultaneous_intervals(seed):
    rng = np.random.default_rng(seed)
    scores = rng.normal([0, 0.5, 1.0, 4.0], size=(20, 4))
    sets = rank_sets(scores)
    changes = np.stack([scores[:, j] - scores[:, k] for j, k in itertools.combinations(range(4), 2)], axis=1)
    parts = changes[np.random.default_rng(0).integers(0, 20, (2000, 20))]
    largest = np.max(np.abs(parts.mean(1) - changes.mean(0)) / parts.std(1, ddof=1), axis=1) * np.sqrt(20)
    # A little wider than nominal: the other resamples are not those of the function.
    critical = np.quantile(largest, 0.97)
    for j in range(4):
        apart = [
            (scores[:, j] - scores[:, k]).mean() / (scores[:, j] - scores[:, k]).std(ddof=1) * np.sqrt(20)
            for k in range(4)
            if k != j
        ]
        n_better, n_worse = np.sum(np.array(apart) > critical), np.sum(np.array(apart) < -critical)
        assert sets.low[j] >= 1 + n_better
        assert sets.high[j] <= 4 - n_worse
        assert sets.low[j] <= sets.high[j]


def test_equal_estimators_share_their_ranks_and_a_constant_difference_is_certain():
    scores = np.random.default_rng(0).normal(size=(6, 1)) + np.array([0.0, 0.0, 1.0])
    sets = rank_sets(np.round(scores * 2**20) / 2**20)
    assert (sets.low.tolist(), sets.high.tolist()) == ([1, 1, 3], [2, 2, 3])
    alike = rank_sets(np.ones((6, 3)))
    assert (alike.low.tolist(), alike.high.tolist()) == ([1, 1, 1], [3, 3, 3])


def test_estimators_that_differ_in_one_scene_do_not_hide_that_a_third_is_worse():
    scores = np.random.default_rng(1).normal(size=(20, 3)) * 0.3 + [0.0, 0.0, 1.0]
    scores[:, 1] = scores[:, 0]
    scores[4, 1] += 0.2
    sets = rank_sets(scores)
    assert (sets.low.tolist(), sets.high.tolist()) == ([1, 1, 3], [2, 2, 3])


@pytest.mark.parametrize("scores", [np.ones((1, 3)), np.ones(3), [[1.0, np.nan], [1.0, 2.0]]])
def test_tables_without_scenes_or_with_holes_are_refused(scores):
    with pytest.raises(ValueError, match="allowed is a finite table"):
        rank_sets(scores)
