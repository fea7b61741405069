"""Atoms off the grid: joint steps under a falling ridge, and blocks of range bins."""

import numpy as np
import pytest

from isacbench.dsp.fitting.atom_fits import fit_atoms
from isacbench.dsp.sparse_bayes.range_blocks import Atoms, relearn
from isacbench.dsp.sparse_bayes.ridge_steps import settle

from .conftest import NOISE

OFFSETS = np.array([[0, 0, 0, 0], [1.3, 0.4, 0.5, -0.4], [4.2, -1.2, -0.4, 0.3], [-3.0, 2.0, 0.1, 0.0]])
AMPLITUDE = np.array([1, 1j, -0.9, 0.8j])


def test_atoms_settle_on_the_echoes(noisy_map, reach_and_map, middle, rng):
    reach, _ = reach_and_map
    places = middle + OFFSETS
    fit = settle(noisy_map(places, AMPLITUDE), reach, places + rng.uniform(-0.15, 0.15, places.shape), NOISE)
    np.testing.assert_allclose(fit.places, places, atol=0.02)
    np.testing.assert_allclose(fit.amplitude, AMPLITUDE, atol=0.05)


def test_copies_of_an_atom_become_one(noisy_map, reach_and_map, middle):
    reach, _ = reach_and_map
    atom_map, copies = (
        noisy_map(middle[None], [1]),
        middle + 0.1 * np.array([[1, 0, 0, 0], [-1, 0, 1, 0], [0, 0, -1, 1]]),
    )
    atoms = Atoms.of(atom_map, copies, fit_atoms(atom_map, copies, 1e-2).amplitude)
    fit = settle(atom_map, reach, relearn(atoms, reach, NOISE).places, NOISE)
    near = np.abs(fit.places - middle).max(axis=1) < 0.3
    assert near.all()
    assert abs(fit.amplitude.sum()) == pytest.approx(1, abs=0.05)


def test_misfit_and_places_outside_are_dropped(noisy_map, reach_and_map, middle):
    reach, _ = reach_and_map
    extra = np.array([[0.9, 0.6, 0, 0], [0, 0, 40.0, 0]])
    places = np.concatenate([middle + OFFSETS, middle + extra])
    fit = settle(noisy_map(middle + OFFSETS, AMPLITUDE), reach, places, NOISE)
    assert len(fit) == len(OFFSETS)


def test_nothing_stands_out_of_noise(noisy_map, reach_and_map, middle):
    reach, _ = reach_and_map
    assert settle(noisy_map(middle[None], [0]), reach, middle + OFFSETS, NOISE) is None


def test_learning_in_blocks_keeps_count_of_what_is_left(noisy_map, reach_and_map, middle, rng):
    reach, _ = reach_and_map
    places, atom_map = middle + OFFSETS, noisy_map(middle + OFFSETS, AMPLITUDE)
    first = places + rng.uniform(-0.1, 0.1, places.shape)
    before = Atoms.of(atom_map, first, fit_atoms(atom_map, first, 1e-2).amplitude)
    after = relearn(before, reach, NOISE)
    assert after.rest.energy < 0.6 * before.rest.energy
    left = atom_map.without(atom_map.lines(after.places), after.amplitude)
    np.testing.assert_allclose(left.cells, after.rest.cells, atol=1e-10)
    assert np.abs(places[:, None] - after.places).max(axis=2).min(axis=1).max() < 0.15
