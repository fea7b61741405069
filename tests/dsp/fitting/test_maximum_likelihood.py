"""Maximum likelihood of a cell's plane waves: to the bound, and no more waves than there are.

Slope and curvature of its fits against differences, and fits against plain algebra.
"""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.fitting.maximum_likelihood import fit_waves, real_snapshots, refined, resolve_directions
from isacbench.model.kernels import steering
from tests.conftest import few
from tests.dsp.plane_wave_data import least_squares, noise, pairs_of, separate_sources, snapshot, waves

N_P, N_Q = 16, 12
RAYLEIGH = np.array([2 / N_P, 2 / N_Q])


def shot(u, w, gain):
    """Noise-free snapshot (1, 1, P, Q)."""
    return snapshot(u, w, gain, (N_P, N_Q))[None]


def refine_directions(snapshots, start, n_steps):
    """Directions of the likeliest waves from a start, as many as there are in it."""
    fit = refined(real_snapshots(snapshots), start.u, start.w, start.found, n_steps)
    return PlaneWaves(fit.u, fit.w, start.found)


@st.composite
def scenes(draw):
    """One to four sources more than a Rayleigh cell apart, and starts a fifth of one beside them."""
    u, w, gain = draw(separate_sources())
    offset = draw(st.lists(st.floats(-0.2, 0.2), min_size=2 * len(u), max_size=2 * len(u)))
    return u, w, gain, np.reshape(offset, (-1, 2)) * RAYLEIGH


@given(scene=scenes())
def test_noise_free_sources_are_found_from_starts_beside_them(scene):
    u, w, gain, offset = scene
    found = refine_directions(shot(u, w, gain), waves(u + offset[:, 0], w + offset[:, 1]), 15)
    np.testing.assert_allclose(found.u[0], u, atol=1e-6)
    np.testing.assert_allclose(found.w[0], w, atol=1e-6)


@few
@given(scene=scenes(), seed=st.integers(0, 99))
def test_no_direction_nearby_leaves_less_unexplained(scene, seed):
    u, w, gain, offset = scene
    data = shot(u, w, gain) + 0.2 * noise(1, 2, N_P, N_Q, seed=seed)
    found = refine_directions(data, waves(u + offset[:, 0], w + offset[:, 1]), 30)
    places = np.concatenate([found.u, found.w])
    _, least = least_squares(data[0], *places)
    for axis, k, step in product((0, 1), range(len(u)), (-1e-4, 1e-4)):
        moved = places.copy()
        moved[axis, k] += step
        assert least_squares(data[0], *moved)[1] >= least


@few
@given(scenes(), st.tuples(*[st.floats(-0.14, 0.14)] * 2), st.integers(-20, 20), st.integers(0, 99))
def test_directions_follow_a_shift_and_know_neither_scale_nor_order(scene, shift, exponent, seed):
    u, w, gain, offset = scene
    data = shot(u, w, gain) + 0.1 * noise(1, 1, N_P, N_Q, seed=seed)
    start = u + offset[:, 0], w + offset[:, 1]
    found = refine_directions(data, waves(*start), 8)
    turned = 2.0**exponent * data * np.outer(steering(N_P, shift[0]), steering(N_Q, shift[1]))
    again = refine_directions(turned, waves(start[0][::-1] + shift[0], start[1][::-1] + shift[1]), 8)
    np.testing.assert_allclose(again.u[0][::-1] - shift[0], found.u[0], atol=1e-7)
    np.testing.assert_allclose(again.w[0][::-1] - shift[1], found.w[0], atol=1e-7)


def test_one_source_is_placed_as_well_as_the_bound_of_cramer_and_rao_allows():
    n, gain = 600, 1.0
    rng = np.random.default_rng(1)
    u, w = rng.uniform(-0.9, 0.9, (2, n, 1))
    offset = rng.uniform(-0.2, 0.2, (2, n, 1)) * RAYLEIGH[:, None, None]
    data = steering(N_P, u)[:, :, :, None] * steering(N_Q, w)[:, :, None, :] * gain
    # 23 dB after the gain of all elements: clear of the threshold.
    found = refine_directions(data + noise(n, 1, N_P, N_Q), waves(u + offset[0], w + offset[1]), 10)
    for error, n_line in ((found.u - u, N_P), (found.w - w, N_Q)):
        bound = np.sqrt(6 / (N_P * N_Q * np.pi**2 * (n_line**2 - 1))) / gain
        assert 0.9 < np.sqrt(np.mean(error**2)) / bound < 1.1


def test_all_snapshots_of_a_cell_share_their_directions():
    u, w = np.array([0.1, 0.16]), np.array([0.0, 0.05])
    data = np.concatenate([shot(u, w, [1, 1]), shot(u, w, [1, -1])], axis=1)
    data = data + 0.1 * noise(1, 2, N_P, N_Q)
    both = refine_directions(data, waves(u + 0.01, w - 0.01), 15)
    np.testing.assert_allclose(both.u[0], u, atol=0.01)
    np.testing.assert_allclose(both.w[0], w, atol=0.01)


