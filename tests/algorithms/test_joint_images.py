"""`music2d_joint` and `esprit2d` from echo to image: close pairs, the Cramér-Rao bound, symmetries."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.esprit2d import Esprit2d
from isacbench_algorithms.music2d_joint import Music2dJoint

from isacbench.bench.cells.cell import MeasuredImage
from isacbench.bench.kinds.efficiency import BOUNDS, ERRORS
from isacbench.bench.kinds.efficiency import measure_efficiency as measure_error
from isacbench.model.array import VirtualArray
from isacbench.model.echo import Simulator
from isacbench.model.kernels import steering
from isacbench.model.radio_coordinates import DIMENSIONS, draw_place, gain_db, space_places
from isacbench.model.scene import Scatterers
from isacbench.model.scenes.scenario import load_scenario
from tests.algorithms.scenes import NOTHING, simulator

BOTH = pytest.mark.parametrize("estimator", [Esprit2d, Music2dJoint])


def image(scenario, estimator, gained_db, trial):
    """Shot of a scenario at an SNR after all gains of one unit scatterer."""
    snr_db = gained_db - gain_db(scenario)
    observation = Simulator(scenario).observe(snr_db, trial)
    return MeasuredImage(scenario, observation, estimator, snr_db, estimator.estimate(observation))


def one_scatterer(trial):
    """Scenario `single` with one unit scatterer at a place that knows no grid."""
    template = load_scenario("single")
    xyz, velocity = space_places(template, draw_place(template, trial, 0, 0.5)[None])
    return replace(template, scatterers=Scatterers(xyz, velocity, np.ones(1)))


def errors_over_bound(estimator, gained_db, trials):
    """Errors (trial, dimension) in standard deviations of the bound; each image must hold the one point."""
    rows = []
    for trial in trials:
        measured = measure_error(image(one_scatterer(trial), estimator, gained_db, trial))
        assert measured["hit"]
        assert not measured["n_false"]
        rows.append([measured[error] / measured[bound] for error, bound in zip(ERRORS, BOUNDS, strict=True)])
    return np.array(rows)


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("gained_db", [25.0, 35.0, 45.0, 60.0])
def test_directions_of_one_scatterer_err_by_less_than_1_3_of_the_cramer_rao_bound(estimator, gained_db):
    errors = errors_over_bound(estimator(), gained_db, range(60))
    ratio = dict(zip(DIMENSIONS, np.sqrt(np.mean(errors**2, axis=0)), strict=True))
    assert ratio["u"] < 1.3
    assert ratio["w"] < 1.3


@BOTH
def test_errors_scale_with_the_noise_however_strong_the_echo_is(estimator):
    some, strong = (errors_over_bound(estimator(), gained_db, range(1)) for gained_db in (50.0, 100.0))
    np.testing.assert_allclose(strong, some, atol=0.05)
    assert np.abs(some).max() < 4


@cache
def empty():
    """Observation of noise by 16 x 16 elements, whose region spans some directions only."""
    return simulator(NOTHING, array=VirtualArray((1, 1), (16, 16), 1, 1)).observe(0.0)


@given(
    n_waves=st.integers(1, 12),
    n_snapshots=st.sampled_from([1, 3]),
    spread=st.floats(0.01, 1.0),
    seed=st.integers(0, 9999),
)
def test_directions_that_esprit_takes_from_a_crowd_lie_inside_the_region(n_waves, n_snapshots, spread, seed):
    rng = np.random.default_rng(seed)
    n_cells = 5
    u, w = spread * rng.uniform(-1, 1, (2, n_cells, n_snapshots, n_waves))
    gain = rng.standard_normal((n_cells, n_snapshots, n_waves)) + 1j * rng.standard_normal(u.shape)
    snapshots = np.einsum("nsk,nskp,nskq->nspq", 10 * gain, steering(16, u), steering(16, w))
    noise = rng.standard_normal(snapshots.shape) + 1j * rng.standard_normal(snapshots.shape)
    method, observation = Esprit2d(), empty()
    subspaces = method.subspaces(snapshots + noise, 2.0)
    waves = method.crowd_directions(observation, subspaces)
    for places, (lower, upper) in zip((waves.u, waves.w), observation.cosine_limits, strict=True):
        assert (places[waves.found] >= lower).all()
        assert (places[waves.found] <= upper).all()
    # Nothing that a crowd shows is split: there are at most as many directions as dimensions.
    assert (waves.found.sum(axis=1) <= subspaces.order).all()


def test_where_all_directions_lie_inside_the_region_esprit_keeps_them():
    method, observation = Esprit2d(), empty()
    (lower_u, upper_u), (lower_w, upper_w) = observation.cosine_limits
    u = np.array([0.8 * lower_u + 0.2 * upper_u, 0.2 * lower_u + 0.8 * upper_u])
    w = np.array([0.7 * lower_w + 0.3 * upper_w, 0.3 * lower_w + 0.7 * upper_w])
    snapshot = np.einsum("k,kp,kq->pq", [10.0, 10.0j], steering(16, u), steering(16, w))
    waves = method.crowd_directions(observation, method.subspaces(snapshot[None, None], 1.0))
    assert waves.found.tolist() == [[True, True]]
    np.testing.assert_allclose(np.sort(waves.u[0]), np.sort(u), atol=1e-6)
