"""Atoms against their definition as plain sums over the apertures, and against the simulated echo."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.fitting.atoms import N_COORDINATES, AtomMap, product_matrix
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.array import VirtualArray
from isacbench.model.echo import central_phase, clean_echo
from isacbench.model.gate import Gate
from isacbench.model.numerology import System
from isacbench.model.scene import Scatterers
from tests.algorithms.scenes import EMPTY
from tests.dsp.fitting import noisy_maps
from tests.dsp.plane_wave_data import noise

# A prefix as long as the symbol: no place within the unambiguous range is beyond it.
SYSTEM = System(n_subcarriers=24, n_symbols=10, cyclic_prefix_ratio=1.0, cyclic_suffix_ratio=0.0)
SHAPE = (4, 5)
GATE = Gate(np.arange(3, 12), np.arange(-3, 4), slice(2, 7), slice(2, 5))
CELLS = noise(*GATE.shape, *SHAPE, seed=1)
PLACES = np.array([[6.3, 0.4, 0.2, -0.6], [6.9, 0.1, 0.5, -0.2], [8.0, -1.6, -1.1, 1.7]])
STEP = 1e-4

COORDINATES = st.tuples(st.floats(2, 13), st.floats(-4, 4), st.floats(-2, 2), st.floats(-2.5, 2.5))


atom = partial(noisy_maps.atom, SYSTEM, SHAPE, GATE)


def derivative(place, axis, order):
    """Central differences of the atom."""
    step = STEP * np.eye(N_COORDINATES)[axis]
    if order == 1:
        return (atom(place + step) - atom(place - step)) / (2 * STEP)
    return (atom(place + step) - 2 * atom(place) + atom(place - step)) / STEP**2


def dense(order):
    """Derivatives (4, n, cells) of the atoms of PLACES along the four coordinates."""
    return np.array([[derivative(place, axis, order).ravel() for place in PLACES] for axis in range(4)])


@pytest.fixture(scope="module")
def atom_map():
    return AtomMap.from_map(GatedMap(CELLS, GATE), SYSTEM)


@given(place=COORDINATES)
def test_outputs_of_the_matched_filters_are_plain_inner_products(atom_map, place):
    correlations = atom_map.correlate(atom_map.lines(np.array([place])))
    assert correlations.value[0] == pytest.approx(np.vdot(atom(place), CELLS), abs=1e-10)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_a_map_without_echoes_is_the_plain_difference(atom_map, n):
    amplitude = np.array([1.0 + 2j, -0.5j, 3.0])[:n]
    lines = atom_map.lines(PLACES[:n])
    rest = atom_map.without(lines, amplitude)
    echoes = sum((gain * atom(place) for gain, place in zip(amplitude, PLACES, strict=False)), 0 * CELLS)
    fresh = AtomMap.from_map(GatedMap(CELLS - echoes, GATE), SYSTEM)
    np.testing.assert_allclose(rest.cells, fresh.cells, atol=1e-12)
    assert rest.energy == pytest.approx(np.sum(np.abs(CELLS - echoes) ** 2), rel=1e-12)


def test_slopes_and_curvatures_of_the_outputs_are_those_of_the_atoms(atom_map):
    lines = atom_map.lines(PLACES)
    slopes = np.einsum("akc,c->ka", dense(1).conj(), CELLS.ravel())
    curvatures = np.einsum("akc,c->ka", dense(2).conj(), CELLS.ravel())
    np.testing.assert_allclose(atom_map.correlate(lines).slope, slopes, atol=1e-5)
    np.testing.assert_allclose(atom_map.correlate_curvatures(lines), curvatures, atol=1e-5)


def test_products_of_atoms_and_slopes_are_plain_inner_products_and_real(atom_map):
    atoms = {None: np.array([atom(place).ravel() for place in PLACES]), **dict(enumerate(dense(1)))}
    lines = atom_map.products(atom_map.lines(PLACES))
    for left, right in product(atoms, repeat=2):
        expected = atoms[left].conj() @ atoms[right].T
        assert np.abs(expected.imag).max() < 1e-8
        np.testing.assert_allclose(product_matrix(lines, left, right), expected.real, atol=1e-6)


def test_an_atom_on_the_whole_map_has_unit_energy_and_is_orthogonal_to_its_slopes():
    gate = Gate(np.arange(24), np.arange(-5, 5), slice(0, 24), slice(0, 10))
    atom_map = AtomMap.from_map(GatedMap(np.zeros((*gate.shape, *SHAPE), complex), gate), SYSTEM)
    products = atom_map.products(atom_map.lines(PLACES))
    for line in products:
        np.testing.assert_allclose(line.value.diagonal(), 1, rtol=1e-12)
        np.testing.assert_allclose(line.slope.diagonal(), 0, atol=1e-12)


def test_a_simulated_echo_is_its_atom_with_the_phase_at_the_middle_of_the_apertures():
    one = Scatterers(np.array([[20.0, 13.0, 9.0]]), np.array([37.0]), np.array([1.7]))
    scenario = replace(EMPTY, system=SYSTEM, array=VirtualArray((1, 1), SHAPE, 1, 1), scatterers=one)
    offset_m = scenario.scatterers.xyz - scenario.base_station_m
    u, w = scenario.frame.direction_cosines(offset_m)
    range_bin = np.linalg.norm(offset_m, axis=1) / SYSTEM.range_bin_m
    doppler_bin = scenario.scatterers.velocity / SYSTEM.velocity_bin_mps
    place = np.stack([range_bin, doppler_bin, u * SHAPE[0] / 2, w * SHAPE[1] / 2], axis=1)[0]
    amplitude = 1.7 * np.sqrt(24 * 10 * 20) * np.exp(1j * central_phase(scenario)[0])
    echo = clean_echo(scenario, GATE)
    np.testing.assert_allclose(amplitude * atom(place), echo, atol=1e-9 * np.abs(echo).max())


def narrow_map(n_p, n_q, limits, seed):
    """The same map with all of the array's dimensions and with those between the limits."""
    gate = Gate(np.arange(5, 9), np.arange(-1, 2), slice(1, 3), slice(1, 2))
    gated = GatedMap(noise(4, 3, n_p, n_q, seed=seed), gate)
    return AtomMap.from_map(gated, SYSTEM), AtomMap.from_map(gated, SYSTEM, limits)


