import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom, binomtest, chi2, multinomial

from isacbench.bench.statistics import (
    deviation_columns,
    exact_interval,
    median_interval,
    median_times,
    rms_interval,
    share_columns,
    student_band,
    wilson_interval,
)


def test_the_interval_of_normal_errors_is_that_of_chi_square_where_squares_spread_as_theirs():
    values = np.tile([0.2, 1.0, 2.0], 20)
    squares = values**2
    freedom = min(60, 2 * 60 * squares.mean() ** 2 / squares.var(ddof=1))
    rms, low, high = rms_interval(values)
    assert rms == pytest.approx(math.sqrt(squares.mean()))
    assert low == pytest.approx(rms * math.sqrt(freedom / chi2.ppf(0.975, freedom)))
    assert high == pytest.approx(rms * math.sqrt(freedom / chi2.ppf(0.025, freedom)))


@pytest.mark.slow
@pytest.mark.parametrize("draw", ["normal", "laplace"])
def test_the_interval_covers_the_truth_as_often_as_it_promises(draw):
    rng = np.random.default_rng(0)
    true = 1.0 if draw == "normal" else math.sqrt(2)
    covered = 0
    for values in getattr(rng, draw)(size=(2000, 100)):
        _, low, high = rms_interval(values)
        covered += low < true < high
    assert 0.91 < covered / 2000 < 0.975


@pytest.mark.parametrize(("n", "has_band"), [(2, False), (4, False), (5, True), (12, True)])
def test_five_trials_are_needed_for_any_band(n, has_band):
    values = np.arange(1.0, n + 1)
    mean, band = deviation_columns(pd.DataFrame({"deviation": values})).values()
    halves = [band, float(student_band(1.0, n))]
    limits = [*rms_interval(values)[1:], *[*share_columns("p", 1, 1000 * n, n_trials=n).values()][1:]]
    assert [math.isfinite(number) for number in halves + limits] == [has_band] * 6
    assert mean == (n + 1) / 2
    assert rms_interval(values)[0] > 0


def test_without_values_there_is_nothing_and_of_one_no_interval():
    assert np.isnan(rms_interval(np.array([]))).all()
    np.testing.assert_array_equal(rms_interval(np.array([-3.0])), [3, np.nan, np.nan])
    assert rms_interval(np.zeros(5))[0] == 0


@pytest.mark.parametrize("n", [1, 10, 200])
def test_wilsons_interval_contains_its_share_and_covers_as_it_promises(n):
    intervals = [wilson_interval(k, n) for k in range(n + 1)]
    for k, (low, high) in enumerate(intervals):
        assert 0 <= low <= k / n <= high <= 1
    if n < 10:
        return
    coverage = [
        sum(binom.pmf(k, n, p) for k, (low, high) in enumerate(intervals) if low <= p <= high)
        for p in np.linspace(0.02, 0.98, 97)
    ]
    assert np.mean(coverage) == pytest.approx(0.95, abs=0.012)


@pytest.mark.parametrize("n", [6, 7, 8, 12, 25, 100, 1001])
def test_the_interval_of_the_median_is_the_tightest_of_order_statistics_that_keeps_its_promise(n):
    ranks = np.arange(1.0, n + 1)
    middle, low, high = median_interval(np.random.default_rng(0).permutation(ranks))
    assert middle == (n + 1) / 2
    assert low + high == n + 1
    # Of values drawn from any continuous distribution, those below its median are a fair coin's heads.
    coverage, tighter = (binom.cdf(high - 1 - k, n, 0.5) - binom.cdf(low - 1 + k, n, 0.5) for k in (0, 1))
    assert tighter < 0.95 <= coverage


@pytest.mark.parametrize("n", range(6))
def test_few_values_have_a_median_and_no_interval(n):
    expected = [(n - 1) / 2 if n else np.nan, np.nan, np.nan]
    np.testing.assert_array_equal(median_interval(np.arange(float(n))), expected)


@pytest.mark.parametrize("n", [6, 20])
@pytest.mark.parametrize("ties", [0.0, 0.3, 1.0])
def test_the_exact_interval_covers_every_win_probability_with_95_per_cent_whatever_the_ties(n, ties):
    """All outcomes of n scenes are enumerated: wins, ties of which each counts half, losses."""
    outcomes = np.array(
        [(wins, even, n - wins - even) for wins in range(n + 1) for even in range(n + 1 - wins)]
    )
    low, high = np.array([exact_interval(wins + even / 2, n) for wins, even, _ in outcomes]).T
    for win in np.linspace(0, 1, 201) * (1 - ties):
        probability = win + ties / 2
        chances = multinomial.pmf(outcomes, n, [win, ties, 1 - ties - win])
        assert chances[(low <= probability) & (probability <= high)].sum() >= 0.95


def test_the_exact_interval_is_that_of_scipy():
    for k in range(11):
        expected = binomtest(k, 10).proportion_ci(method="exact")
        assert exact_interval(k, 10) == pytest.approx(expected)


def test_no_trials_have_no_interval():
    assert all(math.isnan(limit) for limit in (*wilson_interval(0, 0), *exact_interval(0, 0)))


def medians(**columns):
    rows = pd.DataFrame({"estimator": "a", "status": "ok", "timing": False, **columns})
    return median_times(rows, ["estimator"])["time_estimate_s_median"].to_dict()


def test_median_times_are_those_of_cells_without_failures_and_of_timed_ones_where_there_are_any():
    assert medians(snr_db=[0, 0, 0, 10, 10, 10], time_estimate_s=[1.0, 2.0, 9.0, 3.0, 8.0, 9.0]) == {"a": 5.5}
    status, time_s = ["ok", "no_detection", "error", "timeout", "error"], [1.0, 3.0, 50.0, 60.0, 7.0]
    assert medians(estimator=list("aaaab"), status=status, time_estimate_s=time_s) == {"a": 2.0}
    timing, time_s = [True, True, False, False], [1.0, 2.0, 9.0, 4.0]
    assert medians(estimator=list("aaab"), timing=timing, time_estimate_s=time_s) == {"a": 1.5, "b": 4.0}
