from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from scipy.stats import binom

from isacbench.dsp.cfar import training_cells
from isacbench.dsp.cfar.factors import (
    ca_factor,
    goca_factor,
    osca_factor,
    paper_factor,
    soca_factor,
    tm_factor,
)
from isacbench.errors import InputError


def function_of(detector):
    """Gives a detector's test as a function of the map, its window and its other parameters."""

    def detect(power, training, guard, pfa, threshold="exact", looks=1, cells=None, **own):
        return detector(pfa, training, guard, threshold, **own).detect(power, looks, cells)

    return detect


ca_cfar, goca_cfar, os_cfar, osca_cfar, soca_cfar, tm_cfar = map(
    function_of, (CaCfar, GocaCfar, OsCfar, OscaCfar, SocaCfar, TmCfar)
)
SEEDS = st.integers(0, 2**32 - 1)
CA = (ca_cfar, 3, 1)
OSCA = (osca_cfar, 4, None)
OSCA_GUARDED = (osca_cfar, (3, 2), (1, 2))
FRAMED = [goca_cfar, soca_cfar, os_cfar, tm_cfar]
ALL = pytest.mark.parametrize(
    ("detect", "training", "guard"),
    [CA, OSCA, OSCA_GUARDED, *((detect, 3, 1) for detect in FRAMED)],
    ids=["ca", "osca", "osca-guarded", "goca", "soca", "os", "tm"],
)
WITH_GUARD = pytest.mark.parametrize(
    ("detect", "guard"), [(ca_cfar, 1), (osca_cfar, None), *((detect, 1) for detect in (osca_cfar, *FRAMED))]
)
EACH = pytest.mark.parametrize("detect", [ca_cfar, osca_cfar, *FRAMED])


def noise_map(seed, shape, looks=1):
    return np.random.default_rng(seed).standard_gamma(looks, shape) / looks


def window_columns(shape, cell, training, guard):
    """Lists the training cells of a cell of a 2-D map, column by column along axis 0."""
    reach = [t + (0 if guard is None else guard[axis]) for axis, t in enumerate(training)]
    row, col = (
        min(max(i - r, 0), length - 2 * r - 1) for i, r, length in zip(cell, reach, shape, strict=True)
    )
    columns = []
    for c in range(col, col + 2 * reach[1] + 1):
        column = []
        for r in range(row, row + 2 * reach[0] + 1):
            if guard is None or abs(r - cell[0]) > guard[0] or abs(c - cell[1]) > guard[1]:
                column.append((r, c))
        if column:
            columns.append(column)
    return columns


def window_cells(shape, cell, training, guard):
    """Lists the training cells of a cell of a map of any rank, in the order of the axes."""
    starts = [
        min(max(i - t - g, 0), length - 2 * (t + g) - 1)
        for i, t, g, length in zip(cell, training, guard, shape, strict=True)
    ]
    listed = []
    for place in np.ndindex(*(2 * (t + g) + 1 for t, g in zip(training, guard, strict=True))):
        other = tuple(s + p for s, p in zip(starts, place, strict=True))
        if any(abs(o - i) > g for o, i, g in zip(other, cell, guard, strict=True)):
            listed.append(other)
    return listed


