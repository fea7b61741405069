"""Maps of a page: whatever a plugin's diagnosis holds, the page can be written."""

import json
import warnings

import numpy as np
import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.plugins.discovery import isolated_plugins, register_plugin
from isacbench.plugins.local_files import PluginFile
from isacbench.report.html import diagnosed_maps as maps_module
from isacbench.report.html.diagnosed_maps import diagnosed_maps
from isacbench.report.html.joined_runs import read_for_page

ODD = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Detection, Diagnosis


@dataclass(frozen=True)
class Odd:
    name: ClassVar[str] = "odd"
    shows: str = "infinity"

    def estimate(self, observation):
        return PointCloud.empty()

    def diagnose(self, observation):
        if self.shows == "none":
            return None
        gate = observation.gate
        power = np.mean(np.abs(observation.cells) ** 2, axis=(2, 3))
        threshold = np.full_like(power, np.inf)
        threshold[0, 0] = np.nan
        detection = Detection(power > 1e9, threshold, np.ones_like(power))
        return Diagnosis(power, detection, gate.range_bins, gate.doppler_bins, (), None)
"""


@pytest.fixture
def run_of(tiny, tmp_path):
    """Run estimators on two scenarios, and read them."""

    def make(*estimators):
        other = tiny.with_name("other.toml")
        other.write_text(tiny.read_text().replace('"tiny"', '"other"'))
        paths = [str(tiny), str(other)]
        run_suite(
            Suite(name="t", scenarios=paths, estimators=estimators, snr_db=[0], trials=1), tmp_path / "r"
        )
        return read_for_page(tmp_path / "r")

    with isolated_plugins():
        register_plugin(PluginFile("odd.py", ODD))
        yield make


def test_what_is_not_finite_is_left_open(run_of):
    found = diagnosed_maps(run_of("odd"))
    threshold = np.array(found["maps"][0]["threshold_db"], dtype=object)
    assert (threshold == None).all()  # noqa: E711
    json.dumps(found, allow_nan=False)


def test_a_diagnosis_that_is_none_costs_its_own_map(run_of):
    run = run_of("odd[shows=none]", "fft4d")
    with pytest.warns(InputWarning, match="no map and no spectra of odd"):
        found = diagnosed_maps(run)
    assert {one["estimator"] for one in found["maps"]} == {"fft4d"}


def test_every_scene_comes_before_any_has_a_second_estimator(run_of):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        maps = diagnosed_maps(run_of("fft4d", "odd"))["maps"]
    order = [(one["scene"], one["estimator"]) for one in maps]
    assert order == [("tiny", "fft4d"), ("other", "fft4d"), ("tiny", "odd"), ("other", "odd")]


def test_maps_for_which_there_is_no_time_are_counted(run_of, monkeypatch):
    run = run_of("fft4d", "odd")
    monkeypatch.setattr(maps_module, "LONGEST_S", -1.0)
    assert diagnosed_maps(run) == {"maps": [], "left_out": 4}
