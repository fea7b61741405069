"""The accuracy that music2d and esprit2d have to reach on the street, over some trials at full size."""

from functools import cache
from itertools import pairwise, product

import numpy as np
import pandas as pd
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

N_TRIALS = 10
N_STREET_TRIALS = 5
SIGNIFICANCE = 0.05

street = cache(lambda name: Simulator(load_scenario(name)))


def scores(scenario, cloud):
    """Scores of a cloud as attributes."""
    return paper_scores(scenario.truth, cloud, scenario.region, scenario.system.velocity_bin_mps)


def chance_of_being_greater(some, others):
    """P-value of the paired test that some are greater than others; 1 where all pairs are equal."""
    return ttest_rel(some, others, alternative="greater").pvalue if np.ptp(some - others) else 1.0


@pytest.mark.parametrize("estimator", [Music2d(), Esprit2d()], ids=lambda estimator: estimator.name)
def test_the_mean_deviation_over_scenes_does_not_rise_significantly_with_snr(estimator):
    scenes = [
        load_scenario(f"{family}[seed={seed},frame={frame},coherent_phase={phases}]")
        for seed, (frame, phases) in enumerate(product(("panel", "paper"), ("false", "true")), 130)
        for family in ("town", "facade", "crowd", "weak", "street")
    ]

    def deviation(scene, snr_db):
        return scores(scene, estimator.estimate(observe_echo(scene, snr_db))).deviation

    found = np.array([[deviation(scene, snr_db) for scene in scenes] for snr_db in (-10, 0, 10, 20)])
    pairs = [*pairwise(found), (found[0], found[-1])]
    p_values = [chance_of_being_greater(later, earlier) for earlier, later in pairs]
    # Holm's correction: below the significance, something is significant.
    assert min(p_values) * len(p_values) > SIGNIFICANCE


@pytest.mark.parametrize("name", ["street", "street-paper"])
@pytest.mark.parametrize("snr_db", range(-10, 21, 5))
def test_music2d_is_no_worse_than_fft4d_trial_by_trial(name, snr_db):
    seen = [street(name).observe(snr_db, trial) for trial in range(N_TRIALS)]
    music, fft = (
        np.array([scores(street(name).scenario, one.estimate(observation)).deviation for observation in seen])
        for one in (Music2d(), Fft4d())
    )
    assert chance_of_being_greater(music, fft) > SIGNIFICANCE
    assert np.mean(music - fft) <= 0


@cache
def street_means(snr_db):
    """Means of the scores of esprit2d over trials on the street, and of the oracle over its realisations."""
    scenario = street("street").scenario
    seen = [street("street").observe(snr_db, trial) for trial in range(N_STREET_TRIALS)]
    clouds = map(Esprit2d().estimate, seen), Oracle().realisations(scenario, scenario.truth)
    return [pd.DataFrame(vars(scores(scenario, cloud)) for cloud in of).mean() for of in clouds]


def test_esprit2d_images_the_street_nearly_as_well_as_one_point_a_rayleigh_cell():
    esprit2d, oracle = street_means(10.0)
    assert esprit2d.hausdorff_sum_m <= 1.35 * oracle.hausdorff_sum_m
    assert esprit2d.gospa_m <= 1.05 * oracle.gospa_m
    assert esprit2d.density <= 0.65
    assert esprit2d.velocity_nmse <= 1e-3
    assert esprit2d.precision >= 0.92


def test_in_much_noise_esprit2d_is_within_half_of_one_point_a_rayleigh_cell():
    esprit2d, oracle = street_means(-20.0)
    assert esprit2d.hausdorff_sum_m <= 1.5 * oracle.hausdorff_sum_m
