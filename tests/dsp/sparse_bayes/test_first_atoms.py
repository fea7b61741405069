"""First atoms of a map: static and moving ones, and none in noise."""

import numpy as np
import pytest

from isacbench.dsp.sparse_bayes.first_atoms import first_atoms
from isacbench.dsp.sparse_bayes.tiles import BinTaper, strong_dimensions

from .conftest import NOISE

OFFSETS = np.array(
    [[0, 0, 0, 0], [0.6, 0, 0.4, -0.3], [3.6, 0, -0.4, 0.2], [1.2, 2.3, 0.1, 0.3], [-3.0, -3.4, -0.2, 0.0]]
)


def found(atom_map, reach, taper):
    return first_atoms(atom_map, reach, NOISE, taper(atom_map.range_bins))


@pytest.mark.parametrize("taper", [BinTaper.hann, BinTaper.none])
def test_every_echo_has_an_atom_close_by(taper, noisy_map, reach, middle):
    places, amplitude = middle + OFFSETS, np.array([1, 1j, -0.7, 0.8, 0.5j])
    learned, _ = found(noisy_map(places, amplitude), reach, taper)
    distance = np.abs(places[:, None] - learned)
    assert distance.max(axis=2).min(axis=1).max() < 0.3


@pytest.mark.parametrize("taper", [BinTaper.hann, BinTaper.none])
def test_a_moving_echo_is_seen_once_its_line_is_no_noise(taper, noisy_map, reach, middle):
    place = middle + np.array([0, 2.0, 0, 0])
    learned, _ = found(noisy_map(place[None], [np.sqrt(300 * NOISE)]), reach, taper)
    assert np.abs(learned - place).max(axis=1).min() < 0.3


def test_places_beyond_the_region_have_no_atom(noisy_map, reach, middle):
    learned, _ = found(noisy_map(middle + OFFSETS, np.ones(5)), reach, BinTaper.hann)
    assert reach.contains(learned, tolerance_m=1.5).all()


def test_noise_alone_has_no_atoms_of_its_own_strength(noisy_map, reach, middle):
    _, strength = found(noisy_map(middle[None], [0]), reach, BinTaper.hann)
    assert strength.size == 0 or strength.max() < 6 * np.sqrt(NOISE)


def test_speeds_that_are_spread_are_atoms_of_their_own(noisy_map, reach, middle):
    places = middle + np.array([[0, 1.0, 0, 0], [0, 1.8, 0.2, 0], [0, 2.6, 0, 0.2], [0, 3.4, 0.1, 0.1]])
    learned, _ = found(noisy_map(places, np.ones(4)), reach, BinTaper.hann)
    assert np.abs(places[:, None, 1] - learned[:, 1]).min(axis=1).max() < 0.25


def test_strong_dimensions_hold_a_dictionary(rng):
    dictionary = rng.standard_normal((9, 3)) @ rng.standard_normal((3, 6))
    basis = strong_dimensions(dictionary, 1e-6)
    assert basis.shape == (6, 3)
    np.testing.assert_allclose(dictionary @ basis @ basis.T, dictionary, atol=1e-9)
