import numpy as np
import pytest

from isacbench.model.scenes.scenario import load_scenario
from isacbench.plugins.contracts import Detection, Diagnosis, Spectrum
from isacbench.report.diagnoses import draw_map, spectrum_charts

RANGE_BINS, DOPPLER_BINS = np.arange(80, 86), np.arange(-2, 3)


def diagnosis_of(cell=None, spectra=()):
    power = np.full((RANGE_BINS.size, DOPPLER_BINS.size), 2.0)
    power[4, 1], power[0, 0] = 200.0, 0.0
    detection = Detection(power > 20, np.full_like(power, 20.0), np.ones_like(power))
    return Diagnosis(power, detection, RANGE_BINS, DOPPLER_BINS, tuple(spectra), cell)


@pytest.fixture
def scenario(tiny):
    return load_scenario(tiny)


def test_a_map_is_in_decibels_over_the_noise_with_cells_around_their_range_and_velocity(scenario):
    figure = draw_map("title", diagnosis_of(), scenario.system, noise_power=2.0)
    power, threshold, detected = (axes.images[0] for axes in figure.axes[:3])
    bin_mps, bin_m = scenario.system.velocity_bin_mps, scenario.system.range_bin_m
    extent = [-2.5 * bin_mps, 2.5 * bin_mps, 79.5 * bin_m, 85.5 * bin_m]
    np.testing.assert_allclose(power.get_extent(), extent)
    assert power.get_array()[4, 1] == pytest.approx(20.0)
    np.testing.assert_allclose(threshold.get_array(), 10.0)
    assert np.ma.filled(detected.get_array(), np.nan)[4, 1] == pytest.approx(20.0)
    assert np.isfinite(np.ma.filled(detected.get_array(), np.nan)).sum() == 1
    assert np.isfinite(power.get_clim()).all()


def test_the_cut_runs_along_doppler_at_the_strongest_range(scenario):
    figure = draw_map("title", diagnosis_of(), scenario.system, noise_power=2.0)
    (cut,) = (axes for axes in figure.axes if axes.get_title().startswith("cut"))
    power, detected, threshold = cut.lines
    np.testing.assert_allclose(power.get_ydata(), [0, 20, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(detected.get_xdata(), [-scenario.system.velocity_bin_mps])
    np.testing.assert_allclose(threshold.get_ydata(), 10.0)


def test_spectra_show_threshold_peaks_and_the_true_directions_of_the_cell(scenario):
    offset_m = scenario.scatterers.xyz[:1] - scenario.base_station_m
    u, w = scenario.frame.direction_cosines(offset_m)
    range_bin = round(float(np.linalg.norm(offset_m)) / scenario.system.range_bin_m)
    cosine = np.linspace(-1, 1, 21)
    spectra = [
        Spectrum(cosine, -np.abs(cosine), -0.5, np.array([-0.2, 0.3]), "u"),
        Spectrum(cosine, -np.abs(cosine), None, np.empty(0), "w"),
    ]
    group = spectrum_charts("title", diagnosis_of((range_bin, 0), spectra), scenario)
    assert "1 scatterer" in group.title
    along_u, along_w = group.charts
    level, threshold, peaks, true = along_u.series
    np.testing.assert_array_equal(level.x, cosine)
    np.testing.assert_array_equal(threshold.y, np.full(21, -0.5))
    np.testing.assert_allclose(peaks.y, [-0.2, -0.3])
    np.testing.assert_allclose(true.x, u)
    assert along_u.x.title == "direction cosine u"
    level, peaks, true = along_w.series
    np.testing.assert_allclose(true.x, w)


def test_spectra_of_a_cell_without_scatterers_have_no_true_directions(scenario):
    cosine = np.linspace(-1, 1, 21)
    spectrum = Spectrum(cosine, cosine, np.zeros(21), np.empty(0), "u")
    (chart,) = spectrum_charts("title", diagnosis_of((0, 0), [spectrum]), scenario).charts
    assert not np.size(chart.series[-1].x)


def test_spectra_of_no_cell_are_refused(scenario):
    with pytest.raises(ValueError, match="with a cell"):
        spectrum_charts("title", diagnosis_of(), scenario)
