"""Bounds against Fisher matrices of the explicit model, published formulas, and known limits."""

from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import isacbench
from isacbench.dsp.bounds import joint_bound, position_covariance, single_bound
from isacbench.errors import InputError
from isacbench.model.frame import PanelFrame, PaperFrame
from isacbench.model.numerology import System, resource_elements
from tests.conftest import few, slow_but
from tests.dsp import explicit_echoes
from tests.dsp.explicit_echoes import PAIR_SHAPE, PAIR_SYSTEM, SENSING, SHAPE, SYSTEMS, normalised
from tests.dsp.tone_bounds import tone_std_bins

PAIR_CELLS = np.array([PAIR_SYSTEM.range_bin_m, PAIR_SYSTEM.velocity_bin_mps, 2 / 4, 2 / 6])
"""Rayleigh cells in range, velocity, u and w of the full grid and array of the pairs below."""


def random_scene(rng, system, k):
    """Places (4, K) anywhere and amplitudes (K,)."""
    range_m, speed_mps = system.unambiguous_range_m, system.unambiguous_speed_mps
    places = rng.uniform([[0], [-speed_mps], [-1], [-1]], [[range_m], [speed_mps], [1], [1]], (4, k))
    return places, rng.standard_normal(k) + 1j * rng.standard_normal(k)


def unit_columns(system, shape, sensing, places, amplitude):
    """Slopes (elements, 6K) of the echoes with every unknown, of unit norm, and their norms."""
    echoes, slopes = explicit_echoes.echoes_and_slopes(system, shape, sensing, places)
    columns = np.concatenate([slopes * np.repeat(amplitude, 4), echoes, 1j * echoes], axis=1)
    norm = np.linalg.norm(columns, axis=0)
    return columns / norm, norm


def pair_of(axis, separation, phase=0.0):
    """Two equal echoes, Rayleigh cells apart along one axis and `phase` apart in the middle."""
    places = np.array([5.2, 2.3, 0.1, -0.3])[:, None] * PAIR_CELLS[:, None] * np.ones(2)
    places[axis, 1] += separation * PAIR_CELLS[axis]
    return places, np.exp(1j * np.array([0, phase - separation * explicit_echoes.MIDDLE_PHASE[axis]]))


def pair(axis, separation, phase=0.0, sensing="all"):
    """Bound of such a pair."""
    places, amplitude = pair_of(axis, separation, phase)
    return joint_bound(PAIR_SYSTEM, PAIR_SHAPE, *places, amplitude, 1.0, sensing)


@SENSING
@pytest.mark.parametrize("k", [1, 2, 4])
@few
@given(seed=st.integers(0, 2**32 - 1), noise_power=st.floats(1e-3, 1e3))
def test_the_bound_is_that_of_the_filled_fisher_matrix(sensing, k, seed, noise_power):
    system = SYSTEMS[sensing]
    places, amplitude = random_scene(np.random.default_rng(seed), system, k)
    columns, norm = unit_columns(system, SHAPE, sensing, places, amplitude)
    fisher = 2 / noise_power * (columns.conj().T @ columns).real
    assume(np.linalg.cond(fisher) < 1e8)
    expected = (np.linalg.inv(fisher) / np.outer(norm, norm))[: 4 * k, : 4 * k].reshape(k, 4, k, 4)
    bound = joint_bound(system, SHAPE, *places, amplitude, noise_power, sensing)
    np.testing.assert_allclose(normalised(bound.joint_covariance - expected, expected), 0, atol=1e-6)
    found = np.stack([bound.range_m, bound.velocity_mps, bound.u, bound.w], axis=1)
    np.testing.assert_allclose(found, explicit_echoes.standard_deviations(expected), rtol=1e-6)


@SENSING
def test_one_scatterer_has_its_closed_form_wherever_it_is(sensing):
    system, rng = SYSTEMS[sensing], np.random.default_rng(5)
    for _ in range(5):
        places, amplitude = random_scene(rng, system, 1)
        joint = joint_bound(system, SHAPE, *places, amplitude, 0.4, sensing)
        single = single_bound(system, SHAPE, np.abs(amplitude) ** 2 / 0.4, sensing).covariance[:, :, None]
        np.testing.assert_allclose(normalised(joint.joint_covariance - single, single), 0, atol=1e-10)


