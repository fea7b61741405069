"""Images by the PRS alone: every scatterer once, at its own speed and not at those of its grating lobes."""

import dataclasses
import itertools

import numpy as np
import pytest

import isacbench
from isacbench.dsp.bursts import symbol_bursts
from isacbench.dsp.cell_detection import white_noise
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.link.sensing.division import Signal
from isacbench.link.sensing.link_observation import SignalSimulator
from isacbench.link.sensing.observing import observe
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator, echo_parameters
from isacbench.model.numerology import Prs
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.conftest import slow_but

PRS = Signal(sensing="prs")
LOBE_MPS = 7.34


@pytest.fixture(scope="module")
def space():
    """Return an empty space before a smaller array; its frame is whole, for the sake of the bursts."""
    single = load_scenario("single")
    system = dataclasses.replace(single.system, n_subcarriers=1024)
    return dataclasses.replace(single, system=system, array=VirtualArray((1, 1), (8, 8)))


def holding(space, xyz, velocity, amplitude=1.0):
    xyz = np.atleast_2d(xyz)
    amplitude = np.broadcast_to(amplitude, len(xyz))
    return dataclasses.replace(space, scatterers=Scatterers(xyz, np.atleast_1d(velocity), amplitude))


def image(name, scene, snr_db=0.0, trial=0):
    return isacbench.get_estimator(name).estimate(SignalSimulator(scene, PRS).observe(snr_db, trial))


def distances(scene, cloud):
    """Distance of points (n,) from the scene's first scatterer, in its largest number of Rayleigh cells."""
    offsets = radio_places(scene, cloud) - radio_places(scene, scene.truth)[0]
    return np.abs(offsets / rayleigh_cells(scene)).max(axis=1)


ESTIMATORS = [
    *("fft4d", "music2d", "music2d_joint", "esprit2d", "nomp4d", "sbl4d"),
    *("bartlett2d", "capon2d", "iaa2d", "omp4d"),
]


@pytest.fixture(scope="module")
def anywhere(space):
    """Return two scenes of a scatterer, and their observations."""
    generators = [np.random.default_rng(seed) for seed in range(2)]
    scenes = [holding(space, rng.uniform([4, 1, 4], [28, 9, 28]), rng.uniform(-15, 15)) for rng in generators]
    return [(scene, SignalSimulator(scene, PRS).observe(0.0, seed)) for seed, scene in enumerate(scenes)]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_scatterer_anywhere_is_one_point_at_its_own_speed(anywhere, name):
    for scene, observation in anywhere:
        cloud = isacbench.get_estimator(name).estimate(observation)
        assert len(cloud) == 1
        assert distances(scene, cloud)[0] < 0.2
        assert cloud.power[0] == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("name", ["fft4d", "nomp4d"])
@pytest.mark.parametrize(
    "prs", [Prs(2, period=1), Prs(2, 2, 3, 4, 1), Prs(6, 6, 0, 2), Prs(12, 12, 2, 2, 1), Prs(4, 4, 9, 16, 2)]
)
def test_a_lone_scatterer_of_any_prs_is_one_point_in_its_own_cell(space, name, prs):
    system = dataclasses.replace(space.system, prs=prs)
    scene = dataclasses.replace(holding(space, [16.0, 5.0, 16.0], 9.3), system=system)
    cloud = image(name, scene)
    assert len(cloud) == 1
    assert distances(scene, cloud)[0] < 0.5


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_mover_at_another_place_is_kept_though_its_speed_is_that_of_a_lobe(space, name):
    places = np.array([[8.0, 5.0, 8.0], [24.0, 5.0, 24.0]])
    # As far from the array, and a lobe apart: only directions tell the two apart.
    places[1, 1] += np.diff(np.linalg.norm(places - space.base_station_m, axis=1))[0]
    scene = holding(space, places, [-LOBE_MPS / 2, LOBE_MPS / 2], [1.0, 0.8])
    cloud = image(name, scene)
    assert len(cloud) == 2
    nearest = np.linalg.norm(cloud.xyz[:, None] - places, axis=2).argmin(axis=0)
    assert sorted(nearest) == [0, 1]
    np.testing.assert_allclose(cloud.velocity[nearest], scene.truth.velocity, atol=0.5)


