"""Timed runs from the command line."""

import shutil

import pandas as pd
import pytest
from typer.testing import CliRunner

from isacbench.bench.cells.record import TIMING_COLUMNS
from isacbench.cli import app

RUN = ("run", "quick", "-s", "tiny.toml", "-e", "blob", "-e", "seer", "--snr", "0", "-n", "3")


@pytest.fixture
def cli(plugins, tiny, tmp_path, monkeypatch):
    """Run the command line in a folder that holds a small scenario."""
    monkeypatch.chdir(tmp_path)
    drawing = "isacbench.report.html.guarded_pages.draw_run_and_page"
    monkeypatch.setattr(drawing, lambda folder, *_: [folder / "deviation.png"])

    def call(*args):
        return CliRunner().invoke(app, [str(arg) for arg in args])

    return call


def test_a_timed_run_prints_and_writes_its_stages(cli):
    result = cli(*RUN, "--timing", "--repeats", 2, "-o", "out")
    assert result.exit_code == 0, result.output
    assert "tiny: median time of an estimate and its stages [ms], peak memory [MiB]" in result.stdout
    assert "out: summary.csv, summary.md, stages.csv, stages.md, " in result.stdout
    assert pd.read_parquet("out/results.parquet")["timing"].all()


def test_a_folder_goes_on_timed_and_back(cli):
    assert cli(*RUN, "-o", "out").exit_code == 0
    assert "stages.md" in cli(*RUN, "--timing", "--repeats", 1, "-o", "out").stdout
    assert "stages.md" in cli(*RUN[:-1], 4, "-o", "out").stdout
    records = pd.read_csv("out/results.csv")
    assert (records["timing"] == (records["trial"] < 3)).all()
    assert set(TIMING_COLUMNS) <= set(records)
    assert "stages.md" in cli("report", "out").stdout
    assert "0 of them differ" in cli("rescore", "out").stdout


def test_two_timed_runs_are_compared(cli):
    assert cli(*RUN, "--timing", "--repeats", 1, "-o", "base").exit_code == 0
    shutil.copytree("base", "new")
    result = cli("compare", "base", "new", "--tolerance", "time_estimate_s=1000000%", "--json")
    assert result.exit_code == 0, result.output
    assert '"time_estimate_s"' in result.stdout
    assert "not timed" not in result.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--timing", "-j", 2), "timing needs one job on this machine, not jobs 2"),
        (("--timing", "--dask", "tcp://nowhere:1"), "timing needs one job on this machine, not dask"),
        (("--repeats", 3), "repeats = 3 needs timing"),
    ],
)
def test_what_cannot_be_timed_is_a_mistake_in_usage(cli, options, message, tmp_path):
    result = cli(*RUN, *options, "-o", "out")
    assert result.exit_code == 2
    assert result.stderr.startswith(f"isacbench: {message}")
    assert not (tmp_path / "out").exists()


def test_less_than_one_repeat_is_refused(cli):
    assert cli(*RUN, "--timing", "--repeats", 0).exit_code == 2
