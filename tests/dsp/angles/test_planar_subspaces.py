"""Planar subspaces in real arithmetic, against their complex definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.line_subspaces import real_steering, smoothed_covariance
from isacbench.dsp.angles.planar_subspaces import (
    leading_eigenpairs,
    null_minima,
    planar_covariance,
    planar_null_spectrum,
)
from tests.dsp.plane_wave_data import (
    noise,
    plain_covariance,
    separate_sources,
    snapshot,
    unitary_transform,
)

GRID = np.linspace(-1, 1, 65)


def signal_basis(snapshots, subarray, order):
    """Basis (n, L, M, order) of the signal subspaces."""
    vectors = leading_eigenpairs(planar_covariance(snapshots[:, None], subarray), order)[1]
    return vectors.reshape(len(snapshots), *subarray, order)


LENGTHS = st.integers(1, 11), st.integers(1, 5)


@given(st.tuples(*LENGTHS), st.tuples(*[st.integers(0, 4)] * 2), st.integers(0, 999))
def test_covariances_are_forward_backward_averages_turned_by_the_unitary_transform(subarray, more, seed):
    snapshots = noise(2, *np.add(subarray, more), seed=seed)
    snapshots.setflags(write=False)
    along_lines = smoothed_covariance(snapshots, subarray[0]), (subarray[0], 1)
    for found, part in ((planar_covariance(snapshots[:, None], subarray), subarray), along_lines):
        turn = np.kron(*map(unitary_transform, part))
        for cell, covariance in zip(snapshots, found, strict=True):
            expected = turn.conj().T @ plain_covariance(cell, part) @ turn
            assert np.abs(expected.imag).max() < 1e-12
            np.testing.assert_allclose(covariance, expected.real, atol=1e-12)


@pytest.mark.parametrize("n_pairs", [1, 4, 6, 30])
def test_leading_eigenpairs_are_those_of_the_whole_decomposition(n_pairs):
    signal = snapshot([-0.5, 0.1, 0.6, -0.2], [0.3, -0.4, 0.5, 0.1], [100, 30, 10, 3])
    covariance = planar_covariance((signal + noise(5, 16, 16))[:, None], (8, 8))
    values, vectors = leading_eigenpairs(covariance, n_pairs)
    expected_values, expected_vectors = np.linalg.eigh(covariance)
    n_sources = min(n_pairs, 4)
    np.testing.assert_allclose(values[:, :n_sources], expected_values[:, ::-1][:, :n_sources], rtol=1e-6)
    likeness = np.abs(np.sum(vectors * expected_vectors[:, :, ::-1][:, :, :n_pairs], axis=1))
    np.testing.assert_allclose(likeness[:, :n_sources], 1, atol=1e-5)
    identity = vectors.transpose(0, 2, 1) @ vectors
    np.testing.assert_allclose(identity, np.broadcast_to(np.eye(n_pairs), identity.shape), atol=1e-12)


@given(seed=st.integers(0, 999), order=st.integers(1, 5))
def test_the_null_spectrum_is_the_squared_distance_from_the_subspace(seed, order):
    basis = signal_basis(noise(2, 9, 8, seed=seed), (5, 4), order)
    u, w = GRID[::9], GRID[3::11]
    found = planar_null_spectrum(basis, u, w)
    for cell in range(2):
        columns = basis[cell].reshape(20, order)
        for i, k in np.ndindex(u.size, w.size):
            d = np.kron(real_steering(5, u[[i]])[:, 0], real_steering(4, w[[k]])[:, 0])
            expected = np.sum((d - columns @ (columns.T @ d)) ** 2)
            assert found[cell, i, k] == pytest.approx(expected, abs=1e-10)


@given(scene=separate_sources())
def test_nulls_lie_on_noise_free_sources_off_the_grid(scene):
    u, w, gain = scene
    basis = signal_basis(snapshot(u, w, gain), (8, 8), len(u))
    nulls = null_minima(basis, GRID, GRID, np.array([len(u)]))
    np.testing.assert_allclose(sorted(map(tuple, nulls.place)), sorted(zip(u, w, strict=True)), atol=1e-6)


def test_the_curvature_of_a_null_is_that_of_the_spectrum():
    basis = signal_basis(snapshot([0.1, 0.35], [0.2, 0.3], [1, 1j]), (8, 8), 2)
    nulls = null_minima(basis, GRID, GRID, np.array([2]))
    step = 1e-4
    for (u, w), curvature in zip(nulls.place, nulls.curvature, strict=True):
        around = planar_null_spectrum(basis, u + step * np.arange(-1, 2), w + step * np.arange(-1, 2))[0]
        along_u = (around[2, 1] - 2 * around[1, 1] + around[0, 1]) / step**2
        along_w = (around[1, 2] - 2 * around[1, 1] + around[1, 0]) / step**2
        mixed = (around[2, 2] - around[2, 0] - around[0, 2] + around[0, 0]) / (4 * step**2)
        np.testing.assert_allclose(curvature, [[along_u, mixed], [mixed, along_w]], rtol=1e-3, atol=1)


def test_another_step_would_lead_nowhere_from_the_flattest_null():
    basis, step = signal_basis(noise(40, 9, 9), (6, 6), 5), 1e-4
    coarse = np.linspace(-0.9, 0.9, 19)
    nulls = null_minima(basis, coarse, coarse, np.full(40, 5))
    away = np.array([-1, 1])
    steps = []
    for cell, (u, w), curvature in zip(nulls.cell, nulls.place, nulls.curvature, strict=True):
        along_u = planar_null_spectrum(basis[[cell]], u + step * away, [w])[0, :, 0]
        along_w = planar_null_spectrum(basis[[cell]], [u], w + step * away)[0, 0]
        gradient = np.array([np.diff(along_u)[0], np.diff(along_w)[0]]) / (2 * step)
        steps.append(np.abs(np.linalg.solve(curvature, gradient)).max())
    assert len(steps) > 100
    # But for those that lie outside of what a start reaches.
    assert np.quantile(steps, 0.9) < 1e-7


def test_shallow_minima_are_no_sources_but_the_deepest_always_counts():
    basis = signal_basis(snapshot([0.1], [0.2], [1]), (8, 8), 1)
    assert null_minima(basis, GRID, GRID, np.array([5])).cell.size == 1
    away = np.linspace(0.4, 0.9, 17)
    # Sidelobes of the only source, far above half.
    assert null_minima(basis, away, away, np.array([5])).cell.size == 1
