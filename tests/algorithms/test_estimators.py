"""The estimators on scenes small enough to know the answer, and once on the street."""

from collections import Counter
from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.bartlett2d import Bartlett2d
from isacbench_algorithms.capon2d import Capon2d
from isacbench_algorithms.detectors import CaCfar, OscaCfar
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.iaa2d import Iaa2d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.music2d_joint import Music2dJoint
from isacbench_algorithms.omp4d import Omp4d

from isacbench.dsp.windows import Window
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator, observe_echo
from isacbench.model.radio_coordinates import gain_db, radio_places, rayleigh_cells
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.algorithms import scenes
from tests.algorithms.scenes import BASE_M, NOTHING, REGION, SYSTEM, XYZ, distances_m, simulator
from tests.conftest import few, slow_but
from tests.single_scores import paper_scores

BOTH = pytest.mark.parametrize("estimator", [Music2d, Fft4d])
CROSSES = Music2d(integration="element"), Fft4d(integration="element")
WIDE = VirtualArray((2, 2), (4, 6), 4, 1)
OFFSETS = [-0.4, -0.2, 0.0, 0.15, 0.3, 0.5]


def beside_the_bins(xyz, offset):
    """Places moved along the line of sight until their range is so many bins off the middle of a bin."""
    offset_m = xyz - BASE_M
    range_bin = np.linalg.norm(offset_m, axis=1) / SYSTEM.range_bin_m
    return BASE_M + offset_m * ((np.rint(range_bin) + offset) / range_bin)[:, None]


def assert_imaged(cloud, truth, position_m=0.3, velocity_bins=0.15):
    """One point a scatterer, each near it in space, velocity and power."""
    assert len(cloud) == len(truth)
    distance_m = distances_m(cloud, truth)
    nearest = distance_m.argmin(axis=0)
    assert sorted(nearest) == list(range(len(truth)))
    assert distance_m.min(axis=0).max() < position_m
    assert np.abs(cloud.velocity[nearest] - truth.velocity).max() < velocity_bins * SYSTEM.velocity_bin_mps
    assert np.abs(10 * np.log10(cloud.power[nearest] / truth.power)).max() < 1


@BOTH
@pytest.mark.parametrize(
    ("frame", "offset"),
    slow_but([*zip(["panel", "paper"] * 3, OFFSETS, strict=True)], product(["panel", "paper"], OFFSETS)),
)
def test_separate_scatterers_are_imaged_in_place_speed_and_power(estimator, frame, offset):
    scene = simulator(beside_the_bins(XYZ, offset), frame=frame)
    # The paper's frame turns the bias of an angle between FFT samples into more metres along x. All lie in
    # one beam there, so that sidelobes of one change the amplitudes from which the others' bins are told.
    paper = (1.0 if estimator is Fft4d else 0.4, 0.3)
    position_m, velocity_bins = paper if frame == "paper" else (0.3, 0.15)
    cloud = estimator().estimate(scene.observe(30.0))
    assert_imaged(cloud, scene.scenario.truth, position_m, velocity_bins)


@pytest.mark.parametrize(
    "estimator", [Music2d(), Fft4d(), *CROSSES], ids=lambda one: f"{one.name}-{one.integration}"
)
@few
@given(
    st.tuples(st.floats(2, 28), st.floats(2, 38), st.floats(1, 15)), st.floats(-24, 24), st.integers(0, 99)
)
def test_a_lone_strong_scatterer_is_found_alone_within_a_twentieth_of_a_cell(
    estimator, place, velocity, trial
):
    scene = simulator([place], [velocity], array=WIDE)
    # 40 dB above the noise of one element after the transforms.
    cloud = estimator.estimate(scene.observe(40 - 10 * np.log10(SYSTEM.processing_gain), trial))
    assert len(cloud) == 1
    apart = (radio_places(scene.scenario, cloud) - radio_places(scene.scenario, scene.scenario.truth))[0]
    assert np.abs(apart / rayleigh_cells(scene.scenario))[[0, 1, 2]].max() < 0.05
    assert abs(10 * np.log10(cloud.power[0])) < 1


