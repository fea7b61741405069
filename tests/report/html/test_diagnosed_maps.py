"""Maps of a page: whatever a plugin's diagnosis holds, the page can be written."""

import json
import warnings

import numpy as np
import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.report.html import diagnosed_maps as maps_module
from isacbench.report.html.diagnosed_maps import diagnosed_maps
from isacbench.report.html.joined_runs import read_for_page


@pytest.fixture
def run_of(tiny, tmp_path, showing):
    """Run estimators on two scenarios, and read them."""

    def make(*estimators):
        other = tiny.with_name("other.toml")
        other.write_text(tiny.read_text().replace('"tiny"', '"other"'))
        paths = [str(tiny), str(other)]
        run_suite(
            Suite(name="t", scenarios=paths, estimators=estimators, snr_db=[0], trials=1), tmp_path / "r"
        )
        return read_for_page(tmp_path / "r")

    return make


def test_what_is_not_finite_is_left_open(run_of):
    found = diagnosed_maps(run_of("showing"))
    threshold = np.array(found["maps"][0]["threshold_db"], dtype=object)
    assert (threshold == None).all()  # noqa: E711
    json.dumps(found, allow_nan=False)


def test_a_diagnosis_that_is_none_costs_its_own_map(run_of):
    run = run_of("showing[deed=none]", "fft4d")
    with pytest.warns(InputWarning, match="no map and no spectra of showing"):
        found = diagnosed_maps(run)
    assert {one["estimator"] for one in found["maps"]} == {"fft4d"}


def test_every_scene_comes_before_any_has_a_second_estimator(run_of):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        maps = diagnosed_maps(run_of("fft4d", "showing"))["maps"]
    order = [(one["scene"], one["estimator"]) for one in maps]
    assert order == [("tiny", "fft4d"), ("other", "fft4d"), ("tiny", "showing"), ("other", "showing")]


def test_maps_for_which_there_is_no_time_are_counted(run_of, monkeypatch):
    run = run_of("fft4d", "showing")
    monkeypatch.setattr(maps_module, "LONGEST_S", -1.0)
    assert diagnosed_maps(run) == {"maps": [], "left_out": 4}
