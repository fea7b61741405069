import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, norm, rankdata, wilcoxon

from isacbench.bench.compare import significance as statistics
from isacbench.bench.compare.significance import (
    MAX_EXACT,
    MIN_INTERVAL_TRIALS,
    bootstrap_changes,
    holm,
    signed_rank_test,
    smallest_effect,
    trials_needed,
)

small_integers = st.lists(st.integers(-4, 4), min_size=1, max_size=9)


def brute_force(differences):
    """One-sided p-values over all signs, of ranks that zeros take part in."""
    values = np.asarray(differences, dtype=float)
    ranks = rankdata(np.abs(values))
    observed = ranks[values > 0].sum()
    kept = ranks[values != 0]
    sums = [sum(kept[np.array(signs, bool)]) for signs in itertools.product([0, 1], repeat=kept.size)]
    return np.mean([total >= observed for total in sums]), np.mean([total <= observed for total in sums])


@given(small_integers)
def test_p_values_are_those_of_all_sign_flips_whatever_ties_and_zeros(differences):
    found = signed_rank_test(differences)
    greater, less = brute_force(differences)
    assert found.greater == pytest.approx(greater, rel=1e-12)
    assert found.less == pytest.approx(less, rel=1e-12)


@pytest.mark.parametrize("n", [5, 12, 30, 50])
def test_p_values_are_scipys_where_those_are_exact(n):
    differences = np.random.default_rng(n).normal(0.3, 1, n)
    found = signed_rank_test(differences)
    for side in ("greater", "less"):
        expected = wilcoxon(differences, alternative=side, method="exact").pvalue
        assert getattr(found, side) == pytest.approx(expected, rel=1e-10)


@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=60), st.integers(0, 5))
def test_equal_signs_attain_the_smallest_p_value_that_zeros_do_not_change(sizes, n_zeros):
    found = signed_rank_test([*sizes, *[0.0] * n_zeros])
    assert found.greater == pytest.approx(2.0 ** -len(sizes), rel=1e-9)
    assert found.attainable == 2.0 ** -len(sizes)
    assert found.less == pytest.approx(1)


def test_no_difference_at_all_is_no_evidence():
    assert signed_rank_test(np.zeros(20)) == signed_rank_test([]) == (1, 1, 1)


@pytest.mark.parametrize("shift", [-0.1, 0.0, 0.15, 0.3])
@pytest.mark.parametrize("grid", [None, 2])
def test_the_normal_limit_goes_on_where_the_exact_distribution_ends(monkeypatch, shift, grid):
    differences = np.random.default_rng(3).normal(shift, 1, 2 * MAX_EXACT)
    if grid:  # ties and zeros
        differences = np.round(differences * grid) / grid
    limit = signed_rank_test(differences)
    monkeypatch.setattr(statistics, "MAX_EXACT", differences.size)
    exact = signed_rank_test(differences)
    assert limit.greater == pytest.approx(exact.greater, rel=0.05, abs=2e-5)
    assert limit.less == pytest.approx(exact.less, rel=0.05, abs=2e-5)
    assert limit != exact


def test_the_normal_limit_is_scipys_approximation():
    differences = np.random.default_rng(1).normal(0.2, 1, 150)
    expected = wilcoxon(differences, alternative="greater", correction=True).pvalue  # exact up to 50 alone
    assert signed_rank_test(differences).greater == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_differences_that_are_no_numbers_are_refused(bad):
    with pytest.raises(ValueError, match="finite"):
        signed_rank_test([1.0, bad])


@given(st.lists(st.floats(0, 1), max_size=12))
def test_holms_p_values_are_what_his_procedure_rejects(p_values):
    adjusted = holm(p_values)
    for level in (0.01, 0.05, 0.3, 0.999):
        rejected = set()
        for index in sorted(range(len(p_values)), key=lambda index: p_values[index]):
            if p_values[index] * (len(p_values) - len(rejected)) > level:
                break
            rejected.add(index)
        assert {index for index, p in enumerate(adjusted) if p <= level} == rejected


def plain_bootstrap(base, new, n_resamples=4000):
    """Percentile interval of the ratio of means by a loop, at expanded levels."""
    rng = np.random.default_rng(99)
    n = len(base)
    picks = rng.integers(n, size=(n_resamples, n))
    ratios = [new[pick].mean() / base[pick].mean() - 1 for pick in picks]
    from scipy.stats import t

    level = norm.cdf(-t.ppf(0.975, n - 1) * math.sqrt(n / (n - 1)))
    return np.quantile(ratios, [level, 1 - level])