@pytest.mark.parametrize("k", [1, 2, 4])
def test_what_is_separate_stays_and_what_noise_would_explain_leaves(k):
    rng, n, slots = np.random.default_rng(k), 200, np.array([-0.6, -0.2, 0.2, 0.6])
    u, w = (np.array([rng.permutation(slots)[:k] for _ in range(n)]) for _ in range(2))
    gain = rng.uniform(5, 20, (n, k)) * np.exp(2j * np.pi * rng.uniform(size=(n, k)))
    data = np.einsum("nk,nkp,nkq->npq", gain, steering(N_P, u), steering(N_Q, w))[:, None]
    data = data + noise(n, 1, N_P, N_Q, seed=k)
    offset = rng.uniform(-0.2, 0.2, (2, n, k)) * RAYLEIGH[:, None, None]
    # The first source twice, and a wave where nothing is.
    start_u, start_w = u + offset[0], w + offset[1]
    nowhere = rng.uniform(0.8, 1, (2, n, 1))
    start_u = np.concatenate([start_u, start_u[:, :1] + 0.1 * RAYLEIGH[0], nowhere[0]], axis=1)
    start_w = np.concatenate([start_w, start_w[:, :1], nowhere[1]], axis=1)
    found = resolve_directions(data, waves(start_u, start_w), 1.0, 1e-5, 10)
    right = found.found.sum(axis=1) == k
    # Two waves three deviations apart are two; of one source in noise they are in about one case of 200.
    assert np.mean(~right) < 0.02
    for cell in np.flatnonzero(right):
        places = sorted(zip(found.u[cell][found.found[cell]], found.w[cell][found.found[cell]], strict=True))
        np.testing.assert_allclose(places, sorted(zip(u[cell], w[cell], strict=True)), atol=0.02)


def test_of_a_cell_of_noise_one_wave_is_left():
    start = np.random.default_rng(0).uniform(-0.9, 0.9, (2, 30, 4))
    found = resolve_directions(noise(30, 1, N_P, N_Q), waves(*start), 1.0, 1e-5, 5)
    assert found.found.sum(axis=1).tolist() == [1] * 30


@pytest.mark.parametrize("n_steps", [0, 5])
def test_fillers_and_empty_batches_are_left_alone(n_steps):
    data = shot([0.1], [0.2], [1.0])
    start = PlaneWaves(np.array([[0.1, 0.7]]), np.array([[0.2, 0.7]]), np.array([[True, False]]))
    for solve in (
        lambda data, start: refine_directions(data, start, n_steps),
        lambda data, start: resolve_directions(data, start, 1e-9, 1e-5, n_steps),
    ):
        found = solve(data, start)
        assert found.found.tolist() == [[True, False]]
        assert found.u[0, 1] == 0.7
        np.testing.assert_allclose(found.u[0, 0], 0.1, atol=1e-9)
        nobody = PlaneWaves(start.u, start.w, np.zeros((1, 2), dtype=bool))
        assert not solve(data, nobody).found.any()
        empty = PlaneWaves(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2), dtype=bool))
        assert solve(data[:0], empty).u.shape == (0, 2)


def test_coinciding_directions_become_one():
    data = shot([0.1], [0.2], [1.0]) + 0.01 * noise(1, 1, N_P, N_Q)
    found = resolve_directions(data, waves([0.1, 0.1, 0.1], [0.2, 0.2, 0.2]), 1e-4, 1e-5, 5)
    assert found.found.sum() == 1
    np.testing.assert_allclose(pairs_of(found), [[0.1, 0.2]], atol=1e-3)


@pytest.mark.parametrize("snr_db", [-10, 10, 300])
def test_last_digits_of_the_snapshots_decide_nothing(snr_db):
    rng = np.random.default_rng(5)
    u, w = rng.uniform(-0.5, 0.5, (2, 200, 3)) + np.array([-0.5, 0, 0.5]) * 0.9
    clean = np.einsum("nkp,nkq->npq", steering(8, u), steering(6, w))[:, None]
    data = clean + 10 ** (-snr_db / 20) * noise(*clean.shape, seed=5)
    nudged = data * (1 + 1e-15 * rng.standard_normal(data.shape))
    one, other = (refine_directions(cells, waves(u + 0.02, w - 0.02), 40) for cells in (data, nudged))
    # Where the unexplained power stopped falling, ends were up to 1e-6 apart.
    apart = np.maximum(np.abs(one.u - other.u), np.abs(one.w - other.w)).max(axis=1)
    assert np.quantile(apart, 0.95) < 1e-12
    if snr_db > 0:
        assert apart.max() < 1e-9


