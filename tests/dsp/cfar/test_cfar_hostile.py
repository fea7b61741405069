"""CFAR detectors on hostile maps: extreme scales, huge dynamic range, odd shapes and layouts."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from isacbench_algorithms.detectors import CaCfar, GocaCfar, OscaCfar, OsCfar, SocaCfar, TmCfar

from isacbench.dsp.cfar.factors import ca_factor, paper_factor
from isacbench.errors import InputError
from tests.dsp.cfar.known_noise import known_noise

LARGEST, SMALLEST = 1e200, 1e-200
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
        "largest beside zero": peak * LARGEST,
        "float32 squared": noise * 1e-90,
        "140 dB": noise * np.where(checkers, 1e14, 1.0),
        "300 dB": noise * np.where(checkers, 1e30, 1.0),
        "any decade": noise * 10.0 ** np.random.default_rng(2).uniform(-150, 150, shape),
    }


NAMES = pytest.mark.parametrize("name", hostile_maps((3,)))


def sound(detector, power, looks=1):
    with np.errstate(all="raise", under="ignore"):
        found = detector.detect(power, looks)
    for part in (found.noise, found.threshold):
        assert np.isfinite(part).all()
        assert (part >= 0).all()
    assert np.array_equal(found.mask, power > found.threshold)
    return found


SETTINGS = ((1e-15, 1, "exact"), (1e-3, 4, "paper"), (0.5, 4, "exact"))


@EACH
@NAMES
def test_a_detection_is_finite_and_compares_powers_with_thresholds(detector, name):
    # Every map and every detector in turn with each of the settings.
    number = [*hostile_maps((3,))].index(name) + [*DETECTORS.values()].index(detector)
    pfa, looks, threshold = SETTINGS[number % 3]
    sound(small(detector, pfa=pfa, threshold=threshold), hostile_maps(SHAPE)[name], looks)


@EACH
@pytest.mark.parametrize(("part", "shape"), [*enumerate([(5,), (23,), (1, 5), (5, 5), (5, 5, 5), (1, 7, 1)])])
def test_lines_slabs_and_maps_of_the_size_of_the_window_are_tested(detector, part, shape):
    sizes = tuple(1 if length >= 5 else 0 for length in shape)
    own = {OscaCfar: "order_axis", GocaCfar: "split_axis", SocaCfar: "split_axis"}.get(detector)
    axis = {own: int(np.argmax(shape))} if own else {}
    one = detector(training=sizes, guard=sizes, pfa=0.1, **axis)
    # Of the shapes each takes a quarter of what may be hostile, and all of them take all.
    for power in list(hostile_maps(shape).values())[part % 4 :: 4]:
        found = sound(one, power)
        listed = one.detect(power, cells=tuple(index.ravel() for index in np.indices(shape)))
        for name in ("mask", "threshold", "noise"):
            assert np.array_equal(getattr(listed, name), getattr(found, name).ravel())


@pytest.mark.parametrize("shape", [(6, 13), (11, 4), (1, 1), (13,)])
def test_a_window_larger_than_the_map_is_refused_with_what_to_change(shape):
    one = CaCfar(training=TRAINING[: len(shape)], guard=GUARD[: len(shape)])
    if shape == (13,):
        one = CaCfar(training=(6,), guard=(1,))
    with pytest.raises(InputError, match=r"larger than the map of .* take fewer training or guard cells"):
        one.detect(np.ones(shape))


@pytest.mark.parametrize(
    "detector",
    [*(small(detector) for detector in DETECTORS.values()), OscaCfar(training=TRAINING, guard=None)],
    ids=[*DETECTORS, "osca with the cell inside"],
)
@NAMES
def test_noise_is_that_of_rational_numbers_to_1e_minus_14(detector, name):
    maps = hostile_maps(SHAPE)
    power = maps[name]
    noise = detector.detect(power).noise
    # Every fourth cell, and every cell on some map: rational numbers take long.
    for cell in list(np.ndindex(SHAPE))[list(maps).index(name) % 4 :: 4]:
        exact = known_noise(detector, power, cell, Fraction)
        assert abs(Fraction(float(noise[cell])) - exact) <= exact * Fraction(1, 10**14)


@pytest.mark.parametrize("strongest", [1e-250, 1e250])
def test_a_map_whose_sums_would_overflow_or_lose_digits_is_refused_with_what_to_do(strongest):
    with pytest.raises(InputError, match=r"strongest cell of the power map is .*: scale the map"):
        small(CaCfar).detect(noise_map(3) * strongest)


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
def test_the_place_of_a_map_in_memory_changes_no_bit(detector):
    power = hostile_maps(SHAPE)["any decade"]
    one = small(detector)
    first = one.detect(power)
    for other in layouts(power):
        found = one.detect(other)
        for part in ("mask", "threshold", "noise"):
            assert np.array_equal(getattr(found, part), getattr(first, part))


@EACH
def test_narrow_integers_of_numpy_are_numbers_of_cells_and_looks_like_others(detector):
    power, cells = noise_map(6, (300,)), ([0, 100, 150, 299],)
    # The factor of a trimmed mean of many looks takes seconds; those of all cells are more than 127 anyway.
    looks = 2 if detector is TmCfar else 100
    narrow = detector(training=np.int8(100), guard=np.int8(30)).detect(power, np.int8(looks), cells=cells)
    plain = detector(training=100, guard=30).detect(power, looks, cells=cells)
    assert np.array_equal(narrow.threshold, plain.threshold)


@pytest.mark.parametrize("factor_of", [ca_factor, paper_factor])
def test_a_rate_whose_factor_overflows_is_refused_by_name(factor_of):
    assert factor_of(1e-320, 2) < math.inf
    with pytest.raises(InputError, match=r"pfa = 1e-320: the factor overflows"):
        factor_of(1e-320, 1)
