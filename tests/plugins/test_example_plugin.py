"""The example of a third-party package, really installed, takes part."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.conftest import TINY, TINY_POINTS

PACKAGE = Path(__file__).parents[1] / "example_plugin"


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Environment variables of a Python that sees the package, installed beside what is installed already."""
    folder = tmp_path_factory.mktemp("installed")
    # A copy, for building leaves files behind.
    source = shutil.copytree(PACKAGE, tmp_path_factory.mktemp("source") / "example")
    offline = ("--no-build-isolation", "--no-deps", "--no-index", "--disable-pip-version-check")
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", *offline, "--target", str(folder), str(source)],
        check=True,
    )
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": path}


COMMANDS = """
import json
import sys

from typer.testing import CliRunner

from isacbench.cli import app
from isacbench.report.html import guarded_pages

guarded_pages.draw_run_and_page = lambda *_: []
done = {name: CliRunner().invoke(app, words) for name, words in json.loads(sys.argv[1]).items()}
print(json.dumps({name: (one.exit_code, one.stdout, one.output) for name, one in done.items()}))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("example")
    (folder / "tiny.toml").write_text(TINY)
    (folder / "tiny.csv").write_text(TINY_POINTS)
    return folder


@pytest.fixture(scope="module")
def told(environment, folder):
    """Output of commands, all of them called in one process that sees the package, without figures."""
    grid = "strongest[detector=[median,ca,median[pfa=1e-2]]]"
    cells = ["-e", grid, "-e", "fft4d[detector=median]", "--snr", "-5,10", "-n", "1", "-j", "1"]
    commands = {
        "list": ["list", "--json"],
        "check": ["check", "isacbench-example", "--json"],
        "run": ["run", "quick", "-s", "tiny.toml", *cells, "-o", "out"],
    }
    finished = subprocess.run(
        [sys.executable, "-c", COMMANDS, json.dumps(commands)],
        capture_output=True,
        text=True,
        env=environment,
        cwd=folder,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


@pytest.fixture
def isacbench(told):
    """Return a function that returns what a command has printed, if it has succeeded."""

    def call(command):
        exit_code, stdout, output = told[command]
        assert exit_code == 0, output
        return stdout

    return call


def test_an_installed_package_is_listed(isacbench):
    listed = json.loads(isacbench("list"))
    strongest = next(entry for entry in listed["estimators"] if entry["name"] == "strongest")
    assert strongest["package"] == "isacbench-example 0.1.0"
    assert strongest["parameters"]["detector"]["default"] == {"name": "median", "pfa": 1e-3}
    assert "median" in {entry["name"] for entry in listed["detectors"]}


def test_an_installed_package_keeps_the_contract(isacbench):
    checked = json.loads(isacbench("check"))
    assert [plugin["name"] for plugin in checked["plugins"]] == ["strongest", "median"]
    assert {status for status, n in checked["counts"].items() if n} == {"ok"}


def test_an_installed_package_takes_part_in_a_run(isacbench, folder):
    isacbench("run")
    records = pd.read_parquet(folder / "out" / "results.parquet")
    assert set(records["status"]) <= {"ok", "no_detection"}
    assert records.groupby("estimator")["params"].nunique().to_dict() == {"fft4d": 1, "strongest": 3}
    assert set(records.loc[records["estimator"] == "strongest", "n_estimated"]) <= {0, 1}
