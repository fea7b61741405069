"""Figures of a run, all or chosen ones: which are drawn, of what, and into which files."""

import dataclasses
import json
import sys

import matplotlib
import numpy as np
import pandas as pd
import pytest

from isacbench.bench.kinds import imaging
from isacbench.bench.kinds.kind import lines_of
from isacbench.bench.kinds.population import PopulationSuite
from isacbench.bench.run.runner import run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError, InputWarning
from isacbench.metrics.one_to_one import Curve
from isacbench.model.scenes.scenario import load_scenario
from isacbench.report import clouds, diagnoses, figures, run_report
from isacbench.report.figures import new_figure
from isacbench.report.html import page_content
from isacbench.report.run_report import FigureChoice, draw_run, draw_with_page, radius_charts
from tests.report.html.conftest import known

ALL = ["deviation", "curves-tiny", "radii", "clouds-tiny"]


@pytest.fixture
def drawn(monkeypatch):
    """Draw nothing, and list the arguments of clouds and comparisons, and what is saved: names of files."""
    calls = {"clouds": [], "comparisons": [], "saved": []}
    monkeypatch.setattr(run_report, "draw_clouds", lambda *arguments: calls["clouds"].append(arguments))
    monkeypatch.setattr(run_report, "draw_comparison", lambda *one: calls["comparisons"].append(one))
    for module in (figures, diagnoses):
        monkeypatch.setattr(module, "draw_charts", lambda *_: None)
    monkeypatch.setattr(diagnoses, "draw_map", lambda *_: None)
    monkeypatch.setattr(figures, "save", lambda figure, path: calls["saved"].append(path.stem) or path)
    return calls


@pytest.fixture
def run_of(plugins, tiny, tmp_path):
    """Return a function that runs estimators on a small scenario, or on several."""

    def make(*estimators, name="run", n_scenarios=1, **changes):
        paths = [tiny, *(tiny.with_name(f"tiny{number}.toml") for number in range(1, n_scenarios))]
        for path in paths[1:]:
            path.write_text(tiny.read_text().replace('"tiny"', f'"{path.stem}"'))
        suite = {"scenarios": [*map(str, paths)], "snr_db": [0], "trials": 1, "estimators": estimators}
        return run_suite(Suite(name="test", **{**suite, **changes}), tmp_path / name)

    return make


def test_every_figure_of_a_run_is_written_where_it_is_said_to_be(run_of):
    run = run_of("blob", "seer", "trouble")
    paths = draw_run(run)
    assert paths == [run.folder / "figures" / f"{name}.png" for name in ALL]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert sorted((run.folder / "figures").iterdir()) == sorted(paths)


def test_figures_and_page_are_written_each_without_the_other_where_need_be(run_of, drawn, monkeypatch):
    run = run_of("blob")
    names = [f"{name}.png" for name in ALL]
    assert [path.name for path in draw_with_page(run, with_page=False)] == names
    assert not (run.folder / "report.html").exists()
    assert [path.name for path in draw_with_page(run)] == [*names, "report.html"]
    monkeypatch.setattr(page_content, "MOST_ROWS", 0)
    with pytest.warns(InputWarning, match="no page: .*1 rows are too many for a page; allowed are 0"):
        assert [path.name for path in draw_with_page(run)] == names


def test_a_run_of_failures_with_one_snr_and_one_trial_is_drawn(run_of, monkeypatch):
    monkeypatch.setattr(imaging, "SCORES", {"deviation": imaging.SCORES["deviation"]})
    assert len(draw_run(run_of("trouble", "trouble[kind=empty]", snr_db=[3]))) == 4


def test_times_are_drawn_where_they_count(run_of, drawn):
    run = run_of("blob")
    draw_run(run.changed(rows=run.rows.assign(timing=True, time_rdm_s=0.5 * run.rows["time_estimate_s"])))
    assert drawn["saved"] == [*ALL[:2], "pareto-tiny", "stages-tiny", *ALL[2:]]


