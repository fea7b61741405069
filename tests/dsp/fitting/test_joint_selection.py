"""Joint selection and fit: sidelobes explained, families kept together, places between the bins."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.dsp.angles.aperture import Cross, Plane
from isacbench.dsp.bounds import joint_bound
from isacbench.dsp.fitting import joint_selection
from isacbench.dsp.fitting.joint_selection import (
    FEW,
    LOADING,
    MatchedFilters,
    explain_map,
    select_jointly,
)
from isacbench.dsp.rangedoppler import GatedMap
from isacbench.dsp.scatterers import LocatedScatterers
from isacbench.model.kernels import steering
from isacbench.model.observation import cross_of
from tests.algorithms.scenes import SYSTEM, echo_map

MIN_POWER = 1e-6 * SYSTEM.processing_gain

# Range bin, Doppler bin, u, w and amplitude of scatterers in cells, or directions, of their own.
TRUE = np.array(
    [
        [30.3, -2.4, -0.10, 0.10, 1.0],
        [32.45, 0.1, 0.10, 0.12, 1.3],
        [34.2, 2.3, 0.05, 0.20, 0.7],
        [34.7, -0.2, -0.12, 0.19, 1.0],
        [36.1, 3.35, 0.14, 0.17, 0.9],
    ]
)


def gated_map(rows, noise_power=0.0, seed=0):
    """Map of scatterers given as rows of `TRUE`; read-only."""
    gated = echo_map(*map(tuple, np.transpose(rows).tolist()))
    parts = np.random.default_rng(seed).standard_normal((*gated.cells.shape, 2)) * np.sqrt(noise_power / 2)
    cells = gated.cells + parts.view(complex)[..., 0]
    cells.setflags(write=False)
    return GatedMap(cells, gated.gate)


def scatterers(rows, family=-1):
    """Candidates from rows of range bin, Doppler bin, u and w, whatever follows; power unknown."""
    rows = np.asarray(rows, dtype=float)
    return LocatedScatterers(*rows[:, :4].T, np.ones(len(rows)), np.broadcast_to(family, len(rows)).copy())


def places(found):
    """Range bin, Doppler bin, u and w, sorted by range."""
    rows = np.column_stack([found.range_bin, found.doppler_bin, found.u, found.w])
    return rows[np.argsort(rows[:, 0])]


def moved(rows, range_bins, doppler_bins, u=0.0, w=0.0):
    """Rows at other places."""
    return rows + np.array([range_bins, doppler_bins, u, w, 0])


def selected(candidates, gated, min_power, dynamic_range_db):
    """Scatterers that joint selection leaves of candidates."""
    return select_jointly(MatchedFilters(candidates, gated, SYSTEM), min_power, dynamic_range_db).scatterers


@pytest.mark.parametrize(
    ("aperture", "read"), [(Plane(8, 8), np.asarray), (Cross(8, 8), cross_of)], ids=["plane", "cross"]
)
def test_a_true_set_is_kept_whole_with_its_powers(aperture, read):
    whole = gated_map(TRUE)
    gated = GatedMap(read(whole.cells), whole.gate, aperture)
    found = selected(scatterers(TRUE), gated, MIN_POWER, 16.5)
    np.testing.assert_allclose(places(found), TRUE[:, :4])
    np.testing.assert_allclose(found.power, TRUE[:, 4] ** 2 * SYSTEM.processing_gain, rtol=2 * LOADING + 1e-5)


ONE = st.tuples(st.floats(32.5, 33.5), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1), st.floats(0.1, 0.18))


@given(ONE, st.integers(0, 999))
def test_of_one_scatterer_and_its_sidelobes_nearby_only_the_scatterer_is_selected(place, seed):
    true = np.array([[*place, 30.0]])
    side = np.concatenate(
        [moved(true, r, d) for r in (-1.9, -1, 0, 1, 1.9) for d in (-1.9, -1, 0, 1, 1.9) if r or d]
        + [moved(true, 0, 0, u, w) for u in (-0.36, 0.36) for w in (-0.36, 0, 0.36)]
    )
    candidates = np.random.default_rng(seed).permutation(np.concatenate([true, side]))
    found = selected(scatterers(candidates), gated_map(true), MIN_POWER, 16.5)
    np.testing.assert_allclose(places(found), true[:, :4])


def test_sidelobes_far_from_a_scatterer_do_not_join_it():
    true = np.array([[33.0, 0.4, 0.05, 0.15, 30.0]])
    far = np.concatenate([moved(true, r, d) for r in (-4.3, 0, 4.6) for d in (-3.1, 0, 2.7) if r or d])
    candidates = scatterers(np.concatenate([true, far]))
    # The loaded fit leaves that share of the amplitude.
    min_power = (LOADING * true[0, 4]) ** 2 * SYSTEM.processing_gain
    found = selected(candidates, gated_map(true), min_power, 16.5)
    np.testing.assert_allclose(places(found), true[:, :4])


def test_candidates_beside_true_scatterers_or_in_their_place_do_not_join_them():
    rng = np.random.default_rng(1)
    beside = [moved(TRUE, rng.choice([-1, 1]), 0), moved(TRUE, 0, rng.choice([-1, 1]))]
    for candidates, error in (([*beside, TRUE], 1e-7), ([TRUE, moved(TRUE, 0.1, 0.1)], 0.2)):
        together = scatterers(np.concatenate(candidates))
        found = selected(together, gated_map(TRUE), MIN_POWER, 16.5)
        np.testing.assert_allclose(places(found), TRUE[:, :4], rtol=0, atol=error)


# A quarter of a Rayleigh cell apart, 0.25 in u with eight elements: either responds to the other with 0.9.
CLOSE = np.array([[33.0, 0.4, 0.05, 0.15, 1.0], [33.0, 0.4, 0.1125, 0.15, 0.9j]])


def close_map():
    """Map of the close pair, a quarter of a turn between them at the middle of the array."""
    cells = 0.0
    for row, quarter in zip(np.abs(CLOSE), (1, 1j), strict=True):
        alone = gated_map([row])
        n_p, u = alone.cells.shape[2], row[2]
        phase = np.angle(np.vdot(steering(n_p, u), alone.cells.sum(axis=(0, 1, 3))))
        cells = cells + quarter * np.exp(1j * (np.pi * (n_p - 1) / 2 * u - phase)) * alone.cells
    return GatedMap(cells, alone.gate)


@pytest.mark.parametrize(
    ("family", "n_kept"), [((0, 0), 2), ((7, 7), 2), ((0, 1), 1), ((-1, -1), 1), ((0, -1), 1)]
)
def test_two_close_waves_are_kept_if_one_cell_has_told_them_apart_and_else_compete(family, n_kept):
    found = selected(scatterers(np.abs(CLOSE), family), close_map(), MIN_POWER, 16.5)
    assert len(found) == n_kept
    if n_kept == 2:
        expected = np.abs(CLOSE[:, 4]) ** 2 * SYSTEM.processing_gain
        # What loading takes is more for a pair that responds to each other.
        np.testing.assert_allclose(found.power, expected, rtol=0.05)
        assert found.family.tolist() == list(family)


def test_members_from_the_start_stay_and_a_candidate_that_repeats_one_does_not_join():
    start = scatterers(moved(TRUE[:1], 0.0, 0.2))
    # Their beams are known already.
    filters = MatchedFilters(start, gated_map(TRUE), SYSTEM).join(scatterers(TRUE))
    later = select_jointly(filters, MIN_POWER, 16.5, n_members=1).scatterers
    np.testing.assert_allclose(places(later)[0], places(start)[0])
    assert len(later) == len(TRUE)


def test_members_from_the_start_that_are_weak_beside_what_joins_leave():
    nothing_there = moved(TRUE[1:2], 1.2, 1.2, -0.25)
    candidates = scatterers(np.concatenate([nothing_there, TRUE]))
    filters = MatchedFilters(candidates, gated_map(TRUE), SYSTEM)
    found = select_jointly(filters, MIN_POWER, 16.5, n_members=1)
    np.testing.assert_allclose(places(found.scatterers), TRUE[:, :4])


@pytest.mark.parametrize(("dynamic_range_db", "n_kept"), [(19.0, 1), (21.0, 2)])
def test_beside_a_strong_neighbour_the_dynamic_range_decides(dynamic_range_db, n_kept):
    pair = np.array([[32.0, 0.0, -0.12, 0.12, 1.0], [33.0, 1.0, 0.13, 0.18, 0.1]])
    found = selected(scatterers(pair), gated_map(pair), MIN_POWER, dynamic_range_db)
    assert len(found) == n_kept
    apart = moved(pair, 0, 0)
    apart[1, 0] = 35.0
    found = selected(scatterers(apart), gated_map(apart), MIN_POWER, dynamic_range_db)
    assert len(found) == 2


def test_what_is_weaker_than_noise_may_be_is_not_selected():
    strongest = (TRUE[:, 4].max() ** 2) * SYSTEM.processing_gain
    candidates, gated = scatterers(TRUE), gated_map(TRUE)
    assert len(selected(candidates, gated, 1.01 * strongest, 16.5)) == 0
    assert len(selected(candidates, gated, 0.99 * strongest, 16.5)) == 1


def explained(rows, gated, noise_power, family=0):
    """Map explained from candidates at rows."""
    return explain_map(MatchedFilters(scatterers(rows, family), gated, SYSTEM), noise_power)


def off(rows, seed):
    """Rows up to a quarter of a Rayleigh cell off, in all four coordinates."""
    spread = np.array([0.25, 0.25, 0.25 * 2 / 8, 0.25 * 2 / 8, 0.0])
    return rows + spread * np.random.default_rng(seed).uniform(-1, 1, rows.shape)


def test_separate_scatterers_that_explain_the_map_are_near_the_joint_cramer_rao_bound():
    noise_power, n_trials = 10.0, 20
    errors = np.empty((n_trials, len(TRUE), 4))
    for trial in range(n_trials):
        found = explained(off(TRUE, trial), gated_map(TRUE, noise_power, trial), noise_power)
        errors[trial] = places(found) - TRUE[:, :4]
    bin_size = np.array([SYSTEM.range_bin_m, SYSTEM.velocity_bin_mps, 1.0, 1.0])
    range_m, velocity_mps, u, w = (TRUE[:, :4] * bin_size).T
    joint = joint_bound(SYSTEM, (8, 8), range_m, velocity_mps, u, w, TRUE[:, 4], noise_power)
    bound = np.stack([joint.range_m, joint.velocity_mps, joint.u, joint.w], axis=1) / bin_size
    # Means of 100 squares, each coordinate: within 30 % but for once in 10 000.
    ratio = np.sqrt(np.mean((errors / bound) ** 2, axis=(0, 1)))
    assert (ratio > 0.7).all()
    assert (ratio < 1.3).all()


def test_the_power_of_an_explained_map_has_no_bias_and_families_stay():
    found = explained(off(TRUE, 1), gated_map(TRUE), 1e-9 * SYSTEM.processing_gain, np.arange(5) + 2)
    assert found.family.tolist() == [2, 3, 4, 5, 6]
    np.testing.assert_allclose(places(found), TRUE[:, :4], atol=1e-5)
    expected = TRUE[:, 4] ** 2 * SYSTEM.processing_gain
    np.testing.assert_allclose(found.power[np.argsort(found.range_bin)], expected, rtol=1e-5)


@pytest.mark.parametrize("n_twins", [1, 3])
def test_scatterers_that_noise_does_not_tell_from_another_are_merged(n_twins):
    noise_power = 10.0
    twins = off(TRUE[:n_twins], 3)
    for trial in range(3):
        gated = gated_map(TRUE, noise_power, trial)
        found = explained(np.concatenate([off(TRUE, 4), twins]), gated, noise_power)
        assert len(found) == len(TRUE)
        np.testing.assert_allclose(places(found), TRUE[:, :4], atol=0.05)


def crowd(n, seed=0):
    """Rows of scatterers all over a few range bins."""
    rng = np.random.default_rng(seed)
    lower, upper = [31, -3, -0.12, 0.10, 0.8], [36, 3, 0.12, 0.18, 1.2]
    return rng.uniform(lower, upper, (n, 5))


def test_a_crowd_is_not_explained_by_a_few():
    assert explained(TRUE, gated_map(np.concatenate([TRUE, crowd(40)])), 1.0) is None


def test_many_scatterers_of_which_no_cell_is_resolved_are_a_crowd_without_a_fit():
    rows = crowd(FEW + 1)
    unresolved = np.where(np.arange(len(rows)) < 0.45 * len(rows), 0, -1)
    # Even where the candidates are the truth, to the last digit.
    assert explained(rows, gated_map(rows), 1.0, unresolved) is None
    assert explained(rows, gated_map(rows), 1.0, family=0) is not None


def test_many_scatterers_that_leave_much_of_the_map_are_not_fitted(monkeypatch):
    monkeypatch.setattr(joint_selection, "refine_atoms", None)
    rows = crowd(40)
    assert explained(rows[: FEW + 1], gated_map(rows), 1.0) is None


def test_without_scatterers_there_is_nothing_to_select_or_fit():
    nothing = scatterers(np.empty((0, 5)))
    gated = gated_map(TRUE)
    assert len(selected(nothing, gated, MIN_POWER, 16.5)) == 0
    assert len(explain_map(MatchedFilters(nothing, gated, SYSTEM), 1.0)) == 0
