"""Maps and spectra: of a page, writable whatever a diagnosis holds, and as figures."""

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

from isacbench.bench.run.runner import run_suite
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputWarning
from isacbench.model.frame import get_frame
from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.contracts import Detection, Diagnosis, Spectrum
from isacbench.report import diagnoses
from isacbench.report.diagnoses import diagnosed_maps, draw_map, over_noise, spectrum_charts

RANGE_BINS, DOPPLER_BINS = np.arange(80, 86), np.arange(-2, 3)
COSINE = np.linspace(-1, 1, 21)


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


MALFORMED = {
    "none": "NoneType",
    "raise": "ZeroDivisionError: no luck",
    "map": "power has shape",
    "mask": "mask has shape",
    "complex": "power holds complex128",
    "bins": "range_bins holds",
    "empty": "power has no finite number",
    "texts": "AttributeError",
    "level": r"level_db has shape \(10,\); allowed: \(11,\)",
    "label": "allowed are 'u' and 'w'",
    "cell": "cell holds object",
}


def test_a_diagnosis_that_fails_or_is_malformed_costs_its_own_map(run_of, monkeypatch):
    monkeypatch.setattr(diagnoses, "MOST_MAPS", 2 * len(MALFORMED) + 2)
    run = run_of(*(f"showing[deed={deed}]" for deed in MALFORMED), "fft4d")
    with pytest.warns(InputWarning) as caught:
        found = diagnosed_maps(run)
    assert {one["estimator"] for one in found["maps"]} == {"fft4d"}
    said = "\n".join(str(one.message) for one in caught)
    for deed, message in MALFORMED.items():
        assert re.search(rf"showing.deed=\"?{deed}\"?.: .*{message}", said), said


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


def diagnosed(scenario, cell=None, spectra=()):
    power = np.full((RANGE_BINS.size, DOPPLER_BINS.size), 2.0)
    power[4, 1], power[0, 0] = 200.0, 0.0
    detection = Detection(power > 20, np.full_like(power, 20.0), np.ones_like(power))
    found = Diagnosis(power, detection, RANGE_BINS, DOPPLER_BINS, tuple(spectra), cell)
    return over_noise(scenario, "one", found, 2.0)


@pytest.fixture
def scenario(tiny):
    return load_scenario(tiny)


def test_a_map_is_in_decibels_over_the_noise_with_cells_around_their_range_and_velocity(scenario):
    figure = draw_map("title", diagnosed(scenario))
    power, threshold, detected = (axes.images[0] for axes in figure.axes[:3])
    bin_mps, bin_m = scenario.system.velocity_bin_mps, scenario.system.range_bin_m
    extent = [-2.5 * bin_mps, 2.5 * bin_mps, 79.5 * bin_m, 85.5 * bin_m]
    np.testing.assert_allclose(power.get_extent(), extent)
    assert power.get_array()[4, 1] == pytest.approx(20.0)
    np.testing.assert_allclose(threshold.get_array(), 10.0)
    assert np.ma.filled(detected.get_array(), np.nan)[4, 1] == pytest.approx(20.0)
    assert np.isfinite(np.ma.filled(detected.get_array(), np.nan)).sum() == 1
    assert np.isfinite(power.get_clim()).all()


def test_directions_beyond_a_period_are_shown_on_the_axis_of_their_spectrum(scenario):
    spaced = replace(scenario, frame=get_frame("panel", spacing_wavelengths=(0.5, 0.8)))
    offset_m = spaced.scatterers.xyz[:1] - spaced.base_station_m
    _, (w,) = spaced.frame.direction_cosines(offset_m)
    range_bin = round(float(np.linalg.norm(offset_m)) / spaced.system.range_bin_m)
    # Peaks are found from -1 to 1; the samples lie around an alias of the true direction.
    axis = w - 2 + np.linspace(-0.1, 0.1, 21)
    peak = np.array([(w + 1) % 2 - 1])
    found = diagnosed(spaced, (range_bin, 0), [Spectrum(axis, -np.abs(axis - w + 2), None, peak, "w")])
    *_, peaks, true = spectrum_charts("title", found).charts[0].series
    np.testing.assert_allclose([peaks.x, true.x], [[w - 2], [w - 2]])
    np.testing.assert_allclose(peaks.y, 0, atol=1e-9)


def test_spectra_show_threshold_peaks_and_the_true_directions_of_the_cell(scenario):
    offset_m = scenario.scatterers.xyz[:1] - scenario.base_station_m
    u, w = scenario.frame.direction_cosines(offset_m)
    range_bin = round(float(np.linalg.norm(offset_m)) / scenario.system.range_bin_m)
    spectra = [
        Spectrum(COSINE, -np.abs(COSINE), -0.5, np.array([-0.2, 0.3]), "u"),
        Spectrum(COSINE, -np.abs(COSINE), None, np.empty(0), "w"),
    ]
    group = spectrum_charts("title", diagnosed(scenario, (range_bin, 0), spectra))
    assert "1 scatterer" in group.title
    along_u, along_w = group.charts
    level, threshold, peaks, true = along_u.series
    np.testing.assert_array_equal(level.x, COSINE)
    np.testing.assert_array_equal(threshold.y, np.full(21, -0.5))
    np.testing.assert_allclose(peaks.y, [-0.2, -0.3])
    np.testing.assert_allclose(true.x, u)
    assert along_u.x.title == "direction cosine u"
    level, peaks, true = along_w.series
    np.testing.assert_allclose(true.x, w)
    elsewhere = spectrum_charts("title", diagnosed(scenario, (0, 0), spectra))
    assert not np.size(elsewhere.charts[0].series[-1].x)
