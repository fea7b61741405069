import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.kinds.resolution import ResolutionKind, ResolutionSuite, measure_resolution, pair
from isacbench.bench.run.runner import run, run_suite
from isacbench.errors import InputError, InputWarning
from isacbench.model.cloud import PointCloud
from isacbench.model.echo import resource_grid
from isacbench.model.radio_coordinates import DIMENSIONS, draw_place, radio_places, rayleigh_cells
from isacbench.model.scene import Scatterers

CENTRE = np.array([70.0, 3.0, 0.1, -0.05])


@pytest.fixture
def suite(plugins, room_file):
    return ResolutionSuite(
        name="test",
        scenarios=[str(room_file)],
        estimators=["seer", "blob"],
        dimensions=["range", "u"],
        separations_cells=[0.5, 1],
        phases_deg=[0, 180],
        snr_gain_db=[60],
        trials=2,
    )


@given(
    dimension=st.sampled_from(DIMENSIONS),
    separation=st.floats(0.05, 2),
    phase_deg=st.floats(-180, 180),
)
def test_the_two_echoes_have_the_wanted_phase_between_them_at_the_centre_of_the_aperture(
    room, dimension, separation, phase_deg
):
    scenario = pair(room, "pair", CENTRE, dimension, separation, phase_deg)
    both = scenario.scatterers
    centre = []
    for index in ([0], [1]):
        one = Scatterers(both.xyz[index], both.velocity[index], both.amplitude[index], both.phase_rad[index])
        centre.append(resource_grid(dataclasses.replace(scenario, scatterers=one), [(4, 4)])[127, 63, 0])
    np.testing.assert_allclose(centre[1] / centre[0], np.exp(1j * math.radians(phase_deg)), atol=1e-7)


def test_scenes_of_a_template_do_not_repeat_its_warnings(suite, room):
    stray = Scatterers(np.array([[-1.0, 0.0, 0.0]]), np.zeros(1), np.ones(1))
    with pytest.warns(InputWarning, match="outside the region"):
        template = dataclasses.replace(room, scatterers=stray)
    assert len(ResolutionKind().tasks(suite, {"room": template})) == 8


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_a_pair_differs_in_one_dimension_alone_around_its_centre(room, dimension):
    places = radio_places(room, pair(room, "pair", CENTRE, dimension, 0.7, 90.0).scatterers)
    difference = np.zeros(4)
    difference[DIMENSIONS.index(dimension)] = 0.7
    np.testing.assert_allclose((places[1] - places[0]) / rayleigh_cells(room), difference, atol=1e-9)
    np.testing.assert_allclose(places.mean(axis=0), CENTRE, atol=1e-9)


def image(room, shoot, shifts, dimension="u", separation=0.5):
    """Measure an image whose points lie at shifts, in cells, from the centre of a pair."""
    scenario = pair(room, "pair", CENTRE, dimension, separation, 0.0)
    return measure_resolution(dimension, shoot(scenario, CENTRE + np.array(shifts) * rayleigh_cells(room)))


def test_a_pair_is_found_where_each_has_a_point_within_half_their_distance(room, shoot):
    assert image(room, shoot, [[0, 0, -0.45, 0], [0, 0, 0.05, 0]]) == {"resolved": True, "n_false": 0}
    assert image(room, shoot, [[0.9, -0.9, -0.25, 0.9], [-0.9, 0.9, 0.25, 0]])["resolved"]


@pytest.mark.parametrize(
    ("shifts", "n_false"),
    [
        ([[0, 0, -0.25, 0]], 0),  # one of them
        ([[0, 0, -0.3, 0], [0, 0, -0.2, 0]], 1),  # both on one side
        ([[0, 0, -0.25, 0], [0, 0, 0.52, 0]], 1),  # too far out
        ([[0, 0, -0.25, 0], [0, 0, 0.25, 1.1]], 1),  # too far off in another dimension
        (np.empty((0, 4)), 0),
    ],
)
def test_a_pair_is_not_found(room, shoot, shifts, n_false):
    assert image(room, shoot, shifts) == {"resolved": False, "n_false": n_false}


def test_there_is_a_scene_for_every_dimension_distance_and_phase_with_a_name_of_its_own(records):
    assert len(records) == 2 * 2 * 2 * 2 * 2
    assert records["scenario"].nunique() == 8
    assert "room-u-0.5-180deg" in set(records["scenario"])
    keys = ["template", "dimension", "separation_cells", "phase_deg"]
    assert len(records[["scenario", *keys]].drop_duplicates()) == 8
    assert set(records["snr_gain_db"]) == {60}


