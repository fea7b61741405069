"""CFAR detectors against plain loops and rational numbers, on maps of any level, shape and place in memory.

What they promise as plugins, orders of rates and levels among it, is tested with the promises of maps.
"""

import pickle
import tracemalloc
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from scipy.stats import binom

from isacbench.dsp.cfar import training_cells as windows
from isacbench.dsp.cfar.factors import paper_factor
from isacbench.errors import InputError
from tests.conftest import few, slow_but
from tests.dsp.cfar.known_noise import known_noise, training_cells

PARTS = "mask", "threshold", "noise"
CLASSES = [CaCfar, GocaCfar, SocaCfar, OsCfar, TmCfar, OscaCfar]
AXES = {GocaCfar: "split_axis", SocaCfar: "split_axis", OscaCfar: "order_axis"}
# What a detector has beyond its window: trimmed means are also means of all cells, and single cells.
TRIMS = [{"trim_low": low, "trim_high": high} for low, high in ((0.1, 0.4), (0, 0), (5 / 8, 2 / 8))]
OWN = {OsCfar: [{"rank_fraction": 0.6}], TmCfar: TRIMS}
WITH_OWN = [(detector, own) for detector in CLASSES for own in OWN.get(detector, [{}])]
BY_DEFAULT = [detector(pfa=0.05) for detector in CLASSES]
GUARDED_OSCA = OscaCfar(0.05, training=(3, 2), guard=(1, 2))


def each(detectors):
    """Test with one detector after the other, by name."""
    names = [f"{one.name}{'-guarded' * (one.name == 'osca' and one.guard is not None)}" for one in detectors]
    return pytest.mark.parametrize("detector", detectors, ids=names)


EVERY = each([*BY_DEFAULT, GUARDED_OSCA])
SEEDS = st.integers(0, 2**32 - 1)


def noise_map(seed, shape, looks=1):
    return np.random.default_rng(seed).standard_gamma(looks, shape) / looks


def equals_a_plain_double_loop(detector, power, looks=1):
    found = detector.detect(power, looks)
    for cell in np.ndindex(power.shape):
        noise, factor = known_noise(detector, power, cell, looks)
        assert found.noise[cell] == pytest.approx(noise, rel=1e-13)
        assert found.threshold[cell] == pytest.approx(factor() * noise, rel=1e-11)
    assert np.array_equal(found.mask, power > found.threshold)


SIZES = st.tuples(st.integers(0, 2), st.integers(0, 2))
GUARDS = st.tuples(st.integers(0, 1), st.integers(0, 1))
SHAPES = st.tuples(st.integers(7, 9), st.integers(7, 9))
LINES = st.tuples(
    st.tuples(st.integers(13, 20)), st.tuples(st.integers(1, 4)), st.tuples(st.integers(0, 2)), st.just(1)
)
MAPS = st.tuples(SHAPES, SIZES.filter(any), GUARDS, st.sampled_from([1, 4]))
# With the cell inside, its column has another one.
AROUND = st.tuples(SHAPES, SIZES.map(lambda n: (n[0] + 1, n[1])), st.none(), st.sampled_from([1, 4]))


@pytest.mark.parametrize(
    ("detector", "own", "windows"),
    [*((*one, kind) for one in WITH_OWN for kind in (MAPS, LINES)), (OscaCfar, {}, AROUND)],
    ids=lambda value: getattr(value, "name", None),
)
@few
@given(data=st.data(), seed=SEEDS)
def test_every_cell_up_to_the_edges_equals_a_plain_double_loop(detector, own, windows, data, seed):
    shape, training, guard, looks = data.draw(windows)
    one = detector(pfa=0.05, training=training, guard=guard, **own)
    equals_a_plain_double_loop(one, noise_map(seed, shape, looks), looks)


@pytest.mark.parametrize(("detector", "name"), AXES.items())
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_halves_and_orders_along_any_axis_of_a_cube_equal_a_plain_loop(detector, name, axis):
    # No more than the window but along that axis, and one cell more there.
    power = noise_map(axis, np.add((3, 3, 5), np.arange(3) == axis))
    equals_a_plain_double_loop(detector(0.05, (1, 1, 1), (0, 0, 1), **{name: axis}), power)


HOSTILE = 11, 13
SETTINGS = (1e-15, 1, "exact"), (1e-3, 4, "paper"), (0.5, 4, "exact")


