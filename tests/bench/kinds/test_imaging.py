"""Scores of images: means of trials and of scenarios, their tables and charts."""

import math
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.kinds.imaging import IN_TABLES, ImagingKind, deviation_charts, score_charts
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.scores import SCORES, average_scenarios, score_of, summarise_scores
from isacbench.bench.statistics import deviation_columns
from isacbench.bench.suites.suite import Suite
from isacbench.charts import SHARE_LIMITS, assign_lines
from isacbench.model.scenes.scenario import load_scenario

N_TRIALS = 5
KIND = ImagingKind()


@pytest.fixture
def suite(plugins, tiny):
    estimators = ["blob", "blob[n=5]", "trouble[kind=empty]", "trouble"]
    return Suite(name="test", scenarios=[str(tiny)], estimators=estimators, snr_db=[0, -10], trials=N_TRIALS)


def test_means_and_student_bands_are_those_of_the_trials(records):
    summary = summarise_scores(records)
    row = summary[(summary["estimator"] == "blob") & (summary["snr_db"] == 0)].iloc[0]
    part = records[(records["params"] == row["params"]) & (records["snr_db"] == 0)]
    values = part.loc[part["estimator"] == "blob", "deviation"]
    assert row["deviation_mean"] == pytest.approx(values.mean())
    assert row["deviation_band"] == pytest.approx(2.776445 * values.std() / math.sqrt(5), rel=1e-6)
    assert row["n_cells"] == N_TRIALS
    parts = summary[["hausdorff_xy_m_mean", "hausdorff_xz_m_mean", "hausdorff_yz_m_mean"]]
    np.testing.assert_allclose(summary["hausdorff_sum_m_mean"], parts.sum(axis=1, skipna=False))


def test_what_did_not_work_is_counted_and_failures_have_no_mean(records):
    summary = summarise_scores(records)
    failed, empty = summary[summary["n_failed"] > 0], summary[summary["n_no_detection"] > 0]
    assert set(failed["estimator"]) == {"trouble"}
    assert set(failed["n_failed"]) == set(empty["n_no_detection"]) == {N_TRIALS}
    assert failed["deviation_mean"].isna().all()
    assert empty["deviation_mean"].notna().all()


@pytest.mark.parametrize("failure", ["error", "timeout", "killed"])
def test_a_failure_among_others_is_left_out_of_their_mean(records, failure):
    blob = records[records["estimator"] == "blob"].copy()
    blob.loc[blob.index[blob["snr_db"] == 0][0], ["status", "deviation"]] = failure, np.nan
    summary = summarise_scores(blob)
    assert sorted(summary["n_failed"]) == [0, 0, 0, 1]
    assert summary["deviation_mean"].notna().all()
    assert any("(1 failed)" in text for row in KIND.tables(blob)[0].texts for text in row)


def test_fewer_than_five_trials_have_a_mean_and_no_band_and_titles_say_so(records):
    few = records[(records["trial"] < 4) & (records["estimator"] == "blob")]
    summary = summarise_scores(few)
    assert summary["deviation_mean"].notna().all()
    assert summary["deviation_band"].isna().all()
    (table,) = KIND.tables(few)
    times = "median processor time (not measured alone) of an image"
    assert table.title == f"tiny: mean of 4 trials, no confidence band below 5; {times}"
    assert not any("±" in text for row in table.texts for text in row)
    assert KIND.charts(few)[0].title.endswith(": mean of 4 trials, no confidence band below 5")


def test_a_table_has_a_row_an_snr_in_order_and_the_time_last(records):
    records = records.assign(time_estimate_s=np.arange(len(records)) ** 2 / 1e3)
    (table,) = KIND.tables(records)
    assert [row[0] for row in table.texts] == ["-10", "0", "time [ms]"]
    _, second, _, failed = np.reshape(np.array(table.texts)[:, 1:], (3, 4, -1)).swapaxes(0, 1)
    assert [row[0] for row in failed] == [f"{N_TRIALS} failed"] * 2 + [""]
    assert not any(failed[:, 1:].ravel())
    # The time is the median of cells that did not fail, whatever their SNR.
    times_s = records[records["params"].str.contains('"n":5')]["time_estimate_s"]
    assert second[-1][0] == f"{1e3 * times_s.median():.1f}"


def test_further_scores_follow_the_deviation_and_columns_that_a_kind_adds_follow_them(records):
    class Counting(ImagingKind):
        columns: ClassVar = {"n_things": 0, "share": math.nan}

    records = records.assign(n_things=105, share=0.5)
    records.loc[records["status"] == "error", ["n_things", "share"]] = 0, math.nan
    (table,) = Counting().tables(records[records["params"].str.contains('"n":5')])
    shown = [*IN_TABLES, *Counting.columns]
    assert table.headings[1:] == ["blob[n=5]: deviation", *(score_of(name).name for name in shown)]
    row = dict(zip(table.headings, table.texts[1], strict=True))
    summary = Counting().summary(records)
    mean = summary.query("estimator == 'blob' and snr_db == 0").iloc[1]
    expected = {"GOSPA skill": "{:.2f}", "recall": "{:.2f}", "velocity NMSE": "{:.1e}"}
    names = {one.name: name for name, one in SCORES.items()}
    assert {one: row[one] for one in expected} == {
        one: form.format(mean[f"{names[one]}_mean"]) for one, form in expected.items()
    }
    assert (row["n_things"], row["share"]) == ("105", "0.5")
    assert summary.loc[summary["n_failed"] > 0, ["n_things_mean", "share_mean"]].isna().all(axis=None)


