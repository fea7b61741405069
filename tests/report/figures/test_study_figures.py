import numpy as np
import pandas as pd
import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.suites.detection_kind import DetectionSuite
from isacbench.bench.suites.resolution_kind import ResolutionSuite
from isacbench.bench.suites.suite import Suite
from isacbench.report.drawing.style import assign_looks
from isacbench.report.figures import run_figures
from isacbench.report.figures.run_figures import draw_run
from isacbench.report.figures.study_figures import (
    draw_detection,
    draw_efficiency,
    draw_maps,
    draw_resolution,
    draw_roc,
)

LOOKS = assign_looks({("a", "{}"): "a", ("b", "{}"): "b"}, bounds=())
SNRS = [0.0, 20.0, 40.0]


def efficiency_summary():
    """Two estimators at three SNRs: a is twice the bound, b is never found."""
    parts = []
    for name, ratio in (("a", 2.0), ("b", np.nan)):
        part = pd.DataFrame({"scenario": "room", "estimator": name, "params": "{}", "snr_gain_db": SNRS})
        bound = 10 ** (-part["snr_gain_db"] / 20)
        columns = {"n_trials": 10, "n_failed": 0, "n_misses": 0 if name == "a" else 10, "n_false": 5}
        for dimension, unit in (("range", "range_m"), ("velocity", "velocity_mps"), ("u", "u"), ("w", "w")):
            columns |= {f"rmse_{unit}": ratio * bound, f"bound_{unit}": bound}
            columns |= {f"ratio_{dimension}": ratio, f"ratio_{dimension}_low": 0.9 * ratio}
            columns |= {f"ratio_{dimension}_high": 1.2 * ratio}
        parts.append(part.assign(**columns))
    # Out of order, as a merged run is.
    return pd.concat(parts).iloc[::-1].reset_index(drop=True)


def test_errors_bound_ratio_and_misses_are_drawn_in_order_of_snr_a_panel_a_dimension():
    figure = draw_efficiency(efficiency_summary(), "room", LOOKS)
    errors, ratio, missed = figure.axes[0], figure.axes[5], figure.axes[4]
    bound, found, lost = errors.lines
    assert errors.get_yscale() == "log"
    np.testing.assert_allclose(bound.get_xydata(), np.column_stack([SNRS, [1, 0.1, 0.01]]))
    np.testing.assert_allclose(found.get_ydata(), [2, 0.2, 0.02])
    assert np.isnan(lost.get_ydata()).all()
    np.testing.assert_allclose(ratio.lines[1].get_ydata(), 2)
    band = errors.collections[0].get_paths()[0].vertices
    assert {1.8, 2.4} <= set(np.round(band[band[:, 0] == 0, 1], 6))
    assert [line.get_ydata()[0] for line in missed.lines] == [0, 1]
    assert [line.get_ydata()[0] for line in figure.axes[9].lines] == [0.5, 0.5]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b", "Cramér-Rao bound"]
    assert [axes.get_title() for axes in figure.axes[:4]] == [
        "Range",
        "Velocity",
        "Direction cosine u",
        "Direction cosine w",
    ]
    assert [axes.get_ylabel() for axes in figure.axes[:3]] == [
        "root mean square error [m]",
        "root mean square error [m/s]",
        "root mean square error",
    ]


def test_a_single_hit_among_trials_is_no_measurement_and_few_hits_have_no_band():
    summary = efficiency_summary().assign(n_misses=[9, 7, 0] * 2)  # SNRs descend: 40, 20 and 0 dB
    few = summary["snr_gain_db"] > 0
    summary.loc[few, [name for name in summary if name.endswith(("_low", "_high"))]] = np.nan
    ratio = draw_efficiency(summary, "room", LOOKS).axes[5]
    np.testing.assert_allclose(ratio.lines[1].get_ydata(), [2, 2, np.nan])
    assert {x for path in ratio.collections[0].get_paths() for x, _ in path.vertices} == {0.0}


def test_the_title_says_that_few_trials_have_no_band():
    title = draw_efficiency(efficiency_summary().assign(n_trials=3), "room", LOOKS).get_suptitle()
    assert title == "room: one scatterer, errors where it was found; 3 trials, no confidence band below 5"


def test_probabilities_of_resolution_are_drawn_over_distance_and_dashed_where_in_phase():
    rows = {"template": "room", "estimator": "a", "params": "{}", "snr_gain_db": 60.0, "dimension": "u"}
    summary = pd.DataFrame({**rows, "separation_cells": [1.0, 0.1, 0.5], "resolved": [1.0, 0.2, 0.6]})
    summary = summary.assign(
        resolved_low=0.0, resolved_high=1.0, resolved_in_phase=[0.9, 0.0, 0.3], n_trials=5
    )
    (axes,) = draw_resolution(summary, LOOKS).axes
    mean, in_phase = axes.lines[:2]
    np.testing.assert_allclose(mean.get_xydata(), [[0.1, 0.2], [0.5, 0.6], [1.0, 1.0]])
    np.testing.assert_allclose(in_phase.get_ydata(), [0.0, 0.3, 0.9])
    assert (mean.get_linestyle(), in_phase.get_linestyle()) == ("-", "--")
    assert axes.get_xscale() == "log"
    assert list(axes.get_xticks()) == [0.1, 0.5, 1.0]


