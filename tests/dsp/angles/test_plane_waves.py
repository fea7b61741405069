"""Pairing of direction cosines: sources kept, intersections that are none left out."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.aperture import Cross, Plane
from isacbench.dsp.angles.peaks import Peaks
from isacbench.dsp.angles.plane_waves import PlaneWaves, pair_directions
from isacbench.model.kernels import steering
from isacbench.model.observation import cross_of

N_P, N_Q = 16, 12
PLANE = Plane(N_P, N_Q)
LIMITS = {"min_power": 1e-8, "dynamic_range_db": 40.0, "n_most": 9}


def snapshot(u, w, amplitude):
    """Noise-free snapshot (1, P, Q): the sum over sources, written out."""
    cells = np.zeros((N_P, N_Q), dtype=complex)
    for u_k, w_k, amplitude_k in zip(u, w, amplitude, strict=True):
        for p in range(N_P):
            for q in range(N_Q):
                cells[p, q] += amplitude_k * np.exp(-1j * np.pi * (p * u_k + q * w_k))
    return cells[None]


def candidates(cosine):
    """Peaks of one cell."""
    places = np.unique(cosine)[None]
    return Peaks(places, np.ones(places.shape, dtype=bool))


@st.composite
def scenes(draw):
    """Draw one to four sources in as many distinct columns and rows, more than a Rayleigh cell apart."""
    k = draw(st.integers(1, 4))
    slots = np.array([-0.75, -0.25, 0.25, 0.75])
    u, w = (
        slots[draw(st.permutations(range(4)))[:k]]
        + np.array(draw(st.lists(st.floats(-0.1, 0.1), min_size=k, max_size=k)))
        for _ in range(2)
    )
    gain = [draw(st.floats(0.5, 2)) * np.exp(1j * draw(st.floats(0, 2 * np.pi))) for _ in range(k)]
    return u, w, np.array(gain)


def pairs_of(waves):
    """Pairs (u, w) found in the first cell, sorted."""
    return sorted(zip(waves.u[0][waves.found[0]], waves.w[0][waves.found[0]], strict=True))


@given(scene=scenes())
def test_of_all_intersections_exactly_the_sources_are_kept(scene):
    u, w, gain = scene
    waves = pair_directions(snapshot(u, w, gain), PLANE, candidates(u), candidates(w), **LIMITS)
    assert pairs_of(waves) == sorted(zip(u, w, strict=True))


@given(scene=scenes(), exponent=st.integers(-12, 12), phase=st.floats(0, 2 * np.pi))
def test_pairs_depend_neither_on_a_scale_nor_on_a_global_phase(scene, exponent, phase):
    u, w, gain = scene
    changed = 2.0**exponent * np.exp(1j * phase) * snapshot(u, w, gain)
    limits = LIMITS | {"min_power": LIMITS["min_power"] * 4.0**exponent}
    waves = pair_directions(changed, PLANE, candidates(u), candidates(w), **limits)
    assert pairs_of(waves) == sorted(zip(u, w, strict=True))


@given(scene=scenes())
def test_amplitudes_are_the_complex_ones_of_the_sources_jointly_in_every_snapshot(scene):
    u, w, gain = scene
    waves = PlaneWaves(u[None], w[None], np.ones((1, len(u)), dtype=bool))
    other = gain[::-1] * 1j
    snapshots = np.stack([snapshot(u, w, gain), snapshot(u, w, other)])
    amplitudes = waves.amplitudes(snapshots, PLANE)
    # The loading of 1e-9 that keeps Gram matrices invertible is the error.
    np.testing.assert_allclose(amplitudes[0, 0], gain, atol=1e-8)
    np.testing.assert_allclose(amplitudes[1, 0], other, atol=1e-8)


@given(scene=scenes(), seed=st.integers(0, 999))
def test_amplitudes_are_those_of_least_squares_on_all_elements(scene, seed):
    u, w, _ = scene
    rng = np.random.default_rng(seed)
    cells = rng.standard_normal((1, 1, N_P, N_Q)) + 1j * rng.standard_normal((1, 1, N_P, N_Q))
    responses = np.stack(
        [np.outer(steering(N_P, a), steering(N_Q, b)).ravel() for a, b in zip(u, w, strict=True)], axis=1
    )
    expected = np.linalg.lstsq(responses, cells.ravel(), rcond=None)[0]
    waves = PlaneWaves(u[None], w[None], np.ones((1, len(u)), dtype=bool))
    np.testing.assert_allclose(waves.amplitudes(cells, PLANE)[0, 0], expected, atol=1e-8)


@given(scene=scenes(), seed=st.integers(0, 999), n_found=st.integers(0, 4))
def test_what_waves_leave_unexplained_is_the_residual_of_dense_least_squares(scene, seed, n_found):
    u, w, gain = scene
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, N_P, N_Q)) + 1j * rng.standard_normal((2, N_P, N_Q))
    cells = noise + np.concatenate([snapshot(u, w, gain), snapshot(u, w, 1j * gain)])
    found = np.broadcast_to(np.arange(len(u)) < n_found, (2, len(u)))
    waves = PlaneWaves(np.stack([u, u]), np.stack([w, w]), found)
    for cell in range(2):
        responses = np.zeros((N_P * N_Q, int(found[cell].sum())), dtype=complex)
        for k in range(responses.shape[1]):
            responses[:, k] = np.outer(steering(N_P, u[k]), steering(N_Q, w[k])).ravel()
        amplitude = np.linalg.lstsq(responses, cells[cell].ravel(), rcond=None)[0]
        left = np.mean(np.abs(cells[cell].ravel() - responses @ amplitude) ** 2)
        assert waves.unexplained(cells, PLANE)[cell] == pytest.approx(left, rel=1e-7)


@given(scene=scenes(), seed=st.integers(0, 999))
def test_amplitudes_on_a_cross_are_those_of_dense_least_squares_on_its_elements(scene, seed):
    u, w, gain = scene
    parts = np.random.default_rng(seed).standard_normal((2, 1, N_P, N_Q))
    cells = cross_of(snapshot(u, w, gain) + 0.1 * (parts[0] + 1j * parts[1]))
    responses = np.concatenate([snapshot([u[k]], [w[k]], [1.0]) for k in range(len(u))])
    dense = cross_of(responses).T
    amplitude = np.linalg.lstsq(dense, cells[0], rcond=None)[0]
    waves = PlaneWaves(u[None], w[None], np.ones((1, len(u)), dtype=bool))
    cross = Cross(N_P, N_Q)
    np.testing.assert_allclose(waves.amplitudes(cells[None], cross)[0, 0], amplitude, atol=1e-7)
    left = np.mean(np.abs(cells[0] - dense @ amplitude) ** 2)
    assert waves.unexplained(cells, cross) == pytest.approx([left], rel=1e-7)


@given(scene=scenes(), order=st.permutations(range(4)), phase=st.floats(0, 2 * np.pi))
def test_on_a_cross_what_is_of_one_amplitude_on_column_and_row_is_a_pair(scene, order, phase):
    u, w, gain = scene
    # Waves of equal amplitude could be paired either way.
    gain = 0.6 ** np.array(order[: len(u)]) * np.exp(1j * phase) * np.array([1, 1j, -1, -1j])[: len(u)]
    cells = cross_of(snapshot(u, w, gain))
    waves = pair_directions(cells, Cross(N_P, N_Q), candidates(u), candidates(w), **LIMITS)
    assert set(zip(u, w, strict=True)) <= set(pairs_of(waves))
    amplitude = np.abs(waves.amplitudes(cells[None], Cross(N_P, N_Q))[0, 0])
    true = [(a, b) in set(zip(u, w, strict=True)) for a, b in zip(waves.u[0], waves.w[0], strict=True)]
    assert amplitude[~np.array(true)].max(initial=0) < 1e-3


@pytest.mark.parametrize("w_amplitudes", [(1.0, 0.5), (1.0, 0.3)])
def test_which_of_equal_pairs_a_cross_takes_does_not_depend_on_rounding(w_amplitudes):
    # The column sees a strong and a weak wave, the row two whose amplitudes are those of neither.
    u, w, cross = np.array([0.1, -0.5]), np.array([-0.2, 0.6]), Cross(N_P, N_Q)
    column = steering(N_P, u).T @ np.array([1.2, 0.02])
    row = steering(N_Q, w).T @ np.array(w_amplitudes)
    pairs = set()
    for phase, dtype in product(np.linspace(0, 6, 20), (np.complex64, np.complex128)):
        cells = (np.exp(1j * phase) * np.concatenate([column, row[1:]])[None]).astype(dtype)
        peaks = (Peaks(line[None], np.ones((1, 2), dtype=bool)) for line in (u, w))
        waves = pair_directions(cells, cross, *peaks, **LIMITS)
        assert waves.found.sum() == 3
        pairs.add(tuple(pairs_of(waves)))
    assert pairs == {((-0.5, -0.2), (0.1, -0.2), (0.1, 0.6))}


def test_exact_waves_leave_nothing_unexplained_and_no_waves_leave_all():
    u, w, gain = np.array([-0.3, 0.4]), np.array([0.1, -0.5]), np.array([1.0, 2.0j])
    cells = snapshot(u, w, gain)
    for found, left in ((True, 0.0), (False, np.mean(np.abs(cells) ** 2))):
        waves = PlaneWaves(u[None], w[None], np.full((1, 2), found))
        assert waves.unexplained(cells, PLANE) == pytest.approx([left], abs=1e-15)


def test_waves_of_some_cells_stay_resolved_or_not():
    u = np.arange(6.0).reshape(3, 2) / 10
    keep = np.array([True, False, True])
    waves = PlaneWaves(u, -u, u > 0.1, np.array([True, True, False]))
    some = waves.select(keep)
    assert some.u.tolist() == u[keep].tolist()
    assert some.w.tolist() == (-u[keep]).tolist()
    assert some.found.tolist() == (u > 0.1)[keep].tolist()
    assert some.resolved.tolist() == [True, False]
    assert PlaneWaves(u, -u, u > 0.1).select(keep).resolved is None


def test_sources_that_share_a_column_or_a_row_are_told_apart():
    u, w, gain = np.array([-0.3, -0.3, 0.4]), np.array([-0.5, 0.2, 0.2]), np.array([1.0, 0.8j, -1.2])
    waves = pair_directions(snapshot(u, w, gain), PLANE, candidates(u), candidates(w), **LIMITS)
    assert pairs_of(waves) == sorted(zip(u, w, strict=True))


def test_a_filler_has_no_amplitude_and_does_not_disturb_the_others():
    u, w = np.array([[0.1, 0.1]]), np.array([[-0.2, -0.2]])
    waves = PlaneWaves(u, w, np.array([[True, False]]))
    amplitude = waves.amplitudes(snapshot([0.1], [-0.2], [2j])[None], PLANE)[0, 0]
    np.testing.assert_allclose(amplitude, [2j, 0], atol=1e-8)


def test_cells_are_independent():
    cells = np.concatenate([snapshot([0.1], [0.2], [1]), snapshot([-0.4, 0.5], [0.6, -0.3], [1, 1])])
    u = Peaks(np.array([[0.1, 0.0], [-0.4, 0.5]]), np.array([[True, False], [True, True]]))
    w = Peaks(np.array([[0.2, 0.0], [0.6, -0.3]]), np.array([[True, False], [True, True]]))
    together = pair_directions(cells, PLANE, u, w, **LIMITS)
    assert together.found.sum(axis=1).tolist() == [1, 2]
    for cell in range(2):
        alone = pair_directions(
            cells[[cell]],
            PLANE,
            Peaks(u.place[[cell]], u.found[[cell]]),
            Peaks(w.place[[cell]], w.found[[cell]]),
            **LIMITS,
        )
        k = alone.found.sum()
        np.testing.assert_allclose(together.u[cell, :k], alone.u[0, :k])
        np.testing.assert_allclose(together.w[cell, :k], alone.w[0, :k])


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ({}, 3),
        ({"n_most": 2}, 2),
        ({"dynamic_range_db": 30.0}, 2),
        ({"dynamic_range_db": 10.0}, 1),
        ({"min_power": 0.05}, 1),
        ({"min_power": 2.0}, 0),
    ],
)
def test_power_dynamic_range_and_number_limit_what_is_kept_strongest_first(limits, expected):
    u, w = np.array([-0.5, 0.0, 0.5]), np.array([0.5, -0.5, 0.0])
    amplitude = 10 ** (-np.array([0, 15, 32]) / 20)
    waves = pair_directions(snapshot(u, w, amplitude), PLANE, candidates(u), candidates(w), **LIMITS | limits)
    assert waves.u[0][waves.found[0]].tolist() == u[:expected].tolist()


def test_without_candidates_nothing_is_found():
    none = Peaks(np.empty((1, 0)), np.empty((1, 0), dtype=bool))
    assert not pair_directions(snapshot([0], [0], [1]), PLANE, none, candidates([0.0]), **LIMITS).found.any()


def test_without_cells_nothing_is_found():
    none = Peaks(np.empty((0, 2)), np.empty((0, 2), dtype=bool))
    found = pair_directions(np.empty((0, N_P, N_Q), dtype=complex), PLANE, none, none, **LIMITS).found
    assert len(found) == 0


@pytest.mark.parametrize("db", [60, 140, 155])
def test_of_two_sources_far_apart_in_power_both_are_paired_without_noise(db):
    u, w = np.array([-0.4, 0.1]), np.array([0.3, -0.2])
    data = snapshot(u, w, [1, 10 ** (-db / 20)])
    # A tie that is coarser than the weak source paired it with anything.
    waves = pair_directions(data, PLANE, candidates(u), candidates(w), 1e-18, 170.0, 2)
    np.testing.assert_allclose(pairs_of(waves), sorted(zip(u, w, strict=True)))


def test_what_is_left_of_explained_snapshots_is_rounding():
    u, w, gain = np.array([[-0.4, 0.1]]), np.array([[0.3, -0.2]]), np.array([1, 0.3j])
    data = snapshot(u[0], w[0], gain)
    waves = PlaneWaves(u, w, np.ones((1, 2), dtype=bool))
    # The loading alone would leave 1e-18.
    assert waves.unexplained(data, PLANE)[0] < 1e-28
