"""Orthogonal matching pursuit on a grid, against dense dictionaries."""

import warnings
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest

from isacbench.dsp.fitting.atoms import AtomMap
from isacbench.dsp.fitting.grid_pursuit import PlaceGrid, pursue_on_grid
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.model.gate import Gate
from isacbench.model.numerology import System
from tests.dsp.fitting.noisy_maps import atom

SYSTEM = System(n_subcarriers=12, n_symbols=8)
SHAPE = (4, 5)
WHOLE = Gate(np.arange(12), np.arange(-4, 4), slice(0, 12), slice(0, 8))
PART = Gate(np.arange(2, 9), np.arange(-3, 3), slice(1, 5), slice(1, 5))
GATES = {"whole": WHOLE, "part": PART}
U, W = np.arange(-2, 3) / 2, np.arange(-3, 3) / 2
BINS = np.array([(r, d) for r in np.arange(3.5, 6.5, 0.5) for d in np.arange(-1, 1.5, 0.5)])
ENERGY = 1e-6

echo = partial(atom, SYSTEM, SHAPE)


def scene(gate, *, level=0.02, seed=0):
    """Map of three echoes on the grid and one off it, in noise."""
    rng = np.random.default_rng(seed)
    places = [(4.0, 0.5, -1.0, 1.0), (4.5, -0.5, 0.5, -1.5), (6.0, 1.0, 1.0, 0.0), (5.3, 0.2, -0.3, 0.8)]
    cells = sum(g * echo(gate, place) for place, g in zip(places, (2.0, 1.5j, -1.0, 0.7 + 0.3j), strict=True))
    return cells + level * rng.standard_normal((*cells.shape, 2)).view(np.complex128)[..., 0]


def grid_places():
    """Places (m g h, 4) of the grid, in its order."""
    return np.array([(*place, u, w) for place in BINS for u in U for w in W])


def pursued(cells, gate, n_most, zoom=1, **kwargs):
    """Atoms of the pursuit on the grid."""
    atom_map = AtomMap.from_map(GatedMap(cells, gate), SYSTEM)
    grid = PlaceGrid(BINS, U, W, np.array([0.5, 0.5, 0.5, 0.5]), zoom)
    limits = {"least_energy": ENERGY, "dynamic_range_db": 200.0, **kwargs}
    return pursue_on_grid(atom_map, grid, n_most=n_most, **limits)


@cache
def filled_dictionary(gate_name):
    """Echoes (cells, places) of all places of the grid, one after the other."""
    echoes = [echo(GATES[gate_name], place).ravel() for place in grid_places()]
    return np.stack(echoes, axis=1)


def plain_pursuit(cells, gate_name, n_most):
    """Places and least-squares amplitudes by a textbook pursuit over a filled dictionary."""
    dictionary, data = filled_dictionary(gate_name), cells.ravel()
    norms = np.linalg.norm(dictionary, axis=0)
    residual, chosen = data, []
    for _ in range(n_most):
        chosen.append(int(np.argmax(np.abs(residual.conj() @ dictionary) / norms)))
        amplitude = np.linalg.lstsq(dictionary[:, chosen], data, rcond=None)[0]
        residual = data - dictionary[:, chosen] @ amplitude
    return grid_places()[chosen], amplitude


@pytest.mark.parametrize("gate_name", GATES)
def test_atoms_and_amplitudes_are_those_of_a_filled_dictionary(gate_name):
    gate = GATES[gate_name]
    for seed in range(2):
        cells = scene(gate, seed=seed)
        places, amplitude = plain_pursuit(cells, gate_name, 8)
        found = pursued(cells, gate, 8)
        np.testing.assert_array_equal(found.places, places)
        np.testing.assert_allclose(np.abs(found.amplitude), np.abs(amplitude), rtol=1e-8)


def test_atoms_are_those_of_another_implementation():
    from doa_py.algorithm import omp  # brings hundreds of modules

    cells, dictionary = scene(WHOLE), filled_dictionary("whole")
    array = SimpleNamespace(steering_vector=lambda frequency, grids, unit: dictionary)
    with warnings.catch_warnings(action="ignore", category=PendingDeprecationWarning):  # of its matrices
        theirs = omp(cells.reshape(-1, 1), 6, array, 1.0, np.arange(len(grid_places())))
    ours = pursued(cells, WHOLE, 6).places
    np.testing.assert_array_equal(grid_places()[theirs], sorted(ours.tolist()))


def test_what_is_left_is_orthogonal_to_every_atom():
    cells = scene(PART)
    found = pursued(cells, PART, 12, zoom=4)
    atom_map = AtomMap.from_map(GatedMap(cells, PART), SYSTEM)
    lines = atom_map.lines(found.places)
    left = atom_map.without(lines, found.amplitude).correlate(lines).value
    assert np.abs(left).max() < 1e-9 * np.abs(atom_map.correlate(lines).value).max()


@pytest.mark.parametrize(
    "place", [(4.31, 0.17, -0.62, 0.93), (5.0, 0.5, 0.25, -1.25), (3.24, -0.74, 1.4, 0.1)]
)
def test_a_lone_echo_off_the_grid_is_one_atom_at_its_place(place):
    found = pursued(3.0 * echo(WHOLE, place), WHOLE, 5, zoom=4, least_energy=0.01)
    assert len(found.places) == 1
    np.testing.assert_allclose(found.places[0], place, atol=5e-3)
    assert abs(found.amplitude[0]) ** 2 == pytest.approx(9.0, rel=1e-3)


def test_the_pursuit_ends_with_the_energy_the_dynamic_range_or_the_number_asked_for():
    cells = scene(PART)
    everything = pursued(cells, PART, 40, least_energy=0.02).places
    assert len(everything) < 40
    assert len(pursued(cells, PART, 3).places) == 3
    fewer = pursued(cells, PART, 40, least_energy=0.02, dynamic_range_db=10.0).places
    assert 0 < len(fewer) < len(everything)
    assert len(pursued(cells, PART, 40, least_energy=1e6).places) == 0
    np.testing.assert_array_equal(fewer, everything[: len(fewer)])


def test_the_pursuit_ends_where_the_best_atom_is_a_sum_of_those_before():
    # As many directions as the map has dimensions, and more: at last nothing is new.
    cells = scene(PART)[:1, :1]
    gate = Gate(PART.range_bins[:1], PART.doppler_bins[:1], slice(0, 1), slice(0, 1))
    found = pursued(cells, gate, 60, least_energy=0.0)
    assert len(found.places) <= 2 * np.prod(SHAPE)
    assert np.isfinite(found.amplitude).all()


def test_a_map_without_power_and_a_grid_without_places_give_no_atoms():
    silence = np.zeros((*PART.shape, *SHAPE), dtype=complex)
    assert len(pursued(silence, PART, 5).places) == len(pursued(silence, PART, 5, zoom=4).places) == 0
    atom_map = AtomMap.from_map(GatedMap(scene(PART), PART), SYSTEM)
    nowhere = PlaceGrid(np.empty((0, 2)), U, W, np.full(4, 0.5), 4)
    assert len(pursue_on_grid(atom_map, nowhere, ENERGY, 30.0, 5).places) == 0
