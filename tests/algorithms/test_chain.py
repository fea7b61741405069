"""The chain that all cell-by-cell estimators share: each stage is exchanged by itself."""

from functools import cache

import numpy as np
import pytest
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.detectors import CaCfar
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.iaa2d import Iaa2d
from isacbench_algorithms.music2d import Music2d

from isacbench import PointCloud, observe
from isacbench.checking.scenes import RESOLVED, observed
from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.model.echo import observe_echo
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from tests.algorithms.scenes import EACH_CELLWISE, crowd, distances_m

# One of those that share plane waves or spectra.
EXCHANGED = pytest.mark.parametrize("estimator", [Fft4d, Music2d, Esprit2d, Capon2d], ids=lambda e: e.name)


@cache
def sixty():
    """A crowd of 60, 10 dB."""
    return observe_echo(crowd(60), 10.0)


@cache
def image(estimator, **params):
    """Cloud of the crowd."""
    return estimator(**params).estimate(sixty())


@cache
def diagnosis(estimator, **params):
    """Diagnosis of the crowd."""
    return estimator(**params).diagnose(sixty())


@EACH_CELLWISE
def test_the_detector_is_exchanged_by_an_argument(estimator):
    few, many = (diagnosis(estimator, detector=CaCfar(pfa=pfa)).detection.mask.sum() for pfa in (1e-9, 0.1))
    assert 0 < few < many


@EACH_CELLWISE
def test_plane_waves_are_exchanged_by_one_method(estimator):
    class Ahead(estimator):
        def plane_waves(self, observation, cells):
            u, w = (np.full((len(cells), 1), np.mean(limits)) for limits in observation.cosine_limits)
            return PlaneWaves(u, w, np.ones(u.shape, dtype=bool))

    cosines = radio_places(sixty(), Ahead().estimate(sixty()))[:, 2:]
    middle = np.mean(sixty().cosine_limits, axis=1)
    assert len(cosines)
    np.testing.assert_allclose(cosines, np.tile(middle, (len(cosines), 1)), atol=1e-9)


@EXCHANGED
def test_the_own_cell_test_the_sidelobe_test_and_the_cloud_are_exchanged_by_one_method_each(estimator):
    class Everywhere(estimator):
        def own_cell_test(self, located):
            return located

    class Untested(Everywhere):
        def sidelobe_test(self, located, rdm, levels):
            return located.scatterers

    class Nothing(estimator):
        def to_cloud(self, rdm, found):
            return PointCloud.empty()

    # With weak waves, some of which are those of a neighbouring cell.
    given = {"local_dynamic_range_db": 30.0}
    images = (one(**given).estimate(sixty()) for one in (estimator, Everywhere, Untested))
    tested, anywhere, untested = map(len, images)
    assert 0 < tested < anywhere < untested
    assert len(Nothing().estimate(sixty())) == 0


@EACH_CELLWISE
def test_no_two_points_are_one_scatterer(estimator):
    observation, cloud = sixty(), image(estimator)
    # Directions are 0.01 apart: 0.04 Rayleigh cells of eight elements.
    points = radio_places(observation, cloud) / rayleigh_cells(observation) / [0.3, 0.3, 0.04, 0.04]
    apart = np.abs(points[:, None] - points).max(axis=2)
    assert apart[np.triu_indices(len(cloud), 1)].min() > 1 - 1e-9


@EACH_CELLWISE
def test_the_map_of_the_detection_is_tapered_as_asked_for(estimator):
    # Sidelobes are what a taper is for: without it the weakest cells of a crowd are stronger.
    plain = diagnosis(estimator, detection_window="rect")
    assert np.median(plain.power) > np.median(diagnosis(estimator).power)
    assert estimator().detection_window == "hann"


@EACH_CELLWISE
def test_noise_is_taken_for_a_plane_wave_no_more_often_than_angle_pfa_says(small_street, estimator):
    street = observe(small_street, snr_db=-25)
    often, hardly = (len(estimator(angle_pfa=pfa).estimate(street)) for pfa in (0.5, 1e-300))
    assert hardly < often


def test_a_diagnosis_marks_the_directions_that_the_image_has(small_street):
    # Polished ones, which lie between the samples.
    street = observe(small_street, snr_db=-25)
    polished, raw = (Iaa2d(polish=polish).diagnose(street).spectra[0].peaks for polish in (3, 0))
    assert not np.array_equal(polished, raw)


def test_maximum_likelihood_brings_the_peaks_of_the_adaptive_approach_nearer_to_the_truth():
    shot = observed(RESOLVED, 10.0)
    images = (Iaa2d(polish=polish).estimate(shot.observation) for polish in (0, 3))
    raw_m, polished_m = (np.median(distances_m(image, shot.scenario.truth).min(axis=0)) for image in images)
    assert polished_m < 0.2 * raw_m
