from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from isacbench.dsp.cfar import ca_cfar, osca_cfar
from isacbench.dsp.thresholds import ca_factor, osca_factor, paper_factor
from isacbench.errors import InputError

SEEDS = st.integers(0, 2**32 - 1)
CA = (ca_cfar, 3, 1)
OSCA = (osca_cfar, 4, None)
OSCA_GUARDED = (osca_cfar, (3, 2), (1, 2))
ALL = pytest.mark.parametrize(
    ("detect", "training", "guard"), [CA, OSCA, OSCA_GUARDED], ids=["ca", "osca", "osca-guarded"]
)


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


def plain_noise_and_factor(detect, power, cell, training, guard, pfa, looks):
    columns = window_columns(power.shape, cell, training, guard)
    if detect is ca_cfar:
        chosen = [c for column in columns for c in column]
        return math.fsum(power[c] for c in chosen) / len(chosen), ca_factor(pfa, len(chosen), looks)
    orders, laws = [], []
    for column in columns:
        rank = max(1, math.floor(0.75 * len(column)))
        orders.append(sorted(power[c] for c in column)[rank - 1])
        laws.append((rank, len(column) - (cell in column)))
    return math.fsum(orders) / len(orders), osca_factor(pfa, tuple(laws), looks)


SIZES = st.tuples(st.integers(0, 2), st.integers(0, 2))


@settings(max_examples=40, deadline=None)
@given(
    SEEDS,
    st.tuples(st.integers(9, 12), st.integers(9, 12)),
    SIZES.filter(any),
    SIZES,
    st.sampled_from([1, 4]),
    st.sampled_from(["ca", "osca", "osca with the cell inside"]),
)
def test_every_cell_up_to_the_edges_equals_a_plain_double_loop(seed, shape, training, guard, looks, kind):
    detect = ca_cfar if kind == "ca" else osca_cfar
    if kind == "osca with the cell inside":
        training, guard = (training[0] + 1, training[1]), None
    power = noise_map(seed, shape, looks)
    found = detect(power, training, guard, 0.05, looks=looks)
    for cell in np.ndindex(shape):
        noise, factor = plain_noise_and_factor(detect, power, cell, training, guard, 0.05, looks)
        assert found.noise[cell] == pytest.approx(noise, rel=1e-13)
        assert found.threshold[cell] == pytest.approx(factor * noise, rel=1e-11)
    assert np.array_equal(found.mask, power > found.threshold)


@ALL
@given(seed=SEEDS, exponent=st.integers(-300, 300))
@settings(max_examples=20, deadline=None)
def test_power_of_two_scale_leaves_the_mask_unchanged(detect, training, guard, seed, exponent):
    power = noise_map(seed, (15, 13))
    found, scaled = (detect(p, training, guard, 0.05) for p in (power, np.ldexp(power, exponent)))
    assert np.array_equal(found.mask, scaled.mask)
    assert np.array_equal(np.ldexp(found.threshold, exponent), scaled.threshold)


@ALL
@given(seed=SEEDS, rows=st.integers(0, 5), cols=st.integers(0, 5))
@settings(max_examples=20, deadline=None)
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
@settings(max_examples=20, deadline=None)
def test_smaller_pfa_detects_a_subset(detect, training, guard, seed, pfa, ratio):
    power = noise_map(seed, (12, 12))
    strict, loose = (detect(power, training, guard, p).mask for p in (pfa * ratio, pfa))
    assert not np.any(strict & ~loose)


@ALL
@given(seed=SEEDS, cell=st.tuples(st.integers(0, 14), st.integers(0, 12)))
@settings(max_examples=20, deadline=None)
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
@settings(max_examples=10, deadline=None)
def test_float32_map_gives_what_the_same_map_in_float64_gives(detect, training, guard, seed):
    power = noise_map(seed, (14, 14)).astype(np.float32)
    single, double = (detect(p, training, guard, 1e-3) for p in (power, power.astype(np.float64)))
    assert single.threshold.dtype == single.noise.dtype == np.float64
    assert np.array_equal(single.threshold, double.threshold)
    assert np.array_equal(single.mask, double.mask)


@pytest.mark.parametrize(("detect", "guard"), [(ca_cfar, 1), (osca_cfar, None), (osca_cfar, 1)])
@pytest.mark.parametrize("looks", [1, 16, 256])
def test_false_alarm_rate_is_nominal_in_the_corner_at_the_border_and_inside(detect, guard, looks):
    # One independent map for each place along the last axis, which the window does not mix.
    training, keep = ((4, 4, 0), None) if guard is None else ((3, 3, 0), (1, 1, 0))
    n_maps, pfa = 20_000, 0.02
    found = detect(noise_map(looks, (9, 9, n_maps), looks), training, keep, pfa, looks=looks)
    least, most = binom.interval(1 - 1e-6, n_maps, pfa)
    for cell in ((0, 0), (0, 4), (8, 3), (4, 4)):
        assert least <= np.count_nonzero(found.mask[cell]) <= most


@pytest.mark.slow
@pytest.mark.parametrize(("detect", "guard"), [(ca_cfar, 1), (osca_cfar, None), (osca_cfar, 1)])
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


@pytest.mark.parametrize(("detect", "training", "guard", "n"), [(*CA, 72), (*OSCA, 9)])
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


@ALL
@pytest.mark.parametrize(
    ("power", "message"),
    [
        (np.ones((12, 12), complex), "complex128"),
        (np.ones((12, 12), bool), "bool"),
        (bad(np.nan), "nan"),
        (bad(np.inf), "inf"),
        (bad(-1e-9), "-1e-09"),
        (np.full((12, 12), 1e308), "overflow"),
        (np.ones((8, 12)), "larger than the map"),
        (np.ones((12, 8)), "larger than the map"),
        (np.ones((0, 12)), "shape"),
        (np.float64(1), "shape"),
    ],
)
def test_bad_map_is_refused_with_a_message_that_names_it(detect, training, guard, power, message):
    with pytest.raises(InputError, match=message):
        detect(power, training, guard, 1e-3)


@pytest.mark.parametrize("detect", [ca_cfar, osca_cfar])
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"pfa": 0.0}, "pfa = 0.0"),
        ({"pfa": 1.0}, "pfa = 1.0"),
        ({"looks": 0}, "looks = 0"),
        ({"looks": 1.5}, "looks = 1.5"),
        ({"threshold": "printed"}, "threshold = 'printed'"),
        ({"training": -1}, "training = -1"),
        ({"training": 0}, "training = 0"),
        ({"training": (1, 2, 3)}, "2 axes"),
        ({"training": 1.5}, "training = 1.5"),
        ({"guard": -1}, "guard = -1"),
        ({"guard": (1,)}, "2 axes"),
    ],
)
def test_bad_parameter_is_refused_with_a_message_that_names_it(detect, changed, message):
    parameters = {"training": 2, "guard": 1, "pfa": 0.1} | changed
    with pytest.raises(InputError, match=message):
        detect(np.ones((12, 12)), **parameters)


def test_osca_with_the_cell_inside_refuses_columns_of_that_cell_alone():
    with pytest.raises(InputError, match="axis 0"):
        osca_cfar(np.ones((12, 12)), (0, 4), None, 0.1)
