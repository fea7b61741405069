"""Sparse Bayesian learning: grids in the space of the data, atoms in their own, both the same."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.sparse_bayes import learning
from isacbench.dsp.sparse_bayes.learning import GridModel, Noise, learn_atoms, learn_grid, matched
from tests.dsp.plane_wave_data import noise as white

SHAPES = st.tuples(*(st.tuples(st.integers(1, 5), st.integers(1, 4)) for _ in range(3)))


def correlated(n, rng):
    mixing = rng.standard_normal((n, n))
    return mixing @ mixing.T / n + np.eye(n)


def every_atom(factors):
    """All atoms of a grid as rows (a b c, r d w), by a plain loop."""
    return np.array([np.kron(np.kron(x, y), z) for x, y, z in product(*factors)])


def problem(shapes, seed):
    """Dictionaries, noise, the atoms of the grid and the covariance of the noise."""
    rng = np.random.default_rng(seed)
    factors = tuple(rng.standard_normal(shape) for shape in shapes)
    (_, r), (_, d), (_, w) = shapes
    noise = Noise(0.3, correlated(r, rng), correlated(d, rng))
    covariance = 0.3 * np.kron(np.kron(noise.along_range, noise.along_doppler), np.eye(w))
    return factors, noise, every_atom(factors), covariance, rng


PROBLEMS = given(st.builds(problem, SHAPES, st.integers(0, 10**6)))


@PROBLEMS
def test_the_covariance_of_a_grid_is_the_sum_over_its_atoms_and_noise(problem):
    factors, noise, atoms, covariance, rng = problem
    power = rng.uniform(0, 2, [len(each) for each in factors])
    expected = atoms.T @ (power.ravel()[:, None] * atoms) + covariance
    np.testing.assert_allclose(GridModel(factors, noise).covariance(power), expected, rtol=1e-12, atol=1e-12)


@PROBLEMS
def test_the_information_of_a_grid_is_the_quadratic_form_of_each_atom(problem):
    factors, noise, atoms, _, rng = problem
    inverse = correlated(atoms.shape[1], rng)
    expected = np.array([atom @ inverse @ atom for atom in atoms])
    information = GridModel(factors, noise).information(inverse)
    np.testing.assert_allclose(information.ravel(), expected, rtol=1e-11, atol=1e-11)


@PROBLEMS
def test_products_of_a_grid_are_those_of_its_atoms(problem):
    factors, _, atoms, _, rng = problem
    data = rng.standard_normal([each.shape[1] for each in factors]) * (1 + 0.5j)
    np.testing.assert_allclose(matched(factors, data).ravel(), atoms @ data.ravel(), rtol=1e-12, atol=1e-12)


def few_echoes(rng):
    """A grid that resolves nothing, two of its atoms as echoes, and white noise."""
    step = np.linspace(0, 3, 7)
    factors = tuple(np.sinc(step[:, None] - np.arange(n)) for n in (5, 3, 4))
    data = 3 * np.einsum("r,d,w->rdw", *(each[2] for each in factors))
    data = data + 2j * np.einsum("r,d,w->rdw", *(each[5] for each in factors))
    return factors, data + 0.07 * white(*data.shape, seed=rng)


def test_learning_in_the_space_of_atoms_is_learning_in_the_space_of_data(monkeypatch, rng):
    monkeypatch.setattr(learning, "STEPS_A_VARIANCE", 1)
    monkeypatch.setattr(learning, "FIRST_PRUNED_STEP", 100)
    factors, data = few_echoes(rng)
    atoms = every_atom(factors)
    power = rng.uniform(0.5, 1, [len(each) for each in factors])
    noise = Noise(0.01, np.eye(5), np.eye(3))
    on_grid = learn_grid(factors, data, noise, power, 5)
    index, amplitude = learn_atoms(atoms @ atoms.T, atoms @ data.ravel(), power.ravel(), 0.01, 5)
    assert index.tolist() == list(range(len(atoms)))
    np.testing.assert_allclose(on_grid.ravel(), amplitude, atol=2e-3)


def test_learning_leaves_the_echoes_and_little_else(rng):
    factors, data = few_echoes(rng)
    noise = Noise(0.005, np.eye(5), np.eye(3))
    power = np.abs(matched(factors, data)) ** 2
    size = np.abs(learn_grid(factors, data, noise, power, 60))
    strongest = np.argsort(-size.ravel())[:2]
    assert {np.unravel_index(at, size.shape) for at in strongest} == {(2, 2, 2), (5, 5, 5)}
    assert np.sort(size.ravel())[-2:] == pytest.approx([2, 3], abs=0.2)
    assert np.count_nonzero(size > 0.05) < 20


def test_an_atom_without_first_power_gets_none(rng):
    factors, data = few_echoes(rng)
    power = np.ones([len(each) for each in factors])
    power[2, 2, 2] = 0
    amplitude = learn_grid(factors, data, Noise(0.005, np.eye(5), np.eye(3)), power, 8)
    assert amplitude[2, 2, 2] == 0
    assert np.abs(amplitude).max() > 0


@pytest.mark.parametrize("exponent", [-60, 60])
def test_powers_of_two_change_no_bit_of_a_grid(exponent, rng):
    factors, data = few_echoes(rng)
    power, unit = np.ones([len(each) for each in factors]), 2.0**exponent
    noise = Noise(0.005, np.eye(5), np.eye(3))
    one = learn_grid(factors, data, noise, power, 8)
    other = learn_grid(factors, unit * data, noise._replace(power=0.005 * unit**2), unit**2 * power, 8)
    np.testing.assert_array_equal(unit * one, other)


def test_directions_of_many_cells_are_those_of_each_cell_alone(rng):
    factors = rng.standard_normal((7, 4)), rng.standard_normal((5, 3))
    cells = white(6, 4, 3, seed=rng)
    noise = rng.uniform(0.1, 1, 6)
    together = learning.learn_directions(factors, cells, noise, 4)
    for cell, power, level in zip(cells, together, noise, strict=True):
        alone = learning.learn_directions(factors, cell[None], level[None], 4)
        np.testing.assert_allclose(alone[0], power, rtol=1e-9)


def test_weak_atoms_are_left_out_of_what_is_learned():
    gram = np.eye(4)
    index, amplitude = learn_atoms(gram, np.array([1, 1e-6, 1j, 1e-7]), np.ones(4), 1e-4, 6)
    assert index.tolist() == [0, 2]
    np.testing.assert_allclose(amplitude, [1, 1j], atol=1e-3)
