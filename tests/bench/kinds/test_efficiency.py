import math

import numpy as np
import pandas as pd
import pytest

from isacbench.bench.kinds.efficiency import EfficiencyKind, measure_efficiency
from isacbench.bench.run.runner import run, run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import draw_place, radio_places, rayleigh_cells

PLACE = np.array([70.0, 3.0, 0.1, -0.05])
ERRORS = ["error_range_m", "error_velocity_mps", "error_u", "error_w"]
BOUNDS = ["bound_range_m", "bound_velocity_mps", "bound_u", "bound_w"]


@pytest.fixture
def suite(plugins, room_file):
    return Suite(
        kind="efficiency",
        name="test",
        scenarios=[str(room_file)],
        estimators=["seer", "blob"],
        snr_gain_db=[20, 30],
        trials=3,
    )


def test_the_error_is_that_of_the_nearest_point_and_the_others_are_false(room, put, shoot):
    cells = rayleigh_cells(room)
    shifts = np.array([[0.3, -0.2, 0.1, 0.4], [0.5, 0.5, 0.5, 0.5], [0.0, 0.0, 1.5, 0.0]])
    measured = measure_efficiency(shoot(put(room, PLACE), PLACE + shifts * cells))
    assert measured["hit"]
    assert measured["n_false"] == 2
    np.testing.assert_allclose([measured[name] for name in ERRORS], shifts[0] * cells, atol=1e-9)
    empty = measure_efficiency(shoot(put(room, PLACE), np.empty((0, 4))))
    assert (empty["hit"], empty["n_false"]) == (False, 0)


@pytest.mark.parametrize("index", range(4))
def test_a_point_beyond_one_rayleigh_cell_in_any_dimension_is_a_miss_and_false(room, put, shoot, index):
    for cells, hit in ((0.98, True), (1.02, False)):
        place = PLACE.copy()
        place[index] += cells * rayleigh_cells(room)[index]
        measured = measure_efficiency(shoot(put(room, PLACE), place))
        assert measured["hit"] == hit
        assert measured["n_false"] == (not hit)
        assert ("error_u" in measured) == hit


def test_bounds_are_those_of_single_tones_in_rayleigh_cells(room, put, shoot):
    snr_db = -20.0
    measured = measure_efficiency(shoot(put(room, PLACE), PLACE, snr_db))
    gained = 10 ** (snr_db / 10) * 255 * 127 * 81
    for name, n, cell in zip(BOUNDS, (255, 127, 9, 9), rayleigh_cells(room), strict=True):
        expected = cell * math.sqrt(3 / (2 * math.pi**2 * gained * (1 - 1 / n**2)))
        assert measured[name] == pytest.approx(expected)


def test_one_place_a_trial_for_every_snr_and_estimator_and_it_is_stored(suite, room):
    results = run_suite(suite)
    places = [draw_place(room, trial, 0, 0.5) for trial in range(3)]
    assert results.draws["trial"].tolist() == [0, 1, 2]
    seer = [(key, cloud) for key, cloud in results.clouds.items() if key.estimator == "seer"]
    assert len(seer) == 3 * 2
    for key, cloud in seer:
        drawn = results.draws.iloc[key.trial]
        assert cloud.to_array()[0, :4].tolist() == drawn[["x", "y", "z", "v"]].tolist()
    again = run_suite(suite.replace(estimators=["blob"], snr_db=[0.0], trials=2))
    pd.testing.assert_frame_equal(again.draws, results.draws.iloc[:2])
    stored = PointCloud.from_array(results.draws.loc[[0], ["x", "y", "z", "v"]])
    np.testing.assert_allclose(radio_places(room, stored)[0], places[0])


def test_rows_have_the_snr_per_element_and_after_gain(suite, records):
    gain = 10 * math.log10(255 * 127 * 81)
    assert sorted(records["snr_gain_db"].unique()) == [20, 30]
    np.testing.assert_allclose(records["snr_gain_db"] - records["snr_db"], gain, atol=1e-5)


def test_who_sees_the_truth_hits_without_error(records):
    seen = records[records["estimator"] == "seer"]
    assert seen["hit"].all()
    assert (seen[ERRORS].abs() < 1e-9).all(axis=None)
    assert (seen["n_false"] == 0).all()


def test_a_failure_is_neither_a_hit_nor_a_miss(suite):
    records = run(
        suite.replace(estimators=["seer", "trouble", "trouble[kind=empty]"], snr_gain_db=[20, 25.25])
    )
    summary = EfficiencyKind().summary(records).set_index(["params", "snr_gain_db"])
    assert summary["n_trials"].tolist() == [3] * 6
    assert summary.xs('{"kind":"raise"}')["n_failed"].tolist() == [3, 3]
    assert summary.xs('{"kind":"raise"}')["n_misses"].tolist() == [0, 0]
    assert summary.xs('{"kind":"empty"}')["n_misses"].tolist() == [3, 3]
    assert summary.loc[summary["n_failed"] + summary["n_misses"] == 3, "ratio_u"].isna().all()
    # Every estimator has a table, with the median times of cells that did not fail.
    records["time_estimate_s"] = np.random.default_rng(0).permutation(len(records)) ** 2 / 1e3
    seer, failed, empty = EfficiencyKind().tables(records)
    trials = "3 trials, no confidence band below 5; median processor time (not measured alone)"
    assert seer.title == f"room, seer: error over Cramér-Rao bound, {trials}"
    times_ms = 1e3 * records[records["estimator"] == "seer"].groupby("snr_db")["time_estimate_s"].median()
    assert [row[-1] for row in seer.texts] == [f"{time_ms:.1f}" for time_ms in times_ms]
    assert [row[:3] for row in seer.texts] == [["20", "0.000", "0"], ["25.25", "0.000", "0"]]
    assert failed.texts[0][1:] == ["0.000 (3 failed)", "0", *5 * [""]]
    assert empty.texts[0][1] == "1.000"