def detection_summary(scenarios, estimator=None):
    """Two detectors at three SNRs whose P_d grows with the SNR; no false alarm at the first."""
    rows = [
        {
            "scenario": scenario,
            "estimator": estimator or detector,
            "params": f'{{"detector":"{detector}","pfa":{pfa}}}',
            "detector": detector,
            "pfa": pfa,
            "snr_db": snr_db - 50,
            "snr_gain_db": snr_db,
            "n_cells": 8,
            "pd": snr_db / 40,
            "pd_low": 0.0,
            "pd_high": 1.0,
            "n_clear": 1000,
            "pfa_measured": pfa if snr_db else 0.0,
            "pfa_measured_low": 0.0,
            "pfa_measured_high": 2 * pfa,
            "deviation_mean": 5.0,
            "deviation_band": 1.0,
        }
        for scenario in scenarios
        for detector in ("ca", "os")
        for pfa in ([1e-2, 1e-3] if estimator is None else [1e-3])
        for snr_db in SNRS
    ]
    return pd.DataFrame(rows).iloc[::-1].reset_index(drop=True)


def test_maps_have_a_column_each_and_no_false_alarm_is_drawn_below_one():
    figure = draw_maps(detection_summary(["homogeneous", "clutter-edge"]))
    assert len(figure.axes) == 4
    detected, false = figure.axes[0], figure.axes[2]
    np.testing.assert_allclose(detected.lines[0].get_xydata(), np.column_stack([SNRS, [0, 0.5, 1]]))
    np.testing.assert_allclose(false.lines[0].get_ydata(), [1e-4, 1e-3, 1e-3])
    assert len(detected.lines) == 2 + 1  # the last one in closed form
    assert false.get_ylim() == figure.axes[3].get_ylim()


def test_the_roc_has_a_row_an_snr_and_a_point_a_nominal_rate():
    figure = draw_roc(detection_summary(["homogeneous"]))
    assert [axes.get_title() for axes in figure.axes] == ["homogeneous, 0 dB", "homogeneous, 20 dB"]
    np.testing.assert_allclose(figure.axes[1].lines[0].get_xydata(), [[1e-3, 0.5], [1e-2, 0.5]])
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim()


def test_deviation_detection_and_false_alarms_of_a_scenario_stand_side_by_side():
    figure = draw_detection(detection_summary(["street"], estimator="music2d"))
    deviation, detected, _ = figure.axes
    np.testing.assert_allclose(deviation.lines[0].get_xydata()[:, 0], [-50, -30, -10])
    assert len(detected.lines) == 2
    assert "music2d behind each detector" in figure.get_suptitle()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["os", "ca", "nominal P_fa"]


SMALL = {"name": "test", "scenarios": ["room.toml"], "estimators": ["seer"], "snr_gain_db": [20], "trials": 1}


@pytest.mark.parametrize(
    ("make", "changes", "names"),
    [
        (Suite, {"kind": "efficiency", "estimators": ["seer", "trouble"]}, ["efficiency-room"]),
        (
            ResolutionSuite,
            {"separations_cells": [1], "snr_gain_db": [60, 70], "dimensions": ["u"]},
            ["resolution-room-60dB", "resolution-room-70dB"],
        ),
        (
            DetectionSuite,
            {
                "scenarios": ["tiny.toml"],
                "estimators": ["blob"],
                "detectors": ["ca", "level"],
                "maps": ["homogeneous"],
            },
            ["maps", "roc", "detection-tiny"],
        ),
    ],
)
def test_figures_of_a_stored_study_are_written_where_they_are_said_to_be(
    plugins, room_file, tiny, tmp_path, monkeypatch, all_axes_named, make, changes, names
):
    monkeypatch.chdir(tmp_path)
    run_suite(make(**{**SMALL, **changes}), out=tmp_path / "run")
    paths = draw_run(Run.open(tmp_path / "run"))
    assert [path.relative_to(tmp_path / "run").as_posix() for path in paths] == [
        f"figures/{name}.png" for name in names
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert len(all_axes_named) == len(names)


def test_detection_without_maps_has_the_figure_of_its_scenario_alone(plugins, tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(run_figures, "save", lambda _, path: path)
    suite = {"scenarios": [str(tiny)], "estimators": ["blob"], "detectors": ["ca"], "maps": []}
    run_suite(DetectionSuite(**{**SMALL, **suite}), out=tmp_path / "run")
    assert [path.stem for path in draw_run(Run.open(tmp_path / "run"))] == ["detection-tiny"]
