"""The example of a third-party package, really installed, takes part."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

PACKAGE = Path(__file__).parent / "example_plugin"


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


@pytest.fixture
def isacbench(environment, tmp_path):
    """Run the command line as a process of its own."""

    def call(*args):
        command = [sys.executable, "-m", "isacbench", *map(str, args)]
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return call


def test_an_installed_package_is_listed(isacbench):
    listed = json.loads(isacbench("list", "--json"))
    strongest = next(entry for entry in listed["estimators"] if entry["name"] == "strongest")
    assert strongest["package"] == "isacbench-example 0.1.0"
    assert strongest["parameters"]["detector"]["default"] == {"name": "median", "pfa": 1e-3}
    assert "median" in {entry["name"] for entry in listed["detectors"]}


def test_an_installed_package_keeps_the_contract(isacbench):
    checked = json.loads(isacbench("check", "isacbench-example", "--json"))
    assert [plugin["name"] for plugin in checked["plugins"]] == ["strongest", "median"]
    assert {status for status, n in checked["counts"].items() if n} == {"ok"}


def test_an_installed_package_takes_part_in_a_run(isacbench, tiny, tmp_path):
    grid = "strongest[detector=[median,ca,median[pfa=1e-2]]]"
    isacbench("run", "quick", "-s", tiny, "-e", grid, "-e", "fft4d[detector=median]", "-n", 1, "-o", "out")
    records = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert set(records["status"]) <= {"ok", "no_detection"}
    assert records.groupby("estimator")["params"].nunique().to_dict() == {"fft4d": 1, "strongest": 3}
    assert set(records.loc[records["estimator"] == "strongest", "n_estimated"]) <= {0, 1}