def test_the_summary_takes_errors_of_hits_alone():
    rows = {
        **{"scenario": "s", "estimator": "e", "params": "{}", "snr_db": -60.0, "snr_gain_db": 20.0},
        **{"status": ["ok", "ok", "no_detection", "timeout"], "hit": [True, True, False, False]},
        **{"n_false": [0, 2, 0, 0], "timing": False, "time_estimate_s": [0.1, 0.2, 0.3, 0.4]},
        **{name: [3.0, -4.0, math.nan, math.nan] for name in ERRORS},
        **{name: [2.0, 2.0, 2.0, math.nan] for name in BOUNDS},
    }
    (row,) = EfficiencyKind().summary(pd.DataFrame(rows)).to_dict("records")
    assert row["ratio_u"] == pytest.approx(math.sqrt(12.5) / 2)
    assert row["rmse_range_m"] == pytest.approx(math.sqrt(12.5))
    counts = [row[name] for name in ("n_trials", "n_failed", "n_misses", "n_false")]
    assert (row["bound_w"], counts, row["time_estimate_s_median"]) == (2.0, [4, 1, 1, 2], 0.2)


SNRS_DB = [0.0, 20.0, 40.0]


@pytest.fixture
def made():
    """Summary of two estimators at three SNRs, out of order: a is twice the bound, b is never found."""
    parts = []
    for name, ratio, n_misses in (("a", 2.0, 0), ("b", np.nan, 10)):
        part = pd.DataFrame({"scenario": "room", "estimator": name, "params": "{}", "snr_gain_db": SNRS_DB})
        bound = 10 ** (-part["snr_gain_db"] / 20)
        columns = {"n_trials": 10, "n_failed": 0, "n_misses": n_misses, "n_false": 5}
        for bound_name, dimension in zip(BOUNDS, ("range", "velocity", "u", "w"), strict=True):
            columns |= {bound_name: bound, bound_name.replace("bound", "rmse"): ratio * bound}
            ends = {"": ratio, "_low": 0.9 * ratio, "_high": 1.2 * ratio}
            columns |= {f"ratio_{dimension}{end}": value for end, value in ends.items()}
        parts.append(part.assign(**columns))
    return pd.concat(parts).iloc[::-1].reset_index(drop=True)


@pytest.fixture
def charts_of(of_summary):
    """Return a function that draws a summary: charts and their series by title, and the title of all."""

    def draw(made):
        (group,) = of_summary(EfficiencyKind).charts(made)
        return {chart.title: (chart, *chart.series) for chart in group.charts}, group.title

    return draw


def test_errors_bound_ratio_and_misses_are_drawn_over_snr_a_chart_a_dimension(made, charts_of):
    charts, title = charts_of(made)
    errors, lost, found, bound = charts["Range"]
    assert (errors.y.log, errors.y.title) == (True, "root mean square error [m]")
    assert (bound.label, list(bound.x)) == ("Cramér-Rao bound", SNRS_DB)
    np.testing.assert_allclose(bound.y, [1, 0.1, 0.01])
    np.testing.assert_allclose(found.y, [2, 0.2, 0.02])
    np.testing.assert_allclose(found.low, 0.9 * found.y)
    assert (found.label, lost.label) == ("a", "b: no score")
    above, _, ratio = charts["Range: error over the bound"]
    assert (above.lines, list(ratio.y), list(ratio.high)) == ([1.0], [2] * 3, pytest.approx([2.4] * 3))
    assert [list(one.y) for one in charts["Missed"][1:]] == [[1] * 3, [0] * 3]
    assert [list(one.y) for one in charts["False points"][1:]] == [[0.5] * 3] * 2
    names = ["Range", "Velocity", "Direction cosine u", "Direction cosine w", "Missed"]
    assert list(charts)[:5] == names
    assert [charts[name][0].y.title[22:] for name in names[1:4]] == [" [m/s]", "", ""]
    assert title == "room: one scatterer, errors where it was found; 10 trials, 95 % confidence band"


def test_a_single_hit_among_trials_is_no_measurement_and_few_trials_have_no_band(made, charts_of):
    made["n_misses"] = [9, 7, 0] * 2  # SNRs descend: 40, 20 and 0 dB
    ratio = charts_of(made)[0]["Range: error over the bound"][2]
    np.testing.assert_allclose(ratio.y, [2, 2, np.nan])
    np.testing.assert_allclose(ratio.low, [1.8, 1.8, np.nan])
    _, title = charts_of(made.assign(n_trials=3))
    assert title.endswith("; 3 trials, no confidence band below 5")


@pytest.mark.slow
def test_an_efficient_estimate_of_range_meets_the_bound_on_the_built_in_scenario():
    records = run("efficiency", estimators=["fft4d"], snr_db=[-45.7], trials=100)
    (row,) = EfficiencyKind().summary(records).to_dict("records")
    assert row["n_misses"] == 0
    assert row["ratio_range_low"] < 1.05
    assert row["ratio_range_high"] > 0.95
    assert all(row[f"ratio_{name}_high"] > 0.95 for name in ("velocity", "u", "w"))
