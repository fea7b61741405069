import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.report.tables.budgets import budget_grids, budget_series, summarise_budgets
from isacbench.report.tables.tables_by_kind import grids_of, write_run_tables
from tests.report.tables.printed import printed

positive = st.floats(1e-6, 1e4)


@given(positive, positive)
def test_the_series_covers_the_times_in_steps_of_one_two_and_five(one, other):
    shortest, longest = sorted((one, other))
    series = np.array(budget_series(shortest, longest))
    mantissas = series / 10.0 ** np.floor(np.log10(series) + 1e-9)
    assert set(mantissas.round(6)) <= {1.0, 2.0, 5.0}
    steps = series[1:] / series[:-1]
    assert ((steps > 1.99) & (steps < 2.51)).all()
    assert shortest <= series[0] < 2.51 * shortest
    assert longest <= series[-1]
    assert (series[:-1] < longest).all()


def noisy(mean, n=8, spread=1.0, seed=0):
    values = np.random.default_rng(seed).normal(size=n)
    return mean + spread * (values - values.mean())


def test_each_budget_has_its_best_and_no_limit_is_among_them(plugins, timed):
    rows = timed(seer=(0.001, 0.1), fast=(0.01, noisy(9)), slow=(0.15, noisy(5)), worse=(0.4, noisy(6)))
    found = summarise_budgets(rows)
    assert found["budget_s"].tolist() == [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]
    assert found["estimator"].tolist() == ["fast"] * 4 + ["slow"] * 2
    assert found["n_within"].tolist() == [1, 1, 1, 1, 2, 3]
    # The noise of a trial is shared: what is worse is so in every one.
    assert found["may_be_best"].map(json.loads).tolist() == [["fast"]] * 4 + [["slow"]] * 2
    # Three sets of estimators are asked about.
    assert found["level"].unique() == pytest.approx(0.05 / 3)


def test_a_budget_is_kept_by_the_upper_limit_of_the_time_not_by_its_median(timed):
    rows = timed(steady=(0.019, 5.0), erratic=([0.01] * 7 + [0.03], 4.0))
    found = summarise_budgets(rows)
    assert found["estimator"].tolist() == ["steady", "erratic"]
    few = summarise_budgets(timed(n_trials=2, steady=(0.019, 5.0), erratic=([0.01, 0.03], 4.0)))
    assert few["estimator"].tolist() == ["steady", "erratic"]


def test_what_is_not_told_from_the_best_is_named_the_fastest_first(timed):
    rows = timed(
        best=(0.03, noisy(5.0, seed=1)),
        close=(0.02, noisy(5.2, seed=2)),
        alike=(0.04, noisy(5.0, seed=1) + 0.04),
        worse=(0.01, noisy(9.0, spread=0.1, seed=3)),
    )
    last = summarise_budgets(rows).iloc[-1]
    assert last["estimator"] == "best"
    # `alike` is worse in every trial, by less than anybody would choose by.
    assert json.loads(last["may_be_best"]) == ["close", "best", "alike"]


def test_too_few_trials_tell_nothing_apart_and_the_title_says_so(timed):
    (grid,) = budget_grids(timed(n_trials=3, a=(0.01, 1.0), b=(0.01, 9.0)))
    assert grid.title == (
        "street, 10 dB: least mean deviation within a time, 3 trials, too few to tell any apart: 5 are needed"
    )
    assert grid.header[2:4] == ["deviation", "time [ms]"]
    assert grid.rows == [["10", "a", "1.00", "10", "2 of 2", "the best"]]
    (grid,) = budget_grids(timed(a=(0.01, 1.0), b=(0.01, 9.0)))
    assert grid.title.endswith("8 trials")
    assert grid.header[2:4] == ["deviation (95 %)", "time [ms] (95 %)"]
    assert grid.rows[0][-2:] == ["1 of 2", "the best"]


def test_one_trial_has_no_intervals(timed):
    (grid,) = budget_grids(timed(n_trials=1, a=(0.0123, 1.0)))
    assert grid.rows == [["20", "a", "1.00", "12.3", "1 of 1", "the best"]]


def test_failures_are_never_best_and_empty_images_are_told(timed):
    rows = timed(broken=(0.01, 1.0), hasty=(0.02, 2.0))
    rows.loc[rows.index[0], ["status", "deviation"]] = "error", np.nan
    rows.loc[rows["estimator"] == "hasty", "status"] = "no_detection"
    (grid,) = budget_grids(rows)
    assert [row[1] for row in grid.rows] == ["hasty (8 empty)"]
    assert budget_grids(rows[rows["estimator"] == "broken"]) == []


def test_each_scenario_and_snr_has_its_table(timed):
    rows = pd.concat(
        [timed(a=(0.01, 1.0)), timed(a=(0.01, 1.0), snr_db=-5.0), timed(a=(0.01, 1.0), scenario="b")]
    )
    assert [grid.title.partition(":")[0] for grid in budget_grids(rows)] == [
        "street, -5 dB",
        "street, 10 dB",
        "b, 10 dB",
    ]


def test_tables_of_budgets_are_written_where_times_count_and_go_where_they_do_not(timed, tmp_path):
    rows = timed(a=(0.01, 1.0), b=(0.3, 0.5))
    paths = write_run_tables(tmp_path, rows)
    assert [path.name for path in paths] == [
        "summary.csv",
        "summary.md",
        "stages.csv",
        "stages.md",
        "pareto.csv",
        "budgets.csv",
        "budgets.md",
    ]
    assert len(pd.read_csv(tmp_path / "pareto.csv")) == 2
    assert pd.read_csv(tmp_path / "budgets.csv")["label"].tolist() == ["a"] * 5 + ["b"]
    assert (tmp_path / "budgets.md").read_text(encoding="utf-8").startswith("**street, 10 dB")
    write_run_tables(tmp_path, rows.assign(timing=False))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["summary.csv", "summary.md"]


def test_what_is_printed_has_the_budgets_after_the_summary_in_lines_that_fit(timed):
    rows = timed(a=(0.01, 1.0), b=(0.3, 0.5))
    summary, *_, budgets = grids_of(rows)
    assert (
        summary.title == "street: mean of 8 trials, 95 % confidence band; median processor time of an image"
    )
    assert "least mean deviation within a time" in budgets.title
    assert max(map(len, printed(budgets))) <= 100
