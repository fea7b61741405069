import math

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.run.runner import run
from isacbench.bench.studies.imaging_study import average_scenarios, summarise_scores
from isacbench.bench.studies.intervals import mean_band
from isacbench.bench.suites.suite import Suite
from isacbench.report.tables.image_tables import SHOWN, score_grids
from tests.report.tables.printed import printed

N_TRIALS = 5
N_SCORES = 1 + len(SHOWN)


@pytest.fixture(scope="module")
def made():
    """Rows of the run, once it was made."""
    return []


@pytest.fixture
def records(plugins, tiny, made):
    suite = Suite(
        name="test",
        scenarios=[str(tiny)],
        estimators=["blob", "blob[n=5]", "trouble[kind=empty]", "trouble"],
        snr_db=[0, -10],
        trials=N_TRIALS,
    )
    if not made:
        made.append(run(suite))
    return made[0].copy()


def test_means_and_student_bands_are_those_of_the_trials(records):
    summary = summarise_scores(records)
    row = summary[(summary["estimator"] == "blob") & (summary["snr_db"] == 0)].iloc[0]
    part = records[(records["params"] == row["params"]) & (records["snr_db"] == 0)]
    values = part.loc[part["estimator"] == "blob", "deviation"]
    assert row["deviation_mean"] == pytest.approx(values.mean())
    assert row["deviation_band"] == pytest.approx(2.776445 * values.std() / math.sqrt(5), rel=1e-6)
    assert row["n_cells"] == N_TRIALS


def test_the_hausdorff_sum_is_the_sum_of_its_three_components(records):
    summary = summarise_scores(records)
    parts = summary[["hausdorff_xy_m_mean", "hausdorff_xz_m_mean", "hausdorff_yz_m_mean"]]
    np.testing.assert_allclose(summary["hausdorff_sum_m_mean"], parts.sum(axis=1, skipna=False))


def test_what_did_not_work_is_counted_and_failures_have_no_mean(records):
    summary = summarise_scores(records)
    failed = summary[summary["n_failed"] > 0]
    assert failed["estimator"].tolist() == ["trouble", "trouble"]
    assert (failed["n_failed"] == N_TRIALS).all()
    assert failed["deviation_mean"].isna().all()
    empty = summary[summary["n_no_detection"] > 0]
    assert (empty["n_no_detection"] == N_TRIALS).all()
    assert empty["deviation_mean"].notna().all()


def test_a_failure_among_others_is_left_out_of_their_mean(records):
    blob = records[records["estimator"] == "blob"].copy()
    first = blob.index[blob["snr_db"] == 0][0]
    for failure in ("error", "timeout", "killed", "skipped"):
        blob.loc[first, ["status", "deviation"]] = failure, np.nan
        summary = summarise_scores(blob)
        assert sorted(summary["n_failed"]) == [0, 0, 0, 1], failure
        assert summary["deviation_mean"].notna().all(), failure
        assert any("(1 failed)" in cell for row in score_grids(blob)[0].rows for cell in row), failure


def test_fewer_than_five_trials_have_a_mean_and_no_band_and_the_title_says_so(records):
    few = records[(records["trial"] < 4) & (records["estimator"] == "blob")]
    summary = summarise_scores(few)
    assert summary["deviation_mean"].notna().all()
    assert summary["deviation_band"].isna().all()
    (grid,) = score_grids(few)
    times = "median processor time (not measured alone) of an image"
    assert grid.title == f"tiny: mean of 4 trials, no confidence band below 5; {times}"
    assert not any("±" in cell for row in grid.rows for cell in row)


def test_labels_show_only_the_parameters_in_which_variants_differ():
    variants = [
        ("a", '{"n":1,"pfa":null}'),
        ("b", '{"detector":{"name":"ca","pfa":0.1},"n":1}'),
        ("b", '{"detector":{"name":"ca","pfa":0.2},"n":1}'),
        ("b", '{"detector":{"k":1,"name":"osca"},"n":1}'),
        ("c", '{"pfa":null}'),
        ("c", '{"pfa":0.5}'),
        ("d", '{"guard":[0,3],"on":true}'),
        ("d", '{"guard":[1],"on":false}'),
    ]
    assert list(estimator_labels(variants).values()) == [
        "a",
        "b[detector=ca[pfa=0.1]]",
        "b[detector=ca[pfa=0.2]]",
        "b[detector=osca[k=1]]",
        "c[pfa=none]",
        "c[pfa=0.5]",
        "d[guard=(0,3),on=true]",
        "d[guard=(1),on=false]",
    ]


