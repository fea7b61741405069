"""The command report: what each option makes, and names that the shell completes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from isacbench.cli import app
from isacbench.cli.completion import estimators_like, metrics_like, scenarios_like, suites_like


@pytest.fixture
def cli(plugins, tiny, tmp_path, monkeypatch):
    """Run the command line in a folder with two stored runs of one suite."""
    monkeypatch.chdir(tmp_path)

    def invoke(*args):
        return CliRunner().invoke(app, [str(arg) for arg in args])

    for estimator, folder in (("blob", "one"), ("seer", "two")):
        made = invoke(
            "run",
            "quick",
            "-s",
            "tiny.toml",
            "-e",
            estimator,
            "--snr",
            "0,10",
            "-n",
            1,
            "-o",
            folder,
            "--no-html",
        )
        assert made.exit_code == 0, made.output
    return invoke


def files_of(folder):
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.suffix in {".html", ".png", ".pdf"}
    }


def test_a_run_leaves_the_page_out_where_it_is_told_to(cli, tmp_path):
    before = {"figures/deviation.png", "figures/curves-tiny.png", "figures/clouds-tiny.png"}
    assert files_of(tmp_path / "one") == before
    assert "report.html" in cli("report", "one").stdout
    assert files_of(tmp_path / "one") == {*before, "report.html"}


def test_html_writes_the_page_alone(cli, tmp_path):
    (tmp_path / "one" / "summary.md").unlink()
    result = cli("report", "one", "--html")
    assert (result.exit_code, result.stdout.strip()) == (0, "one/report.html")
    assert not (tmp_path / "one" / "summary.md").exists()


def test_several_runs_become_one_page(cli, tmp_path):
    result = cli("report", "one", "two", "--html", "-o", "board.html")
    assert (result.exit_code, result.stdout.strip()) == (0, "board.html")
    assert (tmp_path / "board.html").stat().st_size > 1e6
    assert cli("report", "one", "two", "--html").stdout.strip() == "leaderboard.html"


def test_chosen_figures_are_drawn_and_nothing_else(cli, tmp_path):
    before = files_of(tmp_path / "one")
    result = cli("report", "one", "--metric", "recall", "--format", "pdf")
    assert result.stdout.strip() == "figures: one/figures/recall-tiny.pdf"
    assert files_of(tmp_path / "one") - before == {"figures/recall-tiny.pdf"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["one", "two"], "several folders, and -o, need --html"),
        (["one", "-o", "a.html"], "several folders, and -o, need --html"),
        (["one", "--html", "--snr", "10"], "--html cannot be combined with"),
        (["one", "two", "--html", "-o", "board.txt"], "give -o FILE.html"),
        (["one", "one", "--html"], "given twice"),
        (["one", "--snr", "7"], "no SNR in dB of 7; allowed are 0, 10"),
        (["none", "--html"], "none"),
    ],
)
def test_a_wrong_report_ends_in_exit_code_2_with_one_message(cli, arguments, message):
    result = cli("report", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert len(result.stderr.splitlines()) == 1


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
