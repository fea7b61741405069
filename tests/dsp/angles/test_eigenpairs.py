"""Rounding of signal subspaces: bounds that hold, missing gaps, digits that last."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.line_subspaces import MOST_ROTATION, line_eigenpairs, separated_order, with_rounding
from isacbench.dsp.angles.planar_subspaces import planar_eigenpairs
from tests.dsp.plane_wave_data import noise, snapshot

EPS = np.finfo(np.float64).eps


def orthogonal(n, rng):
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def covariance_pairs(values, rng):
    """Eigenpairs of a covariance of given eigenvalues."""
    turn = orthogonal(len(values), rng)
    found, vectors = np.linalg.eigh((turn * values) @ turn.T)
    return with_rounding(found[None, ::-1], vectors[None, :, ::-1]), turn


def sine_between(one, other):
    """Sine of the largest angle between the spaces of two orthonormal bases."""
    return np.linalg.norm(other - one @ (one.T @ other), 2)


@given(st.lists(st.floats(-13, 0), min_size=3, max_size=9), st.integers(1, 8), st.integers(0, 999))
def test_no_subspace_of_a_covariance_is_farther_off_than_its_bound(decades, order, seed):
    values = np.sort(10.0 ** np.array(decades))[::-1]
    order = min(order, len(values) - 1)
    pairs, turn = covariance_pairs(values, np.random.default_rng(seed))
    off = sine_between(turn[:, :order], pairs.vectors[0, :, :order])
    bound = pairs.rotation[0, order - 1]
    # Near 1 the gap itself is rounding, and its bound with it; the data of the test are rounded as well.
    assert off <= 2 * bound + 40 * EPS or bound > 0.1


def test_a_cut_through_equal_eigenvalues_is_no_cut():
    pairs = covariance_pairs(np.array([9.0, 4.0, 4.0, 4.0, 1.0, 1.0]), np.random.default_rng(0))[0]
    found = [separated_order(pairs.rotation, np.array([asked])).item() for asked in range(1, 6)]
    assert found == [1, 1, 1, 4, 4]


@pytest.mark.parametrize("power", [1.0, 0.0])
def test_a_white_covariance_has_no_signal_subspace(power):
    pairs = with_rounding(np.full((1, 5), power), np.eye(5)[None])
    assert separated_order(pairs.rotation, np.array([4])).tolist() == [0]


@given(st.lists(st.sampled_from([0.0, 1e-9, MOST_ROTATION, 2e-3, 1.0]), max_size=6), st.integers(0, 7))
def test_the_order_is_the_largest_that_is_determined(sines, order):
    found = separated_order(np.array([sines]).reshape(1, -1), np.array([order]))
    determined = [k for k, sine in enumerate(sines[:order], 1) if sine <= MOST_ROTATION]
    assert found.tolist() == [max(determined, default=0)]


def test_of_one_noise_free_source_one_dimension_is_determined():
    data = snapshot([0.1], [0.2], [1.0])
    for pairs in (planar_eigenpairs(data[None], (8, 8), 5), line_eigenpairs(data, 10)):
        assert separated_order(pairs.rotation, np.array([4])).tolist() == [1]


@pytest.mark.parametrize(("cells", "order"), [(0.1, 2), (1e-2, 2), (1e-4, 1)])
def test_two_noise_free_echoes_in_phase_are_two_from_a_hundredth_of_a_cell_on(cells, order):
    u, w = np.array([0.1, 0.1 + cells / 8]), np.array([0.2, 0.2])
    gain = np.exp(7.5j * np.pi * (u + w))
    pairs = planar_eigenpairs(snapshot(u, w, gain)[None], (10, 10), 3)
    assert separated_order(pairs.rotation, np.array([2])).tolist() == [order]


def test_noise_80_db_below_leaves_the_subspace_of_the_sources_determined():
    data = noise(20, 1, 16, 16) + 7e3 * snapshot([0.1, -0.4], [0.2, 0.3], [1, 0.01])
    pairs = planar_eigenpairs(data, (8, 8), 7)
    assert (separated_order(pairs.rotation, np.full(20, 2)) == 2).all()


def test_eigenvalues_that_are_hardly_numbers_are_not_separated():
    pairs = with_rounding(np.array([[1.0, 3e-310, 1e-310, 0.0]]), np.eye(4)[None])
    assert (pairs.rotation < 1).tolist() == [[True, False, False]]
    assert pairs.rotation.max() == 1
