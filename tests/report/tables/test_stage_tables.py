import numpy as np
import pandas as pd
import pytest

from isacbench.bench.cells.record import TIMING_COLUMNS
from isacbench.bench.studies.imaging_study import summarise_scores
from isacbench.report.tables.image_tables import score_grids
from isacbench.report.tables.stage_tables import is_timed, stage_grids, summarise_stages
from isacbench.report.tables.tables_by_kind import grids_of


@pytest.fixture
def records(made_run):
    """Rows of a made-up timed run: milliseconds in stages, the last estimator once in a hundred slower."""
    records, _ = made_run(("street", "yard"), ("blob", "nomp4d"), trials=3)
    trial = records["trial"].to_numpy()
    times = dict.fromkeys(TIMING_COLUMNS, 0.0) | {
        "time_estimate_s": 1e-3 * np.array([10, 12, 500])[trial],
        "time_detection_s": 1e-3 * np.array([2, 3, 4])[trial],
        "time_peaks_s": 1e-3 * np.array([8, 9, 400])[trial],
        "time_spread_s": 1e-4,
        "peak_memory_mib": 32.0,
    }
    hausdorff = [f"hausdorff_{what}_m" for what in ("xy", "xz", "yz", "sum")]
    others = dict.fromkeys([*hausdorff, "density", "velocity_nmse", "chamfer_m", "gospa_m", "precision"], 1.0)
    return records.assign(timing=True, **others, **times)


def test_a_row_has_the_median_times_of_an_estimator_and_leaves_stages_without_time_empty(records):
    street, yard = stage_grids(records)
    assert (
        street.title == "street: median processor time of an estimate and its stages [ms], peak memory [MiB]"
    )
    assert yard.title.startswith("yard: ")
    row = dict(zip(street.header, street.rows[0], strict=True))
    assert row == {
        "estimator": "blob",
        "cells": "9",
        "time": "12.00",
        "spread": "0.10",
        "rdm": "",
        "detection": "3.00",
        "subspace": "",
        "spectrum": "",
        "peaks": "9.00",
        "refinement": "",
        "memory": "32.0",
    }


def test_every_table_of_a_run_shows_the_same_median_time(records):
    records["time_estimate_s"] = np.arange(len(records)) ** 2 / 1e6
    records.loc[records["trial"] == 2, "timing"] = records["snr_db"] != records["snr_db"].iloc[0]
    (summary, _), (street, _) = score_grids(records), stage_grids(records)
    assert summary.rows[-1][1] == f"{float(street.rows[0][2]):.1f}"
    at_each_snr = summarise_scores(records)
    medians = summarise_stages(records).merge(at_each_snr, on=["scenario", "estimator", "params", "snr_db"])
    assert (medians["time_estimate_s_median_x"] == medians["time_estimate_s_median_y"]).all()


def test_failures_and_rows_whose_times_do_not_count_are_left_out(records):
    records.loc[records["trial"] == 2, "status"] = "error"
    records.loc[records["trial"] == 1, "timing"] = False
    records.loc[records["trial"] == 1, [*TIMING_COLUMNS]] = np.nan
    summary = summarise_stages(records)
    assert set(summary["n_timed"]) == {1}
    assert set(summary["time_estimate_s_median"]) == {0.01}
    assert len(summary) == 2 * 2 * 3


def test_the_spread_of_single_repeats_is_empty(records):
    records["time_spread_s"] = np.nan
    assert stage_grids(records)[0].rows[0][3] == ""


def test_an_estimator_that_failed_everywhere_has_no_row(records):
    records.loc[records["estimator"] == "nomp4d", "status"] = "timeout"
    assert [row[0] for row in stage_grids(records)[0].rows] == ["blob"]
    records["status"] = "killed"
    assert stage_grids(records) == []


def test_scenes_of_one_template_share_a_table(records):
    records["template"] = "room"
    (grid,) = stage_grids(records)
    assert grid.title.startswith("room: ")
    assert [row[1] for row in grid.rows] == ["18", "18"]


def test_tables_of_stages_are_written_and_shown_beside_the_others_where_a_run_was_timed(
    records, tables_written, tmp_path
):
    paths = tables_written(records)
    assert [path.name for path in paths][:4] == ["summary.csv", "summary.md", "stages.csv", "stages.md"]
    written = pd.read_csv(tmp_path / "stages.csv")
    pd.testing.assert_frame_equal(written, summarise_stages(records).reset_index(drop=True))
    assert (tmp_path / "stages.md").read_text().count("**street: median processor time of an estimate") == 1
    shown = score_grids(records) + stage_grids(records)
    assert grids_of(records)[: len(shown)] == shown


def test_a_run_that_was_not_timed_has_no_tables_of_stages(records, tables_written):
    ordinary = records.drop(columns=[*TIMING_COLUMNS]).assign(timing=False)
    assert not is_timed(ordinary)
    assert [path.name for path in tables_written(ordinary)] == ["summary.csv", "summary.md"]
    assert grids_of(ordinary) == score_grids(ordinary)


def test_of_many_scenarios_all_together_are_printed_and_each_is_a_detail(records):
    parts = [records.assign(scenario=f"town[seed={seed}]") for seed in range(13)]
    first, *others = stage_grids(pd.concat(parts, ignore_index=True))
    assert first.title.startswith("13 scenarios: median processor time")
    assert first.rows[0][:3] == ["blob", str(13 * 18), "12.00"]
    assert [grid.is_detail for grid in (first, *others)] == [False, *[True] * 13]
