"""What rounding, units, precision and memory order may change in an image: nothing that anybody could see.

Scenes that failed are kept as examples.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from isacbench_algorithms.fft4d import Fft4d
from isacbench_algorithms.music2d import Music2d
from isacbench_algorithms.nomp4d import Nomp4d

from isacbench.bench.cells.radio_coordinates import radio_places, rayleigh_cells, space_places
from isacbench.errors import InputError
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.numerology import System
from isacbench.model.region import Region
from isacbench.model.scene import Scatterers, Scenario

EMPTY = Scenario(
    name="few",
    system=System(n_subcarriers=255, n_symbols=63),
    array=VirtualArray((1, 1), (8, 8), 1, 1),
    frame=get_frame("panel"),
    base_station_m=np.array([0.0, 110.0, 25.0]),
    region=Region((-60.0, 60.0), (-25.0, 45.0), (-25.0, 60.0), (-40.0, 40.0)),
    scatterers=Scatterers(np.empty((0, 3)), np.empty(0), np.empty(0)),
)
CELLS = rayleigh_cells(EMPTY)
MIDDLE = np.array([90.0, 3.0, 0.04, 0.03])
APART = np.array([[0, 0, 0, 0], [3.3, 1.2, 0.4, -0.3], [-2.7, -2.1, -0.3, 0.6]])

ESTIMATORS = pytest.mark.parametrize("estimator", [Nomp4d(), Fft4d(), Music2d()], ids=lambda one: one.name)


def scene(offsets, amplitude=1.0, phase_rad=0.0):
    """Scenario of scatterers at offsets (n, 4) in Rayleigh cells."""
    xyz, velocity = space_places(EMPTY, MIDDLE + np.reshape(offsets, (-1, 4)) * CELLS)
    scatterers = Scatterers(xyz, velocity, np.broadcast_to(amplitude, len(xyz)), phase_rad)
    return replace(EMPTY, scatterers=scatterers)


def crowd(seed, n):
    """Scatterers within 4 x 2.5 bins, and within 2.4 Rayleigh cells along u and w."""
    rng = np.random.default_rng(seed)
    offsets = rng.uniform(-1, 1, (n, 4)) * [2, 1.25, 1.2, 1.2]
    return scene(offsets, 10 ** rng.uniform(-0.5, 0.3, n), rng.uniform(0, 6.28, n))


def spread(seed, n):
    """Scatterers two Rayleigh cells apart at least."""
    rng, offsets = np.random.default_rng(seed), np.empty((0, 4))
    while len(offsets) < n:
        one = rng.uniform(-1, 1, 4) * [8, 5, 0.6, 0.6]
        if np.all(np.abs(offsets - one).max(axis=1) > 2):
            offsets = np.vstack([offsets, one])
    return scene(offsets, 10 ** rng.uniform(-0.5, 0.3, n), rng.uniform(0, 6.28, n))


def moved(one, other):
    """Farthest a point lies from the other cloud of as many, relative to the size of each coordinate."""
    assert len(one) == len(other)
    one, other = one.to_array(), other.to_array()
    scale = np.array([60.0, 60.0, 60.0, 40.0, one[:, 4].max(initial=1e-300)])
    distance = (np.abs(one[:, None] - other) / scale).max(axis=2)
    return max(distance.min(axis=axis, initial=np.inf).max(initial=0) for axis in (0, 1))


@ESTIMATORS
@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 8), st.sampled_from([-10.0, 0.0, 30.0, np.inf]))
def test_the_last_bits_of_the_cells_move_no_point(estimator, seed, n, snr_db):
    seen = Simulator(spread(seed, n)).observe(snr_db)
    cloud = estimator.estimate(seen)
    noise = np.random.default_rng(seed).standard_normal((*seen.cells.shape, 2)).view(complex)[..., 0]
    rounded = replace(seen, cells=seen.cells * (1 + 1e-15 * noise))
    assert moved(cloud, estimator.estimate(rounded)) < 1e-9
    assert moved(cloud, estimator.estimate(replace(seen, cells=np.asfortranarray(seen.cells)))) < 1e-9
    single = replace(seen, cells=seen.cells.astype(np.complex64))
    assert moved(cloud, estimator.estimate(single)) < 1e-6


@ESTIMATORS
@settings(max_examples=2, deadline=None)
@given(st.integers(0, 10_000), st.integers(-498, 498))
@example(1, 498)
@example(1, -498)
def test_powers_of_two_scale_powers_and_nothing_else(estimator, seed, exponent):
    seen = Simulator(spread(seed, 3)).observe(10.0)
    cloud, scaled = (estimator.estimate(replace(seen, cells=k * seen.cells)) for k in (1.0, 2.0**exponent))
    np.testing.assert_array_equal(scaled.xyz, cloud.xyz)
    np.testing.assert_array_equal(scaled.velocity, cloud.velocity)
    np.testing.assert_array_equal(scaled.power, cloud.power * 2.0**exponent * 2.0**exponent)


@ESTIMATORS
@pytest.mark.parametrize("factor", [1e-150, 3e7, 1e150])
def test_any_other_factor_does_so_but_for_rounding(estimator, factor):
    seen = Simulator(spread(3, 5)).observe(10.0)
    cloud, scaled = (estimator.estimate(replace(seen, cells=k * seen.cells)) for k in (1.0, factor))
    assert moved(cloud, replace(scaled, power=scaled.power / factor / factor)) < 1e-10


@pytest.mark.parametrize("estimator", [Fft4d(), Music2d()], ids=lambda one: one.name)
@pytest.mark.parametrize(
    "offsets",
    [
        [[0, 0.5, 0.5, 0.25]],
        [[-1, 0.5, 0, 0], [1, 0.5, 0, 0]],
        [[0, 0.5, i, k] for i in (-1, 1) for k in (-1, 1)],
    ],
    ids=["one", "two in range", "four in a square"],
)
def test_halfway_between_two_cells_rounding_decides_nothing(estimator, offsets):
    system = EMPTY.system
    middle = np.array([37 * system.range_bin_m, system.velocity_bin_mps, 0, 0])
    xyz, velocity = space_places(EMPTY, middle + np.array(offsets) * CELLS)
    seen = Simulator(replace(EMPTY, scatterers=Scatterers(xyz, velocity, np.ones(len(xyz))))).observe(np.inf)
    cloud = estimator.estimate(seen)
    for seed in range(3):
        noise = np.random.default_rng(seed).standard_normal((*seen.cells.shape, 2)).view(complex)[..., 0]
        assert moved(cloud, estimator.estimate(replace(seen, cells=seen.cells * (1 + 1e-15 * noise)))) < 1e-9


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 8))
def test_without_noise_all_that_is_resolved_is_found_and_nothing_else(seed, n):
    scenario = spread(seed, n)
    cloud = Nomp4d().estimate(Simulator(scenario).observe(np.inf))
    assert len(cloud) == n
    error = radio_places(scenario, cloud)[:, None] - radio_places(scenario, scenario.scatterers)
    assert np.abs(error / CELLS).max(axis=2).min(axis=0).max() < 1e-2


@pytest.mark.parametrize("seed", [1, 3, 9])
def test_a_crowd_without_noise_leaves_no_points_around_it(seed):
    scenario = crowd(seed, 8)
    cloud = Nomp4d().estimate(Simulator(scenario).observe(np.inf))
    assert 1 <= len(cloud) <= 8


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize(
    ("apart", "phase_rad"), [(1e-7, 0.0), (1e-6, np.pi / 2), (1e-3, np.pi / 2), (1e-2, 0.0)]
)
def test_a_pair_too_close_for_double_precision_is_two_points_at_most(axis, apart, phase_rad):
    pair = scene(np.array([[0], [apart]]) * np.eye(4)[axis], phase_rad=[0.0, phase_rad])
    cloud = Nomp4d().estimate(Simulator(pair).observe(np.inf))
    assert 1 <= len(cloud) <= 2
    error = radio_places(pair, cloud) - radio_places(pair, pair.scatterers)[0]
    assert np.abs(error / CELLS).max() < 0.5


def test_no_more_scatterers_are_sought_than_asked_for_and_the_strongest_first():
    scenario = spread(2, 8)
    seen = Simulator(scenario).observe(30.0)
    every, few = Nomp4d().estimate(seen), Nomp4d(max_scatterers=3).estimate(seen)
    assert len(every) == 8
    assert len(few) == 3
    assert np.sort(few.power).min() > np.sort(every.power)[3] / 2


def test_a_number_of_scatterers_below_one_is_refused_by_name():
    with pytest.raises(InputError, match=r"max_scatterers = 0: allowed is 1 and more"):
        Nomp4d(max_scatterers=0)
