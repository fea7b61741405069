"""The examples of third-party packages, really installed: what they do, and what the learned one learned."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.conftest import TINY, TINY_POINTS

pytestmark = pytest.mark.first

ROOT = Path(__file__).parents[2]
LEARNED = ROOT / "examples" / "learned_detector"

MEASURE = """
import io
import json
import sys
from contextlib import redirect_stdout

import numpy as np
from typer.testing import CliRunner

from isacbench import load_scenario
from isacbench.cli import app
from isacbench.plugins.registry import get_detector
from isacbench.report import run_report

from isacbench_learned.surroundings import FEATURES

sys.path.insert(0, sys.argv[2])
import train as training
from train import scene_names, train

training.SNRS_DB = (15.0,)
run_report.draw_with_page = lambda *_: []
done = {name: CliRunner().invoke(app, words) for name, words in json.loads(sys.argv[1]).items()}
alarms, exact = {}, []
for looks in (1, 256):
    power = np.random.default_rng([7, looks]).standard_gamma(looks, (134, 134)) / looks
    detection = get_detector("learned", pfa=3e-2).detect(power, looks)
    alarms[looks] = detection.mask.sum().item()
    exact.append(bool(np.array_equal(detection.mask, power > detection.threshold)))
power = np.random.default_rng(1).standard_gamma(256, (60, 60)) / 256
power[29:32, 28:33] += 1e5 * np.outer([0.25, 1, 0.25], [1e-3, 0.25, 1, 0.25, 1e-3])
around = np.argwhere(get_detector("learned").detect(power, 256).mask[25:36, 25:36]) - 5
sizes = [len(load_scenario(name).scatterers.xyz) for name in scene_names(4)]
with redirect_stdout(io.StringIO()):
    trained = [train(1), train(1)]
commands = {name: (one.exit_code, one.stdout, one.output) for name, one in done.items()}
print(json.dumps({"commands": commands, "alarms": alarms, "exact": exact, "around": around.tolist(),
                  "sizes": sizes, "trained": trained, "features": FEATURES}))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("example")
    (folder / "tiny.toml").write_text(TINY)
    (folder / "tiny.csv").write_text(TINY_POINTS)
    return folder


@pytest.fixture(scope="module")
def told(tmp_path_factory, folder):
    """Measurements of one Python that sees both packages, beside what is installed already."""
    installed = tmp_path_factory.mktemp("installed")
    # Copies, for building leaves files behind.
    sources = tmp_path_factory.mktemp("source")
    for source in (LEARNED, ROOT / "tests" / "example_plugin"):
        shutil.copytree(source, sources / source.name)
    offline = ("--no-build-isolation", "--no-deps", "--no-index", "--disable-pip-version-check")
    packages = [str(path) for path in sources.iterdir()]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", *offline, "--target", str(installed), *packages],
        check=True,
    )
    grid = "strongest[detector=[median,ca,median[pfa=1e-2]]]"
    cells = ["-e", grid, "-e", "fft4d[detector=median]", "--snr", "-5,10", "-n", "1", "-j", "1"]
    commands = {
        "list": ["list", "--json"],
        "check": ["check", "isacbench-example", "--json"],
        "check learned": ["check", "isacbench-learned", "--json"],
        "run": ["run", "quick", "-s", "tiny.toml", *cells, "-o", "out"],
    }
    path = os.pathsep.join(filter(None, [str(installed), os.environ.get("PYTHONPATH")]))
    finished = subprocess.run(
        [sys.executable, "-c", MEASURE, json.dumps(commands), str(sources / LEARNED.name)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        cwd=folder,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


@pytest.fixture
def isacbench(told):
    """Return a function that returns what a command has printed, if it has succeeded."""

    def call(command):
        exit_code, stdout, output = told["commands"][command]
        assert exit_code == 0, output
        return stdout

    return call


def test_installed_packages_are_listed_and_keep_the_contract(isacbench):
    listed = json.loads(isacbench("list"))
    strongest = next(entry for entry in listed["estimators"] if entry["name"] == "strongest")
    assert strongest["package"] == "isacbench-example 0.1.0"
    assert strongest["parameters"]["detector"]["default"] == {"name": "median", "pfa": 1e-3}
    assert {"median", "learned"} <= {entry["name"] for entry in listed["detectors"]}
    for command, names in (("check", ["strongest", "median"]), ("check learned", ["learned"])):
        checked = json.loads(isacbench(command))
        assert [plugin["name"] for plugin in checked["plugins"]] == names
        assert {status for status, n in checked["counts"].items() if n} == {"ok"}


def test_an_installed_package_takes_part_in_a_run(isacbench, folder):
    isacbench("run")
    records = pd.read_parquet(folder / "out" / "results.parquet")
    assert set(records["status"]) <= {"ok", "no_detection"}
    assert records.groupby("estimator")["params"].nunique().to_dict() == {"fft4d": 1, "strongest": 3}
    assert set(records.loc[records["estimator"] == "strongest", "n_estimated"]) <= {0, 1}


def test_the_learned_detector_keeps_its_rate_in_white_noise_and_detects_above_its_threshold(told):
    # Neighbours share their surroundings: 4 standard deviations are 10 % of 1600 alarms, 17 % of a third.
    expected = 134**2 * 3e-2
    assert list(told["alarms"].values()) == pytest.approx([expected] * 2, rel=0.17)
    assert sum(told["alarms"].values()) == pytest.approx(2 * expected, rel=0.125)
    assert told["exact"] == [True, True]


def test_a_strong_echo_is_detected_and_what_its_taper_spreads_is_not(told):
    # All these cells exceed the noise by far: only what was learned tells them apart.
    assert told["around"] == [[0, 0]]


def test_training_repeats_and_gives_a_file_of_the_stored_kind(told):
    first, second = told["trained"]
    stored = json.loads((LEARNED / "isacbench_learned" / "weights.json").read_text())
    n_features = len(told["features"])
    assert min(told["sizes"]) > 0
    assert first == second
    assert first.keys() == stored.keys()
    assert first["features"] == stored["features"] == told["features"]
    for weights in (first, stored):
        n_knots = {len(row) for row in weights["knots"]}
        assert len(weights["knots"]) == n_features
        assert len(n_knots) == 1
        assert [len(set_of) for set_of in weights["values"]] == [n_features, n_features]
        assert {len(row) for set_of in weights["values"] for row in set_of} == n_knots
