"""Unitary ESPRIT on exact subspaces, where it is exact, and where it is not to be trusted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.line_subspaces import unitary_transform
from isacbench.dsp.angles.planar_subspaces import (
    leading_eigenpairs,
    most_sources,
    planar_covariance,
    planar_eigenpairs,
    unitary_esprit,
)
from isacbench.model.kernels import steering, within_period
from tests.dsp.plane_wave_data import noise, plain_covariance, responses, separate_sources, snapshot

CONSTELLATIONS = {
    "one": ([0.3], [-0.2]),
    "equal u": ([0.2, 0.2], [-0.4, 0.5]),
    "equal w": ([-0.4, 0.5], [0.2, 0.2]),
    "three on a line along u": ([-0.3, 0.0, 0.3], [0.1, 0.1, 0.1]),
    "three on a diagonal": ([-0.3, 0.0, 0.3], [-0.2, 0.0, 0.2]),
    "corners of a rectangle": ([-0.2, -0.2, 0.3, 0.3], [-0.3, 0.2, -0.3, 0.2]),
    "edge of the visible region": ([0.98, -0.98, 0.0], [0.0, 0.1, 0.98]),
    "a quarter of a Rayleigh cell": ([0.1, 0.13125], [0.2, 0.2]),
}


def solve(snapshots, subarray, order):
    """ESPRIT on the signal subspaces of snapshots."""
    vectors = leading_eigenpairs(planar_covariance(snapshots[:, None], subarray), order)[1]
    return unitary_esprit(vectors.reshape(len(snapshots), *subarray, order))


def pairs_of(u, w):
    return sorted(zip(np.round(u, 4) + 0.0, np.round(w, 4) + 0.0, strict=True))


@pytest.mark.parametrize("turns", [0, 0.25, 0.5])
@pytest.mark.parametrize("name", CONSTELLATIONS)
def test_coherent_sources_of_one_noise_free_snapshot_are_found_in_pairs(name, turns):
    u, w = (np.array(cosines) for cosines in CONSTELLATIONS[name])
    # Phases at the middle of the aperture, where they matter.
    gain = np.exp(2j * np.pi * turns * np.arange(len(u)) + 7.5j * np.pi * (u + w))
    found = solve(snapshot(u, w, gain), (8, 8), len(u))
    assert found.reliable.all()
    np.testing.assert_allclose(pairs_of(found.u[0], found.w[0]), pairs_of(u, w), atol=2e-4)


@given(scene=separate_sources(), shift=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)))
def test_directions_move_with_the_sources_and_do_not_depend_on_their_order(scene, shift):
    u, w, gain = scene
    turned = snapshot(u, w, gain) * np.outer(steering(16, shift[0]), steering(16, shift[1]))
    found = solve(turned, (8, 8), len(u))
    moved = pairs_of(u + shift[0], w + shift[1])
    np.testing.assert_allclose(pairs_of(found.u[0], found.w[0]), moved, atol=2e-4)
    swapped = solve(snapshot(u[::-1], w[::-1], gain[::-1]), (8, 8), len(u))
    np.testing.assert_allclose(pairs_of(swapped.u[0], swapped.w[0]), pairs_of(u, w), atol=2e-4)


def test_as_many_sources_as_a_subarray_can_tell_apart_are_found():
    assert most_sources((2, 2)) == 2
    assert most_sources((8, 8)) == 56
    # Independent directions of a basis instead of a snapshot's few looks.
    u, w = np.array([-0.6, -0.1, 0.5, 0.8]), np.array([0.2, 0.7, -0.5, 0.1])
    turn = np.kron(unitary_transform(3), unitary_transform(3)).conj().T
    centre = np.exp(1j * np.pi * (u + w))
    steered = (centre[:, None] * responses(u, w, (3, 3)).reshape(4, 9)).T
    basis = np.linalg.qr((turn @ steered).real)[0].reshape(1, 3, 3, 4)
    found = unitary_esprit(basis)
    np.testing.assert_allclose(pairs_of(found.u[0], found.w[0]), pairs_of(u, w), atol=2e-4)


def test_a_pair_that_noise_turned_to_the_wrong_axis_is_not_reliable():
    # Opposite echoes a tenth of a Rayleigh cell apart in u, at the limit of resolution.
    u, w = np.array([0.0, 0.0125]), np.array([0.1, 0.1])
    gain = 62.5 * np.array([1, -1]) * np.exp(7.5j * np.pi * (u + w))
    found = solve(snapshot(u, w, gain) + noise(200, 16, 16), (8, 8), 2)
    along_u = np.ptp(found.u, axis=1) > np.ptp(found.w, axis=1)
    assert 0.05 < np.mean(~found.reliable) < 0.6
    assert np.mean(along_u[~found.reliable]) < 0.1
    assert np.mean(along_u[found.reliable]) > 0.8


def solve_data(snapshots, subarray, order):
    """ESPRIT on the signal subspaces of snapshots, with the digits that they take."""
    vectors = planar_eigenpairs(snapshots[:, None], subarray, order + 1).vectors[:, :, :order]
    return unitary_esprit(vectors.reshape(len(snapshots), *subarray, order))


def farthest(found, u, w):
    """Distance of the source that is farthest from what was found."""
    return np.hypot(found.u[0][:, None] - u, found.w[0][:, None] - w).min(axis=0).max()


@pytest.mark.parametrize("phase", [1, 1j, -1])
@pytest.mark.parametrize("cells", [0.1, 0.03])
def test_a_pair_much_closer_than_a_rayleigh_cell_is_told_apart_without_noise(cells, phase):
    u, w = np.array([0.1, 0.1 + cells / 8]), np.array([0.2, 0.2])
    gain = np.exp(7.5j * np.pi * (u + w)) * [1, phase]
    found = solve_data(snapshot(u, w, gain), (10, 10), 2)
    assert farthest(found, u, w) < 1e-3 * (u[1] - u[0])


@pytest.mark.parametrize("inside", [1e-3, 1e-6, 1e-9, 0.0])
def test_a_source_at_the_very_edge_is_right_and_leaves_the_others_right(inside):
    u, w = np.array([1 - inside, 0.3]), np.array([0.0, 0.2])
    found = solve_data(snapshot(u, w, [1, 1j]), (10, 10), 2)
    # Half a cell off from normal equations.
    assert farthest(found, u, w) < 1e-7


@pytest.mark.parametrize("u", [0.0, 0.5, 0.9, 0.97, 0.999, 1.0])
def test_a_source_in_noise_is_placed_as_well_at_the_ends_of_the_circle_as_broadside(u):
    n, size, snr = 400, 16, 10**-0.5
    data = snapshot([u], [0.1], [1.0]) + noise(n, size, size, seed=3) / np.sqrt(snr)
    error = within_period(solve(data, (10, 10), 1).u[:, 0] - u)
    bound = 6 / (snr * np.pi**2 * size**2 * (size**2 - 1))
    # Smoothing costs a factor of about 1.6; a bias towards broadside would add its square.
    assert 1.2 < np.mean(error**2) / bound < 1.9
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(n)


def complex_total_least_squares(snapshots, subarray, order):
    """Cosines u of sources by ESPRIT on complex subspaces, as textbooks write it."""
    found = []
    for one in snapshots:
        vectors = np.linalg.eigh(plain_covariance(one, subarray))[1]
        signal = vectors[:, -order:].reshape(*subarray, order)
        pair = np.concatenate([signal[:-1].reshape(-1, order), signal[1:].reshape(-1, order)], axis=1)
        null = np.linalg.svd(pair)[2].conj().T[:, order:]
        found.append(-np.angle(np.linalg.eigvals(-null[:order] @ np.linalg.inv(null[order:]))) / np.pi)
    return np.array(found)


@pytest.mark.parametrize("u", [(0.95, -0.2, 0.4), (0.98, 0.7, -0.98), (0.1, 0.22, -0.6)])
def test_errors_of_several_sources_are_those_of_complex_total_least_squares(u):
    w = np.array([0.1, 0.5, -0.6])
    data = snapshot(np.array(u), w, [1, 1j, -1]) + noise(60, 16, 16, seed=5) * 0.3

    def mean_square(cosines):
        apart = within_period(cosines[:, :, None] - np.array(u))
        return np.mean(np.abs(apart).min(axis=1) ** 2)

    mine, reference = solve(data, (8, 8), 3).u, complex_total_least_squares(data, (8, 8), 3)
    assert mean_square(mine) < 1.5 * mean_square(reference)
