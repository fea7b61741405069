import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.plan.labels import find_limits
from isacbench.bench.run_times import pareto_frontier, summarise_points, summarise_times, timed_rows

# Few values: ties are the rule.
alternatives = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=12)


def beats(one, other):
    return one[0] <= other[0] and one[1] <= other[1] and one != other


@given(alternatives)
def test_exactly_what_nothing_beats_is_on_the_frontier(points):
    times, errors = np.reshape(points, (-1, 2)).T
    found = pareto_frontier(times, errors)
    assert found.tolist() == [not any(beats(other, point) for other in points) for point in points]


@given(alternatives.filter(len), st.randoms(use_true_random=False))
def test_the_frontier_does_not_hang_on_the_order_nor_on_the_units(points, random):
    order = list(range(len(points)))
    random.shuffle(order)
    times, errors = np.transpose(points).astype(float)
    shuffled = pareto_frontier(np.exp(times[order]), 3 * errors[order] - 7)
    assert shuffled.tolist() == pareto_frontier(times, errors)[order].tolist()


def on_frontier(points):
    return points.loc[points["is_on_frontier"], "estimator"].tolist()


def test_a_point_has_the_mean_error_the_median_time_and_both_intervals(timed):
    errors_m, times_s = np.arange(8.0), 0.01 * np.array([9, 2, 3, 4, 5, 6, 7, 80])
    (point,) = summarise_points(timed(a=(times_s, errors_m)), ()).to_dict("records")
    assert point["hausdorff_sum_m_mean"] == 3.5
    assert point["hausdorff_sum_m_high"] - 3.5 == pytest.approx(
        2.364624 * errors_m.std(ddof=1) / 8**0.5, rel=1e-6
    )
    assert point["hausdorff_sum_m_low"] == pytest.approx(7 - point["hausdorff_sum_m_high"])
    assert point["time_s"] == pytest.approx(0.055)
    assert (point["time_low_s"], point["time_high_s"], point["time_slowest_s"]) == (0.02, 0.8, 0.8)


def test_each_scenario_and_snr_has_a_frontier_of_its_own_without_the_limits(timed):
    rows = pd.concat(
        [
            timed(limit=(0.001, 0.1), fast=(0.01, 9.0), slow=(0.1, 5.0), bad=(0.2, 6.0)),
            timed(limit=(0.001, 0.1), fast=(0.01, 4.0), slow=(0.1, 5.0), bad=(0.2, 3.0), snr_db=-10.0),
        ]
    )
    points = summarise_points(rows, {"limit"})
    assert points["snr_db"].tolist() == [-10.0] * 4 + [10.0] * 4
    assert on_frontier(points[points["snr_db"] == 10]) == ["fast", "slow"]
    assert on_frontier(points[points["snr_db"] == -10]) == ["fast", "bad"]
    assert points.loc[points["is_limit"], "estimator"].unique().tolist() == ["limit"]


@pytest.mark.parametrize("status", ["error", "timeout", "killed", "skipped"])
def test_what_failed_in_a_trial_is_not_on_the_frontier_and_pushes_nobody_off(timed, status):
    rows = timed(best=(0.01, 1.0), other=(0.02, 2.0))
    first = rows.index[rows["estimator"] == "best"][0]
    # A row that was lost before it could be timed does not say that it was.
    rows.loc[first, ["status", "timing", "hausdorff_sum_m"]] = status, False, np.nan
    points = summarise_points(rows, ())
    assert on_frontier(points) == ["other"]
    best = points.iloc[0]
    assert (best["n_trials"], best["n_failed"], best["hausdorff_sum_m_mean"]) == (8, 1, 1.0)
    assert not best["is_complete"]


