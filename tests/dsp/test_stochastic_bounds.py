"""The stochastic bound against filled matrices, numerical Fisher matrices, and the deterministic bound."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.bounds import joint_bound, single_bound, stochastic_bound
from isacbench.model.numerology import System, resource_elements
from tests.conftest import few
from tests.dsp import explicit_echoes
from tests.dsp.explicit_echoes import PAIR_SHAPE, PAIR_SYSTEM, SENSING, SHAPE, SYSTEMS, normalised

PAIR_ELEMENTS = 32 * 70 * 4 * 6


def filled_bound(system, shape, sensing, places, covariance, noise_power):
    """The formula of Stoica and Nehorai as it is printed, of filled matrices; (K, 4, K, 4)."""
    A, D = explicit_echoes.echoes_and_slopes(system, shape, sensing, places)
    k = A.shape[1]
    projector = np.eye(len(A)) - A @ np.linalg.inv(A.conj().T @ A) @ A.conj().T
    R = A @ covariance @ A.conj().T + noise_power * np.eye(len(A))
    effective = covariance @ A.conj().T @ np.linalg.inv(R) @ A @ covariance
    fisher = (D.conj().T @ projector @ D * np.kron(effective.T, np.ones((4, 4)))).real
    scale = 1 / np.sqrt(np.diagonal(fisher))
    inverse = np.linalg.inv(fisher * np.outer(scale, scale)) * np.outer(scale, scale)
    return (noise_power / 2 * inverse).reshape(k, 4, k, 4)


def covariance_of(unknowns, k):
    """Hermitian matrix (K, K) of its K² real unknowns."""
    matrix = np.zeros((k, k), dtype=complex)
    matrix[np.diag_indices(k)] = unknowns[:k]
    upper = np.triu_indices(k, 1)
    real, imaginary = np.split(unknowns[k:], 2)
    matrix[upper] = real + 1j * imaginary
    matrix[upper[1], upper[0]] = real - 1j * imaginary
    return matrix


def random_covariance(rng, k, rank=None):
    """Covariance (K, K) of amplitudes of some rank, and one of its factors (K, rank)."""
    shape = (k, rank or k)
    factor = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    return factor @ factor.conj().T, factor


def places_apart(rng, system, shape, k):
    """Places (4, K) that each lie some 0.7 cells and more from the next along the diagonal of the cells."""
    cells = np.array([system.range_bin_m, system.velocity_bin_mps, 2 / shape[0], 2 / shape[1]])
    offset = rng.uniform(-0.5, 0.5, (4, 1)) + rng.uniform(0, 0.2, (4, k))
    return cells[:, None] * (0.7 * np.arange(k) + offset)


def averaged_deterministic(system, shape, sensing, places, factor, noise_power):
    """Deterministic bound of as many frames as the factor has columns, which are their amplitudes."""
    k = len(factor)
    information = 0.0
    for amplitude in factor.T:
        joint = joint_bound(system, shape, *places, amplitude, noise_power, sensing).joint_covariance
        information = information + np.linalg.inv(joint.reshape(4 * k, 4 * k))
    return np.linalg.inv(information).reshape(k, 4, k, 4)


def pair_bound(separation, covariance, snr_post):
    """Bound of two scatterers, range bins apart; their covariance counts at the middle of the aperture."""
    range_m = np.array([5.2, 5.2 + separation]) * PAIR_SYSTEM.range_bin_m
    zero, turn = np.zeros(2), np.exp(1j * np.array([0, -separation * explicit_echoes.MIDDLE_PHASE[0]]))
    covariance = turn[:, None] * np.asarray(covariance) * turn.conj()
    radio = PAIR_SYSTEM, PAIR_SHAPE, range_m, zero, zero, zero
    return stochastic_bound(*radio, covariance, PAIR_ELEMENTS / snr_post), range_m


@SENSING
@pytest.mark.parametrize(
    ("k", "rank", "noise_power"),
    [(1, 1, 0.01), (2, 2, 1.0), (3, 3, 300.0), (3, 3, 0.01), (3, 2, 1.0), (3, 1, 300.0)],
)
def test_the_bound_is_the_printed_formula_of_filled_matrices(sensing, k, rank, noise_power):
    rng = np.random.default_rng([k, rank])
    system, shape = SYSTEMS[sensing], SHAPE if sensing == "all" else (2, 3)
    places = places_apart(rng, system, shape, k)
    covariance, _ = random_covariance(rng, k, rank)
    expected = filled_bound(system, shape, sensing, places, covariance, noise_power)
    bound = stochastic_bound(system, shape, *places, covariance, noise_power, sensing=sensing)
    np.testing.assert_allclose(normalised(bound.joint_covariance - expected, expected), 0, atol=1e-8)
    np.testing.assert_array_equal(bound.covariance[k - 1], bound.joint_covariance[k - 1, :, k - 1])


@pytest.mark.parametrize("noise_power", [0.1, 30.0])
def test_the_bound_is_that_of_the_numerical_fisher_matrix_of_the_likelihood(noise_power):
    rng, system, shape, k = np.random.default_rng(8), System(n_subcarriers=4, n_symbols=3), (2, 2), 2
    unit = np.array([system.range_bin_m, system.velocity_bin_mps, 1.0, 1.0])[:, None]
    places = places_apart(rng, system, shape, k)
    powers, correlation = [1.0, 2.5], [0.7, -0.4]

    def data_covariance(unknowns):
        A, _ = explicit_echoes.echoes_and_slopes(system, shape, "all", unknowns[: 4 * k].reshape(4, k) * unit)
        S = covariance_of(unknowns[4 * k : -1], k)
        return A @ S @ A.conj().T + unknowns[-1] * np.eye(len(A))

    unknowns = np.array([*(places / unit).ravel(), *powers, *correlation, noise_power])
    inverse = np.linalg.inv(data_covariance(unknowns))
    slopes = []
    for step in 1e-5 * np.eye(unknowns.size):
        slope = data_covariance(unknowns + step) - data_covariance(unknowns - step)
        slopes.append(inverse @ slope / 2e-5)
    fisher = np.array([[np.trace(a @ b).real for b in slopes] for a in slopes])
    expected = np.linalg.inv(fisher)[: 4 * k, : 4 * k].reshape(4, k, 4, k).transpose(1, 0, 3, 2)
    expected = expected * unit[:, 0] * unit[:, :, None]
    S = covariance_of(unknowns[4 * k : -1], k)
    bound = stochastic_bound(system, shape, *places, S, noise_power)
    np.testing.assert_allclose(normalised(bound.joint_covariance - expected, expected), 0, rtol=0, atol=1e-6)


@SENSING
@few
@given(snr_post=st.floats(1e-3, 1e6), n_frames=st.integers(1, 1000), seed=st.integers(0, 2**32 - 1))
def test_one_scatterer_has_its_closed_form(sensing, snr_post, n_frames, seed):
    system = SYSTEMS[sensing]
    places = places_apart(np.random.default_rng(seed), system, SHAPE, 1)
    snr = snr_post / (resource_elements(system, sensing).sum() * SHAPE[0] * SHAPE[1])
    bound = stochastic_bound(system, SHAPE, *places, [3 * snr], 3.0, n_frames, sensing)
    single = single_bound(system, SHAPE, snr, sensing).covariance[None, :, None]
    expected = single * (1 + 1 / snr_post) / n_frames
    np.testing.assert_allclose(normalised(bound.joint_covariance - expected, expected), 0, atol=1e-9)


@SENSING
@pytest.mark.parametrize("noise_power", [0.1, 1e4])
def test_fully_correlated_amplitudes_have_the_deterministic_bound_times_their_joint_snr(sensing, noise_power):
    rng, system = np.random.default_rng(3), SYSTEMS[sensing]
    places = places_apart(rng, system, SHAPE, 3)
    covariance, factor = random_covariance(rng, 3, rank=1)
    A, _ = explicit_echoes.echoes_and_slopes(system, SHAPE, sensing, places)
    snr_post = np.linalg.norm(A @ factor) ** 2 / noise_power
    joint = joint_bound(system, SHAPE, *places, factor[:, 0], noise_power, sensing).joint_covariance
    expected = joint * (1 + 1 / snr_post)
    bound = stochastic_bound(system, SHAPE, *places, covariance, noise_power, sensing=sensing)
    np.testing.assert_allclose(normalised(bound.joint_covariance - expected, expected), 0, rtol=0, atol=1e-8)


@SENSING
@pytest.mark.parametrize("seed", range(4))
def test_it_is_never_below_the_deterministic_bound_of_the_same_covariance_and_reaches_it(sensing, seed):
    rng, system = np.random.default_rng(seed), SYSTEMS[sensing]
    places = places_apart(rng, system, SHAPE, 3)
    covariance, factor = random_covariance(rng, 3)
    excess = []
    for noise_power in (1e4, 1e2, 1.0, 1e-8):
        expected = averaged_deterministic(system, SHAPE, sensing, places, factor, noise_power)
        bound = stochastic_bound(system, SHAPE, *places, covariance, noise_power, sensing=sensing)
        difference = normalised(bound.joint_covariance - expected, expected).reshape(12, 12)
        assert np.linalg.eigvalsh(difference).min() > -1e-7
        excess.append(np.abs(difference).max())
    assert excess[0] > excess[1] > excess[2] > excess[3]
    assert excess[0] > 0.1
    assert excess[3] < 1e-7


def test_powers_are_those_of_uncorrelated_amplitudes():
    system = SYSTEMS["all"]
    places = places_apart(np.random.default_rng(5), system, SHAPE, 3)
    powers = np.array([1.0, 1e-3, 4.0])
    few, all_ = (stochastic_bound(system, SHAPE, *places, S, 2.0) for S in (powers, np.diag(powers)))
    np.testing.assert_array_equal(few.joint_covariance, all_.joint_covariance)


def test_weak_scatterers_keep_their_digits_beside_strong_ones():
    system = System(n_subcarriers=64, n_symbols=64)
    places = np.array([[10.0, 70.0], [-8.0, 9.0], [-0.4, 0.5], [0.3, -0.2]])
    for weak in (1e-2, 1e-6, 1e-10):
        bound = stochastic_bound(system, (8, 8), *places, [1.0, weak], 1e-9)
        alone = stochastic_bound(system, (8, 8), *places[:, 1:], [weak], 1e-9)
        np.testing.assert_allclose(bound.range_m[1], alone.range_m[0], rtol=0.01)


@pytest.mark.parametrize(("separation", "tolerance"), [(0.3, 1e-8), (0.1, 1e-6), (0.03, 1e-3)])
@pytest.mark.parametrize("correlation", [0.0, 0.5j, 1.0])
def test_close_pairs_keep_their_digits(separation, tolerance, correlation):
    """Filled echoes, orthogonalised, lose half the digits that their inner products lose."""
    S = np.array([[1, correlation], [np.conj(correlation), 1]])
    bound, range_m = pair_bound(separation, S, 1e4)
    n = np.arange(32) - 31 / 2
    waves = np.exp(-2j * np.pi / 32 * np.outer(n, range_m / PAIR_SYSTEM.range_bin_m))
    # Amplitudes count at the middle, where slopes in velocity and direction are orthogonal to those in range.
    slopes = -2j * np.pi / 32 * n[:, None] * waves
    basis, _ = np.linalg.qr(waves)
    left = slopes - basis @ (basis.conj().T @ slopes)
    left -= basis @ (basis.conj().T @ left)
    looks, noise_power = PAIR_ELEMENTS / 32, PAIR_ELEMENTS / 1e4
    R = looks * waves @ S @ waves.conj().T + noise_power * np.eye(32)
    effective = S @ waves.conj().T @ np.linalg.solve(R, waves) @ S * looks
    fisher = 2 * looks / noise_power * (left.conj().T @ left * effective.T).real
    expected = np.sqrt(np.diagonal(np.linalg.inv(fisher))) * PAIR_SYSTEM.range_bin_m
    np.testing.assert_allclose(bound.range_m, expected, rtol=tolerance)


def test_a_sample_covariance_of_few_frames_passes_as_one():
    rng, system = np.random.default_rng(6), System(n_subcarriers=64, n_symbols=64)
    places = rng.uniform([[0], [-20], [-0.9], [-0.9]], [[100], [20], [0.9], [0.9]], (4, 20))
    covariance, _ = random_covariance(rng, 20, rank=3)
    assert np.isfinite(stochastic_bound(system, (8, 8), *places, covariance / 3, 1.0).range_m).all()
