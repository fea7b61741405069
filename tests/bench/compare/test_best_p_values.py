import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from isacbench.bench.compare.statistics import MAX_ENUMERATED, best_p_values, smallest_p_value

# Sixteenths: sums are exact, so that an oracle with another order of them finds the same ties.
tables = arrays(
    np.float64,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=5),
    elements=st.integers(-64, 64).map(lambda n: n / 16),
)


def plain_p_values(scores, margin):
    """By loops over alternatives, flips, others and trials."""
    n_trials, n = scores.shape
    found = []
    for k in range(n):
        greatest = []
        for signs in itertools.product([1, -1], repeat=n_trials):
            statistics = [0.0]
            for other in set(range(n)) - {k}:
                differences = [scores[t, k] - scores[t, other] - margin for t in range(n_trials)]
                size = sum(d * d for d in differences) ** 0.5
                total = sum(s * d for s, d in zip(signs, differences, strict=True))
                statistics.append(total / size if size else 0.0)
            greatest.append(max(statistics))
        found.append(np.mean([value >= greatest[0] - 1e-9 for value in greatest]))
    return found


@given(tables, st.sampled_from([0.0, 0.25]))
def test_p_values_are_those_of_all_flips_counted_one_by_one(scores, margin):
    np.testing.assert_allclose(best_p_values(scores, margin), plain_p_values(scores, margin))


@given(tables)
def test_the_least_mean_always_may_be_best_and_no_p_value_is_less_than_flips_allow(scores):
    p_values = best_p_values(scores)
    assert p_values[scores.mean(axis=0).argmin()] == 1
    assert p_values.min() >= smallest_p_value(len(scores))


def test_worse_in_every_trial_is_told_apart_but_not_within_the_margin():
    noise = np.random.default_rng(0).normal(size=(8, 1))
    scores = noise + np.array([0.0, 0.5])
    assert best_p_values(scores).tolist() == [1, smallest_p_value(8)]
    assert best_p_values(scores, margin=0.4)[1] == smallest_p_value(8)
    assert best_p_values(scores, margin=0.6)[1] == 1


@pytest.mark.parametrize("n_trials", [8, MAX_ENUMERATED + 4])
def test_the_truly_best_of_many_is_missed_as_rarely_as_promised(n_trials):
    rng = np.random.default_rng(0)
    level, n_runs = 0.1, 50
    # All are best here, the hardest case; trials share a part, and spreads differ.
    missed = 0
    for _ in range(n_runs):
        scores = rng.normal(size=(n_trials, 1)) + rng.normal(size=(n_trials, 12)) * np.linspace(0.5, 2, 12)
        missed += best_p_values(scores)[0] <= level
    # Four standard deviations of the count above the level.
    assert missed / n_runs < level + 4 * (level * (1 - level) / n_runs) ** 0.5


def test_flips_that_are_drawn_are_the_same_every_time():
    scores = np.random.default_rng(0).normal(size=(20, 4))
    assert best_p_values(scores).tolist() == best_p_values(scores).tolist()
    assert best_p_values(scores).tolist() != best_p_values(scores, seed=1).tolist()


@pytest.mark.parametrize("scores", [[1.0, 2.0], np.empty((0, 3)), [[1.0, np.nan]], [[1.0], [np.inf]]])
def test_anything_but_a_finite_table_is_refused(scores):
    with pytest.raises(ValueError, match="allowed is a finite table"):
        best_p_values(scores)
