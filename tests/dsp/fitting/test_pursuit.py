"""Moves of a pursuit on small maps of known echoes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import spherical_jn

from isacbench.dsp.fitting import pursuit
from isacbench.dsp.fitting.atom_fits import fit_atoms, refine_atoms
from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.gate import Gate
from isacbench.model.numerology import System
from tests.dsp.fitting.noisy_maps import noisy_map

SYSTEM = System(n_subcarriers=64, n_symbols=32)
SHAPE = (8, 6)
GATE = Gate(np.arange(10, 24), np.arange(-6, 7), slice(3, 11), slice(3, 10))
LIMITS = ((-0.5, 0.5), (-0.6, 0.4))
PLACE = np.array([16.3, 0.4, 0.2, -0.3])
NOISE = 1e-3
QUADRATURE, IN_PHASE = 1j, 1.0


def noisy(places, amplitude, noise=NOISE, seed=0):
    """Map of echoes in noise of a power per cell and element."""
    places = np.reshape(places, (-1, N_COORDINATES))
    return noisy_map(SYSTEM, SHAPE, GATE, places, np.asarray(amplitude, complex), np.sqrt(noise), seed)


def space_of(atom_map):
    return pursuit.BeamSpace.from_map(atom_map, GATE, LIMITS)


def fitted(places, amplitude, noise=NOISE, seed=0):
    """Map and its fit with atoms at the true places."""
    atom_map = noisy(places, amplitude, noise, seed)
    return atom_map, fit_atoms(atom_map, np.reshape(places, (-1, N_COORDINATES)))


def test_beams_are_outputs_of_unit_energy_at_their_directions():
    atom_map = noisy(PLACE, [2.0])
    space = space_of(atom_map)
    along_range, along_doppler, along_u, along_w = space.axes
    assert space.beams.shape == tuple(axis.size for axis in space.axes)
    towards_u, towards_w = atom_map.line(along_u, 2).value, atom_map.line(along_w, 3).value
    for r, d, i, k in ((0, 0, 0, 0), (4, 3, 2, 5), (-1, -1, -1, -1)):
        row = np.flatnonzero(atom_map.range_bins == along_range[r])[0]
        column = np.flatnonzero(atom_map.doppler_bins == along_doppler[d])[0]
        expected = towards_u[i] @ atom_map.cells[row, column] @ towards_w[k]
        assert space.beams[r, d, i, k] == pytest.approx(expected)


def test_independent_samples_are_the_rayleigh_cells_of_the_region():
    # 8 range and 7 Doppler bins; a cosine of 1 is 4 cells along u and 3 along w.
    assert space_of(noisy(PLACE, [1.0])).n_independent == pytest.approx(8 * 7 * 4 * 3)


def test_the_residual_is_that_of_the_map_without_the_atoms():
    places = PLACE + np.array([[0, 0, 0, 0], [2.1, -0.7, 0.9, 0.4]])
    atom_map, fit = fitted(places, [2.0, 1j], noise=0.01)
    without = noisy(places, np.array([2.0, 1j]) - fit.amplitude, noise=0.01)
    space = space_of(atom_map)
    np.testing.assert_allclose(space.residual(fit), space_of(without).beams, atol=1e-10)
    no_atoms = fit_atoms(atom_map, np.empty((0, N_COORDINATES)))
    np.testing.assert_array_equal(space.residual(no_atoms), space.beams)


@given(st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1)))
def test_the_highest_peak_is_the_nearest_sample_to_a_lone_echo(offset):
    place = PLACE + offset
    space = space_of(noisy(place, [1.0], noise=1e-8))
    places, energy = space.peaks(space.beams, 0.3)
    best = energy.argmax()
    # Halfway between bins the sum of two holds 81 % of an echo: a bin wins up to 0.293 away.
    assert np.all(np.abs(places[best] - place) < [0.3, 0.3, 0.251, 0.251])
    assert 0.36 < energy[best] < 1.01


def test_peaks_are_the_samples_that_no_neighbour_exceeds():
    space = space_of(noisy(PLACE, [1.0], noise=0.05))
    _, energy = space.peaks(space.beams, 0.1)
    dense = space.beams
    for axis in (0, 1):
        ahead = np.moveaxis(dense, axis, 0)
        between = (ahead[:-1] + ahead[1:]) / np.sqrt(2)
        woven = np.empty((2 * len(ahead) - 1, *ahead.shape[1:]), complex)
        woven[::2], woven[1::2] = ahead, between
        dense = np.moveaxis(woven, 0, axis)
    power, expected = np.abs(dense) ** 2, []
    for index in zip(*np.nonzero(power > 0.1), strict=True):
        around = tuple(slice(max(i - 1, 0), i + 2) for i in index)
        if power[index] == power[around].max():
            expected.append(power[index])
    np.testing.assert_allclose(np.sort(energy), np.sort(expected), rtol=1e-12)
    assert len(energy) > 5


def test_the_mean_residual_around_a_place_is_that_of_its_surroundings():
    space = space_of(noisy(PLACE, [0.0]))
    residual = np.ones_like(space.beams)
    residual[:, :, space.u > 0] = 2.0
    places = np.array([[16, 0, -1.5, 0], [16, 0, 1.5, 0], [0, -90, -50, 50.0]])
    np.testing.assert_allclose(space.energy_around(residual, places).mean(axis=1), [1, 4, 1])


@pytest.mark.parametrize("axis", range(N_COORDINATES))
@pytest.mark.parametrize("turn", [IN_PHASE, QUADRATURE])
def test_two_close_echoes_under_one_atom_gain_from_a_split_along_their_line(axis, turn):
    apart = 0.4 * np.eye(N_COORDINATES)[axis]
    atom_map = noisy([PLACE - apart / 2, PLACE + apart / 2], [1.0, turn], noise=1e-6)
    fit = refine_atoms(atom_map, PLACE[None], 10)
    splits = pursuit.split_gains(fit, np.array([1e-6]), 1e-5)
    assert splits[1][0] > 1e-5
    assert np.flatnonzero(splits[0][0]).tolist() == [axis]
    assert 0.1 < splits[0][0, axis] <= 0.5
    # The two starts lead to the two echoes, and their gain is of the order that was promised.
    two = refine_atoms(atom_map, fit.places + np.array([[-1.0], [1.0]]) * splits[0], 12)
    order = two.places[:, axis].argsort()
    np.testing.assert_allclose(two.places[order, axis], PLACE[axis] + [-0.2, 0.2], atol=0.05)
    assert 0.5 < (two.energy - fit.energy) / splits[1][0] < 2.5


@pytest.mark.parametrize("snr", [1e2, 1e4, 1e6])
def test_one_echo_in_noise_is_not_split(snr):
    for seed in range(8):
        atom_map, _ = fitted(PLACE, [1.0], noise=1 / snr, seed=seed)
        fit = refine_atoms(atom_map, PLACE[None], 5)
        splits = pursuit.split_gains(fit, np.array([1 / snr]), 20 / snr)
        assert splits[1][0] == 0
        assert not np.any(splits[0][splits[1] > 0])


def test_no_split_gains_what_noise_may_or_where_all_around_is_as_bad():
    apart = 0.3 * np.eye(N_COORDINATES)[0]
    atom_map = noisy([PLACE - apart / 2, PLACE + apart / 2], [1.0, 1.0], noise=1e-6)
    fit = refine_atoms(atom_map, PLACE[None], 10)
    gain = pursuit.split_gains(fit, np.array([1e-6]), 1e-5)[1][0]
    assert 0 < gain < fit.power[0] / 8
    assert pursuit.split_gains(fit, np.array([1e-6]), 2 * gain)[1][0] == 0
    assert pursuit.split_gains(fit, np.array([gain]), 1e-5)[1][0] == 0


def test_two_elements_see_one_wave_and_no_split():
    cells = np.random.default_rng(0).standard_normal((*GATE.shape, 2, 2)).astype(complex)
    small = AtomMap.from_map(GatedMap(cells, GATE), SYSTEM)
    fit = fit_atoms(small, PLACE[None])
    splits = pursuit.split_gains(fit, np.array([1e-9]), 1e-9)
    assert np.all(np.isfinite(splits[1]))
    assert np.all(splits[0][:, 2:] == 0)


@given(st.floats(1, 1e6), st.floats(1e-9, 0.1))
def test_the_highest_noise_is_where_rice_expects_one_crossing_in_so_many_images(n, chance):
    level = pursuit.noise_maximum(n, chance)
    if level > N_COORDINATES:
        expected = n * (np.pi * level / 3) ** 2 * np.exp(-level)
        assert expected == pytest.approx(chance, rel=1e-5)
    assert level > np.log(n / chance)


@given(st.tuples(*[st.floats(-6, 6)] * 4))
def test_the_envelope_bounds_the_kernels(distance):
    # On the whole map and array; a gate's part of two atoms can have a larger product.
    whole = Gate(np.arange(64), np.arange(-16, 16), slice(0, 64), slice(0, 32))
    full = AtomMap.from_map(GatedMap(np.zeros((*whole.shape, *SHAPE), complex), whole), SYSTEM)
    lines = full.lines(np.stack([PLACE, PLACE + distance]))
    response = np.prod([line.value[0, 1] for line in full.products(lines)])
    # A kernel of n samples exceeds 1/(πx) by x/n over its sine, π/2 at most within half its period.
    reach = np.array([64, 32, *SHAPE])
    turns = np.abs(distance - reach * np.rint(distance / reach))
    slack = np.prod(1 / np.sinc(np.minimum(turns / reach, 0.5)))
    assert abs(response) <= slack * pursuit.sidelobe_envelope(turns) + 1e-12


def test_the_strongest_around_is_the_loudest_sidelobe_or_neighbour_and_never_itself():
    places = PLACE + np.array([[0, 0, 0, 0], [0, 0, 1.6, 1.1], [3, 0, 0, 0.5]])
    _, fit = fitted(places, [4.0, 1.0, 0.5], noise=0.0)
    strongest = pursuit.strongest_around(fit.places, fit)
    assert strongest[0] == pytest.approx(1.0)
    assert strongest[1] == pytest.approx(16.0)
    assert strongest[2] == pytest.approx(16 / (3 * np.pi * 0.5 * np.pi) ** 2)
    elsewhere = pursuit.strongest_around(PLACE + np.array([[5.5, 0, 0, 0]]), fit)
    sidelobes = 16 / (5.5 * np.pi) ** 2, 0.25 / (2.5 * np.pi * 0.5 * np.pi) ** 2
    assert elsewhere[0] == pytest.approx(max(sidelobes))


def test_two_atoms_that_nearly_cancel_hardly_count_as_neighbours():
    places = PLACE + np.array([[0, 0, 0, 0], [0.1, 0, 0, 0]])
    _, fit = fitted(places, [5.0, -5.0], noise=0.0)
    assert pursuit.strongest_around(PLACE + np.array([[0, 1, 0, 0]]), fit)[0] < 0.01 * fit.power.min()


def test_sidelobes_of_many_places_are_summed_in_parts_of_bounded_size(monkeypatch):
    rng = np.random.default_rng(0)
    places, energy = rng.uniform(-9, 9, (50, N_COORDINATES)), rng.uniform(0, 1, 50)
    whole = pursuit.sidelobe_energy(places, places, energy, least_range=3.0)
    monkeypatch.setattr(pursuit, "MOST_PAIRS", 150)
    in_parts = pursuit.sidelobe_energy(places, places, energy, least_range=3.0)
    np.testing.assert_allclose(in_parts, whole, rtol=1e-12)
    far = np.abs(places[7, 0] - places[:, 0]) >= 3
    amplitude = np.sqrt(energy[far]) @ pursuit.sidelobe_envelope(places[7] - places[far])
    assert whole[7] == pytest.approx(amplitude**2)


def test_the_strongest_around_is_near_across_the_end_of_a_coordinate():
    fit = fitted(PLACE[None], [4.0])[1]
    beside = fit.places + np.array([0.5, 0.0, 0.0, 0.0])
    here, beyond = (pursuit.strongest_around(beside + turns, fit)[0] for turns in (0.0, fit.atom_map.periods))
    assert beyond == pytest.approx(here)
    assert here > 10.0


@pytest.mark.parametrize("axis", range(N_COORDINATES))
def test_a_pair_becomes_one_in_its_middle_if_that_loses_no_more_than_is_allowed(axis):
    apart = 0.1 * np.eye(N_COORDINATES)[axis]
    atom_map, fit = fitted([PLACE, PLACE + apart, PLACE + 2.0], [1.0, 0.7j, 1.0], noise=0.0)
    lost = fit.lost_without()[1, 0]
    drop, places = pursuit.needless_atoms(fit, 1.01 * lost)
    assert drop.tolist() == [False, True, False]
    weight = fit.power[1] / (fit.power[0] + fit.power[1])
    np.testing.assert_allclose(places[0], PLACE + weight * apart, atol=1e-9)
    np.testing.assert_array_equal(places[2], fit.places[2])
    assert not pursuit.needless_atoms(fit, 0.99 * lost)[0].any()
    assert fit.energy - refine_atoms(atom_map, places[~drop], 8).energy == pytest.approx(lost, rel=0.1)


def test_an_atom_that_others_explain_without_moving_is_needless_wherever_it_is():
    places = PLACE + np.array([[0, 0, 0, 0], [3, 0, 0, 0], [-3, 0, 0, 0]])
    _, fit = fitted(places, [1.0, 0.1, 0.2], noise=0.0)
    assert pursuit.needless_atoms(fit, 0.011)[0].tolist() == [False, True, False]


@pytest.mark.parametrize("n_atoms", [1, 2])
def test_the_misfit_of_unresolved_echoes_is_highest_where_the_bessel_function_of_twice_the_atoms_is(n_atoms):
    along = np.linspace(-0.25, 0.25, 7)[:, None] * np.eye(N_COORDINATES)[0]
    atom_map = noisy(PLACE + along, [1.0, -0.5, 1.0, 2.0, 0.3, 1.0, 0.8], noise=0.0)
    starts = PLACE + np.linspace(-0.1, 0.1, n_atoms + 2)[1:-1, None] * np.eye(N_COORDINATES)[0]
    fit = refine_atoms(atom_map, starts, 30)
    cells = np.linspace(-4, 4, 321)
    beside = fit_atoms(atom_map, PLACE + cells[:, None] * np.eye(N_COORDINATES)[0], ridge=1.0)
    lines = zip(beside.lines, fit.lines, strict=True)
    products = np.prod([line.value @ other.value.T for line, other in lines], axis=0)
    left = np.abs(beside.correlations.value - products @ fit.amplitude)
    expected = np.abs(spherical_jn(2 * n_atoms, np.pi * np.abs(cells)))
    assert np.abs(cells[left.argmax()]) == pytest.approx(np.abs(cells[expected.argmax()]), abs=0.2)
    assert left[cells.size // 2] < 0.3 * left.max()


def least_misfit(fit, atoms):
    """Misfit from which these atoms, all nearby, are dropped."""
    return np.sqrt(fit.energy_of(np.array(atoms)) ** 3 / fit.power[atoms].sum())


@pytest.mark.parametrize("axis", range(N_COORDINATES))
def test_a_weak_atom_on_the_line_of_a_misfit_is_one_itself_and_beside_that_line_is_not(axis):
    along, across = 2.5 * np.eye(N_COORDINATES)[[axis, axis - 1]]
    _, fit = fitted([PLACE, PLACE + along, PLACE + along + across], [2.0, 0.1, 0.1], noise=0.0)
    least = least_misfit(fit, [1])
    elsewhere, around = least / pursuit.MISFIT_SHARE, least / pursuit.MISFIT_AROUND
    for low, high in ((0.95, 1.5), (1.5, 0.95)):
        assert not pursuit.misfit_atoms(fit, np.array([low * elsewhere, high * around, 0])).any()
    found = pursuit.misfit_atoms(fit, np.array([1.05 * elsewhere, 1.05 * around, 0]))
    assert found.tolist() == [False, True, False]


def test_of_no_atoms_none_is_misfit():
    no_atoms = fit_atoms(noisy(PLACE, [1.0]), np.empty((0, N_COORDINATES)))
    assert pursuit.misfit_atoms(no_atoms, np.empty(0)).shape == (0,)


def test_atoms_that_explain_much_together_are_no_misfit():
    far, pair = np.eye(N_COORDINATES)[0] * [[4.0], [0.2]]
    _, fit = fitted([PLACE, PLACE + far, PLACE + far + pair], [9.0, 1.0, 1.0], noise=0.0)
    least = least_misfit(fit, [1, 2])
    assert np.all((fit.power * fit.own)[1:] < 0.2 * least)
    left = np.full(3, least / pursuit.MISFIT_SHARE)
    assert not pursuit.misfit_atoms(fit, 0.95 * left).any()
    assert pursuit.misfit_atoms(fit, 1.05 * left).tolist() == [False, True, True]


def test_a_duplicate_half_a_turn_of_the_array_away_is_one_and_stays_at_the_stronger_end():
    half = SHAPE[0] / 2
    ends = np.array([[16.3, 0.4, half - 0.01, -0.3], [16.3, 0.4, 0.01 - half, -0.3]])
    _, fit = fitted(ends, [1.0, 0.5])
    drop, places = pursuit.needless_atoms(fit, 20 * NOISE)
    assert drop.sum() == 1
    (stays,) = np.flatnonzero(~drop)
    assert np.abs(np.abs(places[stays, 2]) - half).max() <= 0.01
    np.testing.assert_allclose(places[stays, [0, 1, 3]], ends[0, [0, 1, 3]])


@given(st.tuples(*[st.floats(-200, 200)] * 8))
def test_the_nearest_of_equal_places_is_within_half_a_period_and_a_whole_number_of_them_away(values):
    places, reference = np.array(values[:4]), np.array(values[4:])
    periods = np.array([64.0, 32.0, 8.0, 6.0])
    nearest = pursuit.unwrapped(places, reference, periods)
    assert np.all(np.abs(nearest - reference) <= periods / 2 * (1 + 1e-9))
    turns = (nearest - places) / periods
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)


def test_places_a_period_apart_hold_the_same_atom():
    atom_map = noisy(PLACE, [0.0])
    moved = PLACE + np.array([1, -1, 1, 1]) * atom_map.periods
    for axis in range(N_COORDINATES):
        here, there = (atom_map.line(place[axis : axis + 1], axis).value for place in (PLACE, moved))
        sign = np.sign(np.sum(here * there))
        np.testing.assert_allclose(there, sign * here, atol=1e-9)


def test_of_equal_energies_the_first_comes_first_whatever_their_last_digits():
    energy = np.array([1.0, 3.0, 2.0, 3.0 + 1e-15, 3.0 - 1e-15])
    assert pursuit.descending(energy).tolist() == [1, 3, 4, 2, 0]


@pytest.mark.parametrize("sign", [-1, 1])
def test_two_equal_samples_are_two_peaks_whichever_rounding_favours(sign):
    space = space_of(noisy(PLACE, [0.0], noise=0.0))
    residual = np.zeros_like(space.beams)
    residual[4, 4, 3, 4:6] = 1.0, 1.0 + sign * 1e-13
    places, _ = space.peaks(residual, 0.9)
    assert len(places) == 2
