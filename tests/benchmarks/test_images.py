"""What a whole image costs, by each estimator, and what each metric does."""

import pytest
from isacbench_algorithms.bartlett2d import Bartlett2d
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.iaa2d import Iaa2d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint
from isacbench_algorithms.nomp4d import Nomp4d
from isacbench_algorithms.omp4d import Omp4d
from isacbench_algorithms.oracle import Oracle

from isacbench.metrics.gospa import gospa_m
from isacbench.plugins.scoring import score
from tests.score_tables import METRICS


@pytest.mark.parametrize(
    "estimator",
    [
        *(Music2d(), Fft4d(), Music2dJoint(), Esprit2d(), Nomp4d()),
        *(Bartlett2d(), Capon2d(), Iaa2d(), Omp4d()),
    ],
    ids=lambda one: one.name,
)
def test_estimate(benchmark, scene, estimator):
    assert len(benchmark(estimator.estimate, scene.observation)) > 10


def test_estimate_oracle(benchmark, scene):
    truth = scene.scenario.truth
    assert 10 < len(benchmark(Oracle().estimate, scene.observation, truth)) <= len(truth)


@pytest.fixture
def clouds(scene):
    """Truth and an estimate of either scene."""
    return scene.scenario.truth, Music2d().estimate(scene.observation)


@pytest.mark.parametrize("metric", METRICS)
def test_score(benchmark, clouds, metric):
    assert benchmark(score, *clouds, metric)["n_true"] == len(clouds[0])


def test_gospa(benchmark, clouds):
    assert benchmark(gospa_m, *clouds) > 0