def test_scores_over_the_radius_are_means_over_images_and_the_legend_has_the_area(run_of, monkeypatch):
    radius_m = np.array([0.1, 1.0, 4.0])
    curves = [Curve(radius_m, *(share * np.ones((3, 3)))) for share in (0.2, 0.6)]
    run = run_of("blob", "trouble", snr_db=[-10, 0], trials=1)
    rows = pd.concat([run.rows, run.rows], ignore_index=True)
    monkeypatch.setattr(run_report, "score_curve", lambda _: curves.pop())
    (group,) = radius_charts(run.changed(rows=rows, read_clouds=None), lines_of(rows))
    assert [chart.y.title for chart in group.charts] == ["F-score", "precision", "recall"]
    for chart in group.charts:
        (series,) = chart.series  # what failed has none
        np.testing.assert_allclose(series.x, radius_m)
        np.testing.assert_allclose(series.y, 0.4)
        assert series.label == "blob: area 0.40"
    assert group.title == "Points matched one to one within a radius, 0 dB, 1 scene"


def test_of_a_population_the_worst_scene_of_each_estimator_is_drawn(
    plugins, tiny, tmp_path, drawn, monkeypatch
):
    def load(name):
        family, _, _ = name.partition("[")
        return dataclasses.replace(load_scenario(tiny), name=name, family=family, family_version=1)

    monkeypatch.setattr("isacbench.bench.cells.plan.load_scenario", load)
    keys = {"scenarios": ["town[seed=1]", "town[seed=2,frame=paper]", "sparse[seed=3]"], "trials": 1}
    suite = PopulationSuite(name="p", version=1, estimators=["blob", "oracle"], snr_db=[0, 10], **keys)
    draw_run(run_suite(suite, tmp_path / "run"))
    assert drawn["saved"] == ["ratios", "scores", "targets-sparse", "radii", "worst-blob"]
    ((title, _, label, image, *_),) = drawn["comparisons"]
    assert title.endswith("at 10 dB: the worst ratio of 2 scenes")
    assert label == "blob"
    assert image.note.startswith("4 points, ")


def test_of_many_scenarios_only_their_mean_is_drawn_and_a_warning_says_so(run_of, drawn, monkeypatch):
    monkeypatch.setattr(run_report, "MANY_SCENARIOS", 1)
    monkeypatch.setattr(imaging, "MANY_SCENARIOS", 1)
    run = run_of("blob", "seer", n_scenarios=2)
    with pytest.warns(InputWarning, match="of more than 1 scenarios only means are drawn"):
        draw_run(run)
    assert drawn["saved"] == ["deviation", "radii"]
    with pytest.raises(InputError, match="2 scenarios are too many for figures of each; give --scenario"):
        draw_run(run, FigureChoice(trial=0))


def test_a_run_without_cells_draws_nothing(run_of):
    run = run_of("trouble[kind=interrupt]")
    assert run.manifest["interrupted"]
    assert draw_run(run) == []


def test_names_that_no_file_could_have_are_drawn_in_files_that_can_and_a_note_says_what_came_of_each_image(
    run_of, tiny, drawn
):
    tiny.write_text(tiny.read_text().replace('"tiny"', r'"../$a\n街 b"'), encoding="utf-8")
    draw_run(run_of("blob", "trouble", "trouble[kind=empty]"))
    assert drawn["saved"] == ["deviation", "curves-a-b", "radii", "clouds-a-b"]
    title, _, _, _, panels, n_columns = drawn["clouds"][0]
    assert (title, n_columns) == ("../\\$a\ufffd\ufffd b, trial 0", 4)
    notes = [image.note for _, image in panels]
    assert notes[1].startswith("4 points, Hausdorff sum ")
    assert notes[2:] == ["error", "nothing detected"]


def snrs_of(call):
    return [heading for heading, _ in call[4] if heading.endswith("truth")]


def labels_of(call):
    return [heading for heading, _ in call[4][1 : call[5]]]


def test_clouds_show_the_snrs_nearest_to_the_papers_none_twice_whether_installed_or_not(
    plugins, run_of, drawn, monkeypatch
):
    draw_run(run_of("blob", snr_db=[-30, -8, -7, 20]))
    assert snrs_of(drawn["clouds"][0]) == [f"SNR {snr_db} dB: truth" for snr_db in (-30, -7, 20)]
    other = run_of("blob", name="other", snr_db=[-7])
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place != str(plugins.path)])
    draw_run(Run.open(other.folder))
    assert snrs_of(drawn["clouds"][1]) == ["SNR -7 dB: truth"]
    assert labels_of(drawn["clouds"][1]) == ["blob"]


