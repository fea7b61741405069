"""Sparse Bayesian learning: lone scatterers exactly, streets densely, and what it says where it fails."""

from dataclasses import replace

import numpy as np
import pytest
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.nomp4d import Nomp4d
from isacbench_algorithms.sbl4d import Sbl4d

from isacbench import load_scenario, observe, score
from isacbench.instrument.remarks import Remarks
from isacbench.model.array import VirtualArray
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers
from tests.algorithms.scenes import stress_case
from tests.single_scores import paper_scores


def hausdorff_sum_m(scenario, cloud):
    return paper_scores(scenario.truth, cloud, scenario.region).hausdorff_sum_m


def street_part(shape, x_m=(10.0, 16.0), y_m=(15.0, 20.0)):
    """A part of the street seen by an array: quick, and still a crowd."""
    street = load_scenario("street")
    region = Region(x_m, y_m, street.region.z_m, street.region.speed_mps)
    inside, every = region.contains(street.scatterers.xyz), street.scatterers
    columns = every.xyz, every.velocity, every.amplitude, every.phase_rad
    scatterers = Scatterers(*(column[inside] for column in columns))
    array = VirtualArray((1, 1), shape, 1, 1)
    return replace(street, name="part", array=array, region=region, scatterers=scatterers)


def test_lone_scatterers_are_the_image_of_the_pursuit():
    scenario = load_scenario("sparse[seed=3]")
    observation = observe(scenario, snr_db=10)
    cloud = Sbl4d().estimate(observation)
    np.testing.assert_array_equal(cloud.to_array(), Nomp4d().estimate(observation).to_array())
    assert len(cloud) == len(scenario.truth)
    assert hausdorff_sum_m(scenario, cloud) < 0.2


def test_a_lone_scatterer_on_a_bin_without_noise_is_one_point():
    # Noise is rounding there, and the pursuit leaves more.
    image, _ = stress_case("bin[range_offset=0.0,doppler_offset=0.0,where=middle]").make(Sbl4d())
    assert len(image.cloud) == 1


@pytest.mark.parametrize(
    ("make", "n_remarks"),
    [
        (lambda: street_part((16, 16), (10.0, 22.0), (6.0, 11.0)), 0),
        # Its atoms are more than are fitted together.
        pytest.param(lambda: load_scenario("street"), 1, marks=pytest.mark.slow),
    ],
    ids=["part", "street"],
)
def test_a_street_is_dense_without_ghosts_and_remarks_are_of_atoms_left_out(make, n_remarks):
    scenario, ratios = make(), []
    for trial in range(3):
        observation = observe(scenario, 10, trial)
        with Remarks() as remarks:
            cloud = Sbl4d().estimate(observation)
        scores = score(scenario.truth, cloud, region=scenario.region)
        other = Esprit2d().estimate(observation)
        ratios.append(hausdorff_sum_m(scenario, cloud) / hausdorff_sum_m(scenario, other))
        assert min(scores["precision"], scores["recall"]) > 0.95
        assert scores["density"] < 0.6
        assert scores["velocity_nmse"] < 1e-3
        assert remarks.counts["unexplained"] == (0, 1)
        assert ["left out" in sentence for sentence in remarks.sentences()] == [True] * n_remarks
    assert np.mean(ratios) < 0.9  # a single one hangs on one point


@pytest.mark.parametrize(
    ("coherent_phase", "snr_db", "least"),
    [
        (True, -45, 0.85),
        # There the pursuit leaves noise alone, and learning explains more by as many atoms.
        (False, -35, 1.0),
    ],
    ids=["carrier phases", "in phase"],
)
def test_in_noise_it_sees_what_the_pursuit_sees(coherent_phase, snr_db, least):
    street = street_part((16, 16), (10.0, 22.0), (6.0, 11.0))
    scenario = replace(street, system=replace(street.system, coherent_phase=coherent_phase))
    recall = []
    for trial in range(2):
        observation = observe(scenario, snr_db, trial)
        clouds = [estimator.estimate(observation) for estimator in (Sbl4d(), Nomp4d())]
        recall.append([score(scenario, cloud)["recall"] for cloud in clouds])
    learned, pursued = np.mean(recall, axis=0)
    assert learned >= least * pursued


@pytest.mark.slow
def test_the_coherent_street_has_few_ghosts():
    scenario = load_scenario("street-coherent")
    clouds = [Sbl4d().estimate(observe(scenario, 10, trial)) for trial in range(12)]
    assert np.mean([score(scenario.truth, cloud)["precision"] for cloud in clouds]) >= 0.9


def test_a_crowd_beyond_the_limit_is_imaged_by_its_strongest_atoms_and_said():
    scenario = street_part((4, 9))
    observation = observe(scenario, snr_db=10)
    with Remarks() as remarks:
        cloud = Sbl4d(lone_scatterers=0, max_scatterers=40).estimate(observation)
    assert remarks.counts["crowded"].n > 0
    assert not remarks.counts["unexplained"].n
    assert 10 < len(cloud) <= 40
    assert scenario.region.contains(cloud.xyz, tolerance_m=0.5).all()


def test_a_map_that_atoms_do_not_explain_is_imaged_by_esprit_and_said():
    observation = observe(street_part((4, 4)), snr_db=10)
    rng = np.random.default_rng(1)
    # Every element and bin for itself: no echo looks so.
    signs = rng.choice([-1.0, 1.0], observation.cells.shape)
    scrambled = replace(observation, cells=observation.cells * signs)
    with Remarks() as remarks:
        cloud = Sbl4d().estimate(scrambled)
    assert remarks.counts["unexplained"].n == 1
    np.testing.assert_array_equal(cloud.to_array(), Esprit2d().estimate(scrambled).to_array())
