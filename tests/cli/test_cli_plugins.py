"""Plugin files and grids on the command line and in suites."""

import json

import pandas as pd
import pytest

from isacbench.bench.cells.task import build_estimators
from isacbench.bench.kinds.detection import DetectionSuite
from isacbench.bench.run.runner import run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError

LOCAL = '''
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.plugins.contracts import Detection
from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class Middle:
    """The middle of the region."""

    name: ClassVar[str] = "middle"
    speed_mps: float = 0.0

    def estimate(self, observation):
        middle = (observation.region.lower_m + observation.region.upper_m) / 2
        return PointCloud([middle], [self.speed_mps], [1.0])


@dataclass(frozen=True)
class Half:
    """Half of the highest power."""

    name: ClassVar[str] = "half"
    pfa: float = 0.5

    def detect(self, power, looks=1):
        threshold = np.full(power.shape, power.max() / 2)
        return Detection(power > threshold, threshold, threshold)
'''


@pytest.fixture
def cli(cli, write_plugin):
    """Run the command line in a folder that holds a small scenario and a plugin file."""
    write_plugin("local.py", LOCAL)
    return cli


def test_run_takes_estimators_of_a_plugin_file_in_grids(cli):
    grid = "middle[speed_mps=[0,5,-5.0]]"
    result = cli("run", "quick", "-s", "tiny.toml", "--plugin", "local.py", "-e", grid, "-n", 1, "-o", "out")
    assert result.exit_code == 0, result.output
    records = pd.read_parquet("out/results.parquet")
    assert set(records["estimator"]) == {"middle"}
    speeds = [json.loads(params)["speed_mps"] for params in records["params"].unique()]
    assert speeds == [0, 5, -5]


def test_list_and_image_know_plugin_files_and_several_of_them(cli, write_plugin):
    other = LOCAL.replace('"middle"', '"centre"').replace('"half"', '"third"')
    write_plugin("other.py", other)
    files = ("--plugin", "local.py", "--plugin", "other.py")
    listed = json.loads(cli("list", "--json", *files).stdout)
    packages = {entry["name"]: entry["package"] for entry in listed["estimators"] + listed["detectors"]}
    assert (packages["middle"], packages["third"]) == ("local.py", "other.py")
    result = cli("image", "-s", "tiny.toml", "-e", "centre", *files)
    assert result.exit_code == 0, result.output
    assert "1 point " in result.stdout


def suite(*estimators):
    return Suite(name="s", scenarios=["tiny.toml"], estimators=estimators, snr_db=[0], trials=1)


def test_tables_of_a_suite_are_built_in_order(plugins):
    entries = build_estimators(suite("blob[n=[1,2],detector=[level,ca]]", "seer"))
    assert [(c.name, getattr(c.plugin, "n", 0)) for c in entries] == [
        ("blob", 1), ("blob", 1), ("blob", 2), ("blob", 2), ("seer", 0)
    ]  # fmt: skip


@pytest.mark.parametrize("estimators", [("blob[n=[4,5]]", "blob[n=5]"), ("blob[detector=[level,level[]]]",)])
def test_variants_that_mean_the_same_are_refused(plugins, estimators):
    with pytest.raises(InputError, match="repeats an estimator with equal parameters"):
        build_estimators(suite(*estimators))


@pytest.fixture
def detection(plugins, tiny):
    """Return a function that runs detectors behind an estimator."""
    common = {"name": "s", "scenarios": [str(tiny)], "maps": ["homogeneous"], "snr_db": [-36], "trials": 1}
    return lambda **options: run(DetectionSuite(kind="detection", **common, **options))


def test_a_detection_suite_takes_tables_of_detectors_and_of_estimators(detection):
    grid = "ca[pfa=[1e-3,1e-4]]"
    records = detection(estimators=["fft4d[max_sources=[1,2]]"], detectors=[grid, "level"])
    on_map, behind = (records[(records["scenario"] == "homogeneous") == chosen] for chosen in (True, False))
    detectors = ["ca[pfa=1e-3]", "ca[pfa=1e-4]", "level"]
    assert on_map["detector"].tolist() == detectors
    assert behind["detector"].tolist() == 2 * detectors
    assert (records["status"] != "error").all()
    with pytest.raises(InputError, match="'ca\\[pfa=1e-3\\]' repeats a detector"):
        detection(estimators=["fft4d"], detectors=[grid, "ca[pfa=1e-3]"])


REMARKING = '''
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud
from isacbench.instrument.remarks import remark


@dataclass(frozen=True)
class Open:
    """Leaves everything open."""

    name: ClassVar[str] = "open"

    def estimate(self, observation):
        remark("unseparated", 3, 4)
        return PointCloud.empty()
'''


def test_an_image_tells_what_its_estimator_remarked(cli, write_plugin):
    write_plugin("remarking.py", REMARKING)
    result = cli("image", "-s", "tiny.toml", "--plugin", "remarking.py", "-e", "open")
    assert result.exit_code == 0, result.output
    assert "3 of 4 subspaces: signal and noise not separated" in result.output