@given(st.integers(2, 3000), st.floats(1e-6, 1e6))
def test_a_tone_is_bounded_as_rife_and_boorstyn_have_it(n, snr):
    # Amplitude b, unknown phase, noise of variance s² in real and in imaginary part, a sample a second.
    b, s2 = 1.3, 1.3**2 / (2 * snr)
    frequency = 12 * s2 / (b**2 * n * (n**2 - 1))  # variance, in (rad/s)²
    assert tone_std_bins(n, n * snr) == pytest.approx(np.sqrt(frequency) * n / (2 * np.pi), rel=1e-9)


@given(st.integers(2, 300), st.integers(2, 300), st.tuples(*[st.integers(2, 20)] * 2), st.floats(1e-6, 1e6))
def test_on_the_full_grid_every_parameter_is_a_tone_of_its_own(n_subcarriers, n_symbols, shape, snr):
    system = System(n_subcarriers=n_subcarriers, n_symbols=n_symbols)
    bound = single_bound(system, shape, snr)
    snr_post = snr * n_subcarriers * n_symbols * shape[0] * shape[1]
    for std, n, bin_ in (
        (bound.range_m, n_subcarriers, system.range_bin_m),
        (bound.velocity_mps, n_symbols, system.velocity_bin_mps),
        (bound.u, shape[0], 2 / shape[0]),
        (bound.w, shape[1], 2 / shape[1]),
    ):
        assert std == pytest.approx(tone_std_bins(n, snr_post) * bin_, rel=1e-9)
    std = np.sqrt(np.diagonal(bound.covariance))
    np.testing.assert_allclose(bound.covariance / np.outer(std, std), np.eye(4), atol=1e-9)


def test_several_tones_are_bounded_as_stoica_and_nehorai_have_it():
    system, noise_power = System(n_subcarriers=24, n_symbols=5), 0.7
    range_bin, amplitude = np.array([3.1, 4.4, 9.9]), np.array([1.0, 0.6j, -1.5 + 0.4j])
    # Their theorem 4.1 for one snapshot: A of steering vectors, D of their slopes, X of amplitudes.
    n = np.arange(24)[:, None]
    A = np.exp(-2j * np.pi * n * range_bin / 24)
    D, X = -2j * np.pi * n / 24 * A, np.diag(amplitude)
    projector = np.eye(24) - A @ np.linalg.inv(A.conj().T @ A) @ A.conj().T
    fisher = (X.conj().T @ D.conj().T @ projector @ D @ X).real
    expected = noise_power / 2 * np.linalg.inv(fisher)
    # Tones that share velocity and direction: a look from every symbol and element.
    range_m, zero, looks = range_bin * system.range_bin_m, np.zeros(3), 5 * 3 * 4
    bound = joint_bound(system, SHAPE, range_m, zero, zero, zero, amplitude, looks * noise_power)
    in_bins = bound.joint_covariance[:, 0, :, 0] / system.range_bin_m**2
    np.testing.assert_allclose(in_bins, expected, rtol=1e-8)


def test_the_comb_couples_range_and_velocity_and_the_full_grid_does_not():
    system = SYSTEMS["prs"]
    comb, full = (single_bound(system, SHAPE, 1.0, sensing).covariance for sensing in ("prs", "all"))
    n, m = np.nonzero(resource_elements(system, "prs"))
    correlation = comb[0, 1] / np.sqrt(comb[0, 0] * comb[1, 1])
    # Of the estimates: minus that of the slopes, whose signs differ.
    assert correlation == pytest.approx(np.corrcoef(n, m)[0, 1], rel=1e-9)
    assert correlation > 1e-3
    assert full[0, 1] == pytest.approx(0, abs=1e-12 * np.sqrt(full[0, 0] * full[1, 1]))


@SENSING
def test_scatterers_far_apart_have_their_own_bounds(sensing):
    system, zero = System(n_subcarriers=256, n_symbols=224), np.zeros(2)
    u, amplitude = np.array([-0.3, 0.4]), np.array([1.0, 3j])
    single = single_bound(system, (16, 16), np.abs(amplitude) ** 2, sensing)
    excess = []
    for bins in (0.7, 7.7, 77.7):
        range_m = np.array([0, bins]) * system.range_bin_m
        joint = joint_bound(system, (16, 16), range_m, zero, u, zero, amplitude, 1.0, sensing)
        excess.append(np.max(joint.range_m / single.range_m) - 1)
    assert excess[0] > excess[1] > excess[2] > 0
    assert excess[2] < 1e-3


