"""Known rates of factors, against drawn windows, sums, and one another."""

import math

import numpy as np
import pytest
from scipy import stats

from isacbench.checking.stress.case import NotApplicableError
from isacbench.checking.stress.promises.known_factor import known_rate
from isacbench.checking.stress.promises.known_noise import _estimate
from isacbench.plugins.registry import get_detector

SHAPE, CELL = (9, 11), (4, 5)


def rate_of(name, factor, looks, cell=CELL, **parameters):
    return known_rate(get_detector(name, **parameters), factor, SHAPE, cell, looks)


@pytest.mark.parametrize("looks", [1, 4, 16])
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
    if parameters.get("order_axis") and looks == 4:
        pytest.skip(
            "whether the quadrature over columns of three cells settles for few looks, rounding decides"
        )
    shape, n_maps, factor = (5, 5), 200, 1.6
    detector = get_detector(name, **{"training": 2, "guard": 0} | parameters)
    maps = np.random.default_rng(looks).standard_gamma(looks, (n_maps, *shape)) / looks
    noise = np.array([_estimate(detector, one, cell) for one in maps])
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


@pytest.mark.parametrize("looks", [2, 16])
@pytest.mark.parametrize("trim", [(0.25, 0.0), (0.0, 0.25)])
def test_a_mean_trimmed_on_one_side_is_not_known_for_many_looks(looks, trim):
    with pytest.raises(NotApplicableError, match="one side"):
        rate_of("tm", 2.5, looks, trim_low=trim[0], trim_high=trim[1])


def test_a_trimmed_mean_of_a_thousand_looks_takes_too_long():
    with pytest.raises(NotApplicableError, match="too long"):
        rate_of("tm", 1.2, 1024)


def test_a_rate_whose_quadrature_does_not_settle_is_not_known():
    with pytest.raises(NotApplicableError, match="settle"):
        rate_of("tm", 3.0, 16, trim_low=0.02)


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
