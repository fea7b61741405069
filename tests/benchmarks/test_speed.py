"""Run times of what an image costs, on the street at full size."""

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, OscaCfar
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.oracle import Oracle
from threadpoolctl import threadpool_limits

from isacbench.dsp.detection import power_map
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


@pytest.mark.parametrize("detector", [OscaCfar(), CaCfar()], ids=lambda one: one.name)
def test_detection(benchmark, observation, detector):
    power, looks = power_map(observation.cells, "noncoherent")
    assert benchmark(detector.detect, power, looks).mask.any()