@pytest.mark.parametrize("name", slow_but(["music2d"], ["music2d", "esprit2d", "nomp4d", "sbl4d"]))
def test_most_of_a_street_has_its_own_speeds(name):
    street = load_scenario("street")
    # Of half the bandwidth, which is quicker.
    street = dataclasses.replace(street, system=dataclasses.replace(street.system, n_subcarriers=1024))
    cloud = isacbench.get_estimator(name).estimate(observe(street, 20.0, sensing="prs"))
    truth = street.truth
    distance = np.linalg.norm(cloud.xyz[:, None] - truth.xyz, axis=2)
    nearest = distance.argmin(axis=1)
    in_own_cell = distance.min(axis=1) < 1
    in_lobe = np.abs(cloud.velocity - truth.velocity[nearest]) > LOBE_MPS / 2
    assert len(cloud) > 25
    assert in_own_cell.mean() > 0.8
    # Of images there would be two and more a scatterer.
    assert np.mean(in_lobe[in_own_cell]) < 0.2


@pytest.mark.parametrize("snr_db", [-20.0, 0.0, 30.0])
def test_grating_lobes_do_not_count_as_noise(space, snr_db):
    xyz = itertools.product([8.0, 16.0, 24.0], [2.0, 8.0], [10.0, 20.0])
    scene = holding(space, list(xyz), np.linspace(-14, 14, 12))
    simulator = SignalSimulator(scene, PRS)
    observation = simulator.observe(snr_db)
    expected = simulator.noise_power(snr_db) * np.mean(simulator.weights(snr_db).noise ** 2)
    measured = white_noise(GatedMap.of(observation, observation.cells))
    assert measured == pytest.approx(expected, rel=0.3)
    as_of_whole_frame = dataclasses.replace(observation, sensing="all")
    assert white_noise(GatedMap.of(as_of_whole_frame, observation.cells)) > measured


def test_cells_of_the_gate_have_the_kernel_of_the_bursts(space):
    scene = holding(space, [16.0, 5.0, 16.0], 3.3)
    observation = SignalSimulator(scene, PRS).observe(np.inf)
    gated = GatedMap.of(observation, observation.cells)
    row = np.abs(gated.cells[..., 0, 0]).sum(axis=1).argmax()
    seen = gated.cells[row, :, 0, 0]
    place = echo_parameters(scene).doppler_bin
    kernel = symbol_bursts(scene.system, "prs").response(observation.gate.doppler_bins, place)[:, 0]
    peak = np.abs(kernel).argmax()
    # The comb's other teeth, a quarter of the map away, leave less than a part in a thousand.
    np.testing.assert_allclose(seen / seen[peak], kernel / kernel[peak], atol=1e-3)


@pytest.mark.parametrize("name", ["music2d", "nomp4d", "sbl4d"])
def test_observations_tell_what_was_sensed_and_of_all_there_is_nothing_new(space, name):
    scene = holding(space, [[16.0, 5.0, 16.0], [20.0, 3.0, 9.0]], [3.3, -8.0])
    whole, plain = SignalSimulator(scene).observe(0.0), Simulator(scene).observe(0.0)
    assert (whole.sensing, plain.sensing) == ("all", "all")
    assert SignalSimulator(scene, PRS).observe(0.0).sensing == "prs"
    gated = GatedMap.of(plain, plain.cells)
    assert gated.cells is plain.cells
    assert not gated.sees_lobes
    estimator = isacbench.get_estimator(name)
    np.testing.assert_array_equal(estimator.estimate(whole).to_array(), estimator.estimate(plain).to_array())


@pytest.mark.parametrize(
    ("name", "n_symbols"),
    slow_but(
        [("music2d", 199), ("nomp4d", 223), ("sbl4d", 226)],
        itertools.product(["music2d", "nomp4d", "sbl4d"], [199, 223, 226]),
    ),
)
def test_frames_of_any_length_have_one_point_a_scatterer(space, name, n_symbols):
    system = dataclasses.replace(space.system, n_symbols=n_symbols)
    scene = dataclasses.replace(holding(space, [16.0, 5.0, 16.0], 9.3), system=system)
    cloud = image(name, scene)
    assert len(cloud) == 1
    assert distances(scene, cloud)[0] < 0.2


def test_an_empty_space_has_an_empty_image(space):
    observation = SignalSimulator(space, PRS).observe(0.0)
    for name in ESTIMATORS:
        assert len(isacbench.get_estimator(name).estimate(observation)) == 0, name