@BOTH
@pytest.mark.parametrize("integration", ["noncoherent", "element"])
def test_a_scene_of_noise_is_detected_as_often_as_pfa_says_and_hardly_ever_imaged(estimator, integration):
    scene, pfa = simulator(NOTHING), 1e-2
    one, detected, points = estimator(pfa=pfa, integration=integration), [], Counter()
    for trial in range(6):
        observation = scene.observe(0.0, trial)
        detected.append(one.diagnose(observation).detection.mask.mean())
        points[len(one.estimate(observation))] += 1
    # Tapers colour the noise: up to twice the nominal rate.
    assert 0.5 * pfa < np.mean(detected) < 2 * pfa
    # 162 cells can be reached, so 1.6 are detected an image; angle_pfa stops all but a few of these.
    assert points[0] > 0.9 * points.total()
    assert max(points) <= 1


@pytest.mark.parametrize("estimator", [Bartlett2d, Esprit2d, Omp4d, Fft4d], ids=lambda one: one.name)
def test_noise_is_imaged_on_beams_as_often_as_pfa_promises(estimator):
    scene, pfa, n = simulator(NOTHING), 1e-2, 12
    one = estimator(pfa=pfa, integration="beams")
    points = sum(len(one.estimate(scene.observe(0.0, trial))) for trial in range(n))
    promised = n * pfa * np.count_nonzero(scene.gate.reachable)
    # Next to each other, detected cells show one echo; tapers colour the noise.
    assert points < 1.3 * promised + 3 * np.sqrt(promised)


@pytest.mark.parametrize(
    "estimator", [Bartlett2d, Capon2d, Iaa2d, Music2dJoint, Esprit2d, Omp4d], ids=lambda one: one.name
)
def test_an_echo_that_a_beam_alone_shows_is_one_point_in_its_place(estimator):
    scene, found = simulator(XYZ[:1], array=VirtualArray((2, 2), (8, 8), 8, 1)), Counter()
    scenario = scene.scenario
    for trial in range(8):
        # 18 dB after all sums: a tenth of the noise of an element, which the mean power does not show.
        observation = scene.observe(18 - gain_db(scenario), trial)
        for integration in ("beams", "noncoherent"):
            cloud = estimator(integration=integration).estimate(observation)
            apart = np.abs(radio_places(scenario, cloud) - radio_places(scenario, scenario.truth))
            found[integration] += bool((apart / rayleigh_cells(scenario) < 0.4).all(axis=1).any())
    assert found["beams"] >= 6
    assert found["noncoherent"] <= 2


@pytest.mark.parametrize(
    "estimator",
    [
        Music2d(integration="element", detector=CaCfar()),
        *(Music2d(model_order=order) for order in ("eigenvalue_cfar", "mdl", "aic")),
        Music2d(subarray_fraction=0.9, grid_points=101),
        Music2d(detector=OscaCfar()),
        Fft4d(integration="element", detector=CaCfar()),
        Fft4d(angle_points=64),
        *(Music2d(range_window=window) for window in get_args(Window)),
        *(Music2d(doppler_window=window) for window in get_args(Window)),
    ],
    ids=lambda estimator: estimator.name,
)
def test_every_choice_finds_well_separated_scatterers(estimator):
    scene = simulator(beside_the_bins(XYZ, 0.0))
    cloud, truth = estimator.estimate(scene.observe(30.0)), scene.scenario.truth
    distance_m = distances_m(cloud, truth)
    assert distance_m.min(axis=0).max() < 0.5
    assert distance_m.min(axis=1).max() < 3


@BOTH
def test_a_probability_of_false_alarm_replaces_the_detectors(estimator):
    detector = CaCfar(pfa=1e-2, training=4)
    assert estimator(detector=detector).cell_detector() is detector
    assert estimator(detector=detector, pfa=1e-5).cell_detector() == CaCfar(pfa=1e-5, training=4)


EVERY = [*(one() for one in scenes.CELLWISE), *CROSSES]
DIAGNOSED = pytest.mark.parametrize("estimator", EVERY, ids=lambda one: f"{one.name}-{one.integration}")