def test_all_scenes_of_a_trial_have_one_centre(suite, room):
    draws = run_suite(suite.replace(estimators=["blob"])).draws
    assert draws["phase_rad"].abs().max() > 0
    for (_, trial), part in draws.groupby(["scenario", "trial"]):
        places = radio_places(room, PointCloud.from_array(part[["x", "y", "z", "v"]]))
        np.testing.assert_allclose(places.mean(axis=0), draw_place(room, trial, 0, 1.0), atol=1e-9)


def test_who_sees_the_truth_finds_every_pair(records):
    assert records.groupby("estimator")["resolved"].mean().to_dict() == {"seer": 1.0, "blob": 0.0}


def test_the_summary_has_the_mean_over_phases_the_worst_and_the_one_in_phase():
    key = {"template": "t", "estimator": "e", "params": "{}", "snr_gain_db": 60.0, "dimension": "u"}
    rows = pd.DataFrame(
        {
            **{**key, "separation_cells": 0.25, "n_false": 1, "timing": False, "time_estimate_s": 0.1},
            "phase_deg": [0.0, 0.0, 90.0, 90.0, 180.0, 180.0],
            "resolved": [True, False, False, False, True, True],
            "status": ["ok", "ok", "timeout", "timeout", "ok", "ok"],
            "trial": [0, 1] * 3,
        }
    )
    (row,) = ResolutionKind().summary(rows).to_dict("records")
    assert row["resolved"] == row["resolved_in_phase"] == 0.5
    assert (row["resolved_worst"], row["worst_phase_deg"]) == (0.0, 90.0)
    assert [row[name] for name in ("n_cells", "n_trials", "n_failed", "n_false")] == [6, 2, 2, 6]
    assert math.isnan(row["resolved_low"])
    often = pd.concat([rows.assign(trial=trial) for trial in range(5)])
    (row,) = ResolutionKind().summary(often).to_dict("records")
    assert row["resolved_low"] < 0.5 < row["resolved_high"]


def test_a_table_has_a_row_a_dimension_and_distance_and_a_column_an_estimator(suite):
    estimators = ["seer", "blob", "trouble", *(f"blob[n={n}]" for n in (1, 2, 3))]
    records = run(suite.replace(estimators=estimators, dimensions=["velocity", "w"]))
    records["time_estimate_s"] = np.random.default_rng(0).permutation(len(records)) ** 2 / 1e3
    (first,) = ResolutionKind().tables(records)
    rows = [["velocity", "0.5"], ["velocity", "1"], ["w", "0.5"], ["w", "1"], ["time [ms]", ""]]
    assert [row[:2] for row in first.texts] == rows
    assert first.texts[0][2:5] == ["1.00 / 1.00", "0.00 / 0.00", "0.00 / 0.00 (4 failed)"]
    assert len(first.headings) == 2 + 6
    seer_ms = 1e3 * records[records["estimator"] == "seer"]["time_estimate_s"].median()
    assert first.texts[-1][2] == f"{seer_ms:.1f}"


def test_shares_are_drawn_over_distance_and_dashed_where_in_phase(of_summary):
    rows = {"template": "room", "estimator": "a", "params": "{}", "dimension": "u", "n_trials": 5}
    shares = {"resolved": [1.0, 0.2, 0.6], "resolved_low": 0.0, "resolved_high": 1.0}
    made = pd.DataFrame(
        {**rows, **shares, "separation_cells": [1.0, 0.1, 0.5], "resolved_in_phase": [0.9, 0.0, 0.3]}
    )
    (group,) = of_summary(ResolutionKind).charts(made.assign(snr_gain_db=60.0))
    (chart,) = group.charts
    mean, in_phase = chart.series
    assert (list(mean.x), list(mean.y)) == ([0.1, 0.5, 1.0], [0.2, 0.6, 1.0])
    assert (list(mean.high), list(in_phase.y)) == ([1, 1, 1], [0.0, 0.3, 0.9])
    assert (in_phase.label, mean.style.dash, in_phase.style.dash) == ("a, in phase", "solid", "dash")
    assert mean.style.colour == in_phase.style.colour
    (without,) = of_summary(ResolutionKind).charts(made.assign(snr_gain_db=60.0, resolved_in_phase=np.nan))
    assert [one.label for one in without.charts[0].series] == ["a"]
    assert (group.stem, chart.title, chart.x.log) == ("resolution-room", "Direction cosine u", True)
    several = pd.concat([made.assign(snr_gain_db=snr_db) for snr_db in (60.0, 70.0)])
    stems = [one.stem for one in of_summary(ResolutionKind).charts(several)]
    assert stems == ["resolution-room-60dB", "resolution-room-70dB"]


def test_a_region_too_small_for_the_farthest_pair_is_refused_before_anything_runs(suite, tmp_path):
    with pytest.raises(InputError, match="must be at least 5 Rayleigh cells from every border"):
        run(suite.replace(separations_cells=[0.1, 9]), out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
