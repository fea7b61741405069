"""CFAR detectors on hostile but finite maps: ends of float64, huge dynamic range, odd shapes and layouts."""

from __future__ import annotations

import math
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar

from isacbench.dsp.cfar import os_mask, training_cells
from isacbench.dsp.cfar.factors import ca_factor, paper_factor
from isacbench.dsp.cfar.map_checks import checked_power
from isacbench.errors import InputError

SEEDS = st.integers(0, 2**32 - 1)
LARGEST, SMALLEST = np.finfo(np.float64).max, 5e-324
DETECTORS = {"ca": CaCfar, "os": OsCfar, "osca": OscaCfar, "goca": GocaCfar, "soca": SocaCfar, "tm": TmCfar}
EACH = pytest.mark.parametrize("detector", DETECTORS.values(), ids=DETECTORS)
TRAINING, GUARD = (2, 1), (1, 1)
SHAPE = 11, 13


def small(detector, **parameters):
    """Builds a detector with a small window of unequal sides."""
    return detector(training=TRAINING, guard=GUARD, **parameters)


def noise_map(seed, shape=SHAPE):
    return np.random.default_rng(seed).standard_exponential(shape)


def hostile_maps(shape):
    noise, checkers = noise_map(0, shape), np.indices(shape).sum(axis=0) % 2 == 1
    few = noise_map(1, shape) < 0.1
    peak = np.zeros(shape)
    peak.flat[peak.size // 2] = 1.0
    return {
        "zeros": np.zeros(shape),
        "smallest": np.full(shape, SMALLEST),
        "a few of the smallest": few * SMALLEST,
        "subnormal": noise * 1e-310,
        "1e-300": noise * 1e-300,
        "1e300": noise * 1e300,
        "sums overflow": np.minimum(noise, 4) * 4e307,
        "largest": np.full(shape, LARGEST),
        "largest beside smallest": np.where(checkers, LARGEST, SMALLEST),
        "largest beside zero": peak * LARGEST,
        "smallest beside zero": peak * SMALLEST,
        "140 dB": noise * np.where(checkers, 1e14, 1.0),
        "300 dB": noise * np.where(checkers, 1e30, 1.0),
        "any decade": noise * 10.0 ** np.random.default_rng(2).uniform(-290, 290, shape),
    }


NAMES = pytest.mark.parametrize("name", hostile_maps((3,)))


def listed_everywhere(shape):
    return tuple(index.ravel() for index in np.indices(shape))


def is_sound(detector, power, looks=1):
    with np.errstate(all="raise", under="ignore"):
        found = detector.detect(power, looks)
        listed = detector.detect(power, looks, cells=listed_everywhere(power.shape))
    for part in (found.noise, found.threshold):
        assert np.isfinite(part).all()
        assert (part >= 0).all()
    assert np.array_equal(found.mask, power > found.threshold)
    for name in ("mask", "threshold", "noise"):
        assert np.array_equal(getattr(listed, name), getattr(found, name).ravel())


@EACH
@NAMES
@pytest.mark.parametrize("threshold", ["exact", "paper"])
def test_a_detection_is_finite_and_compares_powers_with_thresholds(detector, name, threshold):
    power = hostile_maps(SHAPE)[name]
    # The printed factors are never as large, nor as small, as the exact ones of these rates.
    for pfa, looks in ((1e-15, 1), (1e-3, 4), (0.5, 1)) if threshold == "exact" else ((1e-3, 4),):
        is_sound(small(detector, pfa=pfa, threshold=threshold), power, looks)


@EACH
@pytest.mark.parametrize(
    ("part", "shape"),
    [*enumerate([(5,), (23,), (1, 5), (5, 1), (5, 5), (7, 5), (5, 5, 5), (1, 7, 1)])],
)
def test_lines_slabs_and_maps_of_the_size_of_the_window_are_tested(detector, part, shape):
    sizes = tuple(1 if length >= 5 else 0 for length in shape)
    own = {OscaCfar: "order_axis", GocaCfar: "split_axis", SocaCfar: "split_axis"}.get(detector)
    axis = {own: int(np.argmax(shape))} if own else {}
    one = detector(training=sizes, guard=sizes, pfa=0.1, **axis)
    # Of lines, slabs, maps and cubes one holds the one half of what may be hostile, and one the other.
    for power in list(hostile_maps(shape).values())[part % 2 :: 2]:
        is_sound(one, power)


@EACH
@pytest.mark.parametrize("shape", [(6, 13), (11, 4), (1, 1), (13,)])
def test_a_window_larger_than_the_map_is_refused_with_what_to_change(detector, shape):
    one = detector(training=TRAINING[: len(shape)], guard=GUARD[: len(shape)])
    if shape == (13,):
        one = detector(training=(6,), guard=(1,))
    with pytest.raises(InputError, match=r"larger than the map of .* fewer training or guard cells"):
        one.detect(np.ones(shape))


def window(cell, training=TRAINING, guard=GUARD, shape=SHAPE):
    """Lists the training cells of a cell in the order of the axes."""
    starts = [
        min(max(i - t - g, 0), length - 2 * (t + g) - 1)
        for i, t, g, length in zip(cell, training, guard, shape, strict=True)
    ]
    places = (
        tuple(s + p for s, p in zip(starts, place, strict=True))
        for place in np.ndindex(*(2 * (t + g) + 1 for t, g in zip(training, guard, strict=True)))
    )
    return [
        place for place in places if any(abs(p - i) > g for p, i, g in zip(place, cell, guard, strict=True))
    ]


def mean(values):
    return sum(values, start=Fraction(0)) / len(values)


def exact_noise(detector, power, cell):
    """Gives the noise estimate of a cell in rational numbers."""
    cells = window(cell)
    values = [Fraction(float(power[c])) for c in cells]
    if detector is CaCfar:
        return mean(values)
    if detector is OsCfar:
        return sorted(values)[3 * len(values) // 4 - 1]
    if detector is TmCfar:
        n_cut = len(values) // 4
        return mean(sorted(values)[n_cut : len(values) - n_cut])
    if detector is OscaCfar:
        columns = [
            sorted(v for v, c in zip(values, cells, strict=True) if c[1] == j)
            for j in sorted({c[1] for c in cells})
        ]
        return mean([column[max(1, 3 * len(column) // 4) - 1] for column in columns])
    halves = (
        [v for v, c in zip(values, cells, strict=True) if c < cell],
        [v for v, c in zip(values, cells, strict=True) if c > cell],
    )
    return (max if detector is GocaCfar else min)(mean(half) for half in halves if half)


@EACH
@NAMES
def test_noise_is_that_of_rational_numbers_to_1e_minus_14(detector, name):
    maps = hostile_maps(SHAPE)
    power = maps[name]
    noise = small(detector).detect(power).noise
    # Every third cell, and every cell on some map: rational numbers take long.
    for cell in list(np.ndindex(SHAPE))[list(maps).index(name) % 3 :: 3]:
        exact = exact_noise(detector, power, cell)
        assert abs(Fraction(float(noise[cell])) - exact) <= exact * Fraction(1, 10**14) + Fraction(SMALLEST)


@settings(max_examples=12, deadline=None)
@given(
    seed=SEEDS,
    exponent=st.sampled_from([-1074, -1070, -1060, -1023, -513, -512, -511, 949, 950, 959, 1000, 1014]),
    detector=st.sampled_from(list(DETECTORS.values())),
    pfa=st.sampled_from([1e-15, 0.01, 0.5]),
)
def test_a_map_of_small_numbers_is_tested_alike_at_both_ends_of_float64(seed, exponent, detector, pfa):
    counts = np.floor(10 ** (3 * np.random.default_rng(seed).random(SHAPE)))
    counts[seed % 11, seed % 13] = 0
    found, scaled = (small(detector, pfa=pfa).detect(p) for p in (counts, np.ldexp(counts, exponent)))
    assert np.array_equal(scaled.mask, found.mask)
    unit = Fraction(2) ** exponent
    for have, want in zip(scaled.threshold.flat, found.threshold.flat, strict=True):
        exact = Fraction(float(want)) * unit
        # The greatest float64 that is not above.
        assert Fraction(float(have)) <= exact
        assert have == LARGEST or exact < Fraction(math.nextafter(float(have), math.inf))


@EACH
@pytest.mark.parametrize("n", [1, 3, 7])
def test_one_in_a_few_subnormal_cells_is_no_false_alarm_of_rounding(detector, n):
    # A mean of subnormal numbers rounds to 0 where few cells hold the smallest of them, and 5e-324 exceeds 0.
    power = np.zeros(SHAPE)
    power.flat[:: 2 * n] = 1.0
    one = small(detector, pfa=1e-3)
    assert np.array_equal(one.detect(power * SMALLEST).mask, one.detect(power).mask)


def test_a_half_whose_sum_overflows_is_not_taken_for_the_greater_one():
    power = np.full(30, 1e306)
    power[:15], power[10] = 1.2e307, 5e307
    for detector in (GocaCfar, SocaCfar):
        one = detector(training=8, guard=1, threshold="paper")
        wanted = one.detect(power * 2.0**-100).noise
        assert np.array_equal(one.detect(power).noise, np.ldexp(wanted, 100))


def test_one_strong_cell_does_not_keep_the_order_statistic_from_testing_the_others():
    power = noise_map(3)
    power[5, 5] = LARGEST
    found = small(OsCfar).detect(power)
    assert found.mask[5, 5]
    assert found.threshold.max() < 100
    assert np.array_equal(os_mask(power, TRAINING, GUARD, 1e-3), found.mask)


@EACH
@given(seed=SEEDS, factor=st.floats(1e-150, 1e150))
@settings(max_examples=10, deadline=None)
def test_thresholds_scale_with_the_map_to_1e_minus_13(detector, seed, factor):
    power = noise_map(seed)
    found, scaled = (small(detector).detect(p) for p in (power, power * factor))
    np.testing.assert_allclose(scaled.threshold, found.threshold * factor, rtol=1e-13)
    np.testing.assert_allclose(scaled.noise, found.noise * factor, rtol=1e-13)


@EACH
@pytest.mark.parametrize("value", [SMALLEST, 1e-200 / 3, 0.1, 7e77, 1e300, LARGEST])
@pytest.mark.parametrize("pfa", [1e-15, 1e-3, 0.1, 0.6])
def test_a_constant_map_is_its_own_noise_and_detected_where_the_factor_is_below_1(detector, value, pfa):
    one = small(detector, pfa=pfa)
    reference, found = (one.detect(np.full(SHAPE, level)) for level in (1.0, value))
    np.testing.assert_allclose(found.noise, value, rtol=1e-14)
    factor = reference.threshold
    assert np.all(np.abs(factor - 1) > 1e-3)
    assert np.array_equal(found.mask, factor < 1)


@EACH
def test_rounding_a_map_to_float32_moves_noise_and_thresholds_by_no_more_than_that_rounding(detector):
    # Each noise estimate grows with every cell and is as large as the map.
    power = noise_map(5)
    double, single = (small(detector).detect(p) for p in (power, power.astype(np.float32)))
    for name in ("noise", "threshold"):
        np.testing.assert_allclose(getattr(single, name), getattr(double, name), rtol=2.0**-24 + 1e-15)


def layouts(power):
    """Gives the same map in other places of memory."""
    wide = np.zeros((2 * power.shape[0], 3 * power.shape[1]))
    wide[::2, 1::3] = power
    read_only = power.copy()
    read_only.flags.writeable = False
    swapped = power.astype(power.dtype.newbyteorder())
    turned = np.ascontiguousarray(power[::-1, ::-1])[::-1, ::-1]
    return [np.asfortranarray(power), wide[::2, 1::3], read_only, swapped, turned, power]


@EACH
@pytest.mark.parametrize("name", ["1e-300", "sums overflow", "300 dB", "subnormal"])
def test_the_place_of_a_map_in_memory_changes_no_bit(detector, name):
    power = hostile_maps(SHAPE)[name]
    one = small(detector)
    first = one.detect(power)
    for other in layouts(power):
        found = one.detect(other)
        for part in ("mask", "threshold", "noise"):
            assert np.array_equal(getattr(found, part), getattr(first, part))


@EACH
@given(seed=SEEDS)
@settings(max_examples=8, deadline=None)
def test_a_map_turned_by_180_degrees_is_tested_alike(detector, seed):
    power = noise_map(seed) * 10.0 ** np.random.default_rng(seed).uniform(0, 14, SHAPE)
    found, turned = (small(detector).detect(p) for p in (power, power[::-1, ::-1]))
    np.testing.assert_allclose(turned.threshold[::-1, ::-1], found.threshold, rtol=1e-13)
    assert np.array_equal(turned.mask[::-1, ::-1], found.mask)


@pytest.mark.parametrize("detector", [CaCfar, OsCfar, OscaCfar, TmCfar])
@pytest.mark.parametrize("axis", [0, 1])
@given(seed=SEEDS)
@settings(max_examples=5, deadline=None)
def test_a_map_mirrored_along_one_axis_is_tested_alike_where_windows_have_no_halves(detector, axis, seed):
    power = noise_map(seed)
    found, mirrored = (small(detector).detect(p) for p in (power, np.flip(power, axis)))
    np.testing.assert_allclose(np.flip(mirrored.threshold, axis), found.threshold, rtol=1e-13)


@EACH
@given(seed=SEEDS)
@settings(max_examples=5, deadline=None)
def test_a_map_transposed_with_its_window_is_tested_alike(detector, seed):
    power = noise_map(seed)
    own = {OscaCfar: "order_axis", GocaCfar: "split_axis", SocaCfar: "split_axis"}.get(detector)
    turned_detector = detector(training=TRAINING[::-1], guard=GUARD[::-1], **({own: 1} if own else {}))
    found, turned = small(detector).detect(power), turned_detector.detect(power.T)
    np.testing.assert_allclose(turned.threshold.T, found.threshold, rtol=1e-13)
    assert np.array_equal(turned.mask.T, found.mask)


@EACH
def test_narrow_integers_of_numpy_are_numbers_of_cells_and_looks_like_others(detector):
    power, cells = noise_map(6, (300,)), ([0, 100, 150, 299],)
    # The factor of a trimmed mean of many looks takes seconds; those of all cells are more than 127 anyway.
    looks = 2 if detector is TmCfar else 100
    narrow = detector(training=np.int8(100), guard=np.int8(30)).detect(power, np.int8(looks), cells=cells)
    plain = detector(training=100, guard=30).detect(power, looks, cells=cells)
    assert np.array_equal(narrow.threshold, plain.threshold)


@pytest.mark.skipif(np.finfo(np.longdouble).maxexp <= 1024, reason="long double is float64 here")
@EACH
def test_a_map_of_long_doubles_beyond_float64_is_refused_without_a_warning(detector):
    with pytest.raises(InputError, match="inf"):
        small(detector).detect(np.full(SHAPE, np.longdouble("1e4000")))
    assert not small(detector).detect(np.full(SHAPE, np.longdouble("1e-4000"))).mask.any()


def test_checks_of_a_map_leave_it_as_it_is():
    power = np.full(SHAPE, LARGEST)
    assert np.array_equal(checked_power(power, 1), power)


@pytest.mark.parametrize("factor_of", [ca_factor, paper_factor])
def test_a_rate_whose_factor_overflows_is_refused_by_name(factor_of):
    assert factor_of(1e-320, 2) < math.inf
    with pytest.raises(InputError, match=r"pfa = 1e-320: the factor overflows"):
        factor_of(1e-320, 1)


@EACH
def test_a_long_line_with_a_long_window_takes_memory_for_the_line_and_for_the_window_alone(detector):
    power = noise_map(7, (20_001,))
    one = detector(training=150, guard=1)
    cells = (np.array([0, 10_000, 20_000]),)
    one.detect(power, cells=cells)
    training_cells._marks.cache_clear()
    training_cells._count.cache_clear()
    tracemalloc.start()
    try:
        one.detect(power, cells=cells)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # One byte for each cell and place of its window would be 6 MB, and offsets eight times that.
    assert peak < 5e6