def plain_noise_and_factor(detect, power, cell, training, guard, pfa, looks, option):
    if detect is osca_cfar:
        orders, laws = [], []
        for column in window_columns(power.shape, cell, training, guard):
            rank = max(1, math.floor(0.75 * len(column)))
            orders.append(sorted(power[c] for c in column)[rank - 1])
            laws.append((rank, len(column) - (cell in column)))
        return math.fsum(orders) / len(orders), osca_factor(pfa, tuple(laws), looks)

    chosen = window_cells(power.shape, cell, training, guard)
    n = len(chosen)
    if detect is ca_cfar:
        return math.fsum(power[c] for c in chosen) / n, ca_factor(pfa, n, looks)
    ordered = sorted(power[c] for c in chosen)
    if detect is os_cfar:
        rank = max(1, math.floor(option * n + 1e-9))
        return ordered[rank - 1], osca_factor(pfa, ((rank, n),), looks)
    if detect is tm_cfar:
        below, above = (math.floor(part * n + 1e-9) for part in option)
        kept = ordered[below : n - above]
        return math.fsum(kept) / len(kept), tm_factor(pfa, n, (below, above), looks)

    def place(c):
        return (c[option], *(i for axis, i in enumerate(c) if axis != option))

    halves = [[c for c in chosen if place(c) < place(cell)], [c for c in chosen if place(c) > place(cell)]]
    means = [math.fsum(power[c] for c in half) / len(half) for half in halves if half]
    factor = (goca_factor if detect is goca_cfar else soca_factor)(
        pfa, (len(halves[0]), len(halves[1])), looks
    )
    return (max if detect is goca_cfar else min)(means), factor


def options(detect):
    """Gives what a detector has beyond its window, as its parameters and for the plain loop."""
    return {
        ca_cfar: ({}, None),
        osca_cfar: ({}, None),
        os_cfar: ({"rank_fraction": 0.6}, 0.6),
        tm_cfar: ({"trim_low": 0.1, "trim_high": 0.4}, (0.1, 0.4)),
        goca_cfar: ({"split_axis": 0}, 0),
        soca_cfar: ({"split_axis": 0}, 0),
    }[detect]


SIZES = st.tuples(st.integers(0, 2), st.integers(0, 2))


def equals_a_plain_double_loop(detect, power, training, guard, looks, parameters, option):
    found = detect(power, training, guard, 0.05, looks=looks, **parameters)
    for cell in np.ndindex(power.shape):
        noise, factor = plain_noise_and_factor(detect, power, cell, training, guard, 0.05, looks, option)
        assert found.noise[cell] == pytest.approx(noise, rel=1e-13)
        assert found.threshold[cell] == pytest.approx(factor * noise, rel=1e-11)
    assert np.array_equal(found.mask, power > found.threshold)


@EACH
@settings(max_examples=5, deadline=None)
@given(
    seed=SEEDS,
    shape=st.tuples(st.integers(9, 12), st.integers(9, 12)),
    training=SIZES.filter(any),
    guard=SIZES,
    looks=st.sampled_from([1, 4]),
)
def test_every_cell_up_to_the_edges_equals_a_plain_double_loop(detect, seed, shape, training, guard, looks):
    equals_a_plain_double_loop(
        detect, noise_map(seed, shape, looks), training, guard, looks, *options(detect)
    )


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.tuples(st.integers(9, 12), st.integers(9, 12)), SIZES, st.sampled_from([1, 4]))
def test_osca_with_the_cell_inside_equals_a_plain_double_loop(seed, shape, training, looks):
    training = training[0] + 1, training[1]
    equals_a_plain_double_loop(osca_cfar, noise_map(seed, shape, looks), training, None, looks, {}, None)


@pytest.mark.parametrize("detect", [ca_cfar, *FRAMED])
@settings(max_examples=10, deadline=None)
@given(seed=SEEDS, length=st.integers(13, 20), training=st.integers(1, 4), guard=st.integers(0, 2))
def test_every_cell_of_a_line_equals_a_plain_loop(detect, seed, length, training, guard):
    equals_a_plain_double_loop(detect, noise_map(seed, (length,)), (training,), (guard,), 1, *options(detect))


@pytest.mark.parametrize("detect", [goca_cfar, soca_cfar])
@pytest.mark.parametrize("split_axis", [0, 1, 2])
def test_halves_along_any_axis_of_a_cube_equal_a_plain_loop(detect, split_axis):
    # No more than the window but along that axis, and one cell more there.
    power = noise_map(split_axis, np.add((5, 3, 7), np.arange(3) == split_axis))
    sizes = (1, 1, 2), (1, 0, 1)
    equals_a_plain_double_loop(detect, power, *sizes, 1, {"split_axis": split_axis}, split_axis)


