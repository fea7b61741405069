"""Scatterers from plane waves: at home in their cell, placed along Doppler, and none twice."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from isacbench.dsp.angles.plane_waves import PlaneWaves
from isacbench.dsp.scatterers import DUPLICATE_CELL, LocatedScatterers, locate_waves, merge_duplicates
from isacbench.dsp.windows import Window
from tests.algorithms.scenes import SYSTEM, echo_map
from tests.dsp.plane_wave_data import waves

WINDOWS = get_args(Window)


def gated_map(*columns):
    """Noise-free map of scatterers: range bins, Doppler bins, u, w and amplitudes."""
    return echo_map(*map(tuple, columns))


def waves_in(cells, u, w):
    """Plane waves of given directions, one a cell."""
    return waves(*(np.broadcast_to(cosine, len(cells[0]))[:, None] for cosine in (u, w)))


def placed(gated, plane_waves, cells, windows=("rect", "soft"), dynamic_range_db=60.0, **rule):
    """Places of waves of cells, by the map behind the windows."""
    bins = tuple(np.array(part) for part in cells)
    tapered = gated.tapered(*windows)
    return locate_waves(plane_waves, tapered.around(bins), tapered, bins, dynamic_range_db, **rule)


def located(gated, cells, u=0.05, w=0.15, window="soft", excess=(3.0, 1.0), dynamic_range_db=16.5):
    """Locate one wave a cell."""
    found = placed(gated, waves_in(cells, u, w), cells, ("rect", window), dynamic_range_db)
    return found.in_own_cell(*excess).scatterers


def scatterers(*rows):
    """Scatterers from rows of range bin, Doppler bin, u, w and power."""
    columns = np.array(rows, dtype=float).reshape(-1, 5).T
    return LocatedScatterers(*columns, np.full(len(rows), -1))


def rows_of(found):
    """Scatterers as a set of rows."""
    return {*zip(found.range_bin, found.doppler_bin, found.u, found.w, found.power, strict=True)}


@pytest.mark.parametrize("window", WINDOWS)
def test_a_scatterer_between_doppler_bins_is_placed_there(window):
    for doppler_bin, offset in [(-3, -0.45), (0, -0.2), (2, 0.0), (0, 0.1), (-3, 0.4), (2, 0.4)]:
        gated = gated_map([33], [doppler_bin + offset], [0.05], [0.15], [2.0])
        found = located(gated, ([33], [doppler_bin]), window=window)
        assert found.doppler_bin == pytest.approx(doppler_bin + offset, abs=2e-3)
        assert found.range_bin == pytest.approx([33])
        assert (found.u, found.w) == ([0.05], [0.15])


def test_noise_that_may_be_left_does_not_decide_on_which_side_of_a_bin_an_echo_lies():
    gated, random = gated_map([33.15], [0], [0.05], [0.15], [1.0]), np.random.default_rng(0)
    energy, n_elements = SYSTEM.processing_gain * gated.n_elements, gated.n_elements
    noise = energy / 10**1.8 / n_elements  # 18 dB behind all elements
    sides, trials = [], 40
    for _ in range(trials):
        draw = random.standard_normal((2, *gated.cells.shape)) * np.sqrt(noise * n_elements / 2)
        noisy = replace(gated, cells=gated.cells + draw[0] + 1j * draw[1])
        found = placed(noisy, waves_in(([33], [0]), 0.05, 0.15), ([33], [0]), noise=noise)
        sides.append(found.scatterers.range_bin[0] > 33)
    assert np.mean(sides) > 0.85


def test_power_is_that_of_the_echo_in_the_middle_of_its_cell():
    found = located(gated_map([33], [0], [0.05], [0.15], [2.0]), ([33], [0]), window="rect")
    assert found.power == pytest.approx(4 * SYSTEM.processing_gain)


def test_along_doppler_a_plane_wave_is_kept_in_its_own_cell_only():
    for offset in (-0.4, -0.1, 0.1, 0.4):
        gated = gated_map([33], [1 + offset], [0.05], [0.15], [1.0])
        found = located(gated, ([33] * 5, [-1, 0, 1, 2, 3]))
        assert np.rint(found.doppler_bin).tolist() == [1]


def test_along_range_the_next_cell_may_be_stronger_as_far_as_allowed():
    gated = gated_map([33.4], [0], [0.05], [0.15], [1.0])
    cells = ([31, 32, 33, 34, 35], [0] * 5)
    # Amplitudes at 33 and 34 are as 0.6 to 0.4, and those at 32 and 35 far below them.
    assert len(located(gated, cells, excess=(1.0, 1.0))) == 1
    assert len(located(gated, cells, excess=(1.6, 1.0))) == 2


@pytest.mark.parametrize("window", WINDOWS)
def test_a_scatterer_alone_between_range_bins_is_placed_there(window):
    for offset in (-0.45, -0.2, 0.0, 0.3):
        gated = gated_map([35 + offset], [1.2], [0.05], [0.15], [1.0])
        found = placed(gated, waves(0.05, 0.15), ([35], [1]), (window, "soft"), 16.5)
        assert found.scatterers.range_bin == pytest.approx([35 + offset], abs=2e-3)


def test_among_others_a_scatterer_is_left_in_the_middle_of_its_range_bin():
    gated = gated_map([34.3, 35.3, 36.2], [0] * 3, [0.05] * 3, [0.15] * 3, [1.0, 1.0, 1.0])
    assert located(gated, ([35], [0])).range_bin.tolist() == [35]


@pytest.mark.parametrize("offset", [0.03, -0.03])
def test_the_side_of_a_scatterer_near_the_middle_of_its_bin_is_told_by_phases(offset):
    gated = gated_map([35 + offset], [0], [0.05], [0.15], [1.0])
    cells = gated.cells.copy()
    # Noise makes the neighbour on the other side the stronger one.
    cells[gated.gate.index((np.array([35 + int(np.sign(offset))]), np.array([0])))] *= 0.9
    found = located(replace(gated, cells=cells), ([35], [0]), [0.05], [0.15])
    assert found.range_bin == pytest.approx([35 + offset], abs=0.01)


@pytest.mark.parametrize(
    ("weak", "dynamic_range_db", "kept"), [(35, 21, [33, 35]), (35, 19, [33]), (36, 10, [33, 36])]
)
def test_a_wave_far_below_another_is_dropped_within_5_x_5_cells(weak, dynamic_range_db, kept):
    u, w = [0.05, -0.12], [0.15, 0.2]
    gated = gated_map([33, weak], [0, 0], u, w, [1.0, 0.1])
    found = located(gated, ([33, weak], [0, 0]), u, w, dynamic_range_db=dynamic_range_db)
    assert found.range_bin.tolist() == kept


def clear(gated, cells, u, w, excess=1.1, least_left=0.33):
    """Range bins of the scatterers that are left of one wave a cell, the weakest of them 60 dB down."""
    found = placed(gated, waves_in(cells, u, w), cells)
    return np.sort(found.above_sidelobes(excess, least_left, SYSTEM).scatterers.range_bin)


@given(range_bin=st.floats(33.0, 36.0), doppler_bin=st.floats(-1.0, 1.0), w=st.floats(0.1, 0.2))
def test_of_a_lone_scatterer_that_all_cells_see_one_is_left(range_bin, doppler_bin, w):
    gated = gated_map([range_bin], [doppler_bin], [0.05], [w], [1.0])
    cells = np.meshgrid(np.arange(30, 40), np.arange(-3, 4))
    kept = clear(gated, (cells[0].ravel(), cells[1].ravel()), 0.05, w)
    assert kept == pytest.approx([range_bin], abs=0.51)


@pytest.mark.parametrize("beside", [0.0, 0.06])
@pytest.mark.parametrize("together", [False, True])
def test_a_weak_scatterer_stays_if_a_strong_one_explains_too_little_of_its_amplitude(beside, together):
    u, w = np.array([0.05, 0.05 + beside]), np.array([0.15, 0.15])

    def amplitude_there(gated):
        cell = gated.tapered("rect", "soft")
        row, column = cell.gate.index((np.array([37]), np.array([0])))
        response = np.exp(-1j * np.pi * (np.arange(8)[:, None] * u[1] + np.arange(8) * w[1]))
        return np.mean(cell.cells[row[0], column[0]] * response.conj())

    leak = amplitude_there(gated_map([34.4], [0], u[:1], w[:1], [1.0]))
    kept = set()
    for share in (0.2, 0.5, 1.0, 1.5, 2.0, 3.0):
        weak = share * abs(leak) / np.sqrt(SYSTEM.processing_gain)
        gated = gated_map([34.4, 37.0], [0, 0], u, w, [1.0, weak])
        own = amplitude_there(gated)
        level, limits = abs(own / leak), (1.1, 0.0)
        if together:
            level, limits = abs(own - leak) / abs(own), (0.0, 0.5)
        if abs(level - max(limits)) > 0.1:
            is_kept = 37 in np.rint(clear(gated, ([34, 37], [0, 0]), u, 0.15, *limits))
            assert is_kept == (level > max(limits))
            kept.add(is_kept)
    assert kept == {True, False}


def test_sidelobes_of_two_scatterers_that_add_up_are_no_third():
    u, w = np.array([0.05, 0.05]), np.array([0.15, 0.15])
    # Each alone explains half of the amplitude midway between them.
    gated = gated_map([32.5, 35.5], [0, 0], u, w, [1.0, -1.0])
    kept = clear(gated, ([32, 34, 35], [0, 0, 0]), 0.05, 0.15)
    assert kept == pytest.approx([32.5, 35.5], abs=0.1)


def test_waves_of_one_cell_are_no_sidelobes_of_each_other():
    u, w = [0.05, 0.09], [0.15, 0.15]
    found = placed(gated_map([33, 33], [0, 0], u, w, [1.0, 0.4]), waves(u, w), ([33], [0]))
    assert len(found.above_sidelobes(1.1, 0.33, SYSTEM)) == 2


def test_of_a_close_pair_that_two_cells_resolve_one_cell_keeps_both():
    u, w = np.array([0.01, 0.1]), np.array([0.15, 0.15])
    gated = gated_map([33.5, 33.5], [0, 0], u, w, [1.0, 0.9])
    found = placed(gated, waves([u, u], [w, w]), ([33, 34], [0, 0]), resolved=True)
    # The same pair seen twice: by power alone, the order of its halves would be left to rounding.
    for power in ([4.0, 3.0, 3.9, 3.1], [4.0, 3.1, 3.9, 3.0], [3.9, 3.1, 4.0, 3.0]):
        seen = replace(found, scatterers=replace(found.scatterers, power=np.array(power)))
        kept = seen.above_sidelobes(1.1, 0.33, SYSTEM)
        assert len({*kept.scatterers.family.tolist()}) == 1
        assert np.sort(kept.scatterers.u) == pytest.approx(u)


def test_what_is_no_plane_wave_is_no_scatterer():
    gated = gated_map([33], [0], [0.05], [0.15], [1.0])
    both = waves([0.05, 0.05], [0.15, 0.15])
    for found, n in (([[True, False]], 1), ([[False, False]], 0)):
        some = placed(gated, replace(both, found=np.array(found)), ([33], [0]), ("rect", "rect"))
        assert len(some.scatterers) == n


def test_waves_of_a_resolved_cell_are_one_family_and_those_of_others_none():
    gated = gated_map([33, 33, 36, 39], [0] * 4, [-0.1, 0.1, 0.05, 0.0], [0.1, 0.2, 0.1, 0.2], [1.0] * 4)
    u, w = np.array([[-0.1, 0.1], [0.05, 0], [0, 0]]), np.array([[0.1, 0.2], [0.1, 0], [0.2, 0]])
    found = np.array([[True, True], [True, False], [True, False]])
    some = PlaneWaves(u, w, found)
    for resolved, family in ((True, [0, 0, 1, 2]), (False, [-1] * 4)):
        places = placed(
            gated, some, ([33, 36, 39], [0] * 3), ("rect", "rect"), 20.0, resolved=resolved
        ).scatterers
        assert places.family.tolist() == family


def with_families(*family):
    """Scatterers a range bin apart."""
    rows = scatterers(*((30.0 + i, 1, 0.1, 0.2, 4.0 + i) for i in range(len(family))))
    return replace(rows, family=np.array(family, dtype=np.int64))


def test_joined_scatterers_stand_in_order_and_families_are_numbered_on():
    first, second = with_families(0, -1), with_families(3, -1, 0)
    joined = first.join(second)
    assert joined.range_bin.tolist() == [30.0, 31.0, 30.0, 31.0, 32.0]
    assert joined.power.tolist() == [4.0, 5.0, 4.0, 5.0, 6.0]
    assert joined.family.tolist() == [0, -1, 4, -1, 1]
    assert joined.family.dtype == np.int64


def test_joining_none_changes_nothing():
    some, none = with_families(2, -1), LocatedScatterers.empty()
    assert len(none) == len(none.join(none)) == 0
    for joined in (some.join(none), none.join(some)):
        assert rows_of(joined) == rows_of(some)
        assert joined.family.tolist() == [2, -1]
        assert joined.family.dtype == np.int64


def test_those_who_are_picked_keep_their_family():
    some = with_families(5, -1, 7)
    assert some.select(np.array([True, False, True])).family.tolist() == [5, 7]
    assert some.select(np.array([2, 0])).family.tolist() == [7, 5]


# Steps that do not divide the duplicate cell: no pair lies on its border.
STEPS = [0.17, 0.13, 0.007, 0.004]
CROWDS = st.lists(st.tuples(*[st.integers(0, 6)] * 4), max_size=25).map(
    lambda places: scatterers(*([*np.multiply(one, STEPS), 1 + 0.37 * i] for i, one in enumerate(places)))
)


@given(crowd=CROWDS, seed=st.integers(0, 999))
@example(scatterers(), 0)
def test_merging_keeps_the_strongest_as_a_plain_double_loop_does_in_any_order(crowd, seed):
    points = np.column_stack([crowd.range_bin, crowd.doppler_bin, crowd.u, crowd.w])
    kept = []
    for i in np.argsort(-crowd.power):
        if not any((np.abs(points[i] - points[j]) <= DUPLICATE_CELL).all() for j in kept):
            kept.append(i)
    shuffled = crowd.select(np.random.default_rng(seed).permutation(len(crowd)))
    merged = merge_duplicates(shuffled)
    assert rows_of(merged) == rows_of(crowd.select(np.array(kept, dtype=np.int64)))
    assert len(merged) == len(kept)


TWICE = [(30, 0.100, 9.0), (30, 0.130, 4.5), (30.1, 0.105, 8.0), (30.1, 0.127, 5.0)]


@pytest.mark.parametrize("coordinate", range(4))
def test_two_points_are_one_only_if_near_in_all_four_coordinates(coordinate):
    step = np.zeros(5)
    step[coordinate] = DUPLICATE_CELL[coordinate]
    start = np.array([30.0, 2.0, 0.1, 0.2, 1.0])
    stronger = start + 0.9 * step + [0, 0, 0, 0, 1.0]
    assert rows_of(merge_duplicates(scatterers(start, stronger))) == {tuple(stronger)}
    assert len(merge_duplicates(scatterers(start, start + 1.1 * step))) == 2


@pytest.mark.parametrize(
    ("rows", "family", "kept"),
    [
        # Range bin, u and power; power and family of what is kept. Of equals one is left.
        ([(30, 0.1, 5.0)] * 4, [-1] * 4, [(5.0, -1)]),
        # Of two cells that resolve the same pair the one with the strongest wave is heard, though its
        # estimate of the second is the weaker one; without families each point is for itself.
        (TWICE, [3, 3, 8, 8], [(9.0, 3), (4.5, 3)]),
        (TWICE, [-1] * 4, [(9.0, -1), (5.0, -1)]),
        # A cell that resolves a pair is heard before one that sees half of it.
        ([(30, 0.1, 9.0), (30.1, 0.105, 8.0), (30.1, 0.127, 5.0)], [3, 8, 8], [(8.0, 8), (5.0, 8)]),
        # What the stronger cell has not seen is kept.
        ([(30, 0.1, 9.0), (30.1, 0.105, 3.0), (30.1, 0.127, 5.0)], [3, 8, 8], [(9.0, 3), (5.0, 8)]),
    ],
)
def test_of_the_cells_that_see_the_same_scatterers_the_best_is_heard(rows, family, kept):
    seen = scatterers(*((range_bin, 1, u, 0.2, power) for range_bin, u, power in rows))
    merged = merge_duplicates(replace(seen, family=np.array(family)))
    assert [*zip(merged.power, merged.family, strict=True)] == kept