@pytest.fixture
def many(population_rows):
    """Rows of thirteen scenarios, one estimator with an error that rises with the scenario."""
    return population_rows(["town"], n_scenes=13, a=np.arange(13.0), b=1.0)


def test_scenarios_count_once_each_in_their_mean_however_many_trials_they_have(many):
    errors = np.arange(13.0)
    again = many[many["scenario"] == "town[seed=12]"]
    found = average_scenarios(pd.concat([many, again.assign(trial=1), again.assign(trial=2)]))
    assert found["scenario"].unique().tolist() == ["13 scenarios"]
    row = found[(found["estimator"] == "a") & (found["snr_db"] == 10)].iloc[0]
    assert (row["deviation_mean"], row["deviation_band"]) == pytest.approx(
        tuple(deviation_columns(pd.DataFrame({"deviation": errors})).values())
    )
    assert row["hausdorff_sum_m_mean"] == pytest.approx(errors.mean())
    assert (row["n_cells"], row["n_failed"]) == (15, 0)
    assert {*found} == {*summarise_scores(many)}


def test_of_many_scenarios_their_mean_is_printed_and_drawn_and_each_is_a_detail(many):
    first, *others = KIND.tables(many)
    assert first.title.startswith("mean over 13 scenarios, 95 % confidence band;")
    assert not first.is_detail
    assert first.texts[0][1] == "6.00 ±2.35"
    assert len(others) == 13
    assert all(table.is_detail for table in others)
    (group,) = KIND.charts(many)
    assert [chart.title for chart in group.charts] == ["13 scenarios"]
    assert list(group.charts[0].series[0].y) == [6, 6]
    few = KIND.tables(many[many["scenario"] != "town[seed=12]"])
    assert len(few) == 12
    assert not any(table.is_detail for table in few)


LINES = assign_lines({("a", "{}"): "a", ("limit", "{}"): "limit"}, ["limit"])


def summary_of(scenario="street", half=0.5, **means):
    """Summary whose scores all have the mean `means[estimator]` at three SNRs, out of order."""
    parts = []
    for estimator, mean in means.items():
        part = pd.DataFrame({"scenario": scenario, "estimator": estimator, "params": "{}"}, range(3))
        scores = {f"{score}_mean": mean for score in SCORES} | {f"{score}_band": half for score in SCORES}
        parts.append(part.assign(snr_db=[-10.0, 0.0, 10.0], n_cells=10, **scores))
    return pd.concat(parts).iloc[::-1].reset_index(drop=True)


def test_every_score_has_a_chart_whose_axis_names_it_with_its_unit_and_shares_go_from_0_to_1(tiny):
    scenario = load_scenario(tiny)
    group = score_charts(summary_of(a=0.1, limit=0.2), list(SCORES), "stem", LINES, scenario)
    charts = dict(zip(SCORES, group.charts, strict=True))
    assert len({chart.y.title for chart in group.charts}) == len(SCORES)
    assert all(chart.y.title.endswith(" [m]") == score.endswith("_m") for score, chart in charts.items())
    assert charts["precision"].y.limits == charts["recall"].y.limits == SHARE_LIMITS
    assert [score for score, chart in charts.items() if chart.y.log] == ["velocity_nmse"]
    assert {chart.x.title for chart in group.charts} == {"SNR [dB]"}
    assert group.title.startswith("street: mean of 10 trials, 95 % confidence band\n")
    assert "a median scatterer after all gains: SNR +" in group.title


def test_velocity_errors_that_are_practically_zero_do_not_stretch_the_axis():
    part = summary_of(a=[3e-2, 2e-3, 0.0], limit=0.0)
    (chart,) = score_charts(part, ["velocity_nmse"], "stem", LINES, None).charts
    assert chart.y.limits == pytest.approx((1e-3, 0.1))


def test_deviations_of_all_scenarios_stand_side_by_side_on_one_scale():
    summary = pd.concat([summary_of("one", a=4.0, limit=1.0), summary_of("two", a=8.0)])
    one, two = deviation_charts(summary, LINES, "note").charts
    assert (one.title, two.title) == ("one", "two")
    assert one.y == two.y
    assert [len(chart.series) for chart in (one, two)] == [2, 1]


def test_charts_of_a_run_are_the_deviation_and_all_scores_of_each_scenario(records):
    deviation, curves = KIND.charts(records)
    assert (deviation.stem, curves.stem) == ("deviation", "curves-tiny")
    labels = [line.label for line in lines_of(records).values()]
    assert [one.label for one in deviation.charts[0].series] == [*labels[:-1], f"{labels[-1]}: no score"]
    titles = {chart.y.title for chart in curves.charts}
    assert {"imaging deviation", "F-score", "GOSPA skill", "recall"} <= titles