def test_halves_of_the_default_window_are_36_and_36():
    power = noise_map(1, (9, 9))
    chosen = window_cells(power.shape, (4, 4), (3, 3), (1, 1))
    means = [np.mean([power[c] for c in half]) for half in (chosen[:36], chosen[36:])]
    assert chosen[35] < (4, 4) < chosen[36]
    for detect, factor, noise in ((goca_cfar, 6.710225, max(means)), (soca_cfar, 8.198775, min(means))):
        found = detect(power, 3, 1, 1e-3)
        assert found.noise[4, 4] == pytest.approx(noise)
        assert found.threshold[4, 4] == pytest.approx(factor * noise, rel=1e-6)


@pytest.mark.parametrize("detect", [goca_cfar, soca_cfar])
def test_where_one_half_is_empty_the_test_is_cell_averaging(detect):
    power = noise_map(2, (30,))
    found, averaged = (one(power, 4, 2, 1e-3) for one in (detect, ca_cfar))
    for cell in (0, 1, 2, 27, 28, 29):
        assert found.threshold[cell] == pytest.approx(averaged.threshold[cell], rel=1e-13)


@pytest.mark.parametrize(
    ("detect", "name"), [(goca_cfar, "split_axis"), (soca_cfar, "split_axis"), (osca_cfar, "order_axis")]
)
def test_another_axis_is_the_map_turned(detect, name):
    power = noise_map(3, (14, 17))
    found = detect(power, (2, 3), (1, 0), 0.05, **{name: 1})
    turned = detect(power.T, (3, 2), (0, 1), 0.05)
    assert np.array_equal(found.mask, turned.mask.T)
    assert np.array_equal(found.threshold, turned.threshold.T)
    cells = np.nonzero(power > np.median(power))
    listed = detect(power, (2, 3), (1, 0), 0.05, cells=cells, **{name: 1})
    assert np.array_equal(listed.threshold, found.threshold[cells])


@ALL
@settings(max_examples=8, deadline=None)
@given(
    seed=SEEDS,
    shape=st.sampled_from([(12, 11), (40, 43)]),
    n_cells=st.sampled_from([0, 1, 7, 40, 300]),
    looks=st.sampled_from([1, 4]),
)
def test_listed_cells_have_the_values_of_the_whole_map(detect, training, guard, seed, shape, n_cells, looks):
    power = noise_map(seed, shape, looks)
    rng = np.random.default_rng(seed)
    cells = tuple(rng.integers(0, length, n_cells) for length in shape)
    whole = detect(power, training, guard, 0.05, looks=looks)
    listed = detect(power, training, guard, 0.05, looks=looks, cells=cells)
    assert listed.mask.shape == listed.noise.shape == (n_cells,)
    assert np.array_equal(listed.mask, whole.mask[cells])
    assert np.array_equal(listed.noise, whole.noise[cells])
    assert np.array_equal(listed.threshold, whole.threshold[cells])


@EACH
@pytest.mark.parametrize("shape", [(60,), (9, 8, 10)])
def test_listed_cells_of_a_map_of_any_rank_have_the_values_of_the_whole_map(detect, shape):
    power = noise_map(1, shape)
    training, guard = (1, 1) if len(shape) == 1 else ((0, 2, 1), (0, 1, 1))
    cells = tuple(index[::17] for index in np.indices(shape).reshape(len(shape), -1))
    whole, listed = (detect(power, training, guard, 0.05, cells=some) for some in (None, cells))
    assert np.array_equal(listed.mask, whole.mask[cells])
    assert np.array_equal(listed.threshold, whole.threshold[cells])


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ((np.array([1]),), "tuple of 2"),
        (np.array([[1, 2]]), "tuple of 2"),
        ((np.array([1, 2]), np.array([1])), "equally long"),
        ((np.array([[1]]), np.array([[1]])), "one-dimensional"),
        ((np.array([1.0]), np.array([1.0])), "whole numbers"),
        ((np.ones(12, bool), np.ones(12, bool)), "whole numbers"),
        ((np.array([-1]), np.array([1])), "-1 to -1 along axis 0"),
        ((np.array([1]), np.array([3, 12])[1:]), "12 to 12 along axis 1"),
    ],
)
def test_list_that_names_no_cells_of_the_map_is_refused(cells, message):
    with pytest.raises(InputError, match=message):
        ca_cfar(np.ones((12, 12)), 2, 1, 0.1, cells=cells)