def test_directions_between_the_limits_need_few_dimensions_and_lose_nothing():
    limits = ((-0.1, 0.2), (0.0, 0.25))
    whole, narrow = narrow_map(16, 12, limits, 2)
    assert narrow.cells.shape[2] <= 11
    assert narrow.cells.shape[3] <= 10
    assert narrow.array_shape == (16, 12)
    places = np.random.default_rng(3).uniform([5, -1, -0.8, 0], [8, 1, 1.6, 1.5], (20, 4))
    of_whole, of_narrow = (atom_map.correlate(atom_map.lines(places)) for atom_map in (whole, narrow))
    np.testing.assert_allclose(of_narrow.value, of_whole.value, atol=3e-3)
    np.testing.assert_allclose(of_narrow.slope, of_whole.slope, atol=3e-2)
    products = (atom_map.products(atom_map.lines(places)) for atom_map in (narrow, whole))
    for few, all_ in zip(*products, strict=True):
        np.testing.assert_allclose(few.value, all_.value, atol=1e-6)
        np.testing.assert_allclose(few.slope, all_.slope, atol=1e-5)
        np.testing.assert_allclose(few.slopes, all_.slopes, atol=1e-4)


@given(st.integers(1, 9), st.integers(1, 9), st.floats(-1, 1), st.floats(0, 2))
def test_bases_are_orthonormal_for_any_array_and_keep_no_more_than_it_has(n_p, n_q, lower, width):
    limits = (lower, min(lower + width, 1.0))
    _, narrow = narrow_map(n_p, n_q, (limits, limits), 4)
    for basis, n in zip(narrow.bases, (n_p, n_q), strict=True):
        assert 1 <= basis.shape[1] <= n == len(basis)
        np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-12)
