"""Comparisons over scenes: the scene is the unit, with six of them or more."""

import copy
import json

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.compare.comparison import Tolerance, compare_tables
from isacbench.bench.compare.ranking import rank_table
from isacbench.bench.compare.significance import bootstrap_changes, signed_rank_test
from isacbench.bench.store.run import Run
from isacbench.report.comparison import ComparisonReport, comparison_junit, comparison_markdown

PAIR = ("fft4d", "music2d")


@pytest.fixture
def two_runs(scenes_run):
    """Return a function that makes up a run over scenes, and a second one with a change to its records."""

    def make(change=lambda records: None, **options):
        base = scenes_run(estimators=PAIR, **options)
        records = base.rows.copy()
        change(records)
        return base, Run("new", records, copy.deepcopy(base.manifest))

    return make


def worse(factor, spread=0.05, estimator="music2d"):
    def change(records):
        chosen = records["estimator"] == estimator
        records.loc[chosen, "deviation"] *= factor + np.random.default_rng(1).normal(0, spread, chosen.sum())

    return change


def test_a_curve_is_an_estimator_over_all_scenes_and_over_each_family_of_twenty(two_runs):
    found = compare_tables(*two_runs(worse(1.2), town=20, crowd=19, snr_db=(-10, 0, 10)))
    assert found.unit == "scene"
    curves = found.curves[["scenario", "estimator", "n_pairs", "verdict"]].to_numpy().tolist()
    assert sorted(curves) == [
        ["all scenes", "fft4d", 39, "same"],
        ["all scenes", "music2d", 39, "regression"],
        ["town scenes", "fft4d", 20, "same"],
        ["town scenes", "music2d", 20, "regression"],
    ]
    assert len(found.points) == 4 * 3


def test_tests_and_intervals_are_those_of_the_means_of_scenes(two_runs):
    base, new = two_runs(worse(1.05), town=8, trials=3)
    found = compare_tables(base, new)
    (row,) = found.curves[found.curves["estimator"] == "music2d"].to_dict("records")
    before, after = (
        run.rows[run.rows["estimator"] == "music2d"].groupby("scenario")["deviation"].mean().to_numpy()
        for run in (base, new)
    )
    assert row["change"] == pytest.approx((after - before).mean())
    test = signed_rank_test(after - before)
    assert row["p_worse"] == pytest.approx(min(test.greater, 1))  # the one curve that changed
    expected = bootstrap_changes(before[:, None], after[:, None])
    assert row["change_low"] == pytest.approx(expected["change_low"].iloc[0])
    assert row["win_probability"] == np.mean(after < before)
    assert row["win_low"] <= row["win_probability"] <= row["win_high"]


def test_more_trials_of_the_same_scenes_show_no_more(two_runs):
    base, new = two_runs(worse(1.05), town=8)
    many = [
        run.changed(rows=pd.concat([run.rows.assign(trial=k) for k in range(4)], ignore_index=True))
        for run in (base, new)
    ]
    once, again = compare_tables(base, new), compare_tables(*many)
    pd.testing.assert_frame_equal(once.curves, again.curves)
    pd.testing.assert_frame_equal(once.points, again.points)


def test_below_six_scenes_and_for_other_kinds_the_trial_is_the_unit(two_runs):
    found = compare_tables(*two_runs(worse(1.2), town=5, trials=8))
    assert found.unit == "trial"
    assert set(found.curves["scenario"]) == {f"town[seed={seed}]" for seed in range(5)}
    assert "win_probability" not in found.curves
    assert {"unit", "scenes"} & set(ComparisonReport(found).content()) == set()
    runs = two_runs(worse(1.2), town=8, trials=8)
    for run in runs:
        run.manifest["suite"]["kind"] = "resolution"
    assert compare_tables(*runs).unit == "trial"


def test_estimators_of_one_run_are_compared_over_scenes(scenes_run):
    run = scenes_run(town=9)
    partners = {("fft4d", "{}"): ("music2d", "{}")}
    found = compare_tables(run, run, partners=partners, is_between=True)
    (row,) = found.curves.to_dict("records")
    assert (row["scenario"], row["n_pairs"], row["verdict"]) == ("all scenes", 9, "regression")
    (table, *_) = ComparisonReport(found).tables()
    headings = [column.heading for column in table.columns]
    assert {"P(B better)", "scenes"} <= set(headings)
    assert "trials" not in headings


def test_the_first_lines_count_the_scenes_where_the_new_side_is_better_or_equal(two_runs):
    def change(records):
        chosen = records["estimator"] == "music2d"
        records.loc[chosen & records["scenario"].isin(["town[seed=1]", "town[seed=7]"]), "deviation"] *= 0.5
        records.loc[chosen & (records["scenario"] == "town[seed=2]"), "deviation"] *= 2

    unchanged, changed = ComparisonReport(compare_tables(*two_runs(change, town=8))).effect_lines()
    assert "+0 %, better on 0 of 8 scenes, equal on 8" in unchanged
    assert "better on 2 of 8 scenes, equal on 5" in changed