@ALL
@pytest.mark.parametrize("n_values", [1, 700])
def test_parts_of_a_map_have_the_values_of_the_map_in_one(monkeypatch, detect, training, guard, n_values):
    power = noise_map(8, (37, 14))
    whole = detect(power, training, guard, 0.05)
    monkeypatch.setattr(training_cells, "_MOST_VALUES", n_values)
    parts = detect(power, training, guard, 0.05)
    assert np.array_equal(parts.mask, whole.mask)
    assert np.array_equal(parts.threshold, whole.threshold)


@ALL
def test_memory_order_of_the_map_changes_nothing(detect, training, guard):
    power = noise_map(9, (14, 17))
    found, turned = (detect(np.asarray(power, order=order), training, guard, 0.05) for order in "CF")
    assert np.array_equal(found.noise, turned.noise)
    assert np.array_equal(found.threshold, turned.threshold)


@settings(max_examples=30, deadline=None)
@given(
    SEEDS,
    st.tuples(st.integers(9, 40), st.integers(9, 14)),
    SIZES.filter(any),
    SIZES,
    st.sampled_from([0.0, 0.3, 0.75, 1.0]),
    st.sampled_from([1e-3, 0.3, 0.9]),
    st.booleans(),
)
def test_mask_by_counting_is_the_comparison_with_the_sorted_threshold(
    seed, shape, training, guard, rank_fraction, pfa, ties
):
    power = noise_map(seed, shape)
    if ties:
        power = np.floor(2 * power)
    found = os_cfar(power, training, guard, pfa, rank_fraction=rank_fraction)
    assert np.array_equal(found.mask, power > found.threshold)


def test_mask_by_counting_counts_beyond_255_training_cells():
    power = noise_map(4, (2000,))
    found = os_cfar(power, 300, 2, 0.05)
    assert np.array_equal(found.mask, power > found.threshold)
    assert found.mask.any()


def test_noise_of_the_order_statistic_belongs_to_the_map_that_was_tested():
    power = noise_map(5, (20, 20))
    expected = os_cfar(power, 3, 1, 0.05)
    assert expected.threshold.shape == power.shape
    found = os_cfar(power, 3, 1, 0.05)
    copied = pickle.loads(pickle.dumps(os_cfar(power, 3, 1, 0.05)))
    power[:] = 0
    for one in (found, copied):
        assert np.array_equal(one.mask, expected.mask)
        assert np.array_equal(one.noise, expected.noise)
        assert np.array_equal(one.threshold, expected.threshold)


def test_trimmed_mean_lies_between_cell_averaging_and_the_order_statistic():
    power = noise_map(6, (15, 15))
    untrimmed = tm_cfar(power, 3, 1, 1e-3, trim_low=0, trim_high=0)
    averaged = ca_cfar(power, 3, 1, 1e-3)
    np.testing.assert_allclose(untrimmed.threshold, averaged.threshold, rtol=1e-12)
    vector = power.ravel()
    one_left = tm_cfar(vector, 4, 1, 1e-3, trim_low=5 / 8, trim_high=2 / 8)
    order = os_cfar(vector, 4, 1, 1e-3)
    inner = slice(5, -5)
    np.testing.assert_allclose(one_left.threshold[inner], order.threshold[inner], rtol=1e-9)


def alarms(detect, power, training, guard, pfa, looks, places):
    """Counts the maps, one for each place along the last axis, in which each of a few cells is detected."""
    n_maps = power.shape[2]
    rows, columns = np.repeat(places, n_maps, axis=0).T
    cells = rows, columns, np.tile(np.arange(n_maps), len(places))
    found = detect(power, training, guard, pfa, looks=looks, cells=cells)
    return np.count_nonzero(found.mask.reshape(len(places), n_maps), axis=1)


