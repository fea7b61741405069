"""Times of whole images, by estimator and stage, and of metrics."""

import pytest
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.references import Oracle

from isacbench.instrument.stages import StageClock
from isacbench.metrics.assignment import gospa_m
from isacbench.plugins.registry import estimator_names, get_estimator, sees_truth
from isacbench.plugins.scoring import score
from tests.score_tables import METRICS


@pytest.mark.parametrize("name", [name for name in estimator_names() if not sees_truth(name)])
def test_estimate(benchmark, scene, name):
    estimator = get_estimator(name)
    assert len(benchmark(estimator.estimate, scene.observation)) > 5
    with StageClock() as clock:
        estimator.estimate(scene.observation)
    benchmark.extra_info["seconds by stage"] = clock.seconds


def test_estimate_oracle(benchmark, scene):
    truth = scene.simulator.scenario.truth
    assert 10 < len(benchmark(Oracle().estimate, scene.observation, truth)) <= len(truth)


@pytest.fixture
def clouds(scene):
    """Truth and an estimate of either scene."""
    return scene.simulator.scenario.truth, Music2d().estimate(scene.observation)


@pytest.mark.parametrize("metric", METRICS)
def test_score(benchmark, clouds, metric):
    assert benchmark(score, *clouds, metric)["n_true"] == len(clouds[0])


def test_gospa(benchmark, clouds):
    assert benchmark(gospa_m, *clouds) > 0