@SENSING
@pytest.mark.parametrize("axis", range(4))
def test_the_closer_the_pair_the_larger_the_bound(sensing, axis):
    bounds = (pair(axis, apart, 0.0, sensing) for apart in (0.8, 0.6, 0.4, 0.2, 0.1, 0.05))
    std = [explicit_echoes.standard_deviations(bound.joint_covariance)[:, axis] for bound in bounds]
    assert np.all(np.diff(std, axis=0) > 0)
    # With the square of the distance, as in docs/bounds.md.
    np.testing.assert_allclose(std[-1] / std[-2], 4, rtol=0.02)


@SENSING
@pytest.mark.parametrize(
    ("axis", "separation"),
    slow_but([(0, 0.1), (0, 0.5), (1, 0.25), (2, 0.1), (3, 0.5)], product(range(4), [0.1, 0.25, 0.5])),
)
def test_a_pair_in_phase_or_opposite_in_the_middle_is_hardest_to_place(sensing, axis, separation):
    phase = np.linspace(0, 2 * np.pi, 25)
    covariance = np.array([pair(axis, separation, p, sensing).joint_covariance for p in phase])
    own = covariance[:, 0, axis, 0, axis]
    assert {*np.argsort(own)[-3:].tolist()} == {0, 12, 24}
    assert own[0] == pytest.approx(own[12], rel=1e-4)
    assert np.argmin(own[:13]) == pytest.approx(6, abs=1)
    # What is uncertain in phase is the middle of the two, and their distance where they are opposite.
    ends, cross = own + covariance[:, 1, axis, 1, axis], 2 * covariance[:, 0, axis, 1, axis]
    assert np.argmax((ends - cross)[:24]) == 12
    assert np.argmax((ends + cross)[:24]) == 0


@pytest.mark.parametrize(("separation", "tolerance"), [(0.3, 1e-8), (0.1, 1e-6), (0.03, 1e-3), (0.015, 1e-2)])
def test_close_pairs_keep_their_digits(separation, tolerance):
    """The explicit model's singular values lose half the digits that a Fisher matrix loses."""
    places, amplitude = pair_of(0, separation)
    columns, norm = unit_columns(PAIR_SYSTEM, (2, 2), "all", places, amplitude)
    _, singular, right = np.linalg.svd(np.concatenate([columns.real, columns.imag]), full_matrices=False)
    expected = np.sqrt(np.sum((right.T / singular) ** 2, axis=1) / 2) / norm
    bound = joint_bound(PAIR_SYSTEM, (2, 2), *places, amplitude, 1.0)
    np.testing.assert_allclose(bound.range_m, expected[[0, 4]], rtol=tolerance)


@SENSING
@pytest.mark.parametrize("phase", [0.0, 1.0, np.pi / 2])
def test_scatterers_in_one_place_have_no_bound_and_do_not_disturb_others(sensing, phase):
    system = System(n_subcarriers=64, n_symbols=70)
    places = np.array([[20.0, 20.0, 33.0], [3.0, 3.0, -9.0], [0.1, 0.1, -0.4], [0.2, 0.2, 0.5]])
    amplitude = np.array([1.0, 2 * np.exp(1j * phase), 1.5])
    bound = joint_bound(system, (4, 4), *places, amplitude, 1.0, sensing)
    for std in (bound.range_m, bound.velocity_mps, bound.u, bound.w):
        assert np.isinf(std).tolist() == [True, True, False]
    assert np.isnan(bound.covariance[0, 0, 1])
    assert np.isnan(bound.joint_covariance[0, 0, 2, 0])
    assert np.isfinite(bound.covariance[2]).all()
    # The third sees what the two add up to, as little as it sees of one.
    apart = joint_bound(system, (4, 4), *places[:, 1:], amplitude[1:], 1.0, sensing)
    np.testing.assert_allclose(bound.range_m[2], apart.range_m[1], rtol=0.02)


def test_a_pair_too_close_for_double_precision_is_called_so():
    assert np.isinf(pair(0, 1e-4).range_m).all()
    assert np.isfinite(pair(0, 1e-2).range_m).all()