def test_the_grid_has_a_row_an_snr_in_order_and_the_time_last(records):
    (grid,) = score_grids(records)
    assert [row[0] for row in grid.rows] == ["-10", "0", "time [ms]"]
    assert all(len(row) == len(grid.header) for row in grid.rows)
    assert grid.header[1] == "blob[n=4]: deviation"
    assert grid.rows[0][-N_SCORES] == f"{N_TRIALS} failed"


def test_the_time_is_the_median_of_cells_that_did_not_fail_whatever_their_snr(records):
    records = records.assign(time_estimate_s=np.arange(len(records)) ** 2 / 1e3)
    times_s = records[records["params"].str.contains('"n":5')]["time_estimate_s"]
    (grid,) = score_grids(records)
    assert grid.rows[-1][1 + N_SCORES] == f"{1e3 * times_s.median():.1f}"
    assert grid.rows[-1][-N_SCORES:] == [""] * N_SCORES


def test_further_scores_are_in_the_file_and_in_a_terminal_as_far_as_100_columns_hold(records):
    (four,), (two,) = score_grids(records), score_grids(records[records["estimator"] == "blob"])
    (one,) = score_grids(records[records["params"].str.contains('"n":5')])
    assert four.header[1:6] == ["blob[n=4]: deviation", "Hausdorff [m]", "F-score", "objects", "GOSPA skill"]
    shown = [
        [name for name in ("objects", "GOSPA", "precision", "recall") if name in "".join(printed(grid))]
        for grid in (four, two, one)
    ]
    assert shown == [[], ["objects"], ["objects", "GOSPA", "precision", "recall"]]
    assert max(map(len, printed(two))) <= 100
    row = dict(zip(one.header, one.rows[1], strict=True))
    mean = summarise_scores(records).query("estimator == 'blob' and snr_db == 0").iloc[1]
    spatial = mean["deviation_mean"] - mean["velocity_nmse_mean"]
    assert (row["spatial"], row["kinematic"]) == (f"{spatial:.2f}", f"{mean['velocity_nmse_mean']:.1e}")
    assert (row["GOSPA skill"], row["recall"]) == (
        f"{mean['gospa_skill_mean']:.2f}",
        f"{mean['recall_mean']:.2f}",
    )


def test_brackets_survive_in_the_terminal(records):
    assert "blob[n=5]" in "".join(printed(score_grids(records)[0]))


def test_tables_are_written_and_replaced(records, tables_written):
    paths = tables_written(records)
    assert [path.name for path in paths] == ["summary.csv", "summary.md"]
    assert len(pd.read_csv(paths[0])) == 8
    lines = paths[1].read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("**tiny")
    assert lines[2].startswith("| SNR [dB] | blob[n=4]: deviation |")
    assert f"**{2 * N_TRIALS} of {8 * N_TRIALS} cells failed**" in lines
    reason = "ZeroDivisionError: no luck (test_plugins.py, line 68, in estimate)"
    assert f"| {reason} | error | trouble[kind=raise] | tiny | 10 |" in lines
    assert tables_written(records) == paths


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
    assert (row["deviation_mean"], row["deviation_band"]) == pytest.approx(mean_band(errors))
    assert row["hausdorff_sum_m_mean"] == pytest.approx(errors.mean())
    assert (row["n_cells"], row["n_failed"]) == (15, 0)
    assert {*found} == {*summarise_scores(many)}


def test_of_many_scenarios_their_mean_is_printed_and_each_is_a_detail(many):
    first, *others = score_grids(many)
    assert first.title.startswith("mean over 13 scenarios, 95 % confidence band;")
    assert not first.is_detail
    assert first.rows[0][1] == "6.00 ±2.35"
    assert len(others) == 13
    assert all(grid.is_detail for grid in others)
    few = score_grids(many[many["scenario"] != "town[seed=12]"])
    assert len(few) == 12
    assert not any(grid.is_detail for grid in few)
