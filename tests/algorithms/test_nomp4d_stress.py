"""Matching pursuit ends where a map is no sum of echoes, and nowhere else, however its cells are rounded."""

from itertools import product

import numpy as np
import pytest
from isacbench_algorithms import nomp4d
from isacbench_algorithms.nomp4d import Nomp4d

from isacbench.checking.image_checks import ANY_SCALE
from isacbench.checking.stress import find_cases
from isacbench.dsp.fitting.pursuit import SPLIT_OFFSETS_CELLS, are_near


def only(spec):
    (case,) = find_cases(spec)
    return case


@pytest.fixture
def rounds(monkeypatch):
    """Number of atoms that each joint refinement within boxes starts from."""
    started = []

    def counted(atom_map, places, n_steps, *limits, **damping):
        if limits:
            started.append(len(places))
        return refine(atom_map, places, n_steps, *limits, **damping)

    refine = nomp4d.refine_atoms
    monkeypatch.setattr(nomp4d, "refine_atoms", counted)
    return started


@pytest.mark.parametrize(
    ("filled", "n_steps"),
    [
        ("constant", nomp4d.STEPS),
        *(pytest.param("constant", n_steps, marks=pytest.mark.slow) for n_steps in (3, 7)),
        *(pytest.param("checkers", n_steps, marks=pytest.mark.slow) for n_steps in (3, nomp4d.STEPS, 7)),
    ],
)
def test_equal_echoes_in_all_cells_give_the_same_image_however_they_are_rounded(filled, n_steps, monkeypatch):
    monkeypatch.setattr(nomp4d, "STEPS", n_steps)
    image, _ = only(f"map[filled={filled},exponent=0.0]").make(Nomp4d())
    assert len(image.cloud)
    assert ANY_SCALE.measure(image) <= ANY_SCALE.bound


def test_half_of_a_failed_split_that_stayed_is_not_split_again_whatever_its_last_digits():
    centres = np.random.default_rng(0).uniform(0, 30, (50, 4))
    for centre, step in product(centres, (-SPLIT_OFFSETS_CELLS[0], SPLIT_OFFSETS_CELLS[0])):
        assert are_near(centre[None] + step, centre[None], nomp4d.TABOO_CELLS)


def test_a_map_that_is_no_sum_of_echoes_gets_few_atoms_and_ends(rounds):
    Nomp4d().estimate(only("map[filled=constant,exponent=0.0]").make(Nomp4d())[0].scene.observation())
    assert len(rounds) <= 12 + 2
    assert max(rounds) < 100


def test_a_crowd_gets_all_its_rounds(rounds):
    observation = (
        only("crowd[n_echoes=100,where=one_cell,snr_db=200.0]").make(Nomp4d())[0].scene.observation()
    )
    Nomp4d(max_rounds=4).estimate(observation)
    assert len(rounds) == 4 + 2


def test_noise_that_hides_most_of_the_echoes_does_not_end_a_pursuit(rounds):
    observation = only("crowd[n_echoes=100,where=region,snr_db=-20.0]").make(Nomp4d())[0].scene.observation()
    Nomp4d(max_rounds=3).estimate(observation)
    assert len(rounds) == 3 + 2


def test_the_round_that_reaches_the_most_scatterers_is_the_last(rounds):
    observation = (
        only("crowd[n_echoes=5000,where=one_cell,snr_db=20.0]").make(Nomp4d())[0].scene.observation()
    )
    Nomp4d(max_scatterers=26).estimate(observation)
    # Two refinements follow, of no more atoms.
    assert rounds.index(26) == len(rounds) - 3
    assert max(rounds) == 26