@DIAGNOSED
def test_a_diagnosis_shows_the_map_and_the_spectra_of_its_strongest_cell(estimator):
    amplitude = np.array([1.0, 1.0, 3.0, 1.0, 1.0])
    scene = simulator(beside_the_bins(XYZ, 0.1), amplitude=amplitude)
    seen = estimator.diagnose(scene.observe(20.0))
    shape = seen.range_bins.size, seen.doppler_bins.size
    assert seen.power.dtype == seen.detection.threshold.dtype == np.float64  # whatever the precision
    assert seen.power.shape == seen.detection.mask.shape == seen.detection.threshold.shape == shape
    assert seen.detection.noise.shape == shape
    np.testing.assert_array_equal(seen.detection.mask, seen.power > seen.detection.threshold)
    range_m, velocity_mps, *cosines = radio_places(scene.scenario, scene.scenario.scatterers)[2]
    assert seen.cell == (round(range_m / SYSTEM.range_bin_m), round(velocity_mps / SYSTEM.velocity_bin_mps))
    row, column = seen.cell[0] - seen.range_bins[0], seen.cell[1] - seen.doppler_bins[0]
    assert seen.power[row, column] == seen.power.max()
    assert [spectrum.label for spectrum in seen.spectra] == ["u", "w"]
    for spectrum, cosine in zip(seen.spectra, cosines, strict=True):
        assert spectrum.cosine.shape == spectrum.level_db.shape
        assert (np.diff(spectrum.cosine) > 0).all()
        np.testing.assert_allclose(spectrum.peaks, [cosine], atol=0.02 if estimator in CROSSES else 0.01)
        highest = spectrum.cosine[spectrum.level_db.argmax()]
        assert highest == pytest.approx(cosine, abs=np.diff(spectrum.cosine).max())
        if spectrum.threshold_db is not None:
            threshold_db = np.broadcast_to(spectrum.threshold_db, spectrum.level_db.shape)
            assert spectrum.level_db.max() > threshold_db[spectrum.level_db.argmax()]


@DIAGNOSED
def test_a_diagnosis_of_an_empty_scene_has_a_map_and_no_cell(estimator):
    seen = replace(estimator, pfa=1e-9).diagnose(simulator(NOTHING).observe(0.0))
    assert seen.cell is None
    assert seen.spectra == ()
    assert seen.power.shape == seen.detection.mask.shape


@pytest.mark.parametrize(
    ("estimator", "limit_m", "velocity_nmse"),
    [
        *zip((Music2d(), Fft4d(), *CROSSES), (7.0, 15.0, 8.5, 15.0), [2e-3] * 4, strict=True),
        # Nearest to some scatterers of a car is a point of the static street.
        (Music2dJoint(), 9.0, 0.05),
        pytest.param(Esprit2d(), 9.0, 2e-3, marks=pytest.mark.slow),
    ],
)
def test_the_street_is_imaged_at_full_size_and_by_31_of_256_elements(estimator, limit_m, velocity_nmse):
    scenario = load_scenario("street")
    cloud = estimator.estimate(observe_echo(scenario, 10.0))
    found = paper_scores(scenario.truth, cloud, scenario.region, scenario.system.velocity_bin_mps)
    assert found.hausdorff_sum_m < limit_m
    assert found.velocity_nmse < velocity_nmse


@BOTH
@pytest.mark.parametrize("share", [0.9, 0.98])
def test_where_speeds_span_the_whole_map_a_still_scatterer_is_found_whatever_lies_at_its_edge(
    estimator, share
):
    fastest_mps = SYSTEM.unambiguous_speed_mps
    wide = replace(REGION, speed_mps=(-0.99 * fastest_mps, 0.99 * fastest_mps))
    fast = Scatterers(XYZ[:3], share * fastest_mps * np.array([-1.0, 0.0, 1.0]), np.ones(3))
    scene = Simulator(replace(simulator().scenario, region=wide, scatterers=fast))
    cloud = estimator().estimate(scene.observe(20.0))
    still = cloud.select(np.abs(cloud.velocity) < 1)
    np.testing.assert_allclose(still.xyz[still.power.argmax()], XYZ[1], atol=0.3)
    if share == 0.9:
        assert len(cloud) == 3


@BOTH
def test_speeds_of_one_sign_are_imaged_as_they_are(estimator):
    region = replace(REGION, speed_mps=(5.0, 45.0))
    scene = simulator(XYZ[:3], [10.0, 25.0, 40.0], region=region)
    assert_imaged(estimator().estimate(scene.observe(30.0)), scene.scenario.truth)
