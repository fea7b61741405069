"""Known rates of factors, against drawn windows, sums, and one another."""

import math

import numpy as np
import pytest
from scipy import stats

from isacbench.plugins.registry import detector_names, get_detector
from tests.dsp.cfar.known_factor import UnknownRateError, known_rate
from tests.dsp.cfar.known_noise import known_noise, known_noise_at

SHAPE, CELL = (9, 11), (4, 5)


def rate_of(name, factor, looks, cell=CELL, **parameters):
    return known_rate(get_detector(name, **parameters), factor, SHAPE, cell, looks)


@pytest.mark.parametrize("looks", [1, 16])
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("ca", {}),
        ("os", {"rank_fraction": 0.5}),
        ("osca", {}),
        ("osca", {"guard": 1, "training": 1, "order_axis": 1}),
        ("goca", {}),
        ("soca", {"split_axis": 1}),
        ("tm", {"trim_low": 0.2, "trim_high": 0.4}),
    ],
)
@pytest.mark.parametrize("cell", [(2, 2), (1, 0)])
def test_known_rates_are_those_of_the_noise_known_of_drawn_maps(name, parameters, looks, cell):
    shape, n_maps, factor = (5, 5), 200, 1.6
    detector = get_detector(name, **{"training": 2, "guard": 0} | parameters)
    maps = np.random.default_rng(looks).standard_gamma(looks, (n_maps, *shape)) / looks
    noise = np.array([known_noise_at(detector, one, cell) for one in maps])
    exceeds = stats.gamma.sf(factor * noise, looks, scale=1 / looks)
    rate = known_rate(detector, factor, shape, cell, looks)
    assert abs(exceeds.mean() - rate) < 5 * exceeds.std() / math.sqrt(n_maps)


@pytest.mark.parametrize("looks", [2, 16, 1024])
@pytest.mark.parametrize("factor", [0.9, 1.2])
def test_rate_of_a_mean_is_that_of_the_f_distribution(factor, looks):
    expected = stats.f.sf(factor, 2 * looks, 2 * looks * 72)
    assert rate_of("ca", factor, looks) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("looks", [1, 2, 64])
def test_rates_of_the_greatest_and_the_smallest_half_add_to_those_of_both(looks):
    halves = rate_of("goca", 2.0, looks) + rate_of("soca", 2.0, looks)
    assert halves == pytest.approx(2 * stats.f.sf(2.0, 2 * looks, 2 * looks * 36), rel=1e-9)


@pytest.mark.parametrize("looks", [6, 16])
def test_convolution_over_columns_of_one_cell_gives_the_rate_of_their_mean(looks):
    line = {"training": (0, 4), "guard": 0}
    expected = rate_of("ca", 2.0, looks, **line)
    assert rate_of("osca", 2.0, looks, **line) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("looks", [2, 16])
def test_a_trimmed_mean_lies_between_those_that_trim_less_and_more(looks):
    rates = [rate_of("tm", 2.5, looks, trim_low=0.25, trim_high=high) for high in (0.1, 0.25, 0.5)]
    assert rates == sorted(rates)


@pytest.mark.parametrize(
    ("looks", "trim", "why"),
    [
        (2, {"trim_low": 0.25, "trim_high": 0.0}, "one side"),
        (1024, {}, "too long"),
        (16, {"trim_low": 0.02}, "settle"),
    ],
)
def test_a_rate_that_is_not_known_or_not_affordable_is_refused(looks, trim, why):
    with pytest.raises(UnknownRateError, match=why):
        rate_of("tm", 3.0, looks, **trim)


@pytest.mark.parametrize(("trim_low", "name"), [(0.0, "ca"), (71 / 72, "os")])
def test_trimming_nothing_or_all_but_one_cell_is_another_detector(trim_low, name):
    other = {"rank_fraction": 1.0} if name == "os" else {}
    for looks in (1, 1024):
        trimmed = rate_of("tm", 1.2, looks, trim_low=trim_low, trim_high=0.0)
        assert trimmed == pytest.approx(rate_of(name, 1.2, looks, **other), rel=1e-9)


# Every detector at every rate and with every number of looks, and over the detectors each with each.
@pytest.mark.parametrize(
    ("name", "pfa", "looks"),
    [
        (name, pfa, (1, 2, 16)[(i + j) % 3])
        for i, name in enumerate(["ca", "os", "osca", "goca", "soca", "tm"])
        for j, pfa in enumerate([1e-15, 1e-3, 0.49])
    ],
)
def test_a_factor_that_is_too_large_by_a_thousandth_is_seen(name, pfa, looks):
    detector = get_detector(name, pfa=pfa)
    found = detector.detect(np.ones(SHAPE), looks, cells=tuple([index] for index in CELL))
    (factor,) = found.threshold / found.noise
    assert rate_of(name, factor, looks) == pytest.approx(pfa, rel=1e-8)
    assert rate_of(name, 1.001 * factor, looks) < pfa * (1 - 1e-4)


@pytest.mark.parametrize("name", detector_names())
@pytest.mark.parametrize(("pfa", "looks"), [(1e-15, 16), (1e-6, 2), (0.49, 16)])
def test_factors_in_the_corner_keep_the_known_rate(name, pfa, looks):
    found = get_detector(name, pfa=pfa).detect(np.ones(SHAPE), looks)
    factor = found.threshold[0, 0] / found.noise[0, 0]
    assert rate_of(name, factor, looks, (0, 0)) == pytest.approx(pfa, rel=1e-8)


@pytest.mark.parametrize("name", detector_names())
@pytest.mark.parametrize("decades", [1, 30])
def test_noise_is_that_of_the_definition_whatever_the_dynamic_range(name, decades):
    rng = np.random.default_rng(1)
    power = rng.standard_exponential((13, 17)) * 10.0 ** (decades * rng.random((13, 17)))
    for parameters in ({}, {"training": 3, "guard": 2}, {"training": (2, 4), "guard": (0, 1)}):
        detector = get_detector(name, **parameters)
        known = known_noise(detector, power).reshape(power.shape)
        np.testing.assert_allclose(detector.detect(power).noise, known, rtol=1e-12)
