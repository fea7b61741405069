"""Maps of a page: the same on every machine, and writable whatever a plugin's diagnosis holds."""

import json
import warnings

import numpy as np
import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.report import diagnoses
from isacbench.report.diagnoses import diagnosed_maps


@pytest.fixture
def run_of(tiny, tmp_path, showing):
    """Run estimators on two scenarios."""

    def make(*estimators):
        other = tiny.with_name("other.toml")
        other.write_text(tiny.read_text().replace('"tiny"', '"other"'))
        paths = [str(tiny), str(other)]
        return run_suite(
            Suite(name="t", scenarios=paths, estimators=estimators, snr_db=[0], trials=1), tmp_path / "r"
        )

    return make


def test_what_is_not_finite_is_left_open(run_of):
    found = diagnosed_maps(run_of("showing"))
    threshold = np.array(found["maps"][0]["threshold_db"], dtype=object)
    assert (threshold == None).all()  # noqa: E711
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(("deed", "message"), [("none", "NoneType"), ("raise", "ZeroDivisionError: no luck")])
def test_a_diagnosis_that_fails_or_is_none_costs_its_own_map(run_of, deed, message):
    run = run_of(f"showing[deed={deed}]", "fft4d")
    with pytest.warns(InputWarning, match=f"no map and no spectra of showing.*{message}"):
        found = diagnosed_maps(run)
    assert {one["estimator"] for one in found["maps"]} == {"fft4d"}


def test_every_scene_comes_before_any_has_a_second_estimator_and_what_is_more_is_counted(run_of, monkeypatch):
    run = run_of("fft4d", "showing")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = diagnosed_maps(run)
    order = [("tiny", "fft4d"), ("other", "fft4d"), ("tiny", "showing"), ("other", "showing")]
    assert [(one["scene"], one["estimator"]) for one in found["maps"]] == order
    assert found["left_out"] == 0
    monkeypatch.setattr(diagnoses, "MOST_MAPS", 3)
    found = diagnosed_maps(run)
    assert [(one["scene"], one["estimator"]) for one in found["maps"]] == order[:3]
    assert found["left_out"] == 1