def test_clouds_leave_out_what_sees_the_truth_and_go_on_in_another_figure(run_of, drawn):
    many = [f"blob[n={n}]" for n in range(5, 11)]
    draw_run(run_of("seer", *many))
    assert [labels_of(call) for call in drawn["clouds"]] == [many[:4], many[4:]]
    assert drawn["saved"][-2:] == ["clouds-tiny-1", "clouds-tiny-2"]
    draw_run(run_of("seer", name="limit"))
    assert labels_of(drawn["clouds"][-1]) == ["seer (sees the truth)"]


def test_of_very_many_estimators_the_best_have_their_clouds_drawn_and_the_title_says_so(
    run_of, drawn, monkeypatch
):
    monkeypatch.setattr(clouds, "MOST_CLOUDS", 2)
    run = run_of("blob[n=1]", "trouble", "blob[n=3]", "blob[n=2]", trials=2)
    draw_run(run)
    (call,) = drawn["clouds"]
    assert call[0] == "tiny, the 2 of 4 estimators with the least mean deviation, trial 0"
    worst = json.loads(run.rows.groupby("params")["deviation"].mean().idxmax())["n"]
    assert labels_of(call) == [f"blob[n={n}]" for n in (1, 3, 2) if n != worst]


def test_the_users_own_matplotlib_settings_come_back(run_of, monkeypatch):
    for module, name in ((figures, "draw_charts"), (run_report, "draw_clouds")):
        monkeypatch.setattr(module, name, lambda *_: new_figure(1, 1))
    run = run_of("blob")
    with matplotlib.rc_context({"text.usetex": True, "font.size": 30.0}):
        draw_run(run)
        assert matplotlib.rcParams["text.usetex"]
        assert matplotlib.rcParams["font.size"] == 30.0


def test_a_score_is_drawn_for_the_chosen_scenario_in_the_chosen_format(run_of):
    run = run_of("blob", "seer", n_scenarios=2)
    (path,) = draw_run(run, FigureChoice(scenario="tiny1", metric="gospa_m"), "svg")
    assert path.name == "gospa_m-tiny1.svg"
    assert path.read_text().startswith("<?xml")


CHOICES = {
    FigureChoice(snr_db=10.0, trial=1): [
        "clouds-tiny-10dB-trial1",
        "rdm-tiny-showing-deed-spectra-10dB-trial1",
        "spectrum-tiny-showing-deed-spectra-10dB-trial1",
    ],
    FigureChoice(scenario="tiny"): ["curves-tiny", "clouds-tiny-trial0"],
    FigureChoice(metric="recall"): ["recall-tiny"],
    FigureChoice(): ALL,
}


def test_what_is_chosen_is_drawn_and_nothing_else(run_of, drawn):
    with known():
        run = run_of("blob", "showing[deed=spectra]", snr_db=[0, 10], trials=2)
        for choice, names in CHOICES.items():
            drawn["saved"].clear()
            draw_run(run, choice)
            assert drawn["saved"] == names


def test_a_diagnosis_that_fails_costs_its_own_figures_and_of_many_estimators_the_best_are_diagnosed(
    run_of, drawn, monkeypatch
):
    with known():
        run = run_of("showing[deed=raise]", "showing[deed=spectra]", "showing")
        with pytest.warns(InputWarning, match=r"showing\[deed=raise\]: ZeroDivisionError: no luck"):
            draw_run(run, FigureChoice(snr_db=0.0))
        names = "rdm-tiny-showing-deed-spectra", "spectrum-tiny-showing-deed-spectra", "rdm-tiny-showing"
        assert drawn["saved"][1:] == [f"{name}-0dB-trial0" for name in names]
        monkeypatch.setattr(clouds, "MOST_CLOUDS", 1)
        run.rows.loc[run.rows["params"].str.contains("infinity"), "deviation"] = 0.0
        draw_run(run, FigureChoice(trial=0))
    assert drawn["saved"][5:] == ["rdm-tiny-showing-0dB-trial0"]


def test_what_a_run_has_not_is_refused_with_what_is_allowed(run_of):
    run = run_of("blob", snr_db=[0, 10], trials=2)
    for choice, message in (
        (FigureChoice(scenario="tyni"), "unknown scenario 'tyni': .*tiny"),
        (FigureChoice(snr_db=3.0), "unknown SNR in dB '3': .*0, 10"),
        (FigureChoice(trial=7), "unknown trial '7': .*0, 1"),
        (FigureChoice(metric="gopsa_m"), "did you mean 'gospa_m'"),
    ):
        with pytest.raises(InputError, match=message):
            draw_run(run, choice)
