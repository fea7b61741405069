"""What the steps of an observation cost, and detectors on its map; those of images are in `test_images`."""

from itertools import count

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar

from isacbench.dsp.cell_detection import detect_cells, power_map, white_noise
from isacbench.dsp.cfar.trimmed_factors import tm_factor
from isacbench.model.echo import clean_echo, unit_noise

DETECTORS = [CaCfar(), OsCfar(), OscaCfar(), GocaCfar(), SocaCfar(), TmCfar()]
BY_NAME = pytest.mark.parametrize("detector", DETECTORS, ids=lambda detector: detector.name)


def test_clean_echo(benchmark, scene):
    assert benchmark(clean_echo, scene.simulator.scenario, scene.simulator.gate).any()


def test_noise(benchmark, scene):
    assert benchmark(unit_noise, "benchmark", 0, 0, scene.observation.cells.shape).any()


def test_observe_at_another_snr(benchmark, scene):
    assert benchmark(scene.simulator.observe, 10.0).cells.any()


def test_observe_another_trial(benchmark, scene):
    trials = count(1)
    assert benchmark(lambda: scene.simulator.observe(10.0, next(trials))).cells.any()


@pytest.mark.parametrize("window", ["soft", "hann", "blackman"])
def test_taper(benchmark, scene, window):
    assert benchmark(lambda: scene.gated.tapered(window, window).cells).any()


@pytest.mark.parametrize("integration", ["element", "noncoherent"])
def test_power_map(benchmark, scene, integration):
    assert benchmark(power_map, scene.gated.cells, integration)[0].any()


def test_white_noise(benchmark, scene):
    assert benchmark(white_noise, scene.gated) > 0


@BY_NAME
def test_detect(benchmark, scene, detector):
    seen = scene.gated.tapered("hann", "hann")
    assert benchmark(detect_cells, seen, detector, "noncoherent", 28.0).bins[0].size


@BY_NAME
@pytest.mark.parametrize("n_cells", [100, 1000, 10_000, None])
def test_detect_on_a_whole_map(benchmark, detector, n_cells):
    power, rng = np.random.default_rng(0).standard_exponential((224, 2048)), np.random.default_rng(1)
    cells = n_cells and tuple(rng.integers(0, length, n_cells) for length in power.shape)
    found = benchmark(lambda: detector.detect(power, cells=cells).threshold)
    assert found.size == (n_cells or power.size)


@pytest.mark.parametrize("looks", [2, 16, 256])
def test_factor_of_a_trimmed_mean(benchmark, looks):
    assert benchmark(tm_factor.__wrapped__, 1e-3, 72, (18, 18), looks) > 1
