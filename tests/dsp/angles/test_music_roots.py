"""Root-MUSIC, against an independent implementation and in limit cases."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.line_subspaces import line_eigenpairs, music_roots
from isacbench.model.kernels import steering
from tests.dsp.plane_wave_data import noise

N_SENSORS, N_SUBARRAY = 16, 10
SPEED_OF_LIGHT_MPS = 3e8
"""As the other implementation has it."""


def line(cosines, amplitudes, level, seed):
    """Snapshot (1, 16, 1) of waves and noise."""
    wave = sum(g * steering(N_SENSORS, u) for u, g in zip(cosines, amplitudes, strict=True))
    return (wave + np.sqrt(level) * noise(N_SENSORS, seed=seed))[None, :, None]


def roots_of(snapshots, order, limits=(-1.0, 1.0)):
    """Cosines, ascending."""
    vectors = line_eigenpairs(snapshots, N_SUBARRAY).vectors
    found = music_roots(vectors, np.array([order]), limits)
    return np.sort(found.place[0][found.found[0]])


def theirs(snapshots, order):
    """Cosines by the other implementation, from the same subarrays, forwards and backwards."""
    from doa_py.algorithm import root_music  # brings hundreds of modules

    x = snapshots[0, :, 0]
    shifts = range(N_SENSORS - N_SUBARRAY + 1)
    forwards = np.stack([x[k : k + N_SUBARRAY] for k in shifts], axis=1)
    both = np.concatenate([forwards, forwards[::-1].conj()], axis=1)
    # It subtracts means, which the negatives of all snapshots make zero.
    data = np.concatenate([both, -both], axis=1)
    # Sensors half a wavelength apart.
    positions = 0.5 * np.outer(np.arange(N_SUBARRAY), [0, 1, 0])
    array = SimpleNamespace(num_antennas=N_SUBARRAY, array_position=positions)
    return np.sort(np.sin(root_music(data, order, array, SPEED_OF_LIGHT_MPS, unit="rad")))


@given(st.integers(0, 9999), st.floats(-0.8, 0.2), st.floats(0.15, 0.5), st.floats(0, 2 * np.pi))
def test_directions_are_those_of_another_implementation(seed, first, apart, phase):
    x = line([first, first + apart], [1.0, 0.8 * np.exp(1j * phase)], 1e-2, seed)
    np.testing.assert_allclose(roots_of(x, 2), theirs(x, 2), atol=1e-8)


@given(cosine=st.floats(-0.95, 0.95))
def test_without_noise_a_lone_wave_is_exact(cosine):
    assert roots_of(line([cosine], [1.0], 0.0, 0), 1) == pytest.approx([cosine], abs=1e-10)


@given(first=st.floats(-0.8, 0.2), apart=st.floats(0.2, 0.6), phase=st.floats(0, 2 * np.pi))
def test_without_noise_two_waves_are_exact(first, apart, phase):
    x = line([first, first + apart], [1.0, np.exp(1j * phase)], 0.0, 0)
    np.testing.assert_allclose(roots_of(x, 2), [first, first + apart], atol=1e-8)


def test_directions_beyond_the_limits_are_left_out():
    x = line([-0.5, 0.4], [1.0, 1.0j], 1e-4, 0)
    np.testing.assert_allclose(roots_of(x, 2, (0.0, 1.0)), [0.4], atol=0.02)


def test_no_more_directions_than_the_order_and_none_of_an_empty_subspace():
    x = np.concatenate([line([-0.5, 0.4], [1.0, 1.0j], 1e-4, seed) for seed in range(3)])
    vectors = line_eigenpairs(x, N_SUBARRAY).vectors
    found = music_roots(vectors, np.array([2, 0, 1]), (-1.0, 1.0))
    assert found.found.sum(axis=1).tolist() == [2, 0, 1]
    assert np.isfinite(found.place).all()
    assert music_roots(vectors, np.zeros(3, dtype=int), (-1.0, 1.0)).found.sum() == 0


def test_a_sensor_alone_has_no_direction():
    x = np.zeros((1, N_SENSORS, 1), dtype=complex)
    x[0, 8, 0] = 1.0
    vectors = line_eigenpairs(x, N_SUBARRAY).vectors
    # Eigenvectors of single sensors: their spectrum is flat.
    assert not music_roots(vectors, np.array([1]), (-1.0, 1.0)).found.any()
