"""The example of a learned detector, really installed: its contract, its rate, its training."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "learned_detector"

MEASURE = """
import io
import json
import sys
from contextlib import redirect_stdout

import numpy as np

import isacbench
from isacbench.plugins.registry import get_detector
from isacbench_learned.surroundings import FEATURES
from typer.testing import CliRunner
from isacbench.cli import app

sys.path.insert(0, sys.argv[1])
from train import train

checked = CliRunner().invoke(app, ["check", "isacbench-learned", "--json"])
listed = CliRunner().invoke(app, ["list", "--json"])
found, exact = {}, []
for looks in (1, 16, 256):
    power = np.random.default_rng([7, looks]).standard_gamma(looks, (400, 400)) / looks
    detection = get_detector("learned", pfa=1e-2).detect(power, looks)
    found[looks] = float(detection.mask.mean())
    exact.append(bool(np.array_equal(detection.mask, power > detection.threshold)))
power = np.random.default_rng(1).standard_gamma(256, (60, 60)) / 256
power[29:32, 28:33] += 1e5 * np.outer([0.25, 1, 0.25], [1e-3, 0.25, 1, 0.25, 1e-3])
around = np.argwhere(get_detector("learned").detect(power, 256).mask[25:36, 25:36]) - 5
with redirect_stdout(io.StringIO()):
    trained = [train(4), train(4)]
print(json.dumps({"check": checked.stdout, "list": listed.stdout, "rates": found, "exact": exact,
                  "around": around.tolist(), "trained": trained, "features": FEATURES}))
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """Measurements of a Python that sees the package, installed beside what is installed already."""
    folder = tmp_path_factory.mktemp("installed")
    # A copy, for building leaves files behind.
    source = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("source") / "learned")
    offline = ("--no-build-isolation", "--no-deps", "--no-index", "--disable-pip-version-check")
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", *offline, "--target", str(folder), str(source)],
        check=True,
    )
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    finished = subprocess.run(
        [sys.executable, "-c", MEASURE, str(source)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


def test_the_learned_detector_is_listed(told):
    assert "learned" in {entry["name"] for entry in json.loads(told["list"])["detectors"]}


def test_the_learned_detector_keeps_the_contract(told):
    counts = json.loads(told["check"])["counts"]
    assert {status for status, n in counts.items() if n} == {"ok"}


@pytest.mark.parametrize("looks", ["1", "16", "256"])
def test_the_learned_detector_keeps_its_rate_in_white_noise(told, looks):
    # 1600 alarms are expected; neighbours share their surroundings, and 4 standard deviations are 10 %.
    assert told["rates"][looks] == pytest.approx(1e-2, rel=0.1)


def test_the_learned_detector_detects_where_power_exceeds_its_threshold(told):
    assert told["exact"] == [True, True, True]


def test_a_strong_echo_is_detected_and_what_its_taper_spreads_is_not(told):
    # All these cells exceed the noise by far: only what was learned tells them apart.
    assert told["around"] == [[0, 0]]


def test_training_repeats_and_gives_a_file_of_the_stored_kind(told):
    first, second = told["trained"]
    stored = json.loads((EXAMPLE / "isacbench_learned" / "weights.json").read_text())
    n_features = len(told["features"])
    assert first == second
    assert first.keys() == stored.keys()
    assert first["features"] == stored["features"] == told["features"]
    for weights in (first, stored):
        n_knots = {len(row) for row in weights["knots"]}
        assert len(weights["knots"]) == n_features
        assert len(n_knots) == 1
        assert [len(set_of) for set_of in weights["values"]] == [n_features, n_features]
        assert {len(row) for set_of in weights["values"] for row in set_of} == n_knots
