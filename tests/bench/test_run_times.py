"""Run time: stages, memory, and time against error."""

import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.rows import COLUMNS, TIMING_COLUMNS
from isacbench.bench.kinds.imaging import ImagingKind
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.scores import summarise_scores
from isacbench.bench.run_times import (
    FRONTIER,
    chart_snrs,
    is_timed,
    pareto_charts,
    pareto_frontier,
    stage_charts,
    stage_tables,
    summarise_points,
    summarise_stages,
    time_charts,
    timed_rows,
)

SCORES = ["density", "velocity_nmse", "chamfer_m", "gospa_m", "precision", "recall"]


def timed(n_trials=8, snr_db=10.0, scenario="street", params=None, **estimators):
    """Rows of a timed run: `timed(fast=(time_s, error_m), ...)`, a number or one a trial each."""
    parts = []
    for estimator, (time_s, error_m) in estimators.items():
        part = pd.DataFrame({"trial": range(n_trials), "time_estimate_s": time_s, "deviation": error_m})
        planes = {f"hausdorff_{plane}_m": part["deviation"] / 3 for plane in ("xy", "xz", "yz")}
        own = json.dumps((params or {}).get(estimator, {}))
        parts.append(
            part.assign(**planes, hausdorff_sum_m=part["deviation"], estimator=estimator, params=own)
        )
    rows = pd.concat(parts).sort_values("trial", kind="stable", ignore_index=True)
    rows = rows.assign(scenario=scenario, snr_db=snr_db, status="ok", reason="", n_estimated=10, timing=True)
    return rows.assign(**dict.fromkeys(SCORES, 0.5)).reindex(columns=[*COLUMNS, *TIMING_COLUMNS])


# Few values: ties are the rule.
alternatives = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=12)


def beats(one, other):
    return one[0] <= other[0] and one[1] <= other[1] and one != other


@given(alternatives)
def test_exactly_what_nothing_beats_is_on_the_frontier(points):
    times, errors = np.reshape(points, (-1, 2)).T
    found = pareto_frontier(times, errors)
    assert found.tolist() == [not any(beats(other, point) for other in points) for point in points]


def on_frontier(points):
    return points.loc[points["is_on_frontier"], "estimator"].tolist()


def test_a_point_has_the_mean_error_the_median_time_and_both_intervals():
    errors_m, times_s = np.arange(8.0), 0.01 * np.array([9, 2, 3, 4, 5, 6, 7, 80])
    rows = timed(a=(times_s, errors_m)).assign(peak_memory_mib=np.arange(8.0))
    (point,) = summarise_points(rows).to_dict("records")
    half = 2.364624 * errors_m.std(ddof=1) / 8**0.5
    ends = [point[f"hausdorff_sum_m_{end}"] for end in ("mean", "low", "high")]
    assert ends == pytest.approx([3.5, 3.5 - half, 3.5 + half], rel=1e-6)
    assert [point[f"time_{name}s"] for name in ("", "low_", "high_", "slowest_")] == [0.055, 0.02, 0.8, 0.8]
    assert point["peak_memory_mib"] == 3.5


def test_each_scenario_and_snr_has_a_frontier_of_its_own_without_the_limits():
    rows = pd.concat(
        [
            timed(oracle=(0.001, 0.1), fast=(0.01, 9.0), slow=(0.1, 5.0), bad=(0.2, 6.0)),
            timed(oracle=(0.001, 0.1), fast=(0.01, 4.0), slow=(0.1, 5.0), bad=(0.2, 3.0), snr_db=-10.0),
        ]
    )
    points = summarise_points(rows)
    assert points["snr_db"].tolist() == [-10.0] * 4 + [10.0] * 4
    assert on_frontier(points[points["snr_db"] == 10]) == ["fast", "slow"]
    assert on_frontier(points[points["snr_db"] == -10]) == ["fast", "bad"]
    assert points.loc[points["is_limit"], "estimator"].unique().tolist() == ["oracle"]


@pytest.mark.parametrize("status", ["error", "timeout", "killed", "skipped"])
def test_what_failed_in_a_trial_is_not_on_the_frontier_and_pushes_nobody_off(status):
    rows = timed(best=(0.01, 1.0), other=(0.02, 2.0))
    first = rows.index[rows["estimator"] == "best"][0]
    # A row that was lost before it could be timed does not say that it was.
    rows.loc[first, ["status", "timing", "hausdorff_sum_m"]] = status, False, np.nan
    points = summarise_points(rows)
    assert on_frontier(points) == ["other"]
    best = points.iloc[0]
    assert (best["n_trials"], best["n_failed"], best["hausdorff_sum_m_mean"]) == (8, 1, 1.0)
    assert not best["is_complete"]


