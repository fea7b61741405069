from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar
from scipy.stats import binom

from isacbench.dsp.cfar import training_cells as windows
from isacbench.dsp.cfar.factors import paper_factor
from isacbench.errors import InputError
from tests.conftest import few
from tests.dsp.cfar.known_noise import known_factor, known_noise, training_cells


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


def noise_map(seed, shape, looks=1):
    return np.random.default_rng(seed).standard_gamma(looks, shape) / looks


# What a detector has beyond its window.
OWN = {
    OsCfar: {"rank_fraction": 0.6},
    TmCfar: {"trim_low": 0.1, "trim_high": 0.4},
}
DETECTORS = [CaCfar, GocaCfar, SocaCfar, OsCfar, TmCfar, OscaCfar]


def equals_a_plain_double_loop(detector, power, looks=1):
    found = detector.detect(power, looks)
    for cell in np.ndindex(power.shape):
        noise = known_noise(detector, power, cell)
        factor = known_factor(detector, power.shape, cell, looks)
        assert found.noise[cell] == pytest.approx(noise, rel=1e-13)
        assert found.threshold[cell] == pytest.approx(factor * noise, rel=1e-11)
    assert np.array_equal(found.mask, power > found.threshold)


SIZES = st.tuples(st.integers(0, 2), st.integers(0, 2))
GUARDS = st.tuples(st.integers(0, 1), st.integers(0, 1))
SHAPES = st.tuples(st.integers(7, 9), st.integers(7, 9))


@pytest.mark.parametrize("detector", DETECTORS)
@few
@given(SEEDS, SHAPES, SIZES.filter(any), GUARDS, st.sampled_from([1, 4]))
def test_every_cell_up_to_the_edges_equals_a_plain_double_loop(detector, seed, shape, training, guard, looks):
    one = detector(pfa=0.05, training=training, guard=guard, **OWN.get(detector, {}))
    equals_a_plain_double_loop(one, noise_map(seed, shape, looks), looks)


@few
@given(SEEDS, SHAPES, SIZES, st.sampled_from([1, 4]))
def test_osca_with_the_cell_inside_equals_a_plain_double_loop(seed, shape, training, looks):
    one = OscaCfar(pfa=0.05, training=(training[0] + 1, training[1]), guard=None)
    equals_a_plain_double_loop(one, noise_map(seed, shape, looks), looks)


@pytest.mark.parametrize("detector", DETECTORS)
@few
@given(seed=SEEDS, length=st.integers(13, 20), training=st.integers(1, 4), guard=st.integers(0, 2))
def test_every_cell_of_a_line_equals_a_plain_loop(detector, seed, length, training, guard):
    one = detector(pfa=0.05, training=(training,), guard=(guard,), **OWN.get(detector, {}))
    equals_a_plain_double_loop(one, noise_map(seed, (length,)))


@pytest.mark.parametrize(
    ("detector", "name"), [(GocaCfar, "split_axis"), (SocaCfar, "split_axis"), (OscaCfar, "order_axis")]
)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_halves_and_orders_along_any_axis_of_a_cube_equal_a_plain_loop(detector, name, axis):
    # No more than the window but along that axis, and one cell more there.
    power = noise_map(axis, np.add((3, 3, 5), np.arange(3) == axis))
    equals_a_plain_double_loop(detector(0.05, (1, 1, 1), (0, 0, 1), **{name: axis}), power)


@ALL
def test_listed_cells_have_the_values_of_the_whole_map(detect, training, guard):
    power, rng = noise_map(1, (20, 23)), np.random.default_rng(0)
    whole = detect(power, training, guard, 0.05)
    for n_cells in (0, 300):
        cells = tuple(rng.integers(0, length, n_cells) for length in power.shape)
        listed = detect(power, training, guard, 0.05, cells=cells)
        assert listed.mask.shape == listed.noise.shape == (n_cells,)
        assert np.array_equal(listed.mask, whole.mask[cells])
        assert np.array_equal(listed.noise, whole.noise[cells])
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
@pytest.mark.parametrize("n_values", [1, 350])
def test_parts_of_a_map_have_the_values_of_the_map_in_one(monkeypatch, detect, training, guard, n_values):
    power = noise_map(8, (11, 10))
    whole = detect(power, training, guard, 0.05)
    monkeypatch.setattr(windows, "_MOST_VALUES", n_values)
    parts = detect(power, training, guard, 0.05)
    assert np.array_equal(parts.mask, whole.mask)
    assert np.array_equal(parts.threshold, whole.threshold)


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