def hostile_maps(shape=HOSTILE):
    noise, checkers = noise_map(0, shape), np.indices(shape).sum(axis=0) % 2 == 1
    peak = np.zeros(shape)
    peak.flat[peak.size // 2] = 1.0
    return {
        "zeros": np.zeros(shape),
        "smallest": np.full(shape, 1e-200),
        "a few of the smallest": (noise_map(1, shape) < 0.1) * 1e-200,
        "largest beside zero": peak * 1e200,
        "float32 squared": noise * 1e-90,
        "140 dB": noise * np.where(checkers, 1e14, 1.0),
        "300 dB": noise * np.where(checkers, 1e30, 1.0),
        "any decade": noise * 10.0 ** np.random.default_rng(2).uniform(-150, 150, shape),
    }


def assert_equal(one, other):
    """Every part of two detections is the same in every bit."""
    for part in PARTS:
        assert np.array_equal(getattr(one, part), getattr(other, part))


def sound(detector, power, looks=1):
    with np.errstate(all="raise", under="ignore"):
        found = detector.detect(power, looks)
    for part in (found.noise, found.threshold):
        assert np.isfinite(part).all()
        assert (part >= 0).all()
    assert np.array_equal(found.mask, power > found.threshold)
    return found


SMALL = [detector(training=(2, 1), guard=(1, 1)) for detector in CLASSES]


@pytest.mark.parametrize("name", hostile_maps())
@pytest.mark.parametrize(("number", "detector"), [*enumerate([*SMALL, OscaCfar(training=(2, 1))])])
def test_on_hostile_maps_noise_is_that_of_rational_numbers_to_1e_minus_14(number, detector, name):
    maps = hostile_maps()
    power, place = maps[name], list(maps).index(name)
    # Every map and every detector in turn with each of the settings, none of which changes the noise.
    pfa, looks, threshold = SETTINGS[(number + place) % 3]
    noise = sound(replace(detector, pfa=pfa, threshold=threshold), power, looks).noise
    # Every fourth cell, and every cell on some map: rational numbers take long.
    for cell in list(np.ndindex(HOSTILE))[place % 4 :: 4]:
        exact, _ = known_noise(detector, power, cell, number=Fraction)
        assert abs(Fraction(float(noise[cell])) - exact) <= exact * Fraction(1, 10**14)


@pytest.mark.parametrize("detector", CLASSES, ids=lambda one: one.name)
@pytest.mark.parametrize(("part", "shape"), [*enumerate([(5,), (23,), (1, 5), (5, 5), (5, 5, 5), (1, 7, 1)])])
def test_lines_slabs_and_maps_of_the_size_of_the_window_are_tested(detector, part, shape):
    sizes = tuple(1 if length >= 5 else 0 for length in shape)
    axis = {AXES[detector]: int(np.argmax(shape))} if detector in AXES else {}
    one = detector(training=sizes, guard=sizes, pfa=0.1, **axis)
    # Of the shapes each takes a quarter of what may be hostile, and all of them take all.
    for power in list(hostile_maps(shape).values())[part % 4 :: 4]:
        found = sound(one, power)
        listed = one.detect(power, cells=tuple(index.ravel() for index in np.indices(shape)))
        for name in PARTS:
            assert np.array_equal(getattr(listed, name), getattr(found, name).ravel())


def laid_out_otherwise(power):
    """The same map in other places of memory."""
    wide = np.zeros((2 * power.shape[0], 3 * power.shape[1]))
    wide[::2, 1::3] = power
    read_only = power.copy()
    read_only.flags.writeable = False
    turned = np.ascontiguousarray(power[::-1, ::-1])[::-1, ::-1]
    swapped = power.astype(power.dtype.newbyteorder())
    return [np.asfortranarray(power), wide[::2, 1::3], read_only, swapped, turned]


@EVERY
def test_memory_lists_parts_and_units_that_are_powers_of_two_change_no_bit(detector, monkeypatch):
    power = hostile_maps((20, 23))["any decade"]
    whole = detector.detect(power)

    def same(found, where=..., exponent=0):
        assert np.array_equal(found.mask, whole.mask[where])
        assert np.array_equal(found.threshold, np.ldexp(whole.threshold[where], exponent))
        assert np.array_equal(found.noise, np.ldexp(whole.noise[where], exponent))

    for other in laid_out_otherwise(power):
        same(detector.detect(other))
    for n_cells in (0, 300):
        cells = tuple(np.random.default_rng(0).integers(0, length, n_cells) for length in power.shape)
        same(detector.detect(power, cells=cells), cells)
    for exponent in (-90, 90):
        same(detector.detect(np.ldexp(power, exponent)), exponent=exponent)
    for n_values in (1, 350):
        monkeypatch.setattr(windows, "_MOST_VALUES", n_values)
        same(detector.detect(power))


@EVERY
def test_float32_map_gives_what_the_same_map_in_float64_gives(detector):
    power = noise_map(4, (14, 14)).astype(np.float32)
    single, double = (detector.detect(one) for one in (power, power.astype(np.float64)))
    assert single.threshold.dtype == single.noise.dtype == np.float64
    assert_equal(single, double)


@EVERY
@few
@given(seed=SEEDS, cell=st.tuples(st.integers(0, 14), st.integers(0, 12)))
def test_noise_of_a_cell_depends_on_its_training_cells_alone(detector, seed, cell):
    power = noise_map(seed, (15, 13))
    trains = np.zeros(power.shape, dtype=bool)
    for place in training_cells(detector, power.shape, cell):
        trains[place] = True
    tested = tuple([index] for index in cell)
    found, other = (detector.detect(p, cells=tested) for p in (power, np.where(trains, power, 1e12)))
    assert found.noise == other.noise
    assert found.threshold == other.threshold


@given(
    SEEDS,
    st.tuples(st.integers(9, 40), st.integers(9, 14)),
    SIZES.filter(any),
    SIZES,
    st.sampled_from([0.0, 0.3, 0.75, 1.0]),
    st.sampled_from([1e-3, 0.3, 0.9]),
    st.booleans(),
)
@example(4, (2000,), 300, 2, 0.75, 0.05, False)  # counts beyond 255
def test_mask_by_counting_is_the_comparison_with_the_sorted_threshold(
    seed, shape, training, guard, rank_fraction, pfa, ties
):
    power = noise_map(seed, shape)
    if ties:
        power = np.floor(2 * power)
    found = OsCfar(pfa, training, guard, rank_fraction=rank_fraction).detect(power)
    assert np.array_equal(found.mask, power > found.threshold)
    assert found.mask.any() or power.size < 1000


def test_noise_of_the_order_statistic_belongs_to_the_map_that_was_tested():
    power, detector = noise_map(5, (20, 20)), OsCfar(0.05)
    expected = detector.detect(power)
    assert expected.threshold.shape == power.shape
    found, copied = detector.detect(power), pickle.loads(pickle.dumps(detector.detect(power)))
    power[:] = 0
    for one in (found, copied):
        assert_equal(one, expected)
    listed = detector.detect(power, cells=(np.arange(3), np.arange(3)))
    assert len(pickle.dumps(listed)) < power.nbytes / 2


QUICK, SLOW = [(1, 3000, 0.02), (4, 3000, 0.02)], [(256, 3000, 0.02), (1, 200_000, 1e-3)]


@each([*(one(training=(3, 3, 0), guard=(1, 1, 0)) for one in CLASSES), OscaCfar(training=(4, 4, 0))])
@pytest.mark.parametrize(("looks", "n_maps", "pfa"), slow_but(QUICK, QUICK + SLOW))
def test_false_alarm_rate_is_nominal_in_the_corner_at_the_border_and_inside(detector, looks, n_maps, pfa):
    # One independent map for each place along the last axis, which the window does not mix.
    one, places = replace(detector, pfa=pfa), ((0, 0), (0, 4), (8, 3), (4, 4))
    counts = np.zeros(len(places))
    for seed in range(0, n_maps, 20_000):
        n = min(n_maps, 20_000)
        rows, columns = np.repeat(places, n, axis=0).T
        cells = rows, columns, np.tile(np.arange(n), len(places))
        found = one.detect(noise_map([looks, seed], (9, 9, n), looks), looks, cells)
        counts += np.count_nonzero(found.mask.reshape(len(places), n), axis=1)
    least, most = binom.interval(1 - 1e-6, n_maps, pfa)
    assert np.all((least <= counts) & (counts <= most))


@each(BY_DEFAULT)
def test_printed_factor_multiplies_the_same_noise(detector):
    power = noise_map(5, (9, 9))
    found = replace(detector, threshold="paper").detect(power)
    assert np.array_equal(found.noise, detector.detect(power).noise)
    n = 9 if detector.name == "osca" else 72
    assert found.threshold[4, 4] == pytest.approx(paper_factor(0.05, n) * found.noise[4, 4])


@EVERY
def test_narrow_integers_of_numpy_are_numbers_of_cells_and_looks_like_others(detector):
    power, cells = noise_map(6, (300,)), ([0, 100, 150, 299],)
    # The factor of a trimmed mean of many looks takes seconds; those of all cells are more than 127 anyway.
    looks = 2 if detector.name == "tm" else 100
    narrow = replace(detector, training=np.int8(100), guard=np.int8(30)).detect(power, np.int8(looks), cells)
    plain = replace(detector, training=100, guard=30).detect(power, looks, cells)
    assert np.array_equal(narrow.threshold, plain.threshold)


def ones(*shape, value=1.0):
    """Map of ones but for one cell."""
    power = np.ones(shape)
    power[3, 4] = value
    return power


@EVERY
def test_every_detector_refuses_nan_and_a_list_outside_the_map(detector):
    with pytest.raises(InputError, match="nan"):
        detector.detect(ones(12, 12, value=np.nan))
    with pytest.raises(InputError, match="12 to 12 along axis 0"):
        detector.detect(np.ones((12, 12)), cells=(np.array([12]), np.array([1])))


@pytest.mark.parametrize(
    ("power", "message"),
    [
        (np.ones((12, 12), complex), "complex128"),
        (np.ones((12, 12), bool), "bool"),
        (ones(12, 12, value=np.nan), "nan"),
        (ones(12, 12, value=np.inf), "inf"),
        (ones(12, 12, value=-1e-9), "-1e-09"),
        (np.ones((0, 12)), "shape"),
        (np.float64(1), "shape"),
        # Their sums would overflow or lose digits.
        *((noise_map(3, HOSTILE) * unit, "strongest cell of .*: scale the map") for unit in (1e-250, 1e250)),
    ],
)
def test_bad_map_is_refused_with_a_message_that_names_it(power, message):
    cells = (np.array([5]), np.array([5])) if np.ndim(power) == 2 else None
    for listed in (None, cells):
        with pytest.raises(InputError, match=message):
            CaCfar().detect(power, cells=listed)


LARGER = r"larger than the map of .* take fewer training or guard cells"
NO_CELLS = [
    ((np.array([1]),), "tuple of 2"),
    (np.array([[1, 2]]), "tuple of 2"),
    ((np.array([1, 2]), np.array([1])), "equally long"),
    ((np.array([[1]]), np.array([[1]])), "one-dimensional"),
    ((np.array([1.0]), np.array([1.0])), "whole numbers"),
    ((np.ones(12, bool), np.ones(12, bool)), "whole numbers"),
    ((np.array([-1]), np.array([1])), "-1 to -1 along axis 0"),
    ((np.array([1]), np.array([3, 12])[1:]), "12 to 12 along axis 1"),
]


@pytest.mark.parametrize(
    ("detector", "shape", "given", "message"),
    [
        *((CaCfar(), (12, 12), {"looks": looks}, f"looks = {looks}") for looks in (0, 1.5)),
        (CaCfar(training=(1, 2, 3)), (12, 12), {}, "2 axes"),
        (CaCfar(guard=(1,)), (12, 12), {}, "2 axes"),
        (OscaCfar(training=(0, 4)), (12, 12), {}, "axis 0"),  # columns of the cell alone
        (GocaCfar(split_axis=2), (12, 12), {}, "split_axis = 2"),
        (OscaCfar(guard=1, order_axis=2), (12, 12), {}, "order_axis = 2"),
        *((CaCfar(training=(2, 1)), shape, {}, LARGER) for shape in ((6, 13), (11, 4), (1, 1))),
        (CaCfar(training=(6,), guard=(1,)), (13,), {}, LARGER),
        *((CaCfar(training=2), (12, 12), {"cells": cells}, message) for cells, message in NO_CELLS),
    ],
)
def test_looks_windows_axes_and_lists_that_do_not_fit_the_map_are_refused(detector, shape, given, message):
    with pytest.raises(InputError, match=message):
        detector.detect(np.ones(shape), **given)


@pytest.mark.parametrize("n_listed", [None, 5000])
@pytest.mark.parametrize(("shape", "training"), [((512, 64), (100, 20)), ((32_768,), 300)])
@pytest.mark.parametrize("detector", [CaCfar, OscaCfar])
def test_large_windows_take_little_memory(detector, shape, training, n_listed):
    power = noise_map(0, shape)
    cells = n_listed and tuple(np.random.default_rng(1).integers(0, shape, (n_listed, len(shape))).T)
    tracemalloc.start()
    try:
        detector(training=training).detect(power, cells=cells)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 64 * power.nbytes