def test_what_failed_throughout_has_no_numbers():
    rows = timed(broken=(0.01, 1.0), other=(0.02, 2.0))
    rows.loc[rows["estimator"] == "broken", ["status", "hausdorff_sum_m"]] = "error", np.nan
    points = summarise_points(rows)
    assert points["n_failed"].tolist() == [8, 0]
    assert points.iloc[0][["hausdorff_sum_m_mean", "time_s", "time_high_s", "time_slowest_s"]].isna().all()
    assert not summarise_points(rows.assign(status="error"))["is_on_frontier"].any()


def test_a_mean_over_fewer_trials_than_others_have_is_not_on_the_frontier():
    rows = timed(interrupted=(0.01, 1.0), other=(0.02, 0.5))
    assert on_frontier(summarise_points(rows.iloc[:-2])) == ["interrupted", "other"]
    without = rows.drop(rows.index[rows["estimator"] == "interrupted"][-1])
    assert on_frontier(summarise_points(without)) == ["other"]


def test_an_empty_image_counts_with_its_score_and_is_counted():
    rows = timed(hasty=(0.01, 80.0), other=(0.02, 2.0))
    rows.loc[rows["estimator"] == "hasty", "status"] = "no_detection"
    points = summarise_points(rows)
    assert on_frontier(points) == ["hasty", "other"]
    assert points["n_no_detection"].tolist() == [8, 0]


def test_one_trial_has_points_and_no_intervals():
    (point,) = summarise_points(timed(n_trials=1, a=(0.01, 1.0))).to_dict("records")
    assert (point["hausdorff_sum_m_mean"], point["time_s"], point["is_on_frontier"]) == (1.0, 0.01, True)
    assert np.isnan([point[name] for name in ("hausdorff_sum_m_low", "time_low_s")]).all()


def test_rows_whose_time_does_not_count_make_no_points():
    rows = timed(a=(0.01, 1.0), b=(0.02, 2.0))
    rows["timing"] = rows["estimator"] == "b"
    assert timed_rows(rows)["estimator"].unique().tolist() == ["b"]
    assert summarise_points(rows)["estimator"].tolist() == ["b"]
    assert timed_rows(rows.assign(timing=False)).empty
    # Failures of a run that timed nothing are none of a timed one.
    assert timed_rows(rows.assign(timing=False, status="error")).empty


def test_many_scenarios_are_trials_of_one_and_each_counts_once():
    parts = [
        timed(2, scenario=f"scene {k}", a=([0.01 * k, 0.03 * k], [k, k + 2.0]), b=(1.0, 50.0))
        for k in range(1, 14)
    ]
    rows = pd.concat(parts, ignore_index=True)
    failing = rows["estimator"].eq("b") & rows["scenario"].eq("scene 5") & rows["trial"].eq(0)
    rows.loc[failing, "status"] = "error"
    a, b = summarise_points(rows).to_dict("records")
    assert {a["scenario"], b["scenario"]} == {"13 scenarios as trials"}
    assert (a["n_trials"], a["n_failed"], b["n_failed"]) == (13, 0, 1)
    assert a["hausdorff_sum_m_mean"] == pytest.approx(8.0)
    assert a["time_s"] == pytest.approx(0.14)
    assert (a["is_on_frontier"], b["is_complete"]) == (True, False)


def chart_of(rows):
    """Chart of the only SNR: its x and y axes, and its series by label."""
    (chart,) = pareto_charts(summarise_points(rows), "stem", lines_of(rows)).charts
    return chart, {one.label: one for one in chart.series}


def test_a_point_is_drawn_with_both_its_intervals_over_a_logarithmic_time():
    rows = timed(a=(np.linspace(0.01, 0.02, 8), np.linspace(4, 6, 8)), b=(0.05, 3.0))
    chart, series = chart_of(rows)
    a, point = series["a"], summarise_points(rows).iloc[0]
    assert (a.x, a.y, a.mark) == ([pytest.approx(15.0)], [5.0], "points")
    assert (a.x_low, a.x_high) == ([1e3 * point["time_low_s"]], [1e3 * point["time_high_s"]])
    assert (a.low, a.high) == ([point["hausdorff_sum_m_low"]], [point["hausdorff_sum_m_high"]])
    assert chart.x.log


