"""Run times of what an image costs, on the street at full size."""

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.oracle import Oracle
from scipy.ndimage import rank_filter
from threadpoolctl import threadpool_limits

from isacbench.dsp.cfar import os_mask
from isacbench.dsp.detection import power_map
from isacbench.dsp.thresholds import osca_factor, tm_factor
from isacbench.metrics.score import score
from isacbench.model.echo import Simulator, clean_echo
from isacbench.model.scenario import load_scenario


@pytest.fixture(scope="module")
def simulator():
    """Simulator of the street, its clean echo computed, on one thread."""
    with threadpool_limits(limits=1):
        simulator = Simulator(load_scenario("street"))
        assert simulator.clean.shape[2:] == (16, 16)
        yield simulator


@pytest.fixture(scope="module")
def observation(simulator):
    """Return the street at 10 dB."""
    return simulator.observe(10.0)


@pytest.mark.parametrize("estimator", [Music2d(), Fft4d()], ids=lambda one: one.name)
def test_estimate(benchmark, observation, estimator):
    assert len(benchmark(estimator.estimate, observation)) > 100


def test_estimate_oracle(benchmark, simulator, observation):
    truth = simulator.scenario.truth
    assert 100 < len(benchmark(Oracle().estimate, observation, truth)) < len(truth)


def test_clean_echo(benchmark, simulator):
    assert benchmark(clean_echo, simulator.scenario, simulator.gate).shape == simulator.clean.shape


def test_observe_at_another_snr(benchmark, simulator):
    assert np.isfinite(benchmark(simulator.observe, 10.0).cells[0, 0, 0, 0])


def test_observe_another_trial(benchmark, simulator):
    trials = iter(range(1, 10**6))
    observed = benchmark.pedantic(lambda: simulator.observe(10.0, next(trials)), rounds=20)
    assert np.isfinite(observed.cells[0, 0, 0, 0])


@pytest.mark.parametrize("metric", ["paper", "repository"])
def test_score(benchmark, simulator, observation, metric):
    cloud, truth = Music2d().estimate(observation), simulator.scenario.truth
    assert benchmark(score, truth, cloud, metric)["n_true"] == len(truth)


DETECTORS = [CaCfar(), OsCfar(), OscaCfar(), GocaCfar(), SocaCfar(), TmCfar()]


@pytest.mark.parametrize("detector", DETECTORS, ids=lambda one: one.name)
def test_detection(benchmark, observation, detector):
    power, looks = power_map(observation.cells, "noncoherent")
    assert benchmark(detector.detect, power, looks).mask.any()


@pytest.fixture(scope="module")
def noise_map():
    """Return noise on a whole range-Doppler map."""
    return np.random.default_rng(0).standard_exponential((224, 2048))


@pytest.mark.parametrize("detector", DETECTORS, ids=lambda one: one.name)
@pytest.mark.parametrize("n_cells", [100, 1000, 10_000, None])
def test_detection_of_listed_cells(benchmark, noise_map, detector, n_cells):
    cells = None
    if n_cells is not None:
        rng = np.random.default_rng(1)
        cells = tuple(rng.integers(0, length, n_cells) for length in noise_map.shape)
    found = benchmark(lambda: detector.detect(noise_map, cells=cells).threshold)
    assert found.size == (n_cells or noise_map.size)


def test_mask_by_counting(benchmark, noise_map):
    assert 300 < np.count_nonzero(benchmark(os_mask, noise_map, 3, 1, 1e-3)) < 700


def test_mask_by_a_rank_filter(benchmark, noise_map):
    footprint = np.ones((9, 9), dtype=bool)
    footprint[3:6, 3:6] = False
    order = benchmark(rank_filter, noise_map, 53, footprint=footprint)
    inside = (slice(4, -4), slice(4, -4))
    by_sorting = noise_map > osca_factor(1e-3, ((54, 72),)) * order
    assert np.array_equal(by_sorting[inside], os_mask(noise_map, 3, 1, 1e-3)[inside])


@pytest.mark.parametrize("looks", [2, 16, 256])
def test_factor_of_a_trimmed_mean(benchmark, looks):
    assert benchmark(tm_factor.__wrapped__, 1e-3, 72, (18, 18), looks) > 1
