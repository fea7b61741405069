import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.bench.cells.images import Image
from isacbench.bench.kinds.population import match_points, measure_lone_scatterers, scene_bound
from isacbench.model.cloud import PointCloud
from isacbench.model.radio_coordinates import radio_places, rayleigh_cells, space_places
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.dsp.tone_bounds import tone_std_bins
from tests.single_scores import all_matchings

SPACE = load_scenario("single")
PLACES = np.array([[64.0, 1.0, 0.0, 0.1], [66.0, -9.0, 0.15, -0.1], [68.0, 10.0, -0.15, 0.02]])
CELLS = rayleigh_cells(SPACE)


def scene(places=PLACES, amplitude=None):
    xyz, velocity = space_places(SPACE, places)
    amplitude = np.ones(len(places)) if amplitude is None else np.asarray(amplitude, dtype=float)
    return dataclasses.replace(SPACE, scatterers=Scatterers(xyz, velocity, amplitude))


def measured(places, snr_db=0.0, scenario=None):
    xyz, velocity = space_places(SPACE, np.reshape(places, (-1, 4)))
    cloud = PointCloud(xyz, velocity, np.ones(len(xyz)))
    shot = Image(scenario or scene(), None, None, snr_db, cloud)
    return tuple(measure_lone_scatterers(shot).values())


def test_the_truth_resolves_every_scatterer_without_a_false_point():
    assert measured(PLACES) == (3, 3, 0)


def test_an_empty_image_resolves_nothing_and_has_no_false_point():
    assert measured(np.empty((0, 4))) == (3, 0, 0)


@pytest.mark.parametrize("coordinate", range(4))
def test_a_scatterer_counts_as_resolved_up_to_three_standard_deviations_in_each_coordinate(coordinate):
    bound = scene_bound(scene(), 0.0)
    for share, n_resolved in ((2.99, 3), (-2.99, 3), (3.01, 2), (-3.01, 2)):
        places = PLACES.copy()
        places[1, coordinate] += share * bound[1, coordinate]
        assert measured(places) == (3, n_resolved, 0)


def test_the_second_point_of_a_scatterer_and_a_point_a_cell_away_are_false():
    doubled = np.concatenate([PLACES, PLACES[:1] + 0.3 * CELLS])
    assert measured(doubled) == (3, 3, 1)
    for coordinate in range(4):
        away = PLACES[2:] + 1.01 * np.eye(4)[[coordinate]] * CELLS
        assert measured(np.concatenate([PLACES[:2], away])) == (3, 2, 1)


def test_a_faint_scatterer_is_not_resolvable_and_its_point_is_not_false():
    # The bound of a tone falls with the root of its SNR.
    system, (n_p, n_q) = SPACE.system, SPACE.array.shape
    gain = system.processing_gain * n_p * n_q
    just = (tone_std_bins(n_p, 1.0) / 0.1) ** 2
    for factor, n in ((0.99, 2), (1.01, 3)):
        amplitude = np.array([1e3, 1e3, np.sqrt(factor * just)])
        # The noise has the power 1 after all gain, which makes the power of an echo its SNR.
        snr_db = 10 * np.log10(np.sum(amplitude**2) / gain)
        assert measured(PLACES, snr_db, scene(amplitude=amplitude)) == (n, n, 0)


def test_scatterers_in_one_place_are_not_resolvable():
    twice = np.concatenate([PLACES, PLACES[:1]])
    assert measured(PLACES, scenario=scene(twice)) == (2, 2, 0)


def test_the_bound_is_that_of_a_lone_scatterer_where_others_are_far_away():
    n = [SPACE.system.n_subcarriers, SPACE.system.n_symbols, *SPACE.array.shape]
    gain = SPACE.system.processing_gain * np.prod(SPACE.array.shape)
    lone = [tone_std_bins(samples, gain / len(PLACES)) for samples in n]
    np.testing.assert_allclose(scene_bound(scene(), 0.0) / CELLS, np.tile(lone, (3, 1)), rtol=0.05)


@given(st.integers(0, 4), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_points_are_matched_as_by_trying_all_matchings(n_points, n_scatterers, seed):
    rng = np.random.default_rng(seed)
    error = rng.uniform(-1, 1, (n_points, 1, 4)) - rng.uniform(-1, 1, (1, n_scatterers, 4))
    points, scatterers = match_points(error)
    possible = (
        pairs
        for pairs in all_matchings(n_points, n_scatterers)
        if all((abs(error[p]) < 1).all() for p in pairs)
    )
    n, distance = max((len(pairs), -sum(np.linalg.norm(error[p]) for p in pairs)) for pairs in possible)
    assert len(points) == n == len(set(points)) == len(set(scatterers))
    assert np.linalg.norm(error[points, scatterers], axis=1).sum() == pytest.approx(-distance)


def test_places_come_back_from_space():
    np.testing.assert_allclose(radio_places(SPACE, scene().scatterers), PLACES, atol=1e-12)