@pytest.mark.parametrize("phase", [1, 1j, -1])
@pytest.mark.parametrize("cells", [0.1, 0.03])
def test_a_noise_free_pair_of_any_phase_is_held_at_its_places(cells, phase):
    u, w = np.array([0.1, 0.1 + cells * RAYLEIGH[0]]), np.array([0.2, 0.2])
    middle = np.exp(7.5j * np.pi * u)
    data = shot(u, w, middle * [1, phase])
    distance = u[1] - u[0]
    found = refine_directions(data, waves(u + 1e-6 * distance, w), 30)
    np.testing.assert_allclose(found.u[0], u, atol=1e-2 * distance)
    np.testing.assert_allclose(found.w[0], w, atol=1e-2 * distance)


def test_without_noise_a_pair_stays_two():
    u, w = np.array([0.1, 0.13]), np.array([0.2, 0.2])
    found = resolve_directions(shot(u, w, [1, 1j]), waves(u + 1e-3, w), 0.0, 1e-5, 20)
    assert found.found.all()
    np.testing.assert_allclose(found.u[0], u, atol=1e-12)


@pytest.mark.parametrize(("cells", "second"), [(0.1, 0.9), (0.1, 0.5), (0.05, 0.9), (0.05, 0.5)])
@pytest.mark.parametrize("beside", [-0.05, 0.05])
def test_a_close_pair_in_phase_is_followed_to_the_end_of_its_curved_valley(cells, second, beside):
    u, w = 0.1 + np.array([0, cells]) * RAYLEIGH[0], 0.2 + np.array([0, cells]) * RAYLEIGH[1]
    in_phase = np.exp(1j * np.pi * ((N_P - 1) / 2 * u + (N_Q - 1) / 2 * w))
    offset = np.array([-0.18, 0.18]) + beside
    start = waves(u.mean() + offset * RAYLEIGH[0], w.mean() + offset * RAYLEIGH[1])
    found = resolve_directions(shot(u, w, in_phase * [1, second]), start, 1e-12, 1e-5, 10)
    # Ten steps, half of them taken back, ended as far beside the pair as its waves are apart.
    assert found.found.all()
    np.testing.assert_allclose(pairs_of(found), np.stack([u, w], axis=1), atol=1e-12)


SMALL = 7, 6
NUMBERS = ("unexplained", "gradient", "curvature", "hessian", "power", "alone")


@st.composite
def small_cells(draw):
    """Two cells of noise in two snapshots, up to three directions of each; one may be a filler."""
    rng = np.random.default_rng(draw(st.integers(0, 9999)))
    k = draw(st.integers(1, 3))
    data = noise(2, 2, *SMALL, seed=rng)
    u = np.sort(rng.uniform(-0.2, 0.2, (2, k)), axis=1) + 0.6 * (np.arange(k) - 1)
    w = rng.uniform(-0.8, 0.8, (2, k))
    found = np.ones((2, k), dtype=bool)
    found[1, -1] = k == 1 or draw(st.booleans())
    return data, u, w, found


@pytest.mark.parametrize("seed", range(4))
def test_slope_and_curvature_are_those_of_the_unexplained_power(seed):
    rng = np.random.default_rng(seed)
    data = noise(1, 2, *SMALL, seed=rng)
    places, found = rng.uniform(-0.8, 0.8, (1, 6)), np.ones((1, 3), dtype=bool)

    def fit(places):
        return fit_waves(real_snapshots(data), places[:, :3], places[:, 3:], found)

    here, step = fit(places), 1e-5
    for k in range(6):
        there, back = (fit(places + sign * step * (np.arange(6) == k)) for sign in (1, -1))
        slope = -(there.unexplained - back.unexplained) / (4 * step)
        np.testing.assert_allclose(here.gradient[:, k], slope, atol=1e-6 * np.abs(here.gradient).max())
        bend = -(there.gradient - back.gradient) / (2 * step)
        np.testing.assert_allclose(here.hessian[:, k], bend, atol=1e-6 * np.abs(here.hessian).max())


@given(cell=small_cells())
def test_what_is_left_is_what_plain_least_squares_leaves(cell):
    data, u, w, found = cell
    fit = fit_waves(real_snapshots(data), u, w, found)
    for n in range(2):
        _, left = least_squares(data[n], u[n][found[n]], w[n][found[n]])
        assert fit.unexplained[n] == pytest.approx(left, rel=1e-9)


def test_coinciding_waves_share_their_amplitude_and_fillers_have_none():
    data = np.outer(steering(8, 0.1), steering(8, 0.2))[None, None]
    u, w = np.array([[0.1, 0.1, 0.5]]), np.array([[0.2, 0.2, 0.5]])
    fit = fit_waves(real_snapshots(data), u, w, np.array([[True, True, False]]))
    assert all(np.isfinite(getattr(fit, name)).all() for name in NUMBERS)
    assert fit.unexplained[0] < 1e-12 * np.sum(np.abs(data) ** 2)
    assert fit.power[0, 2] == 0