def test_the_frontier_goes_in_steps_from_the_fastest_to_the_edge_and_dominated_points_are_open():
    chart, series = chart_of(timed(a=(0.01, 5.0), b=(0.02, 4.0), beaten=(0.03, 4.5)))
    frontier = series[FRONTIER]
    assert (frontier.mark, frontier.x, frontier.y) == ("step", [10.0, 20.0, chart.x.limits[1]], [5, 4, 4])
    is_open = {label: one.style.symbol.endswith("-open") for label, one in series.items()}
    assert is_open == {"a": False, "b": False, "beaten": True, FRONTIER: False}


def test_references_are_level_lines_of_their_own_and_do_not_stretch_the_time():
    rows = [
        timed(oracle=(1e-6, np.linspace(0.9, 1.1, 8)), a=(0.01, 5.0)),
        timed(params={"oracle": {"cell": 0.5}}, oracle=(1e-6, 0.5)),
    ]
    chart, series = chart_of(pd.concat(rows))
    one, half = (series[f"oracle{cell} (truth merged in cells)"] for cell in ("", "[cell=0.5]"))
    assert (one.y, half.y) == ([pytest.approx(1.0)] * 2, [0.5] * 2)
    assert one.style.dash != half.style.dash
    assert one.low[0] < 1 < one.high[0]
    assert one.x == chart.x.limits == (1, 100)
    chart, series = chart_of(timed(oracle=(0.01, 1.0)))  # references alone
    assert series["oracle (truth merged in cells)"].x == chart.x.limits


def test_failures_are_crosses_and_what_has_no_score_is_said_in_the_legend():
    rows = timed(good=(0.01, 5.0), shaky=(0.02, 4.0), broken=(0.04, 2.0))
    rows.loc[rows.index[rows["estimator"] == "shaky"][:1], ["status", "hausdorff_sum_m"]] = "error", np.nan
    rows.loc[rows["estimator"] == "broken", ["status", "hausdorff_sum_m"]] = "timeout", np.nan
    _, series = chart_of(rows)
    assert list(series) == ["good", "shaky", "broken: no score", FRONTIER]
    assert series["shaky"].style.symbol == "x"
    assert len(series["broken: no score"].x) == 0


def test_a_run_in_which_all_failed_or_with_one_trial_is_drawn_and_without_times_none():
    for n_trials in (1, 8):
        rows = timed(n_trials, a=(0.01, 5.0))
        assert list(chart_of(rows)[1]) == ["a", FRONTIER]
        rows[["status", "hausdorff_sum_m"]] = "error", np.nan
        assert list(chart_of(rows)[1]) == ["a: no score"]
    assert time_charts(rows.assign(timing=False), lines_of(rows)) == []


def test_of_many_snrs_four_are_drawn_on_one_scale_the_lowest_and_the_highest_among_them():
    snrs_db = [-30.0, -20.0, -10.0, 0.0, 10.0, 20.0]
    rows = pd.concat([timed(a=(0.01, 5 - snr_db / 10), snr_db=snr_db) for snr_db in snrs_db])
    charts = pareto_charts(summarise_points(rows), "stem", lines_of(rows)).charts
    assert [chart.title for chart in charts] == ["-30 dB", "-10 dB", "0 dB", "20 dB"]
    assert all((chart.x, chart.y) == (charts[0].x, charts[0].y) for chart in charts)
    assert chart_snrs([5.0, 5.0, -5.0]) == [-5.0, 5.0]


def with_stages(rows):
    time_s = rows["time_estimate_s"]
    stages = {"time_rdm_s": 0.25 * time_s, "time_spectrum_s": 0.5 * time_s, "time_peaks_s": np.nan}
    return rows.assign(**stages, peak_memory_mib=12.0)


def stages_of(rows):
    return stage_charts(rows, summarise_points(rows), "stem", lines_of(rows))


def test_stages_are_shares_of_the_time_of_the_fastest_and_what_is_in_none_is_the_rest():
    estimators = {"a": (0.01, 5.0), "b": (0.02, 4.0), "beaten": (0.03, 4.5)}
    rows = with_stages(pd.concat([timed(**estimators, snr_db=snr_db) for snr_db in (0.0, 10.0)]))
    (group,) = stages_of(rows)
    assert [chart.title for chart in group.charts] == ["0 dB", "10 dB"]
    for chart in group.charts:
        assert list(chart.y.categories) == ["a: 10 ms, 12 MiB", "b: 20 ms, 12 MiB"]
        assert {one.label: [*one.x] for one in chart.series} == {
            "rdm": pytest.approx([25, 25]),
            "spectrum": pytest.approx([50, 50]),
            "none of these": pytest.approx([25, 25]),
        }
        assert all((one.mark, [*one.y]) == ("bar", [0, 1]) for one in chart.series)
    assert [one.stem for one in time_charts(rows, lines_of(rows))] == ["pareto-street", "stages-street"]
    assert stages_of(timed(**estimators)) == []  # no stage was timed
    assert stages_of(rows.assign(status="error", hausdorff_sum_m=np.nan)) == []


