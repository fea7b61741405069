import json
import sys

import matplotlib
import pytest

from isacbench.bench.run.runner import run, run_suite
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.report.drawing.style import new_figure
from isacbench.report.figures import curves, run_figures
from isacbench.report.figures.run_figures import draw_run


@pytest.fixture
def drawn(monkeypatch):
    """Record what is drawn, and draw nothing: stems to the arguments of the drawing function."""
    calls = {"clouds": [], "saved": []}
    monkeypatch.setattr(run_figures, "draw_clouds", lambda *arguments: calls["clouds"].append(arguments))
    for name in ("draw_scores", "draw_deviations"):
        monkeypatch.setattr(run_figures, name, lambda *_: None)
    monkeypatch.setattr(run_figures, "save", lambda figure, path: calls["saved"].append(path.stem) or path)
    return calls


def run_into(folder, tiny, estimators, snr_db=(0, 10), trials=2):
    run(
        Suite(name="test", scenarios=[str(tiny)], estimators=estimators, snr_db=snr_db, trials=trials),
        out=folder,
    )
    return folder


def test_every_figure_of_a_run_is_written_where_it_is_said_to_be_with_named_axes(
    plugins, tiny, tmp_path, all_axes_named
):
    folder = run_into(tmp_path / "run", tiny, ["blob", "seer", "trouble"], snr_db=[0])
    paths = draw_run(Run.open(folder))
    assert [path.relative_to(folder).as_posix() for path in paths] == [
        "figures/deviation.png",
        "figures/curves-tiny.png",
        "figures/radii.png",
        "figures/clouds-tiny.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    assert sorted((folder / "figures").iterdir()) == sorted(paths)
    assert len(all_axes_named) == len(paths)


def test_a_run_of_failures_with_one_snr_and_one_trial_is_drawn(plugins, tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(curves, "PANELS", [curves.DEVIATION, curves.PANELS[3], curves.PANELS[-1]])
    folder = run_into(tmp_path / "run", tiny, ["trouble", "trouble[kind=empty]"], snr_db=[3], trials=1)
    assert len(draw_run(Run.open(folder))) == 4


def test_of_many_scenarios_only_their_mean_is_drawn_and_a_warning_says_so(
    plugins, tiny, tmp_path, drawn, monkeypatch
):
    monkeypatch.setattr(run_figures, "MANY_SCENARIOS", 1)
    other = tiny.with_name("other.toml")
    other.write_text(tiny.read_text().replace('"tiny"', '"other"'))
    suite = Suite(
        name="t", scenarios=[str(tiny), str(other)], estimators=["blob", "seer"], snr_db=[0], trials=1
    )
    run_suite(suite, tmp_path / "run")
    with pytest.warns(InputWarning, match="of more than 1 scenarios only means are drawn"):
        draw_run(Run.open(tmp_path / "run"))
    assert drawn["saved"] == ["deviation", "radii"]


def test_a_run_without_cells_draws_nothing(plugins, tiny, tmp_path):
    suite = Suite(
        name="t", scenarios=[str(tiny)], estimators=["trouble[kind=interrupt]"], snr_db=[0], trials=1
    )
    run = run_suite(suite, tmp_path / "run")
    assert run.manifest["interrupted"]
    assert draw_run(run) == []


def test_names_that_no_file_could_have_are_drawn_in_files_that_can_and_a_note_says_what_came_of_each_image(
    plugins, tiny, tmp_path, drawn
):
    tiny.write_text(tiny.read_text().replace('"tiny"', r'"../$a\n街 b"'), encoding="utf-8")
    draw_run(
        Run.open(run_into(tmp_path / "run", tiny, ["blob", "trouble", "trouble[kind=empty]"], snr_db=[0]))
    )
    assert drawn["saved"] == ["deviation", "curves-a-b", "radii", "clouds-a-b"]
    assert drawn["clouds"][0][0] == "../\\$a\ufffd\ufffd b, trial 0"
    notes = [image.note for image in drawn["clouds"][0][4][0]]
    assert notes[0].startswith("4 points, Hausdorff sum ")
    assert notes[1:] == ["error", "nothing detected"]


def test_clouds_show_the_snrs_nearest_to_the_papers_none_twice_whether_installed_or_not(
    plugins, tiny, tmp_path, drawn, monkeypatch
):
    draw_run(Run.open(run_into(tmp_path / "run", tiny, ["blob"], snr_db=[-30, -8, -7, 20], trials=1)))
    assert list(drawn["clouds"][0][4]) == [-30, -7, 20]
    other = run_into(tmp_path / "other", tiny, ["blob"], snr_db=[-7], trials=1)
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place != str(plugins.path)])
    draw_run(Run.open(other))
    assert list(drawn["clouds"][1][4]) == [-7]
    assert drawn["clouds"][1][3] == ["blob"]


def test_clouds_leave_out_what_sees_the_truth_and_go_on_in_another_figure(plugins, tiny, tmp_path, drawn):
    many = [f"blob[n={n}]" for n in range(1, 7)]
    draw_run(Run.open(run_into(tmp_path / "run", tiny, ["seer", *many], trials=1)))
    assert [call[3] for call in drawn["clouds"]] == [many[:4], many[4:]]
    assert drawn["saved"][-2:] == ["clouds-tiny-1", "clouds-tiny-2"]
    draw_run(Run.open(run_into(tmp_path / "limit", tiny, ["seer"], trials=1)))
    assert drawn["clouds"][-1][3] == ["seer (sees the truth)"]


def test_of_very_many_estimators_the_best_have_their_clouds_drawn_and_the_title_says_so(
    plugins, tiny, tmp_path, drawn, monkeypatch
):
    monkeypatch.setattr(run_figures, "MOST_CLOUDS", 2)
    specs = ["blob[n=1]", "trouble", "blob[n=3]", "blob[n=2]"]
    suite = Suite(name="test", scenarios=[str(tiny)], estimators=specs, snr_db=[0], trials=2)
    means = run(suite, out=tmp_path / "run").groupby("params")["deviation"].mean()
    draw_run(Run.open(tmp_path / "run"))
    ((title, _, _, columns, *_),) = drawn["clouds"]
    assert title == "tiny, the 2 of 4 estimators with the least mean deviation, trial 0"
    worst = json.loads(means.idxmax())["n"]
    assert columns == [f"blob[n={n}]" for n in (1, 3, 2) if n != worst]


def test_the_users_own_matplotlib_settings_come_back(plugins, tiny, tmp_path, monkeypatch):
    for name in ("draw_deviations", "draw_scores", "draw_clouds"):
        monkeypatch.setattr(run_figures, name, lambda *_: new_figure(1, 1))
    folder = run_into(tmp_path / "run", tiny, ["blob"], snr_db=[0], trials=1)
    with matplotlib.rc_context({"text.usetex": True, "font.size": 30.0}):
        draw_run(Run.open(folder))
        assert matplotlib.rcParams["text.usetex"]
        assert matplotlib.rcParams["font.size"] == 30.0
