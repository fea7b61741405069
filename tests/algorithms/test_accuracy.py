"""The accuracy that music2d and esprit2d have to reach on the street, over some trials at full size."""

from functools import cache
from itertools import product
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.references import Oracle
from scipy.stats import ttest_rel

from isacbench.model.echo import Simulator, observe_echo
from isacbench.model.scenes.scenario import load_scenario
from tests.single_scores import paper_scores

pytestmark = pytest.mark.slow

SCENARIOS = pytest.mark.parametrize("scenario", ["street", "street-paper"])
SNRS_DB = list(range(-30, 21, 5))
N_TRIALS = 10
SIGNIFICANCE = 0.05

_done: dict[tuple[str, str, int], list[SimpleNamespace]] = {}


def deviations(scenario_name, estimator, snr_db):
    """Deviation of every trial at one SNR; both estimators are run on each observation, once."""
    if (scenario_name, estimator, snr_db) not in _done:
        scenario = load_scenario(scenario_name)
        simulator, system = Simulator(scenario), scenario.system
        for other_snr_db in SNRS_DB:
            for name in ("music2d", "fft4d"):
                _done[scenario_name, name, other_snr_db] = []
        for trial in range(N_TRIALS):
            for other_snr_db in SNRS_DB:
                observation = simulator.observe(other_snr_db, trial)
                for one in (Music2d(), Fft4d()):
                    cloud = one.estimate(observation)
                    found = paper_scores(scenario.truth, cloud, scenario.region, system.velocity_bin_mps)
                    _done[scenario_name, one.name, other_snr_db].append(found)
    return _done[scenario_name, estimator, snr_db]


def sums(scenario, estimator, snr_db):
    """Imaging deviation of every trial."""
    return np.array([found.deviation for found in deviations(scenario, estimator, snr_db)])


def chance_of_being_greater(some, others):
    """P-value of the paired test that some are greater than others; 1 where all pairs are equal."""
    return ttest_rel(some, others, alternative="greater").pvalue if np.ptp(some - others) else 1.0


def smallest_by_holm(p_values):
    """Smallest p-value after Holm's correction: below the significance, something is significant."""
    return min(p_values) * len(p_values)


@pytest.mark.parametrize("estimator", [Music2d(), Esprit2d()], ids=lambda estimator: estimator.name)
def test_the_mean_deviation_over_scenes_does_not_rise_significantly_with_snr(estimator):
    scenes = [
        load_scenario(f"{family}[seed={seed},frame={frame},coherent_phase={phases}]")
        for seed, (frame, phases) in enumerate(product(("panel", "paper"), ("false", "true")), 130)
        for family in ("town", "facade", "crowd", "weak", "street")
    ]
    snrs_db = [-10, 0, 10, 20]
    found = np.array([[one_deviation(scene, estimator, snr_db) for snr_db in snrs_db] for scene in scenes])
    p_values = [chance_of_being_greater(found[:, at + 1], found[:, at]) for at in range(len(snrs_db) - 1)]
    p_values.append(chance_of_being_greater(found[:, -1], found[:, 0]))
    assert smallest_by_holm(p_values) > SIGNIFICANCE


def one_deviation(scenario, estimator, snr_db):
    """Imaging deviation of an image."""
    cloud = estimator.estimate(observe_echo(scenario, snr_db))
    bin_mps = scenario.system.velocity_bin_mps
    return paper_scores(scenario.truth, cloud, scenario.region, bin_mps).deviation


@SCENARIOS
@pytest.mark.parametrize("snr_db", [snr_db for snr_db in SNRS_DB if snr_db >= -10])
def test_music2d_is_no_worse_than_fft4d_trial_by_trial(scenario, snr_db):
    music, fft = (sums(scenario, name, snr_db) for name in ("music2d", "fft4d"))
    assert chance_of_being_greater(music, fft) > SIGNIFICANCE
    assert np.mean(music - fft) <= 0


class Means(NamedTuple):
    """Scores of an estimator, means over trials or realisations."""

    hausdorff_sum_m: float
    density: float
    velocity_nmse: float
    gospa_m: float
    precision: float


N_STREET_TRIALS = 5


@cache
def street_means(snr_db):
    """Means of esprit2d over trials on the street, and of the oracle over its realisations."""
    scenario = load_scenario("street")
    simulator, truth = Simulator(scenario), scenario.truth
    clouds = {
        "esprit2d": [
            Esprit2d().estimate(simulator.observe(snr_db, trial)) for trial in range(N_STREET_TRIALS)
        ],
        "oracle": Oracle().realisations(scenario, truth),
    }
    return {
        name: Means(*np.mean([scores(scenario, cloud) for cloud in found], axis=0))
        for name, found in clouds.items()
    }


def scores(scenario, cloud):
    """Scores of a cloud, in the order of `Means`."""
    truth, region = scenario.truth, scenario.region
    found = paper_scores(truth, cloud, region, scenario.system.velocity_bin_mps)
    return found.hausdorff_sum_m, found.density, found.velocity_nmse, found.gospa_m, found.precision


@pytest.mark.parametrize(("score", "ratio"), [("hausdorff_sum_m", 1.35), ("gospa_m", 1.05)])
def test_esprit2d_images_the_street_nearly_as_well_as_one_point_a_rayleigh_cell(score, ratio):
    means = street_means(10.0)
    assert getattr(means["esprit2d"], score) <= ratio * getattr(means["oracle"], score)


def test_the_number_speeds_and_precision_of_esprit2d_are_reached():
    means = street_means(10.0)["esprit2d"]
    assert means.density <= 0.65
    assert means.velocity_nmse <= 1e-3
    assert means.precision >= 0.92


def test_in_much_noise_esprit2d_is_within_half_of_one_point_a_rayleigh_cell():
    means = street_means(-20.0)
    assert means["esprit2d"].hausdorff_sum_m <= 1.5 * means["oracle"].hausdorff_sum_m