@pytest.fixture
def stage_rows():
    """Rows of two scenes at two SNRs: milliseconds in stages, one trial of three much slower."""
    scenes = [(name, snr_db) for name in ("street", "yard") for snr_db in (0.0, 10.0)]
    times = {"blob": ([0.010, 0.012, 0.5], 1.0), "nomp4d": ([0.010, 0.012, 0.5], 2.0)}
    rows = pd.concat([timed(3, snr_db, name, **times) for name, snr_db in scenes], ignore_index=True)
    trial = rows["trial"].to_numpy()
    stages = {"time_detection_s": np.array([2, 3, 4])[trial], "time_peaks_s": np.array([8, 9, 400])[trial]}
    others = dict.fromkeys(TIMING_COLUMNS, 0.0) | {"time_spread_s": 1e-4, "peak_memory_mib": 32.0}
    return rows.assign(**others | {name: 1e-3 * times_ms for name, times_ms in stages.items()})


def test_a_row_has_the_median_times_of_an_estimator_and_its_stages(stage_rows):
    street, yard = stage_tables(stage_rows)
    what = "median processor time of an estimate and its stages [ms], peak memory [MiB]"
    assert (street.title, yard.title) == (f"street: {what}", f"yard: {what}")
    row = dict(zip(street.headings, street.texts[0], strict=True))
    filled = {"estimator": "blob", "cells": "6", "estimate": "12.00", "spread": "0.10", "memory": "32.0"}
    filled |= {"detection": "3.00", "peaks": "9.00"}
    assert row == dict.fromkeys(["rdm", "subspace", "spectrum", "refinement"], "0.00") | filled
    stage_rows["time_spread_s"] = np.nan  # of single repeats
    assert stage_tables(stage_rows)[0].texts[0][3] == ""


def test_every_table_of_a_run_shows_the_same_median_time(stage_rows):
    stage_rows["time_estimate_s"] = np.arange(len(stage_rows)) ** 2 / 1e6
    stage_rows.loc[stage_rows["trial"] == 2, "timing"] = stage_rows["snr_db"] != 0
    (summary, _), (street, _) = ImagingKind().tables(stage_rows), stage_tables(stage_rows)
    assert summary.texts[-1][1] == f"{float(street.texts[0][2]):.1f}"
    at_each_snr = summarise_scores(stage_rows)
    keys = ["scenario", "estimator", "params", "snr_db"]
    medians = summarise_stages(stage_rows).merge(at_each_snr, on=keys)
    assert (medians["time_estimate_s_median_x"] == medians["time_estimate_s_median_y"]).all()


def test_failures_and_rows_whose_times_do_not_count_are_left_out_of_stages(stage_rows):
    stage_rows.loc[stage_rows["trial"] == 2, "status"] = "error"
    stage_rows.loc[stage_rows["trial"] == 1, "timing"] = False
    summary = summarise_stages(stage_rows)
    assert summary[["n_timed", "time_estimate_s_median"]].to_numpy().tolist() == [[1, 0.01]] * 2 * 2 * 2
    stage_rows.loc[stage_rows["estimator"] == "nomp4d", "status"] = "timeout"
    assert [row[0] for row in stage_tables(stage_rows)[0].texts] == ["blob"]
    stage_rows["status"] = "killed"
    assert stage_tables(stage_rows) == []
    assert is_timed(stage_rows)
    assert not is_timed(stage_rows.assign(timing=False))


def test_stages_of_many_scenarios_are_printed_together_and_each_is_a_detail(stage_rows):
    parts = [stage_rows.assign(scenario=f"town[seed={seed}]") for seed in range(13)]
    first, *others = stage_tables(pd.concat(parts, ignore_index=True))
    assert first.title.startswith("13 scenarios: median processor time")
    assert first.texts[0][:3] == ["blob", str(13 * 12), "12.00"]
    assert [table.is_detail for table in (first, *others)] == [False, *[True] * 13]
    (table,) = stage_tables(stage_rows.assign(template="room"))  # scenes of a template share one
    assert table.title.startswith("room: ")
    assert [row[1] for row in table.texts] == ["12", "12"]
