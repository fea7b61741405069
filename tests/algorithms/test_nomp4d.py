"""Matching pursuit on scenes of few scatterers: exact, at the bound, wherever the grid lies."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms import nomp4d
from isacbench_algorithms.nomp4d import Nomp4d

from isacbench import load_scenario, score
from isacbench.bench.kinds.resolution import pair
from isacbench.checking.image_checks import ANY_SCALE
from isacbench.dsp.bounds import single_bound
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.frame import get_frame
from isacbench.model.radio_coordinates import DIMENSIONS, gain_db, radio_places, rayleigh_cells, space_places
from isacbench.model.scene import Scatterers
from tests.algorithms.scenes import EMPTY, stress_case
from tests.conftest import few

SYSTEM, CELLS = EMPTY.system, rayleigh_cells(EMPTY)
MIDDLE = np.array([90.0, 3.0, 0.04, 0.03])
"""Range, velocity, u and w well inside the region."""

# Distances in Rayleigh cells; everything else is free.
SCENES = {
    "apart": [[0, 0, 0, 0], [3.3, 1.2, 0.4, -0.3], [-2.7, -2.1, -0.3, 0.6]],
    "equal angles in different cells": [[0, 0, 0, 0], [2.4, 0, 0, 0], [0, 2.4, 0, 0]],
    "equal cells at different angles": [[0, 0, -0.6, 0], [0, 0, 0.7, 0], [0, 0, 0, 1.3]],
    "three on a line": [[0, 0, -1.1, -0.5], [0, 0, 0, 0], [0, 0, 1.1, 0.5]],
    "three on a line in range": [[-1.2, 0, 0, 0], [0, 0, 0, 0], [1.2, 0, 0, 0]],
}


def scene(places, amplitude=None, phase_rad=0.0, template=EMPTY, name="few"):
    """Scenario of scatterers at places (n, 4) as the radio sees them."""
    xyz, velocity = space_places(template, np.reshape(places, (-1, 4)))
    amplitude = np.ones(len(xyz)) if amplitude is None else np.asarray(amplitude, dtype=float)
    return replace(template, name=name, scatterers=Scatterers(xyz, velocity, amplitude, phase_rad))


def near_middle(offsets):
    """Places some Rayleigh cells off the middle."""
    return MIDDLE + np.asarray(offsets) * CELLS


def image(scenario, snr_after_gain_db=np.inf, trial=0, **parameters):
    """Cloud of one image; the SNR is that of a unit scatterer after all sums."""
    snr_db = snr_after_gain_db - gain_db(scenario)
    return Nomp4d(**parameters).estimate(Simulator(scenario).observe(snr_db, trial))


def errors(scenario, cloud):
    """Distances (n_points, n_true, 4) in Rayleigh cells."""
    true = radio_places(scenario, scenario.scatterers)
    return (radio_places(scenario, cloud)[:, None] - true) / rayleigh_cells(scenario)


def assert_found(scenario, cloud, cells, power=None):
    """One point a scatterer, within so many Rayleigh cells along every coordinate, and its power."""
    error = np.abs(errors(scenario, cloud)).max(axis=2)
    assert len(cloud) == len(scenario.scatterers)
    nearest = error.argmin(axis=0)
    assert sorted(nearest) == list(range(len(cloud)))
    assert error.min(axis=0).max() < cells
    ratio = cloud.power[nearest] / scenario.scatterers.amplitude**2
    np.testing.assert_allclose(ratio, 1, atol=power or 4 * cells)


PANEL, PAPER = (EMPTY, MIDDLE), (replace(EMPTY, frame=get_frame("paper")), np.array([90.0, 3.0, 0.0, 0.25]))


@pytest.mark.parametrize(
    ("name", "radio", "snr_after_gain_db", "cells", "power"),
    [
        *((name, PANEL, np.inf, 1e-3, None) for name in SCENES),
        *((name, PANEL, 30.0, 0.12, 0.5) for name in SCENES),
        ("equal angles in different cells", PAPER, np.inf, 1e-3, None),
        ("three on a line in range", PAPER, np.inf, 1e-3, None),
    ],
)
def test_few_scatterers_are_found_and_nothing_else_and_without_noise_exactly(
    name, radio, snr_after_gain_db, cells, power
):
    template, middle = radio
    scenario = scene(middle + np.array(SCENES[name]) * CELLS, template=template)
    assert_found(scenario, image(scenario, snr_after_gain_db), cells, power)


@few
@given(st.tuples(*[st.floats(-0.5, 0.5)] * 4), st.floats(0, 6.28))
def test_a_lone_scatterer_without_noise_is_exact_wherever_the_bins_lie(offset, phase_rad):
    scenario = scene(near_middle([offset]), phase_rad=phase_rad)
    assert_found(scenario, image(scenario), 1e-6)


def spread(seed, n):
    """Scatterers two Rayleigh cells apart at least."""
    rng, offsets = np.random.default_rng(seed), np.empty((0, 4))
    while len(offsets) < n:
        one = rng.uniform(-1, 1, 4) * [8, 5, 0.6, 0.6]
        if np.all(np.abs(offsets - one).max(axis=1) > 2):
            offsets = np.vstack([offsets, one])
    return scene(near_middle(offsets), 10 ** rng.uniform(-0.5, 0.3, n), rng.uniform(0, 6.28, n))


@few
@given(st.integers(0, 10_000), st.integers(1, 8))
def test_without_noise_all_that_is_resolved_is_found_and_nothing_else(seed, n):
    scenario = spread(seed, n)
    cloud = image(scenario)
    assert len(cloud) == n
    assert np.abs(errors(scenario, cloud)).max(axis=2).min(axis=0).max() < 1e-2


@pytest.mark.parametrize("seed", [1, 3, 9])
def test_a_crowd_without_noise_leaves_no_points_around_it(seed):
    # Within 4 x 2.5 bins, and within 2.4 Rayleigh cells along u and w.
    rng = np.random.default_rng(seed)
    offsets = rng.uniform(-1, 1, (8, 4)) * [2, 1.25, 1.2, 1.2]
    crowd = scene(near_middle(offsets), 10 ** rng.uniform(-0.5, 0.3, 8), rng.uniform(0, 6.28, 8))
    assert 1 <= len(image(crowd)) <= 8


@pytest.mark.parametrize(
    ("seed", "pedestrians", "phase"),
    [(203, 1, "true"), (204, 2, "true"), (204, 2, "false"), (206, 2, "false")],
)
def test_a_few_unresolved_bodies_leave_no_rows_of_points_beside_them(seed, pedestrians, phase):
    scenario = load_scenario(f"crowd[seed={seed},pedestrians={pedestrians},coherent_phase={phase}]")
    scores = score(scenario, Nomp4d().estimate(Simulator(scenario).observe(10.0)))
    assert scores["precision"] > 0.8
    assert scores["recall"] > 0.9


def test_weak_objects_that_stand_out_from_their_surroundings_are_not_taken_for_misfit():
    scenario = load_scenario("weak[seed=304,coherent_phase=true]")
    assert score(scenario, Nomp4d().estimate(Simulator(scenario).observe(10.0)))["recall"] > 0.6


@pytest.mark.parametrize(
    ("axis", "apart", "phase_rad"),
    [(0, 1e-7, 0.0), (1, 1e-6, np.pi / 2), (2, 1e-3, np.pi / 2), (3, 1e-2, 0.0)],
)
def test_a_pair_too_close_for_double_precision_is_two_points_at_most(axis, apart, phase_rad):
    offsets = np.array([[0], [apart]]) * np.eye(4)[axis]
    close = scene(near_middle(offsets), phase_rad=[0.0, phase_rad])
    cloud = image(close)
    assert 1 <= len(cloud) <= 2
    assert np.abs(errors(close, cloud)[:, 0]).max() < 0.5


def test_no_more_scatterers_are_sought_than_asked_for_and_the_strongest_first():
    seen = Simulator(spread(2, 8)).observe(30.0)
    every, some = Nomp4d().estimate(seen), Nomp4d(max_scatterers=3).estimate(seen)
    assert (len(every), len(some)) == (8, 3)
    assert some.power.min() > np.sort(every.power)[3] / 2


def rmse_over_bound(snr_after_gain_db, n_trials):
    """RMSE over the Cramér-Rao bound (4,) of a lone scatterer at random places off the grid."""
    rng, found, n_false = np.random.default_rng(7), [], 0
    for trial in range(n_trials):
        scenario = scene(near_middle([rng.uniform(-2, 2, 4) * [1, 1, 0.5, 0.5]]), phase_rad=rng.uniform(0, 6))
        cloud = image(scenario, snr_after_gain_db, trial)
        error = errors(scenario, cloud)[:, 0]
        found.append(error[np.abs(error).max(axis=1).argmin()])
        n_false += len(cloud) - 1
    # Noise alone: no more often than pfa.
    assert n_false <= 1 + 0.01 * n_trials
    bound = single_bound(SYSTEM, (8, 8), 10 ** (snr_after_gain_db / 10) / (SYSTEM.processing_gain * 64))
    std = np.array([bound.range_m, bound.velocity_mps, bound.u, bound.w]) / CELLS
    return np.sqrt(np.mean(np.square(found), axis=0)) / std


@pytest.mark.parametrize(
    ("snr_after_gain_db", "n_trials", "slack"),
    [
        # RMSE of n Gaussian errors: relative standard deviation (2n)^(-1/2).
        (20.0, 10, 4 / np.sqrt(2 * 10)),
        *(pytest.param(snr_db, 1000, 0, marks=pytest.mark.slow) for snr_db in (20.0, 30.0, 60.0)),
    ],
)
def test_a_lone_scatterer_is_placed_within_a_tenth_of_the_bound(snr_after_gain_db, n_trials, slack):
    assert np.all(rmse_over_bound(snr_after_gain_db, n_trials) < 1.1 + slack)


@pytest.mark.parametrize(
    ("pfa", "n_trials", "most_images", "most_points"),
    [
        (0.01, 15, 1, 1),
        *(pytest.param(pfa, 1500, pfa * 1500, 2, marks=pytest.mark.slow) for pfa in (0.01, 0.1)),
    ],
)
def test_noise_makes_points_no_more_often_than_pfa_says(pfa, n_trials, most_images, most_points):
    counts = np.array([len(image(EMPTY, 0.0, trial, pfa=pfa)) for trial in range(n_trials)])
    assert (n_trials > 1000) <= np.count_nonzero(counts) <= most_images
    assert counts.max() <= most_points


@pytest.mark.parametrize(
    ("dimension", "apart", "phase_deg", "trial"),
    [
        *product(DIMENSIONS, [0.35], [0.0, 90.0, 180.0], [0]),
        # In nearly opposite phase: split and not flanked.
        *(("velocity", 0.25, 135.0, trial) for trial in range(2)),
        # Opposite: most of their echoes cancels.
        *product(["range", "velocity", "u"], [0.15], [180.0], [0]),
    ],
)
def test_coherent_pairs_closer_than_resolved_are_two(dimension, apart, phase_deg, trial):
    scenario = pair(EMPTY, f"pair{phase_deg}", MIDDLE, dimension, apart, phase_deg)
    along = np.sort(errors(scenario, image(scenario, 60.0, trial))[:, 0, DIMENSIONS.index(dimension)])
    np.testing.assert_allclose(along, [0, apart], atol=min(0.1, apart / 2))


@pytest.mark.slow
@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_pairs_a_quarter_of_a_cell_apart_are_two_in_nine_of_ten_images(dimension):
    resolved, limits = [], np.where(np.array(DIMENSIONS) == dimension, 0.125, 1)
    for phase_deg, trial in product((0.0, 45.0, 90.0, 135.0, 180.0), range(8)):
        scenario = pair(EMPTY, f"pair{phase_deg}", MIDDLE, dimension, 0.25, phase_deg)
        found = (np.abs(errors(scenario, image(scenario, 60.0, trial))) < limits).all(axis=2)
        resolved.append(found.any(axis=0).all())
    assert np.mean(resolved) >= 0.9


@pytest.mark.parametrize("snr_after_gain_db", [25.0, 40.0])
def test_a_row_of_echoes_in_phase_closer_than_resolved_is_seen_in_all_its_length(snr_after_gain_db):
    # In phase, most of what a row shows are its two ends.
    row = scene(near_middle(np.linspace(0, 6, 25)[:, None] * [1, 0, 0, 0]))
    error = np.abs(errors(row, image(row, snr_after_gain_db)))
    assert (error < 0.75).all(axis=2).any(axis=0).mean() > 0.8


@pytest.mark.slow
def test_scatterers_of_which_two_rounds_explain_less_than_half_are_sought_to_the_end():
    scenario = load_scenario("town[seed=200]")
    cloud = Nomp4d().estimate(Simulator(scenario).observe(10.0))
    scores = score(scenario.truth, cloud, region=scenario.region)
    assert scores["recall"] > 0.75
    assert scores["precision"] > 0.75


@pytest.fixture(scope="module")
def facade():
    """Crowd seen by a small array."""
    return replace(load_scenario("facade[seed=218,frame=paper]"), array=VirtualArray((1, 1), (8, 8), 1, 1))


def test_no_atom_of_a_crowd_is_left_on_the_grid_where_it_began(facade):
    cloud = image(facade, 10.0 + gain_db(facade))
    halves = 2 * radio_places(facade, cloud) / rayleigh_cells(facade)
    assert len(cloud) > 20
    assert not np.all(np.abs(halves - np.rint(halves)) < 1e-6, axis=1).any()


def test_atoms_of_a_crowd_in_noise_do_not_cancel_each_other(facade):
    # No cell holds the echo of a quarter of the crowd in phase; two that cancel had nine times that of all.
    cloud = Nomp4d().estimate(Simulator(facade).observe(-20.0))
    assert len(cloud) > 20
    assert cloud.power.max() < (facade.scatterers.amplitude.sum() / 4) ** 2


def test_an_image_does_not_depend_on_the_peaks_that_are_judged_first(facade, monkeypatch):
    clouds = []
    for n_first in (100, 10**9):
        monkeypatch.setattr(nomp4d, "STRONGEST_PEAKS", n_first)
        clouds.append(image(facade, 10.0 + gain_db(facade), max_rounds=3).xyz)
    assert len(clouds[0]) > 5
    np.testing.assert_array_equal(*clouds)


def test_a_weak_mover_beside_a_strong_scatterer_is_found():
    scenario = scene(near_middle([[0, 0, 0, 0], [0.4, 3.6, 0.3, -0.4]]), [10**1.5, 1.0])
    for trial in range(2):
        assert_found(scenario, image(scenario, 30.0, trial), 0.15, power=0.5)


def test_more_rounds_find_more():
    scenario = scene(near_middle([[0, 0, 0, 0], [3.3, 1.2, 0.4, -0.3]]), [10.0, 1.0])
    assert [len(image(scenario, 30.0, max_rounds=n)) for n in (1, 2)] == [1, 2]


def test_a_smaller_local_dynamic_range_drops_the_weak_beside_the_strong():
    scenario = scene(near_middle([[0, 0, 0, 0], [1.4, 0.2, 0.4, -0.3]]), [10**0.5, 1.0])
    images = (image(scenario, 30.0, local_dynamic_range_db=limit_db) for limit_db in (16.5, 6.0))
    lax, strict = (np.abs(errors(scenario, cloud)).max(axis=2) for cloud in images)
    assert np.all(lax.min(axis=0) < 0.1)
    assert strict[:, 0].min() < 0.1
    assert strict[:, 1].min() > 1


# Where a map is no sum of echoes.


def observation_of(spec):
    """Observation of a case of the stress test."""
    return stress_case(spec).make(Nomp4d())[0].scene.fresh_observation()


@pytest.fixture
def rounds(monkeypatch):
    """Number of atoms that each joint refinement within boxes starts from."""
    started = []

    def counted(self, pursuit, places):
        started.append(len(places))
        refine(self, pursuit, places)

    refine = Nomp4d._refine
    monkeypatch.setattr(Nomp4d, "_refine", counted)
    return started


@pytest.mark.parametrize(
    ("filled", "n_steps"),
    [
        ("constant", nomp4d.STEPS),
        *(pytest.param("constant", n_steps, marks=pytest.mark.slow) for n_steps in (3, 7)),
        *(pytest.param("checkers", n_steps, marks=pytest.mark.slow) for n_steps in (3, nomp4d.STEPS, 7)),
    ],
)
def test_equal_echoes_in_all_cells_give_the_same_image_however_they_are_rounded(filled, n_steps, monkeypatch):
    monkeypatch.setattr(nomp4d, "STEPS", n_steps)
    image, _ = stress_case(f"map[filled={filled},exponent=0.0]").make(Nomp4d())
    assert len(image.cloud)
    assert ANY_SCALE.measure(image) <= ANY_SCALE.bound


def test_a_map_that_is_no_sum_of_echoes_gets_few_atoms_and_ends(rounds):
    Nomp4d().estimate(observation_of("map[filled=constant,exponent=0.0]"))
    assert len(rounds) <= 12 + 2
    assert max(rounds) < 100


@pytest.mark.parametrize(("max_rounds", "scene"), [(4, "one_cell,snr_db=200.0"), (3, "region,snr_db=-20.0")])
def test_a_crowd_gets_all_its_rounds_though_noise_may_hide_most_of_the_echoes(rounds, max_rounds, scene):
    Nomp4d(max_rounds=max_rounds).estimate(observation_of(f"crowd[n_echoes=100,where={scene}]"))
    assert len(rounds) == max_rounds + 2


def test_the_round_that_reaches_the_most_scatterers_is_the_last(rounds):
    Nomp4d(max_scatterers=26).estimate(observation_of("crowd[n_echoes=5000,where=one_cell,snr_db=20.0]"))
    # Two refinements follow, of no more atoms.
    assert rounds.index(26) == len(rounds) - 3
    assert max(rounds) == 26
