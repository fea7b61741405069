"""Pairing of direction cosines: sources kept, intersections that are none left out."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.aperture import Cross, Plane
from isacbench.dsp.angles.peaks import Peaks
from isacbench.dsp.angles.plane_waves import NOISE_DEVIATIONS, PlaneWaves, pair_directions
from isacbench.model.kernels import steering
from isacbench.model.observation import cross_of
from tests.dsp.plane_wave_data import noise, pairs_of, responses, separate_sources, snapshot, waves

N_P, N_Q = 16, 12
PLANE = Plane(N_P, N_Q)
CROSS = Cross(N_P, N_Q)
shot = partial(snapshot, shape=(N_P, N_Q))
ON_BOTH = pytest.mark.parametrize("aperture", [PLANE, CROSS], ids=["plane", "cross"])
LIMITS = {"min_power": 1e-8, "dynamic_range_db": 40.0, "n_most": 9}


def candidates(cosine):
    """Peaks of one cell."""
    places = np.unique(cosine)[None]
    return Peaks(places, np.ones(places.shape, dtype=bool))


@given(scene=separate_sources())
def test_of_all_intersections_exactly_the_sources_are_kept(scene):
    u, w, gain = scene
    found = pair_directions(shot(u, w, gain), PLANE, candidates(u), candidates(w), **LIMITS)
    assert pairs_of(found) == sorted(zip(u, w, strict=True))


@ON_BOTH
@given(scene=separate_sources(), seed=st.integers(0, 999), n_found=st.integers(0, 4))
def test_amplitudes_and_what_they_leave_are_those_of_dense_least_squares_on_the_elements(
    aperture, scene, seed, n_found
):
    u, w, gain = scene
    n = min(n_found, len(u))
    cells = noise(2, N_P, N_Q, seed=seed) + np.concatenate([shot(u, w, gain), shot(u, w, 1j * gain)])
    dense = responses(u[:n], w[:n], (N_P, N_Q))
    if aperture is CROSS:
        cells, dense = cross_of(cells), cross_of(dense)
    data, dense = cells.reshape(2, -1).T, dense.reshape(n, cells[0].size).T
    amplitude = np.linalg.lstsq(dense, data, rcond=None)[0]
    found = PlaneWaves(np.stack([u, u]), np.stack([w, w]), np.tile(np.arange(len(u)) < n, (2, 1)))
    first, second = found.amplitudes(np.stack([cells, 2j * cells]), aperture)[:, :, :n]
    np.testing.assert_allclose(first, amplitude.T, atol=1e-7)
    np.testing.assert_allclose(second, 2j * amplitude.T, atol=1e-7)
    left = np.mean(np.abs(data - dense @ amplitude) ** 2, axis=0)
    np.testing.assert_allclose(found.unexplained(cells, aperture), left, rtol=1e-7)


def dense_direction_errors(data, dense, n_p, n_q, p, q, white):
    """Errors of k directions from responses (elements, k), with every derivative written out."""
    k, n = dense.shape[1], len(data)
    amplitude = np.linalg.lstsq(dense, data, rcond=None)[0]
    left = np.sum(np.abs(data - dense @ amplitude) ** 2) - white * (n - 2 * k)
    slopes = [-2j * np.pi / size * place[:, None] * dense * amplitude for size, place in ((n_p, p), (n_q, q))]
    jacobian = np.concatenate([dense, 1j * dense, *slopes], axis=1)
    real = np.concatenate([jacobian.real, jacobian.imag])
    spread = np.diag(np.linalg.inv(real.T @ real))[2 * k :]
    return np.sqrt((spread[:k] + spread[k:]) * (max(left, 0) + NOISE_DEVIATIONS**2 * white / 2))


@ON_BOTH
@pytest.mark.parametrize("white", [0.0, 0.01, 4.0])
@given(scene=separate_sources(), seed=st.integers(0, 999))
def test_errors_of_directions_are_those_of_the_dense_information_and_misfit(aperture, white, scene, seed):
    u, w, gain = scene
    p, q = np.divmod(np.arange(N_P * N_Q), N_Q)
    cell = shot(u, w, gain) + noise(1, N_P, N_Q, seed=seed)
    dense = responses(u, w, (N_P, N_Q))
    if aperture is CROSS:
        cell, dense = cross_of(cell), cross_of(dense)
        p, q = cross_of(p.reshape(N_P, N_Q)), cross_of(q.reshape(N_P, N_Q))
    expected = dense_direction_errors(
        cell.ravel(), dense.reshape(len(u), -1).T, N_P, N_Q, p.ravel(), q.ravel(), white
    )
    found = PlaneWaves(np.append(u, 0.9)[None], np.append(w, 0.9)[None], np.arange(len(u) + 1)[None] < len(u))
    errors = found.direction_errors(cell, aperture, white)[0]
    np.testing.assert_allclose(errors, [*expected, 0], rtol=1e-5)


@pytest.mark.parametrize(("aperture", "axes"), [(Plane(2, 2), (2, 2)), (Cross(2, 2), (3,))])
def test_the_error_of_a_direction_is_a_number_however_near_another_one_is(aperture, axes):
    rng = np.random.default_rng(0)
    distance = np.geomspace(1e-9, 1, 200)[:, None]
    u, w = (np.clip(0.1 + distance * rng.standard_normal((200, 4)), -1, 1) for _ in range(2))
    cells = noise(200, *axes, seed=2)
    assert not np.isnan(waves(u, w).direction_errors(cells, aperture, 1e-3)).any()


@given(scene=separate_sources())
def test_waves_that_explain_their_cell_stay_however_small_the_error_allowed(scene):
    u, w, gain = scene
    assert waves(u, w).determined(shot(u, w, gain), PLANE, 0.0, 1e-3).found.all()


def test_a_direction_between_scatterers_of_opposite_phase_leaves_and_the_strong_wave_stays():
    # One strong wave, and a second where two opposite ones 1.2 Rayleigh cells apart leave nothing.
    u, w = np.array([-0.4, 0.35, 0.35 + 2.4 / N_P]), np.zeros(3)
    cell = shot(u, w, np.array([1.0, 0.3, -0.3]))
    for u, kept in (([-0.4, 0.35 + 1.0 / N_P], [True, False]), ([0.35 + 1.0 / N_P], [True])):
        between = waves(u, np.zeros(len(u)))
        assert between.determined(cell, PLANE, 1e-6, 0.35).found.tolist() == [kept]


@given(scene=separate_sources(), order=st.permutations(range(4)), phase=st.floats(0, 2 * np.pi))
def test_on_a_cross_what_is_of_one_amplitude_on_column_and_row_is_a_pair(scene, order, phase):
    u, w, gain = scene
    # Waves of equal amplitude could be paired either way.
    gain = 0.6 ** np.array(order[: len(u)]) * np.exp(1j * phase) * np.array([1, 1j, -1, -1j])[: len(u)]
    cells = cross_of(shot(u, w, gain))
    found = pair_directions(cells, CROSS, candidates(u), candidates(w), **LIMITS)
    assert set(zip(u, w, strict=True)) <= set(pairs_of(found))
    amplitude = np.abs(found.amplitudes(cells[None], CROSS)[0, 0])
    true = [(a, b) in set(zip(u, w, strict=True)) for a, b in zip(found.u[0], found.w[0], strict=True)]
    assert amplitude[~np.array(true)].max(initial=0) < 1e-3


@pytest.mark.parametrize("w_amplitudes", [(1.0, 0.5), (1.0, 0.3)])
def test_which_of_equal_pairs_a_cross_takes_does_not_depend_on_rounding(w_amplitudes):
    # The column sees a strong and a weak wave, the row two whose amplitudes are those of neither.
    u, w = np.array([0.1, -0.5]), np.array([-0.2, 0.6])
    column = steering(N_P, u).T @ np.array([1.2, 0.02])
    row = steering(N_Q, w).T @ np.array(w_amplitudes)
    pairs = set()
    for phase, dtype in product(np.linspace(0, 6, 20), (np.complex64, np.complex128)):
        cells = (np.exp(1j * phase) * np.concatenate([column, row[1:]])[None]).astype(dtype)
        peaks = (Peaks(line[None], np.ones((1, 2), dtype=bool)) for line in (u, w))
        found = pair_directions(cells, CROSS, *peaks, **LIMITS)
        assert found.found.sum() == 3
        pairs.add(tuple(pairs_of(found)))
    assert pairs == {((-0.5, -0.2), (0.1, -0.2), (0.1, 0.6))}


def test_waves_of_some_cells_are_theirs():
    u = np.arange(6.0).reshape(3, 2) / 10
    keep = np.array([True, False, True])
    some = PlaneWaves(u, -u, u > 0.1).select(keep)
    for actual, expected in ((some.u, u), (some.w, -u), (some.found, u > 0.1)):
        assert actual.tolist() == expected[keep].tolist()


def test_sources_that_share_a_column_or_a_row_are_told_apart():
    u, w, gain = np.array([-0.3, -0.3, 0.4]), np.array([-0.5, 0.2, 0.2]), np.array([1.0, 0.8j, -1.2])
    found = pair_directions(shot(u, w, gain), PLANE, candidates(u), candidates(w), **LIMITS)
    assert pairs_of(found) == sorted(zip(u, w, strict=True))


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        *(({}, 3), ({"n_most": 2}, 2), ({"dynamic_range_db": 30.0}, 2), ({"dynamic_range_db": 10.0}, 1)),
        *(({"min_power": 0.05}, 1), ({"min_power": 2.0}, 0)),
    ],
)
def test_power_dynamic_range_and_number_limit_what_is_kept_strongest_first(limits, expected):
    u, w = np.array([-0.5, 0.0, 0.5]), np.array([0.5, -0.5, 0.0])
    amplitude = 10 ** (-np.array([0, 15, 32]) / 20)
    found = pair_directions(shot(u, w, amplitude), PLANE, candidates(u), candidates(w), **LIMITS | limits)
    assert found.u[0][found.found[0]].tolist() == u[:expected].tolist()


def test_without_candidates_nothing_is_found():
    none = Peaks(np.empty((1, 0)), np.empty((1, 0), dtype=bool))
    assert not pair_directions(shot([0], [0], [1]), PLANE, none, candidates([0.0]), **LIMITS).found.any()


@pytest.mark.parametrize("db", [60, 140, 155])
def test_of_two_sources_far_apart_in_power_both_are_paired_without_noise(db):
    u, w = np.array([-0.4, 0.1]), np.array([0.3, -0.2])
    data = shot(u, w, [1, 10 ** (-db / 20)])
    # A tie that is coarser than the weak source paired it with anything.
    found = pair_directions(data, PLANE, candidates(u), candidates(w), 1e-18, 170.0, 2)
    np.testing.assert_allclose(pairs_of(found), sorted(zip(u, w, strict=True)))


def test_what_is_left_of_explained_snapshots_is_rounding():
    u, w = [-0.4, 0.1], [0.3, -0.2]
    # The loading alone would leave 1e-18.
    assert waves(u, w).unexplained(shot(u, w, [1, 0.3j]), PLANE)[0] < 1e-28
