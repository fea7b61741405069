import io
import math

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from isacbench.bench.runner import run
from isacbench.bench.suite import Suite
from isacbench.report.kinds import write_tables
from isacbench.report.tables import estimator_labels, grids, rich_table, summarise


@pytest.fixture
def records(plugins, tiny):
    suite = Suite(
        name="test",
        scenarios=[str(tiny)],
        estimators=["blob", "blob[n=5]", "trouble[kind=empty]", "trouble"],
        snr_db=[0, -10],
        trials=3,
    )
    return run(suite)


def test_means_and_student_bands_are_those_of_the_trials(records):
    summary = summarise(records)
    row = summary[(summary["estimator"] == "blob") & (summary["snr_db"] == 0)].iloc[0]
    part = records[(records["params"] == row["params"]) & (records["snr_db"] == 0)]
    values = part.loc[part["estimator"] == "blob", "deviation"]
    assert row["deviation_mean"] == pytest.approx(values.mean())
    assert row["deviation_band"] == pytest.approx(4.302653 * values.std() / math.sqrt(3), rel=1e-6)
    assert row["n_cells"] == 3


def test_the_hausdorff_sum_is_the_sum_of_its_three_components(records):
    summary = summarise(records)
    parts = summary[["hausdorff_xy_m_mean", "hausdorff_xz_m_mean", "hausdorff_yz_m_mean"]]
    np.testing.assert_allclose(summary["hausdorff_sum_m_mean"], parts.sum(axis=1, skipna=False))


def test_what_did_not_work_is_counted_and_failures_have_no_mean(records):
    summary = summarise(records)
    failed = summary[summary["n_failed"] > 0]
    assert failed["estimator"].tolist() == ["trouble", "trouble"]
    assert (failed["n_failed"] == 3).all()
    assert failed["deviation_mean"].isna().all()
    empty = summary[summary["n_no_detection"] > 0]
    assert (empty["n_no_detection"] == 3).all()
    assert empty["deviation_mean"].notna().all()


@pytest.mark.parametrize("failure", ["error", "timeout", "killed", "skipped"])
def test_a_failure_among_others_is_left_out_of_their_mean(records, failure):
    records = records.copy()
    first = records.index[(records["estimator"] == "blob") & (records["snr_db"] == 0)][0]
    records.loc[first, "status"] = failure
    records.loc[first, "deviation"] = np.nan
    summary = summarise(records)
    assert summary["n_failed"].max() == 3
    assert summary["deviation_mean"].notna().sum() == 6
    assert any("(1 failed)" in cell for row in grids(records)[0].rows for cell in row)


def test_one_trial_has_a_mean_and_no_band(records):
    summary = summarise(records[(records["trial"] == 0) & (records["estimator"] == "blob")])
    assert summary["deviation_mean"].notna().all()
    assert summary["deviation_band"].isna().all()


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
        "b[detector=osca]",
        "c[pfa=none]",
        "c[pfa=0.5]",
        "d[guard=(0,3),on=true]",
        "d[guard=(1),on=false]",
    ]


def test_the_grid_has_a_row_an_snr_in_order_and_the_time_last(records):
    (grid,) = grids(records)
    assert [row[0] for row in grid.rows] == ["-10", "0", "time [ms]"]
    assert all(len(row) == len(grid.header) for row in grid.rows)
    assert grid.header[1] == "blob[n=4]: deviation"
    assert grid.rows[0][-2] == "3 failed"


def test_brackets_survive_in_the_terminal(records):
    console = Console(width=300, record=True, file=io.StringIO())
    console.print(rich_table(grids(records)[0]))
    assert "blob[n=5]" in console.export_text()


def test_tables_are_written_and_replaced(records, tmp_path):
    paths = write_tables(tmp_path, records)
    assert [path.name for path in paths] == ["summary.csv", "summary.md"]
    assert len(pd.read_csv(paths[0])) == 8
    lines = paths[1].read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("**tiny")
    assert lines[2].startswith("| SNR [dB] | blob[n=4]: deviation |")
    assert write_tables(tmp_path, records) == paths
