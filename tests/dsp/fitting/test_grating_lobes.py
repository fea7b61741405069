"""Which grating lobe a scatterer is, when others' sidelobes are higher than the difference of two lobes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.bursts import symbol_bursts, whole_frame
from isacbench.dsp.fitting.joint_selection import best_lobes, lobes_within
from isacbench.model.gate import Gate
from isacbench.model.numerology import System

PRS = symbol_bursts(System(), "prs")
GATE = Gate(np.arange(10), np.arange(-16, 17), slice(4, 6), slice(8, 25))


def scene(doppler, likeness, amplitude):
    """Outputs and responses of filters at all lobes, of scatterers whose directions are so alike."""
    owner, place = lobes_within(doppler, PRS, GATE)
    bins = np.arange(-112, 112)
    kernel = PRS.response(bins, place) / np.sqrt(224 * PRS.redundancy)
    alike = np.full((doppler.size, doppler.size), likeness)
    np.fill_diagonal(alike, 1)
    response = kernel.conj().T @ kernel * alike[np.ix_(owner, owner)]
    return owner, place, response[:, : doppler.size] @ amplitude, response


def started_elsewhere(owner, place, matched, response, rng):
    """The same, each scatterer first at one of its lobes."""
    n = owner.max() + 1
    first = np.array([rng.choice(np.flatnonzero(owner == k)) for k in range(n)])
    order = np.r_[first, np.setdiff1d(np.arange(owner.size), first)]
    return owner[order], place[order], matched[order], response[np.ix_(order, order)]


@given(st.lists(st.floats(-8, 8), min_size=1, max_size=5))
def test_lobes_are_the_places_a_period_apart_that_the_region_reaches(doppler):
    doppler = np.array(doppler)
    owner, place = lobes_within(doppler, PRS, GATE)
    np.testing.assert_array_equal(owner[: doppler.size], np.arange(doppler.size))
    np.testing.assert_array_equal(place[: doppler.size], doppler)
    steps = (place - doppler[owner]) / 4
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-12)
    assert np.all(np.abs(place) <= 8.5)
    for k, bin_ in enumerate(doppler):
        expected = sum(abs(bin_ + 4 * step) <= 8.5 for step in range(-5, 6))
        assert np.count_nonzero(owner == k) == expected


def test_a_frame_without_gaps_has_no_lobes():
    owner, place = lobes_within(np.array([1.0, -3.0]), whole_frame(224), GATE)
    np.testing.assert_array_equal(owner, [0, 1])
    np.testing.assert_array_equal(place, [1.0, -3.0])


@given(st.integers(0, 10**6))
def test_a_scatterer_alone_comes_home_from_any_lobe(seed):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-8, 8, 1)
    owner, place, matched, response = started_elsewhere(*scene(truth, 0.0, np.ones(1)), rng)
    np.testing.assert_allclose(place[best_lobes(matched, response, owner)], truth)


def test_one_by_one_lobes_are_mistaken_and_together_they_are_not():
    mistaken = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        # Speeds that share their grating lobes: whole periods apart but for a fraction of a bin.
        truth = 4.0 * rng.permutation([-1, 0, 1]) + rng.uniform(-0.2, 0.2, 3)
        amplitude = np.exp(2j * np.pi * rng.uniform(size=3))
        owner, place, matched, response = started_elsewhere(*scene(truth, 0.2, amplitude), rng)
        strongest = [np.where(owner == k, np.abs(matched), 0).argmax() for k in range(3)]
        mistaken += np.any(np.abs(place[strongest] - truth) > 1)
        np.testing.assert_allclose(place[best_lobes(matched, response, owner)], truth)
    assert mistaken > 3


def test_of_no_scatterers_there_are_no_lobes():
    none = np.empty(0)
    owner, _ = lobes_within(none, PRS, GATE)
    assert best_lobes(none.astype(complex), np.empty((0, 0)), owner).size == 0