def test_the_relative_interval_is_that_of_a_plain_bootstrap():
    rng = np.random.default_rng(0)
    base = rng.gamma(20, 0.3, 30)
    new = base + rng.normal(0.3, 0.5, 30)
    found = bootstrap_changes(base[:, None], new[:, None])
    assert found.relative[0] == pytest.approx(new.mean() / base.mean() - 1)
    low, high = plain_bootstrap(base, new)
    width = high - low
    assert found.relative_low[0] == pytest.approx(low, abs=0.06 * width)
    assert found.relative_high[0] == pytest.approx(high, abs=0.06 * width)


def test_points_are_resampled_jointly_and_the_same_way_every_time():
    rng = np.random.default_rng(0)
    base = rng.gamma(20, 0.3, (12, 1))
    new = base + rng.normal(0, 0.5, (12, 1))
    found = bootstrap_changes(np.tile(base, 1100), np.tile(new, 1100))
    again = bootstrap_changes(base, new)
    np.testing.assert_allclose(found, np.tile(again, (1100, 1)), rtol=1e-12)


def test_a_missing_pair_is_as_if_the_trial_had_not_been():
    rng = np.random.default_rng(0)
    base = rng.gamma(20, 0.3, (40, 2))
    new = base + 0.5 + rng.normal(0, 0.2, (40, 2))
    base[3, 1] = new[3, 1] = np.nan
    found = bootstrap_changes(base, new)
    without = bootstrap_changes(np.delete(base, 3, axis=0), np.delete(new, 3, axis=0))
    assert found.change[1] == pytest.approx(without.change[1])
    assert found.relative[1] == pytest.approx(without.relative[1])
    assert found.change_low[1] == pytest.approx(without.change_low[1], rel=0.1)
    assert found.change_low[0] < found.change[0] < found.change_high[0]


def test_few_trials_have_no_interval_unless_nothing_changed_and_no_pairs_nothing():
    few = MIN_INTERVAL_TRIALS - 1
    base = np.ones((few, 3))
    new = np.column_stack([np.ones(few), np.linspace(1, 2, few), np.full(few, np.nan)])
    found = bootstrap_changes(base, new)
    assert (found.change_low[0], found.change_high[0], found.relative_high[0]) == (0, 0, 0)
    assert found.change[1] == pytest.approx(0.5)
    assert np.isnan([found.change_low[1], found.relative_high[1], found.change[2], found.change_low[2]]).all()


def test_a_change_from_zero_is_infinitely_large_and_no_change_of_zero_is_none():
    base = np.zeros((8, 2))
    new = np.column_stack([np.zeros(8), np.ones(8)])
    found = bootstrap_changes(base, new)
    assert found.relative.tolist() == [0, np.inf]
    assert found.relative_low.tolist() == [0, np.inf]
    assert found.change.tolist() == [0, 1]


@pytest.mark.slow
@pytest.mark.parametrize("n", [6, 10, 30])
def test_intervals_cover_the_true_change_about_as_often_as_they_promise(n):
    rng = np.random.default_rng(n)
    base = rng.gamma(30, 0.2, (n, 3000))
    new = base + 0.3 + rng.normal(0, 0.5, (n, 3000))
    found = bootstrap_changes(base, new)
    covered = np.mean((found.change_low <= 0.3) & (found.change_high >= 0.3))
    # The columns share their resamples, not their data: draws are independent.
    assert 0.92 < covered < 0.98


@pytest.mark.parametrize(("n", "level"), [(8, 0.01), (13, 0.005 / 33), (15, 0.005), (30, 0.01), (60, 0.001)])
def test_the_smallest_effect_is_shown_with_the_promised_power(n, level):
    effect = float(smallest_effect(2.0, n, level))
    draws = np.random.default_rng(7).normal(effect, 2.0, (1500, n))
    n_shown = sum(signed_rank_test(row).greater <= level for row in draws)
    # Asymptotic theory: some per cent off for few trials.
    assert binom.ppf(0.001, 1500, 0.72) < n_shown < binom.ppf(0.999, 1500, 0.83)


@pytest.mark.parametrize("level", [0.25, 0.01, 0.01 / 66, 1e-9])
def test_fewer_trials_than_needed_show_nothing_however_large_the_effect(level):
    needed = trials_needed(level)
    assert signed_rank_test(np.arange(1.0, needed + 1)).greater <= level
    assert signed_rank_test(np.arange(1.0, needed)).greater > level
    assert smallest_effect(1.0, [needed - 1, needed], level)[0] == np.inf
    assert np.isfinite(smallest_effect(1.0, needed, level))