def test_what_failed_throughout_is_told_and_has_no_numbers(timed):
    rows = timed(broken=(0.01, 1.0), other=(0.02, 2.0))
    rows.loc[rows["estimator"] == "broken", ["status", "hausdorff_sum_m"]] = "error", np.nan
    points = summarise_points(rows, ())
    assert points["n_failed"].tolist() == [8, 0]
    assert points.iloc[0][["hausdorff_sum_m_mean", "time_s", "time_high_s", "time_slowest_s"]].isna().all()
    rows["status"] = "error"
    assert summarise_points(rows, ())["is_on_frontier"].tolist() == [False, False]


def test_a_mean_over_fewer_trials_than_others_have_is_not_on_the_frontier(timed):
    rows = timed(interrupted=(0.01, 1.0), other=(0.02, 0.5))
    assert on_frontier(summarise_points(rows.iloc[:-2], ())) == ["interrupted", "other"]
    without = rows.drop(rows.index[rows["estimator"] == "interrupted"][-1])
    assert on_frontier(summarise_points(without, ())) == ["other"]


def test_an_empty_image_counts_with_its_score_and_is_counted(timed):
    rows = timed(hasty=(0.01, 80.0), other=(0.02, 2.0))
    rows.loc[rows["estimator"] == "hasty", "status"] = "no_detection"
    points = summarise_points(rows, ())
    assert on_frontier(points) == ["hasty", "other"]
    assert points["n_no_detection"].tolist() == [8, 0]


def test_one_trial_has_points_and_no_intervals(timed):
    (point,) = summarise_points(timed(n_trials=1, a=(0.01, 1.0)), ()).to_dict("records")
    assert (point["hausdorff_sum_m_mean"], point["time_s"], point["is_on_frontier"]) == (1.0, 0.01, True)
    assert np.isnan(
        [point[f"{name}"] for name in ("hausdorff_sum_m_low", "hausdorff_sum_m_high", "time_low_s")]
    ).all()


def test_rows_whose_time_does_not_count_make_no_points(timed):
    rows = timed(a=(0.01, 1.0), b=(0.02, 2.0))
    rows["timing"] = rows["estimator"] == "b"
    assert timed_rows(rows)["estimator"].unique().tolist() == ["b"]
    assert summarise_times(rows)["estimator"].tolist() == ["b"]
    assert summarise_times(rows.assign(timing=False)).empty
    # Failures of a run that timed nothing are none of a timed one.
    assert timed_rows(rows.assign(timing=False, status="error")).empty


def test_memory_is_told_where_it_was_measured(timed):
    rows = timed(a=(0.01, 1.0))
    assert summarise_points(rows, ())["peak_memory_mib"].isna().all()
    rows["peak_memory_mib"] = np.arange(8.0)
    assert summarise_points(rows, ())["peak_memory_mib"].tolist() == [3.5]


def test_limits_are_found_by_name_and_what_is_not_installed_is_none(plugins, timed):
    rows = timed(seer=(0.1, 1.0), blob=(0.1, 1.0), gone=(0.1, 1.0))
    assert find_limits(rows) == {"seer"}


def test_many_scenarios_are_trials_of_one_and_each_counts_once(timed):
    parts = [
        timed(2, scenario=f"scene {k}", a=([0.01 * k, 0.03 * k], [k, k + 2.0]), b=(1.0, 50.0))
        for k in range(1, 14)
    ]
    rows = pd.concat(parts, ignore_index=True)
    failing = rows["estimator"].eq("b") & rows["scenario"].eq("scene 5") & rows["trial"].eq(0)
    rows.loc[failing, "status"] = "error"
    a, b = summarise_times(rows).to_dict("records")
    assert {a["scenario"], b["scenario"]} == {"13 scenarios as trials"}
    assert (a["n_trials"], a["n_failed"], b["n_failed"]) == (13, 0, 1)
    assert a["hausdorff_sum_m_mean"] == pytest.approx(8.0)
    assert a["time_s"] == pytest.approx(0.14)
    assert (a["is_on_frontier"], b["is_complete"]) == (True, False)
