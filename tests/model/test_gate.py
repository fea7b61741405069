"""The gate: every cell that the region can reach, no cell twice."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from isacbench.model.gate import DOPPLER_MARGIN_BINS, RANGE_MARGIN_BINS, build_gate
from isacbench.model.numerology import System
from isacbench.model.region import Region

FRACTIONS = st.floats(0, 1)


def limits(size):
    """Two ascending numbers."""
    return st.tuples(*[st.floats(-size, size)] * 2).map(lambda ends: tuple(sorted(ends)))


@st.composite
def scenes(draw):
    """Draw a system, a base station and a region that they observe without ambiguity."""
    system = System(n_subcarriers=draw(st.integers(1, 300)), n_symbols=draw(st.integers(1, 60)))
    box = limits(system.unambiguous_range_m / np.sqrt(3) / 2)
    region = Region(draw(box), draw(box), draw(box), draw(limits(system.unambiguous_speed_mps)))
    base_m = region.lower_m + np.array([draw(FRACTIONS) * 2 - 0.5 for _ in range(3)]) * region.size_m
    if region.range_limits_m(base_m)[1] > system.unambiguous_range_m:
        base_m = region.lower_m
    return system, base_m, region


@given(scenes(), st.tuples(*[FRACTIONS] * 4))
def test_the_reachable_cells_cover_every_scatterer_of_any_region(scene, place):
    system, base_m, region = scene
    gate = build_gate(*scene)
    xyz = np.clip(region.lower_m + np.array(place[:3]) * region.size_m, region.lower_m, region.upper_m)
    low, high = region.speed_mps
    speed_mps = np.clip(low + place[3] * (high - low), low, high)
    range_bin = np.rint(np.linalg.norm(xyz - base_m) / system.range_bin_m)
    doppler_bin = np.rint(speed_mps / system.velocity_bin_mps)
    rows = gate.range_bins[gate.reachable_range] % system.n_subcarriers
    columns = gate.doppler_bins[gate.reachable_doppler] % system.n_symbols
    assert range_bin % system.n_subcarriers in rows
    assert doppler_bin % system.n_symbols in columns


@given(scenes())
def test_bins_are_consecutive_and_never_more_than_the_map_and_wrap_where_they_are_all(scene):
    system = scene[0]
    gate = build_gate(*scene)
    for bins, n_bins in ((gate.range_bins, system.n_subcarriers), (gate.doppler_bins, system.n_symbols)):
        assert 1 <= bins.size <= n_bins
        assert (np.diff(bins) == 1).all()
    assert gate.wraps == (gate.shape[0] == system.n_subcarriers, gate.shape[1] == system.n_symbols)


@given(scenes())
def test_the_mask_is_what_the_slices_say_and_margins_are_equal_to_one_bin(scene):
    gate = build_gate(*scene)
    assert gate.reachable.shape == gate.shape == (gate.range_bins.size, gate.doppler_bins.size)
    reached, margins = (
        (gate.reachable_range, gate.reachable_doppler),
        (RANGE_MARGIN_BINS, DOPPLER_MARGIN_BINS),
    )
    assert gate.reachable.sum() == np.prod([part.stop - part.start for part in reached])
    for part, n_bins, margin in zip(reached, gate.shape, margins, strict=True):
        before, after = part.start, n_bins - part.stop
        assert 0 <= after - before <= 1
        assert after <= margin


def test_the_street_keeps_its_margins():
    region = Region((0.0, 30.0), (0.0, 20.0), (0.0, 20.0), (-15.0, 15.0))
    gate = build_gate(System(), np.array([14.0, 100.0, 20.0]), region)
    assert gate.range_bins[[0, -1]].tolist() == [256, 344]
    assert gate.doppler_bins[[0, -1]].tolist() == [-16, 16]
    assert gate.reachable_range == slice(6, 83)
    assert gate.reachable_doppler == slice(8, 25)


def test_a_region_at_the_base_station_borrows_its_margin_from_the_far_end_of_the_map():
    gate = build_gate(System(), np.zeros(3), Region((0.0, 9.0), (0.0, 1.0), (0.0, 1.0), (0.0, 0.0)))
    assert gate.range_bins[0] == -RANGE_MARGIN_BINS
    assert gate.reachable_doppler == slice(DOPPLER_MARGIN_BINS, DOPPLER_MARGIN_BINS + 1)


def assert_same_bins(gate, range_bins, doppler_bins, reachable):
    np.testing.assert_array_equal(gate.range_bins, range_bins)
    np.testing.assert_array_equal(gate.doppler_bins, doppler_bins)
    np.testing.assert_array_equal(gate.reachable, reachable)


@given(scenes(), st.integers(0, 2), st.integers(0, 2))
def test_trimming_takes_bins_off_both_ends_and_keeps_the_reachable_ones_that_are_left(scene, n, m):
    gate = build_gate(*scene)
    assume(min(gate.shape[0] - 2 * n, gate.shape[1] - 2 * m) >= 1)
    rows, columns = slice(n, gate.shape[0] - n), slice(m, gate.shape[1] - m)
    bins = gate.range_bins[rows], gate.doppler_bins[columns]
    assert_same_bins(gate.extend(-n, -m), *bins, gate.reachable[rows, columns])


@given(scenes(), st.integers(0, 3), st.integers(0, 3))
def test_extending_a_gate_is_undone_by_trimming_it(scene, n, m):
    gate = build_gate(*scene)
    longer = gate.extend(n, m)
    assert longer.shape == (gate.shape[0] + 2 * n, gate.shape[1] + 2 * m)
    assert longer.wraps == (gate.wraps[0] and n == 0, gate.wraps[1] and m == 0)
    assert_same_bins(longer.extend(-n, -m), gate.range_bins, gate.doppler_bins, gate.reachable)
