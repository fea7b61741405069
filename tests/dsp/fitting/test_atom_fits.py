"""Joint fits against dense least squares, numerical gradients and the Cramér-Rao bound."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.bounds import joint_bound
from isacbench.dsp.fitting.atom_fits import LEAST_OWN, fit_atoms, polish_atoms, refine_atoms
from isacbench.model.gate import Gate
from isacbench.model.numerology import System
from tests.conftest import few
from tests.dsp.fitting.noisy_maps import dense, noisy_map

SYSTEM = System(n_subcarriers=20, n_symbols=12)
SHAPE = (4, 3)
WHOLE = Gate(np.arange(20), np.arange(-6, 6), slice(0, 20), slice(0, 12))
PART = Gate(np.arange(5, 14), np.arange(-3, 4), slice(2, 7), slice(2, 5))
PLACES = np.array([[8.3, 0.4, 0.2, -0.3], [8.9, 0.1, 0.5, -0.2], [10.0, -1.6, -1.1, 0.7]])
AMPLITUDE = np.array([1.0 + 2j, -1.5 + 0.3j, 0.8j])


noisy = partial(noisy_map, SYSTEM, SHAPE)


def covariance(fit, noise):
    """Bound (4, n, 4, n) of the places."""
    return (noise / 2 * fit.bound_root @ fit.bound_root.T).reshape(4, len(fit), 4, len(fit))


def test_amplitudes_and_energy_are_those_of_least_squares():
    atom_map = noisy(PART, PLACES, AMPLITUDE, 0.3)
    moved = PLACES + 0.1
    fit, atoms, cells = fit_atoms(atom_map, moved), dense(atom_map, moved), atom_map.cells.ravel()
    expected, *_ = np.linalg.lstsq(atoms, cells)
    np.testing.assert_allclose(fit.amplitude, expected, rtol=1e-6)
    explained = np.sum(np.abs(cells) ** 2) - np.sum(np.abs(cells - atoms @ expected) ** 2)
    assert fit.energy == pytest.approx(explained, rel=1e-8)
    np.testing.assert_allclose(fit.power, np.abs(expected) ** 2, rtol=1e-6)
    assert len(fit) == 3


def test_the_score_is_half_the_gradient_of_the_explained_energy():
    atom_map, places, step = noisy(PART, PLACES, AMPLITUDE, 0.3), PLACES - 0.07, 1e-5
    gradient = np.empty((4, len(places)))
    for axis, atom in np.ndindex(gradient.shape):
        shift = np.zeros_like(places)
        shift[atom, axis] = step
        ahead, behind = (fit_atoms(atom_map, places + sign * shift).energy for sign in (1, -1))
        gradient[axis, atom] = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(fit_atoms(atom_map, places).score, gradient.ravel() / 2, atol=1e-6)


def test_on_the_whole_map_the_covariance_is_the_joint_bound():
    fit = fit_atoms(noisy(WHOLE, PLACES, AMPLITUDE, 0.0), PLACES)
    unit = np.array([SYSTEM.range_bin_m, SYSTEM.velocity_bin_mps, 2 / SHAPE[0], 2 / SHAPE[1]])
    n_total = SYSTEM.processing_gain * np.prod(SHAPE)
    # `joint_bound` refers phases to the first element, atoms to the middle.
    first = np.array([19 / 20, -11 / 12, 3 / 4, 2 / 3])
    amplitude = AMPLITUDE / np.sqrt(n_total) * np.exp(1j * np.pi * PLACES @ first)
    bound = joint_bound(SYSTEM, SHAPE, *(PLACES * unit).T, amplitude, 0.01)
    expected = bound.joint_covariance.transpose(1, 0, 3, 2) / unit[:, None, None, None] / unit[:, None]
    actual = covariance(fit, 0.01)
    np.testing.assert_allclose(actual, expected, atol=1e-6 * expected.max())


@few
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.1, 0.5, np.inf]))
def test_steps_stay_within_their_limits_and_never_explain_less(seed, width):
    rng = np.random.default_rng(seed)
    atom_map = noisy(PART, PLACES, AMPLITUDE, 0.5, seed)
    starts = PLACES[0] + rng.uniform(-1, 1, (3, 4))
    limits = starts - width, starts + width
    fits = [refine_atoms(atom_map, starts, steps, limits) for steps in range(6)]
    assert all(np.all((limits[0] <= fit.places) & (fit.places <= limits[1])) for fit in fits)
    energies = np.array([fit.energy for fit in fits])
    assert energies[0] == fit_atoms(atom_map, starts).energy
    # But for rounding: at the optimum any step is as good.
    assert np.all(np.diff(energies) >= -1e-11 * energies[:-1])


def test_steps_lead_to_the_exact_places_without_noise():
    atom_map = noisy(PART, PLACES, AMPLITUDE, 0.0)
    start = PLACES + np.array([[0.1, -0.1, 0.1, 0.1], [0.1, 0.1, -0.1, 0.1], [-0.1, 0.1, 0.1, -0.1]])
    fit = refine_atoms(atom_map, start, 25)
    np.testing.assert_allclose(fit.places, PLACES, atol=1e-7)
    np.testing.assert_allclose(fit.amplitude, AMPLITUDE, rtol=1e-5)


def test_steps_that_lead_two_atoms_to_one_place_are_taken_back_whatever_they_explain():
    atom_map = noisy(PART, PLACES[:1], AMPLITUDE[:1], 0.0)
    starts = PLACES[0] + np.array([[0, 0.3, 0, 0], [0, 0.5, 0, 0]])
    fit = refine_atoms(atom_map, starts, 4, (PLACES[0], PLACES[0]))
    np.testing.assert_array_equal(fit.places, starts)
    assert fit.energy < fit_atoms(atom_map, PLACES[:1]).energy
    assert fit.own.min() > LEAST_OWN > fit_atoms(atom_map, PLACES[[0, 0]]).own.max()


def test_of_two_atoms_that_nearly_cancel_little_is_shown_and_all_of_a_lone_one():
    places = PLACES[0] + np.array([[0, 0, 0, 0], [0, 0.1, 0, 0], [6, 0, 0, 0]])
    fit = fit_atoms(noisy(PART, places, np.array([5.0, -5.0, 2.0]), 0.0), places)
    np.testing.assert_allclose(fit.power, [25, 25, 4], rtol=1e-6)
    # The product of two atoms a tenth of a cell apart is 1 - (π/10)² / 6.
    assert np.all(fit.shown_energy[:2] < 25 * 0.03**2)
    np.testing.assert_allclose(fit.shown_energy[2], 4, rtol=0.02)


def test_two_atoms_in_one_place_share_an_amplitude():
    fit = fit_atoms(noisy(PART, PLACES[:1], AMPLITUDE[:1], 0.0), PLACES[[0, 0]])
    np.testing.assert_allclose(fit.amplitude.sum(), AMPLITUDE[0], rtol=1e-6)
    assert np.all(np.isfinite(fit.bound_root))


@pytest.mark.parametrize("moves", [False, True])
def test_a_refit_of_some_atoms_is_a_fit_of_them(moves):
    atom_map = noisy(PART, PLACES, AMPLITUDE, 0.3)
    before, places = fit_atoms(atom_map, PLACES), PLACES.copy()
    if moves:
        places[2] += 0.1
    keep = np.array([True, False, True])
    value = before.correlations.value.copy()
    again, fresh = (fit_atoms(atom_map, places[keep], known=known) for known in (before, None))
    for name in ("places", "amplitude", "energy", "score", "information"):
        np.testing.assert_allclose(getattr(again, name), getattr(fresh, name), rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(before.correlations.value, value)


def bound_by_qr(atom_map, places, amplitude):
    """Covariance (4, n, 4, n) in unit noise from all atoms and slopes on the data: nothing is squared."""
    factors, n = atom_map.lines(places), len(places)
    atoms, slopes = zip(*((line.value, line.slope * amplitude[:, None]) for line in factors), strict=True)
    columns = [(*atoms[:axis], slopes[axis], *atoms[axis + 1 :]) for axis in range(4)]
    columns = [atoms, (atoms[0] * 1j, *atoms[1:]), *columns]
    dense_columns = np.concatenate([np.einsum("kr,kd,ku,kw->krduw", *c).reshape(n, -1) for c in columns])
    triangle = np.linalg.qr(np.concatenate([dense_columns.real, dense_columns.imag], axis=1).T, mode="r")
    root = np.linalg.solve(triangle, np.eye(6 * n))[2 * n :]
    return 0.5 * (root @ root.T).reshape(4, n, 4, n)


# Three elements along w see three waves: a pair in phase has no place there, however far apart.
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("turn", "known_from"), [(1.0, 0.05), (1j, 2e-3), (np.exp(0.3j), 5e-3)])
def test_variances_of_close_atoms_are_right_as_long_as_rounding_allows(axis, turn, known_from):
    amplitude = np.array([1.0, turn])
    for apart in 10.0 ** np.arange(-0.5, -9, -0.75):
        places = PLACES[0] + apart * np.array([[0], [1]]) * np.eye(4)[axis]
        atom_map = noisy(WHOLE, places, amplitude, 0.0)
        fit = fit_atoms(atom_map, places)
        assert np.all(np.isfinite(fit.bound_root))
        if apart > known_from:
            both = covariance(fit, 1.0), bound_by_qr(atom_map, places, amplitude)
            actual, expected = (bound[axis, :, axis].diagonal() for bound in both)
            np.testing.assert_allclose(actual, expected, rtol=0.06)


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("apart", [0.03, 0.2])
@pytest.mark.parametrize("turn", [0.6, 0.6j, -0.6, 0.6 * np.exp(0.7j)])
def test_without_one_of_two_close_atoms_as_much_is_lost_as_a_fit_of_the_others_leaves(axis, apart, turn):
    places = np.concatenate([PLACES, PLACES[:1] + apart * np.eye(4)[axis]])
    atom_map = noisy(WHOLE, places, np.append([1.0, *AMPLITUDE[1:] / 4], turn), 0.0)
    fit, others = fit_atoms(atom_map, places), fit_atoms(atom_map, places[:3])
    lost = fit.lost_without()[3]
    assert lost[3] == pytest.approx(fit.energy - others.energy, rel=1e-6)
    one_moves = np.array([[np.inf], [1e-9], [1e-9]])
    moved = refine_atoms(atom_map, places[:3], 12, (places[:3] - one_moves, places[:3] + one_moves))
    assert lost[0] == pytest.approx(fit.energy - moved.energy, rel=0.4)


@given(st.sets(st.integers(0, 3), min_size=1), st.sampled_from([0.0, 0.01, 1.0]))
def test_some_atoms_explain_what_a_fit_without_them_does_not(some, ridge):
    places = np.concatenate([PLACES, PLACES[:1] + 0.3])
    atom_map = noisy(WHOLE, places, np.append(AMPLITUDE, 1j), 0.01)
    fit = fit_atoms(atom_map, places, ridge)
    others = fit_atoms(atom_map, np.delete(places, sorted(some), axis=0), ridge)
    assert fit.energy_of(np.array(sorted(some))) == pytest.approx(fit.energy - others.energy, rel=1e-6)


def test_amplitudes_of_close_opposite_atoms_keep_their_digits():
    # Their condition number is 1e6; a loading of 1e-10 alone would cost 1e-4.
    places = PLACES[[0, 0]] + np.array([[0.0], [1e-3]]) * np.eye(4)[0]
    fit = fit_atoms(noisy(WHOLE, places, np.array([1.0, -1.0]), 0.0), places)
    np.testing.assert_allclose(fit.amplitude, [1, -1], atol=1e-7)


def test_steps_reach_the_optimum_although_rounding_hides_what_they_gain():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        atom_map = noisy(PART, PLACES[1:], AMPLITUDE[1:], 0.03, seed)
        near = refine_atoms(atom_map, PLACES[1:], 30).places
        starts = near + 1e-8 * rng.standard_normal((2, *near.shape))
        one, other = (refine_atoms(atom_map, start, 4).places for start in starts)
        np.testing.assert_allclose(one, other, atol=1e-10, rtol=0)


def close_pair(apart, turn=1.0):
    """Places of two atoms apart along Doppler, and their amplitudes."""
    return PLACES[[0, 0]] + apart * np.array([[0.0], [1.0]]) * np.eye(4)[1], np.array([1.0, 0.9 * turn])


@pytest.mark.parametrize(("apart", "turn"), [(0.2, 1.0), (0.1, 1.0), (0.05, 1.0), (0.02, 1j), (0.1, -1.0)])
def test_settled_close_atoms_lose_digits_by_their_condition_and_not_by_its_square(apart, turn):
    places, amplitude = close_pair(apart, turn)
    atom_map = noisy(WHOLE, places, amplitude, 0.0)
    start = refine_atoms(atom_map, places + 1e-3 * apart * np.array([[1.0], [-1.0]]), 30)
    fit = polish_atoms(atom_map, start, 3)
    # Root of the variance in noise as small as the last digit of the strongest cell.
    error = np.sqrt(bound_by_qr(atom_map, places, amplitude).reshape(8, 8).diagonal().max())
    allowed = 100 * np.finfo(np.float64).eps * error
    np.testing.assert_allclose(fit.places, places, atol=allowed, rtol=0)
    np.testing.assert_allclose(fit.amplitude, amplitude, atol=10 * allowed / apart, rtol=0)


def test_settling_leaves_the_optimum_in_noise_where_it_is():
    places, amplitude = close_pair(0.3)
    atom_map = noisy(WHOLE, places, amplitude, 1e-3)
    fit = refine_atoms(atom_map, places, 60)
    settled = polish_atoms(atom_map, fit, 3)
    np.testing.assert_allclose(settled.places, fit.places, atol=1e-9)
    np.testing.assert_allclose(settled.amplitude, fit.amplitude, atol=1e-8)


@given(st.integers(0, 10_000), st.integers(1, 4))
def test_settling_never_leaves_more(seed, n_steps):
    atom_map = noisy(PART, PLACES, AMPLITUDE, 0.5, seed)
    starts = PLACES + np.random.default_rng(seed).uniform(-0.4, 0.4, PLACES.shape)

    def left(fit):
        return atom_map.without(atom_map.lines(fit.places), fit.amplitude).energy

    fit = fit_atoms(atom_map, starts)
    assert left(polish_atoms(atom_map, fit, n_steps)) <= left(fit) * (1 + 1e-10)