def test_the_ratio_that_rankings_go_by_is_compared_as_well(scenes_run):
    run = scenes_run(town=9, estimators=("fft4d", "music2d", "oracle"))
    partners = {("fft4d", "{}"): ("music2d", "{}")}
    found = compare_tables(run, run, [Tolerance("ratio", 0.05, True)], partners=partners, is_between=True)
    row = found.curves[found.curves["metric"] == "ratio"].squeeze()
    scores = rank_table(run, "ratio").scores
    assert row["base_mean"] == pytest.approx(scores[("fft4d", "{}")].mean())
    assert row["new_mean"] == pytest.approx(scores[("music2d", "{}")].mean())


def test_an_estimator_better_in_one_score_and_worse_in_another_is_told_as_both(scenes_run):
    def change(records):
        records.loc[records["estimator"] == "music2d", "deviation"] *= 3
        records.loc[records["estimator"] == "music2d", "precision"] = 1.0

    run = scenes_run(change, town=12)
    scores = [Tolerance("deviation", 0.05, True), Tolerance("precision", 0.05, True)]
    partners = {("fft4d", "{}"): ("music2d", "{}")}
    told = ComparisonReport(compare_tables(run, run, scores, partners=partners, is_between=True)).summary()
    assert told.startswith("music2d is worse than fft4d in one part and better in another: ")


def test_scenes_that_changed_most_are_listed_with_the_image_that_changed_most(two_runs):
    def change(records):
        chosen = (records["scenario"] == "town[seed=4]") & (records["snr_db"] == 10)
        records.loc[chosen & (records["estimator"] == "fft4d"), "deviation"] += 9

    found = compare_tables(*two_runs(change, town=8))
    (row,) = found.scenes.to_dict("records")
    assert (row["scenario"], row["family"], row["estimator"]) == ("town[seed=4]", "town", "fft4d")
    assert row["change"] == pytest.approx(4.5)  # the mean over two SNRs
    assert (row["snr_db"], row["trial"]) == (10, 0)
    assert "changed most: town[seed=4], fft4d" in comparison_junit(found)
    assert "8 scenes" in comparison_junit(found)
    assert "town[seed=4], fft4d" in comparison_markdown(found)
    assert ComparisonReport(found).lines()[0].startswith("the scene is the unit")
    content = json.loads(json.dumps(ComparisonReport(found).content(), allow_nan=False))
    assert content["unit"] == "scene"
    assert content["scenes"][0]["scenario"] == "town[seed=4]"


def test_equal_runs_are_the_same_and_the_figure_speaks_of_scenes(two_runs):
    found = compare_tables(*two_runs(town=8))
    assert set(found.curves["verdict"]) == {"same"}
    assert (found.curves["win_probability"] == 0.5).all()
    assert found.scenes.empty
    assert "mean of 8 scenes" in ComparisonReport(found).charts("deviation").title


def test_a_scene_that_one_side_lacks_is_left_out_and_a_failed_one_is_a_regression(two_runs):
    def fail(records):
        chosen = (records["scenario"] == "town[seed=1]") & (records["estimator"] == "fft4d")
        records.loc[chosen, "deviation"] = np.nan
        records.loc[chosen, "status"] = "timeout"

    found = compare_tables(*two_runs(fail, town=8))
    assert found.is_regression
    assert list(found.cells["change"]) == ["failed"] * 2
    assert found.curves.set_index("estimator")["n_pairs"].to_dict() == {"fft4d": 7, "music2d": 8}


@pytest.mark.slow
def test_two_estimators_that_are_equal_on_average_are_seldom_told_apart_however_many_trials(scenes_run):
    """Their difference is a property of the scene, which trials repeat: were trials the units, most runs
    would be regressions."""
    n_runs, alpha, n_false, n_held = 20, 0.1, 0, 0
    run = scenes_run(town=12, trials=5, estimators=PAIR, snr_db=(10,))
    partners = {("fft4d", "{}"): ("music2d", "{}")}
    names = run.rows["scenario"].unique()
    for seed in range(n_runs):
        rng = np.random.default_rng(seed)
        records = run.rows.copy()
        effects = pd.Series(rng.standard_t(4, len(names)), index=names)
        records["deviation"] = 10 + rng.normal(0, 0.1, len(records))
        of_second = records["estimator"] == "music2d"
        records.loc[of_second, "deviation"] += records["scenario"].map(effects)[of_second]
        made = run.changed(rows=records)
        exact = [Tolerance("deviation", 0.0, is_relative=False)]
        found = compare_tables(made, made, exact, alpha, partners, is_between=True)
        (row,) = found.curves.to_dict("records")
        n_false += row["verdict"] == "regression"
        n_held += row["change_low"] <= 0 <= row["change_high"]
    assert n_false <= alpha * n_runs + 3 * np.sqrt(alpha * (1 - alpha) * n_runs)
    assert n_held >= 0.95 * n_runs - 3 * np.sqrt(0.95 * 0.05 * n_runs)