@EACH
@settings(max_examples=8, deadline=None, derandomize=True)
@given(seed=SEEDS, training=SIZES.filter(any), guard=SIZES, looks=st.sampled_from([1, 3]))
def test_false_alarm_rate_is_nominal_for_windows_of_any_shape(detect, seed, training, guard, looks):
    # One in ten, for a rate is known the better the larger it is: to 33 % here as to 45 % of 0.03.
    n_maps, pfa = 3000, 0.1
    shape = tuple(2 * (t + g) + 3 for t, g in zip(training, guard, strict=True))
    power = noise_map(seed, (*shape, n_maps), looks)
    places = (0, 0), (0, 1), (shape[0] // 2, shape[1] // 2), (shape[0] - 1, 0)
    counts = alarms(detect, power, (*training, 0), (*guard, 0), pfa, looks, places)
    # Maps are independent of each other, cells of one map are not.
    least, most = binom.interval(1 - 1e-9, n_maps, pfa)
    assert np.all((least <= counts) & (counts <= most))


@ALL
@given(seed=SEEDS, exponent=st.integers(-600, 600))
@settings(max_examples=10, deadline=None)
def test_power_of_two_scale_leaves_the_mask_unchanged(detect, training, guard, seed, exponent):
    power = noise_map(seed, (15, 13))
    found, scaled = (detect(p, training, guard, 0.05) for p in (power, np.ldexp(power, exponent)))
    assert np.array_equal(found.mask, scaled.mask)
    assert np.array_equal(np.ldexp(found.threshold, exponent), scaled.threshold)


@ALL
@given(seed=SEEDS, rows=st.integers(0, 5), cols=st.integers(0, 5))
@settings(max_examples=10, deadline=None)
def test_shifted_map_gives_the_shifted_detection_away_from_the_edges(
    detect, training, guard, seed, rows, cols
):
    power = noise_map(seed, (24, 22))
    whole = detect(power, training, guard, 0.05)
    cut = detect(power[rows:, cols:], training, guard, 0.05)
    inner = (slice(4, -4), slice(4, -4))
    assert np.array_equal(whole.mask[rows:, cols:][inner], cut.mask[inner])
    assert np.array_equal(whole.threshold[rows:, cols:][inner], cut.threshold[inner])


@ALL
@given(seed=SEEDS, pfa=st.floats(1e-6, 0.9), ratio=st.floats(0.01, 0.99))
@settings(max_examples=3, deadline=None)
def test_smaller_pfa_detects_a_subset(detect, training, guard, seed, pfa, ratio):
    # Every seventh cell: of each column one, and as many of the factors that halves of windows need.
    power, cells = noise_map(seed, (12, 12)), tuple(np.indices((12, 12)).reshape(2, -1)[:, ::7])
    strict, loose = (detect(power, training, guard, p, cells=cells).mask for p in (pfa * ratio, pfa))
    assert not np.any(strict & ~loose)


@ALL
@given(seed=SEEDS, cell=st.tuples(st.integers(0, 14), st.integers(0, 12)))
@settings(max_examples=10, deadline=None)
def test_noise_of_a_cell_depends_on_its_training_cells_alone(detect, training, guard, seed, cell):
    power = noise_map(seed, (15, 13))
    sizes = [(size,) * 2 if isinstance(size, int) else size for size in (training, guard)]
    column_cells = window_columns(power.shape, cell, *sizes)
    trains = np.zeros(power.shape, dtype=bool)
    trains[tuple(np.transpose([c for column in column_cells for c in column]))] = True
    changed = np.where(trains, power, 1e12)
    found, other = (detect(p, training, guard, 0.05) for p in (power, changed))
    assert found.noise[cell] == other.noise[cell]
    assert found.threshold[cell] == other.threshold[cell]


@ALL
def test_noise_beside_a_peak_of_1e12_is_right_to_1e_minus_12(detect, training, guard):
    power = noise_map(3, (21, 21))
    clean = detect(power, training, guard, 1e-3).noise
    power[10, 10] = 1e12
    noise = detect(power, training, guard, 1e-3).noise
    reached = np.zeros(power.shape, dtype=bool)
    sizes = [(size,) * 2 if isinstance(size, int) else size for size in (training, guard)]
    for cell in np.ndindex(power.shape):
        reached[cell] = any((10, 10) in column for column in window_columns(power.shape, cell, *sizes))
    np.testing.assert_allclose(noise[~reached], clean[~reached], rtol=1e-12)
    if detect is ca_cfar:
        assert np.all(noise[reached] > 1e10)


@ALL
@given(seed=SEEDS)
@settings(max_examples=5, deadline=None)
def test_float32_map_gives_what_the_same_map_in_float64_gives(detect, training, guard, seed):
    power = noise_map(seed, (14, 14)).astype(np.float32)
    single, double = (detect(p, training, guard, 1e-3) for p in (power, power.astype(np.float64)))
    assert single.threshold.dtype == single.noise.dtype == np.float64
    assert np.array_equal(single.threshold, double.threshold)
    assert np.array_equal(single.mask, double.mask)


@WITH_GUARD
@pytest.mark.parametrize("looks", [1, 16, pytest.param(256, marks=pytest.mark.slow)])
def test_false_alarm_rate_is_nominal_in_the_corner_at_the_border_and_inside(detect, guard, looks):
    # One independent map for each place along the last axis, which the window does not mix.
    training, keep = ((4, 4, 0), None) if guard is None else ((3, 3, 0), (1, 1, 0))
    n_maps, pfa = 8000, 0.02
    power, places = noise_map(looks, (9, 9, n_maps), looks), ((0, 0), (0, 4), (8, 3), (4, 4))
    counts = alarms(detect, power, training, keep, pfa, looks, places)
    least, most = binom.interval(1 - 1e-6, n_maps, pfa)
    assert np.all((least <= counts) & (counts <= most))


@pytest.mark.slow
@WITH_GUARD
def test_false_alarm_rate_of_1e_minus_3_holds_in_every_cell_of_a_window(detect, guard):
    training, keep = ((4, 4, 0), None) if guard is None else ((3, 3, 0), (1, 1, 0))
    n_maps, pfa = 200_000, 1e-3
    rate = np.mean(
        [
            detect(noise_map(seed, (9, 9, n_maps // 10)), training, keep, pfa).mask.mean(axis=2)
            for seed in range(10)
        ],
        axis=0,
    )
    least, most = binom.interval(1 - 1e-6, n_maps, pfa)
    assert np.all((least <= rate * n_maps) & (rate * n_maps <= most))


def test_errata_osca_order_takes_the_6th_smallest_of_9_and_not_percentile_75():
    power = np.arange(9.0) ** 2 + 1
    noise = osca_cfar(power, 4, None, 0.1).noise
    assert np.all(noise == np.sort(power)[5])
    assert np.percentile(power, 75) == np.sort(power)[6]


@pytest.mark.parametrize(
    ("detect", "training", "guard", "n"), [(*CA, 72), (*OSCA, 9), *((detect, 3, 1, 72) for detect in FRAMED)]
)
def test_printed_factor_multiplies_the_same_noise(detect, training, guard, n):
    power = noise_map(5, (9, 9))
    found = detect(power, training, guard, 1e-3, "paper")
    assert np.array_equal(found.noise, detect(power, training, guard, 1e-3).noise)
    assert found.threshold[4, 4] == pytest.approx(paper_factor(1e-3, n) * found.noise[4, 4])


def test_osca_on_a_vector_is_the_plain_order_statistic():
    power = noise_map(6, 40)
    found = osca_cfar(power, 8, 2, 1e-3)
    chosen = [i for i in range(10, 31) if abs(i - 20) > 2]
    assert found.noise[20] == np.sort(power[chosen])[11]
    assert found.threshold[20] == pytest.approx(osca_factor(1e-3, ((12, 16),)) * found.noise[20])


@pytest.mark.parametrize("detect", [ca_cfar, osca_cfar])
@pytest.mark.parametrize("axis", [0, 1])
def test_axis_without_training_and_guard_holds_independent_maps(detect, axis):
    power = noise_map(7, (12, 12))
    training, guard = ((0, 3), (0, 1)) if axis == 0 else ((3, 0), (1, 0))
    # Columns of one cell are their own order statistic, and their mean is cell averaging.
    detect_vector = ca_cfar if axis == 0 else detect
    found = detect(power, training, guard, 0.05)
    for i in range(12):
        alone = detect_vector(np.take(power, i, axis), 3, 1, 0.05)
        np.testing.assert_allclose(np.take(found.threshold, i, axis), alone.threshold, rtol=1e-9)
        assert np.array_equal(np.take(found.mask, i, axis), alone.mask)


@ALL
def test_strong_cell_is_found_and_the_map_is_not_written_to(detect, training, guard):
    power = np.ones((15, 15))
    power[7, 3] = 100.0
    power.flags.writeable = False
    assert np.argwhere(detect(power, training, guard, 1e-3).mask).tolist() == [[7, 3]]


@ALL
def test_silent_map_detects_nothing(detect, training, guard):
    found = detect(np.zeros((12, 12)), training, guard, 0.5)
    assert not found.mask.any()
    assert not found.threshold.any()


def bad(value):
    power = np.ones((12, 12))
    power[3, 4] = value
    return power


@pytest.mark.parametrize(
    ("power", "message"),
    [
        (np.ones((12, 12), complex), "complex128"),
        (np.ones((12, 12), bool), "bool"),
        (bad(np.nan), "nan"),
        (bad(np.inf), "inf"),
        (bad(-1e-9), "-1e-09"),
        (np.ones((8, 12)), "larger than the map"),
        (np.ones((12, 8)), "larger than the map"),
        (np.ones((0, 12)), "shape"),
        (np.float64(1), "shape"),
    ],
)
def test_bad_map_is_refused_with_a_message_that_names_it(power, message):
    with pytest.raises(InputError, match=message):
        ca_cfar(power, 3, 1, 1e-3)
    if np.ndim(power) == 2:
        with pytest.raises(InputError, match=message):
            ca_cfar(power, 3, 1, 1e-3, cells=(np.array([5]), np.array([5])))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"looks": 0}, "looks = 0"),
        ({"looks": 1.5}, "looks = 1.5"),
        ({"training": (1, 2, 3)}, "2 axes"),
        ({"guard": (1,)}, "2 axes"),
    ],
)
def test_looks_and_windows_that_do_not_fit_the_map_are_refused_by_name(changed, message):
    parameters = {"training": 2, "guard": 1, "pfa": 0.1} | changed
    with pytest.raises(InputError, match=message):
        ca_cfar(np.ones((12, 12)), **parameters)


def test_osca_with_the_cell_inside_refuses_columns_of_that_cell_alone():
    with pytest.raises(InputError, match="axis 0"):
        osca_cfar(np.ones((12, 12)), (0, 4), None, 0.1)


@pytest.mark.parametrize(
    ("detect", "parameters", "message"),
    [
        (goca_cfar, {"split_axis": 2}, "split_axis = 2"),
        (osca_cfar, {"order_axis": 2}, "order_axis = 2"),
    ],
)
def test_an_axis_that_the_map_lacks_is_refused_by_name(detect, parameters, message):
    with pytest.raises(InputError, match=message):
        detect(np.ones((12, 12)), 2, 1, 0.1, **parameters)


@ALL
def test_every_detector_refuses_nan_and_a_list_outside_the_map(detect, training, guard):
    with pytest.raises(InputError, match="nan"):
        detect(bad(np.nan), training, guard, 1e-3)
    with pytest.raises(InputError, match="12 to 12 along axis 0"):
        detect(np.ones((12, 12)), training, guard, 1e-3, cells=(np.array([12]), np.array([1])))
