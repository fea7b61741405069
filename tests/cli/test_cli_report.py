"""The command report: what each option makes, and names that the shell completes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.cli.options import estimators_like, metrics_like, scenarios_like, suites_like
from isacbench.report import figures, run_report
from isacbench.report.figures import new_figure
from tests.conftest import TINY, TINY_POINTS


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folder of two stored runs of one suite without figures, to be copied."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "tiny.toml").write_text(TINY)
    (folder / "tiny.csv").write_text(TINY_POINTS)
    for estimator, name in (("fft4d", "one"), ("oracle", "two")):
        scenarios = [str(folder / "tiny.toml")]
        suite = Suite(name="s", scenarios=scenarios, estimators=[estimator], snr_db=[0, 10], trials=1)
        run_suite(suite, folder / name)
    return folder


@pytest.fixture
def cli(runs, command_line, tmp_path, monkeypatch):
    """Run the command line in a folder with a scenario and two stored runs; figures are left empty."""
    for module, name in ((figures, "draw_charts"), (run_report, "draw_clouds")):
        monkeypatch.setattr(module, name, lambda *_: new_figure(1, 1))
    shutil.copytree(runs, tmp_path, dirs_exist_ok=True)
    return command_line


def files_of(folder):
    return {
        path.relative_to(folder).as_posix()
        for path in Path(folder).rglob("*")
        if path.suffix in {".html", ".png", ".pdf"}
    }


def test_a_run_leaves_the_page_out_where_it_is_told_to_and_a_report_writes_it(cli):
    figures = {"figures/deviation.png", "figures/curves-tiny.png"}
    figures |= {"figures/radii.png", "figures/clouds-tiny.png"}
    words = "run quick -s tiny.toml -e fft4d --snr 0 -n 1 -o new --no-html"
    made = cli(*words.split())
    assert made.exit_code == 0, made.output
    assert files_of("new") == figures
    assert "report.html" in cli("report", "one").stdout
    assert files_of("one") == {*figures, "report.html"}


def test_html_writes_pages_alone_and_several_runs_become_one(cli):
    result = cli("report", "one", "--html")
    assert (result.exit_code, result.stdout.strip()) == (0, "one/report.html")
    assert not Path("one/summary.md").exists()
    result = cli("report", "one", "two", "--html", "-o", "board.html")
    assert (result.exit_code, result.stdout.strip()) == (0, "board.html")
    assert Path("board.html").stat().st_size > 1e6
    assert cli("report", "one", "two", "--html").stdout.strip() == "leaderboard.html"


def test_chosen_figures_are_drawn_and_nothing_else(cli):
    result = cli("report", "one", "--metric", "recall", "--format", "pdf")
    assert result.stdout.strip() == "figures: one/figures/recall-tiny.pdf"
    assert files_of("one") == {"figures/recall-tiny.pdf"}


def test_names_that_begin_alike_are_completed():
    assert estimators_like("mus") == ["music2d", "music2d_joint"]
    assert scenarios_like("mesh") == ["mesh-street"]
    assert scenarios_like("tow") == ["town[seed="]
    assert suites_like("population-") == ["population-errors", "population-quick"]
    assert metrics_like("gos") == ["gospa_m"]


def test_the_shell_is_given_the_names():
    environment = {
        **os.environ,
        "_ISACBENCH_COMPLETE": "complete_bash",
        "COMP_WORDS": "isacbench run -e esp",
        "COMP_CWORD": "3",
    }
    command = Path(sys.executable).with_name("isacbench")
    found = subprocess.run([command], env=environment, capture_output=True, text=True, timeout=60)
    assert "esprit2d" in found.stdout