# A corner, borders, and the middle.
PLACES = np.array([0, 0, 7, 14, 2, 7, 7]), np.array([0, 6, 12, 6, 1, 6, 5])


@ALL
@few
@given(seed=SEEDS, rows=st.integers(0, 5), cols=st.integers(0, 5))
def test_shifted_map_gives_the_shifted_detection_away_from_the_edges(
    detect, training, guard, seed, rows, cols
):
    power = noise_map(seed, (24, 22))
    inner = tuple(index.ravel() for index in np.mgrid[4 : 20 - rows, 4 : 18 - cols])
    shifted = inner[0] + rows, inner[1] + cols
    whole = detect(power, training, guard, 0.05, cells=shifted)
    cut = detect(power[rows:, cols:], training, guard, 0.05, cells=inner)
    assert np.array_equal(whole.mask, cut.mask)
    assert np.array_equal(whole.threshold, cut.threshold)


@ALL
@given(seed=SEEDS, pfa=st.floats(1e-6, 0.9), ratio=st.floats(0.01, 0.99))
@few
def test_smaller_pfa_detects_a_subset(detect, training, guard, seed, pfa, ratio):
    power, cells = noise_map(seed, (12, 12)), ([0, 5, 6, 11, 2], [0, 6, 5, 7, 9])
    strict, loose = (detect(power, training, guard, p, cells=cells).mask for p in (pfa * ratio, pfa))
    assert not np.any(strict & ~loose)


@ALL
@few
@given(seed=SEEDS, cell=st.tuples(st.integers(0, 14), st.integers(0, 12)))
def test_noise_of_a_cell_depends_on_its_training_cells_alone(detect, training, guard, seed, cell):
    power = noise_map(seed, (15, 13))
    trains = np.zeros(power.shape, dtype=bool)
    for place in training_cells(OscaCfar(training=training, guard=guard), power.shape, cell):
        trains[place] = True
    tested = tuple([index] for index in cell)
    found, other = (
        detect(p, training, guard, 0.05, cells=tested) for p in (power, np.where(trains, power, 1e12))
    )
    assert found.noise == other.noise
    assert found.threshold == other.threshold


@ALL
@few
@given(seed=SEEDS, exponent=st.integers(-600, 600))
def test_power_of_two_scale_leaves_the_mask_unchanged(detect, training, guard, seed, exponent):
    power = noise_map(seed, (15, 13))
    scaled = np.ldexp(power, exponent)
    found, other = (detect(p, training, guard, 0.05, cells=PLACES) for p in (power, scaled))
    assert np.array_equal(found.mask, other.mask)
    assert np.array_equal(np.ldexp(found.threshold, exponent), other.threshold)


@ALL
def test_float32_map_gives_what_the_same_map_in_float64_gives(detect, training, guard):
    power = noise_map(4, (14, 14)).astype(np.float32)
    single, double = (detect(p, training, guard, 1e-3) for p in (power, power.astype(np.float64)))
    assert single.threshold.dtype == single.noise.dtype == np.float64
    assert np.array_equal(single.threshold, double.threshold)
    assert np.array_equal(single.mask, double.mask)


@WITH_GUARD
@pytest.mark.parametrize("looks", [1, 4, pytest.param(256, marks=pytest.mark.slow)])
def test_false_alarm_rate_is_nominal_in_the_corner_at_the_border_and_inside(detect, guard, looks):
    # One independent map for each place along the last axis, which the window does not mix.
    training, keep = ((4, 4, 0), None) if guard is None else ((3, 3, 0), (1, 1, 0))
    n_maps, pfa = 3000, 0.02
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


@pytest.mark.parametrize(
    ("detect", "training", "guard", "n"), [(*CA, 72), (*OSCA, 9), *((detect, 3, 1, 72) for detect in FRAMED)]
)
def test_printed_factor_multiplies_the_same_noise(detect, training, guard, n):
    power = noise_map(5, (9, 9))
    found = detect(power, training, guard, 1e-3, "paper")
    assert np.array_equal(found.noise, detect(power, training, guard, 1e-3).noise)
    assert found.threshold[4, 4] == pytest.approx(paper_factor(1e-3, n) * found.noise[4, 4])


@ALL
def test_strong_cell_is_found_and_the_map_is_not_written_to(detect, training, guard):
    power = np.ones((15, 15))
    power[7, 3] = 100.0
    power.flags.writeable = False
    assert np.argwhere(detect(power, training, guard, 1e-3).mask).tolist() == [[7, 3]]


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
