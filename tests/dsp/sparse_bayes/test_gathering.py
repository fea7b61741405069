"""Gathering of grid atoms."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.sparse_bayes.places import merge_neighbours, strongest_near

BOX = np.array([0.2, 0.3, 0.25, 0.2])


def atoms(seed, n):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (n, 4)), rng.standard_normal(n) + 1j * rng.standard_normal(n)


@given(st.integers(0, 10**6), st.integers(0, 40))
def test_every_atom_is_gathered_once(seed, n):
    places, amplitude = atoms(seed, n)
    centres, strength = merge_neighbours(places, np.abs(amplitude), BOX)
    assert len(centres) == len(strength) <= n
    np.testing.assert_allclose(strength.sum(), np.abs(amplitude).sum())


@given(st.integers(0, 10**6), st.integers(1, 40))
def test_gathering_does_not_depend_on_the_order(seed, n):
    places, amplitude = atoms(seed, n)
    order = np.random.default_rng(seed).permutation(n)
    one = merge_neighbours(places, amplitude, BOX)
    other = merge_neighbours(places[order], amplitude[order], BOX)
    for first, second in zip(one, other, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-12)


@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(-4000, 4000))
def test_the_last_digits_of_amplitudes_move_no_centroid_of_atoms_with_few_binary_digits(seed, n, numerator):
    rng = np.random.default_rng(seed)
    # An atom that has settled, and copies of it to all sides.
    places = np.full(4, (2 * numerator + 1) * 2.0**-11) + 0.15 * rng.permutation(np.eye(4))[:n]
    weight = rng.uniform(0.5, 1, n)
    nudged = weight * (1 + 1e-15 * rng.integers(-3, 4, n))
    one, other = (merge_neighbours(places, size, BOX)[0] for size in (weight, nudged))
    np.testing.assert_array_equal(one, other)


@given(st.integers(0, 10**6), st.integers(1, 40))
def test_mirrored_atoms_are_gathered_into_mirrored_scatterers(seed, n):
    (places, amplitude), mirror = atoms(seed, n), [1, 1, -1, 1]
    (one, strength), (other, same) = (merge_neighbours(p, amplitude, BOX) for p in (places * mirror, places))
    np.testing.assert_array_equal(one * mirror, other)
    np.testing.assert_array_equal(strength, same)


@given(st.integers(0, 10**6), st.integers(1, 40))
def test_the_strongest_nearby_is_found_as_by_a_plain_loop(seed, n):
    places, amplitude = atoms(seed, n)
    size = np.abs(amplitude)
    places[:, 2:] *= 6
    expected = np.zeros(n)
    for one, other in np.ndindex(n, n):
        along_range, along_doppler, along_u, along_w = np.abs(places[one] - places[other])
        if along_range < 0.4 and along_doppler < 0.6:
            drop = max(np.pi * (along_u - 0.5), 1) * max(np.pi * (along_w - 0.5), 1)
            expected[one] = max(expected[one], size[other] / min(drop, 10**0.7))
    np.testing.assert_allclose(strongest_near(places, size, (0.4, 0.6)), expected, rtol=1e-12)


def test_amplitudes_that_cancel_leave_a_weak_atom():
    places = np.zeros((2, 4))
    places[1, 0] = 0.1
    _, strength = merge_neighbours(places, np.array([1.0, -1.0 + 0j]), BOX)
    np.testing.assert_array_equal(strength, [0])