def test_positions_spread_as_propagated_samples_do():
    rng = np.random.default_rng(11)
    bound = single_bound(System(), (16, 16), 1e-5, "prs")
    place = np.array([85.0, 3.0, 0.12, 0.19])
    deviations = rng.multivariate_normal(np.zeros(4), bound.covariance, size=200_000, method="cholesky")
    for frame in (PanelFrame(yaw_deg=10, tilt_deg=-5), PaperFrame()):
        # First order: small enough to be linear.
        range_m, v, u, w = (place + 1e-3 * deviations).T
        samples = np.column_stack([frame.offsets(range_m, u, w), v])
        covariance = position_covariance(frame, place[:1], place[2:3], place[3:], bound.covariance)
        std = np.sqrt(np.diagonal(covariance[0]))
        expected = np.cov(samples.T) / 1e-6
        np.testing.assert_allclose(std, np.sqrt(np.diagonal(expected)), rtol=0.01)
        np.testing.assert_allclose((covariance[0] - expected) / np.outer(std, std), 0, atol=0.015)


def test_where_there_is_no_bound_positions_have_none_and_others_keep_theirs():
    unknown = np.full((4, 4), np.nan)
    np.fill_diagonal(unknown, np.inf)
    known = np.diag([1e-4, 0.09, 1e-6, 4e-6])
    both = position_covariance(PanelFrame(), [50.0] * 2, [0.1] * 2, [0.2] * 2, [unknown, known])
    assert np.isinf(np.diagonal(both[0])).all()
    assert np.isfinite(both[1]).all()
    horizon = position_covariance(PaperFrame(), [50.0], [0.0], [0.0], known)
    assert np.isnan(horizon[0, :3]).all()


def test_a_step_in_u_is_hundreds_of_metres_a_unit_in_the_paper_frame_and_the_range_in_the_panel_s():
    for name, lowest_m, highest_m in (("street-paper", 320, 970), ("street", 80, 105)):
        scenario = isacbench.load_scenario(name)
        offset_m = scenario.scatterers.xyz - scenario.base_station_m
        range_m = np.linalg.norm(offset_m, axis=1)
        u, w = scenario.frame.direction_cosines(offset_m)
        slope = np.abs(scenario.frame.offset_jacobian(range_m, u, w)[:, 0, 1])
        assert lowest_m < slope.min() < slope.max() < highest_m


@pytest.mark.parametrize(
    ("change", "message"),
    [
        *(({"amplitude": [1.0, other]}, "amplitude") for other in (0.0, np.nan)),
        ({"amplitude": [1.0]}, "as many as amplitudes"),
        ({"u": [0.0]}, "u = .*as many as amplitudes"),
        (dict.fromkeys(("range_m", "velocity_mps", "u", "w", "amplitude"), ()), "range_m"),
        ({"range_m": [1.0, np.inf]}, "range_m"),
        ({"noise_power": 0.0}, "noise_power"),
        ({"array_shape": (1, 8)}, "array_shape"),
        ({"system": System(n_subcarriers=1)}, "n_subcarriers=1"),
        *(({"system": System(n_symbols=n), "sensing": "prs"}, f"n_symbols={n}") for n in (1, 2)),
        ({"sensing": "csi"}, "unknown sensing 'csi'"),
    ],
)
def test_what_bounds_nothing_is_refused(change, message):
    two = {"range_m": [1.0, 5.0], "velocity_mps": [0.0, 0.0], "u": [0.0, 0.1], "w": [0.0, 0.1]}
    radio = {"system": SYSTEMS["all"], "array_shape": SHAPE, "amplitude": [1.0, 1j], "noise_power": 1.0}
    with pytest.raises(InputError, match=message):
        joint_bound(**two | radio | change)


@pytest.mark.parametrize("snr", [0.0, -1.0, [1.0, np.nan]])
def test_a_ratio_that_is_not_positive_is_refused(snr):
    with pytest.raises(InputError, match="snr"):
        single_bound(SYSTEMS["all"], SHAPE, snr)


def test_prs_alone_costs_what_the_documentation_says():
    full, comb = (single_bound(System(), (16, 16), 1.0, sensing) for sensing in ("all", "prs"))
    assert comb.range_m / full.range_m == pytest.approx(4.32, abs=5e-3)
    assert comb.velocity_mps / full.velocity_mps == pytest.approx(4.46, abs=5e-3)
    assert comb.u / full.u == pytest.approx(np.sqrt(224 * 2048 / (48 * 512)), rel=1e-9)
