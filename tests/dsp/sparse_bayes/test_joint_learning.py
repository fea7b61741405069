"""Atoms off the grid: joint steps under a falling ridge, and blocks of range bins."""

from dataclasses import replace

import numpy as np
import pytest

from isacbench.dsp.fitting.atom_fits import fit_atoms
from isacbench.dsp.sparse_bayes.range_blocks import Atoms, learn_blocks
from isacbench.dsp.sparse_bayes.ridge_steps import drop_model_error, refine_on_map, worth

from .conftest import NOISE

OFFSETS = np.array([[0, 0, 0, 0], [1.3, 0.4, 0.5, -0.4], [4.2, -1.2, -0.4, 0.3], [-3.0, 2.0, 0.1, 0.0]])
AMPLITUDE = np.array([1, 1j, -0.9, 0.8j])


def test_atoms_settle_on_the_echoes(noisy_map, reach, middle, rng):
    places = middle + OFFSETS
    starts = places + rng.uniform(-0.15, 0.15, places.shape)
    fit = refine_on_map(noisy_map(places, AMPLITUDE), reach, starts, NOISE)
    np.testing.assert_allclose(fit.places, places, atol=0.02)
    np.testing.assert_allclose(fit.amplitude, AMPLITUDE, atol=0.05)


def test_last_digits_do_not_decide_whether_a_last_step_is_taken(noisy_map, reach, middle):
    atom_map = noisy_map(middle[None], [1e3])
    for offset in (1e-7, 1e-4, 1e-2):
        scaled = (replace(atom_map, cells=unit * atom_map.cells) for unit in (1.0, 1.7, 0.3, 3.1, 1.1, 0.77))
        places = [refine_on_map(one, reach, middle[None] + offset, NOISE).places for one in scaled]
        np.testing.assert_allclose(places, places[:1] * len(places), rtol=0, atol=1e-11)


def test_copies_of_an_atom_become_one(noisy_map, reach, middle):
    atom_map = noisy_map(middle[None], [1])
    copies = middle + 0.1 * np.array([[1, 0, 0, 0], [-1, 0, 1, 0], [0, 0, -1, 1]])
    atoms = Atoms.of(atom_map, copies, fit_atoms(atom_map, copies, 1e-2).amplitude)
    fit = refine_on_map(atom_map, reach, learn_blocks(atoms, reach, NOISE).places, NOISE)
    near = np.abs(fit.places - middle).max(axis=1) < 0.3
    assert near.all()
    assert abs(fit.amplitude.sum()) == pytest.approx(1, abs=0.05)


def test_misfit_and_places_outside_are_dropped(noisy_map, reach, middle):
    extra = np.array([[0.9, 0.6, 0, 0], [0, 0, 40.0, 0]])
    places = np.concatenate([middle + OFFSETS, middle + extra])
    fit = refine_on_map(noisy_map(middle + OFFSETS, AMPLITUDE), reach, places, NOISE)
    assert len(fit) == len(OFFSETS)


def test_nothing_stands_out_of_noise(noisy_map, reach, middle):
    assert len(refine_on_map(noisy_map(middle[None], [0]), reach, middle + OFFSETS, NOISE)) == 0


@pytest.mark.parametrize("amplitude", [12, 50, 100])
def test_of_two_atoms_on_one_echo_one_moves_there(amplitude, noisy_map, reach, middle):
    atom_map = noisy_map(middle[None], [amplitude * np.sqrt(NOISE)])
    double = middle + 0.4 * np.array([[0, 0, 1, 0], [0, 0, -1, 0]])
    apart = fit_atoms(atom_map, double, 1e-4)
    assert (apart.power > 20 * NOISE).all()
    fit = refine_on_map(atom_map, reach, double, NOISE)
    assert len(fit) == 1
    assert worth(fit, NOISE) > worth(apart, NOISE)
    assert np.abs(fit.places - middle).max() < 2 / amplitude


def test_noise_around_an_atom_is_no_misfit(noisy_map, reach, middle):
    echoes = middle + np.array([[0, 0, 0, 0], [4.5, 0.2, 0, 0]])
    fit = fit_atoms(noisy_map(echoes, np.sqrt(NOISE) * np.array([7.5, 120])), echoes, 1e-4)
    assert len(drop_model_error(fit, reach, NOISE)) == len(fit)


def test_learning_in_blocks_keeps_count_of_what_is_left(noisy_map, reach, middle, rng):
    places, atom_map = middle + OFFSETS, noisy_map(middle + OFFSETS, AMPLITUDE)
    first = places + rng.uniform(-0.1, 0.1, places.shape)
    before = Atoms.of(atom_map, first, fit_atoms(atom_map, first, 1e-2).amplitude)
    after = learn_blocks(before, reach, NOISE)
    assert after.rest.energy < 0.6 * before.rest.energy
    left = atom_map.without(atom_map.lines(after.places), after.amplitude)
    np.testing.assert_allclose(left.cells, after.rest.cells, atol=1e-10)
    assert np.abs(places[:, None] - after.places).max(axis=2).min(axis=1).max() < 0.15


def test_weak_atoms_stay_where_the_map_is_explained_and_are_misfit_where_it_is_not(noisy_map, reach, middle):
    places = middle + np.array([[-3.0, 0, 0, 0], [4.0, 0, 0.3, 0]])
    explained = noisy_map(places, [1, 0.05])
    kept = drop_model_error(fit_atoms(explained, places, 1e-4), reach, NOISE)
    np.testing.assert_array_equal(kept.places, places)
    beside = places[1] + np.array([[0.5, 0.8, 0, 0.7], [-0.6, -0.8, 0.6, 0]])
    crowded = explained.without(explained.lines(beside), np.array([-0.05, 0.05j]))
    kept = drop_model_error(fit_atoms(crowded, places, 1e-4), reach, NOISE)
    np.testing.assert_array_equal(kept.places, places[:1])


def test_no_atom_stands_out_of_a_map_that_none_explains(noisy_map, reach, middle):
    echoes = middle + np.array([[-3.0, 0, 0, 0], [3.0, 0, 0, 0]])
    atom_map, elsewhere = noisy_map(echoes, [1, 1]), echoes + np.array([0, 1.0, 0, 0])
    assert len(drop_model_error(fit_atoms(atom_map, elsewhere, 1e-4), reach, NOISE)) == 0
