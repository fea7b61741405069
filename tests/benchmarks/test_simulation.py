"""What an observation costs: echo, noise, another SNR, another trial."""

from itertools import count

import numpy as np

from isacbench.model.echo import clean_echo, unit_noise


def test_clean_echo(benchmark, scene):
    simulator = scene.simulator
    assert benchmark(clean_echo, scene.scenario, simulator.gate).shape == simulator.clean.shape


def test_noise(benchmark, scene):
    shape = scene.simulator.clean.shape
    assert benchmark(unit_noise, scene.scenario.name, 0, 0, shape).shape == shape


def test_observe_at_another_snr(benchmark, scene):
    assert np.isfinite(benchmark(scene.simulator.observe, 10.0).cells[0, 0, 0, 0])


def test_observe_another_trial(benchmark, scene):
    trials = count(1)
    observed = benchmark(lambda: scene.simulator.observe(10.0, next(trials)))
    assert np.isfinite(observed.cells[0, 0, 0, 0])
