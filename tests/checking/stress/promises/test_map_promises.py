"""Promises of detectors: kept by the built-in ones, and each broken by one that was made to break it."""

import dataclasses
import time
import warnings
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isacbench.checking.stress.case import NotApplicableError, Promise
from isacbench.checking.stress.cases.detector_case import DetectorCase
from isacbench.checking.stress.cases.map_cases import (
    BlankMap,
    ConstantMap,
    MapLevel,
    MapRange,
    MapWindow,
    Rate,
)
from isacbench.checking.stress.promises import map_promises
from isacbench.checking.stress.promises.known_noise import known_noise
from isacbench.checking.stress.runs.examining import BROKEN, examine
from isacbench.checking.stress.runs.families import families_of
from isacbench.checking.stress.runs.random_search import cases_from
from isacbench.errors import InputError
from isacbench.plugins.contracts import Detection
from isacbench.plugins.registry import get_detector

NAMES = "ca", "os", "osca", "goca", "soca", "tm"


@dataclass(frozen=True)
class Faulty:
    """Cell averaging with a fault."""

    name: ClassVar[str] = "ca"
    pfa: float = 1e-3
    training: int | tuple[int, ...] = 3
    guard: int | tuple[int, ...] = 1
    threshold: str = "exact"
    fault: str = field(default="none")

    def detect(self, power, looks=1, cells=None):
        if self.fault == "any window":
            return Detection(power > 2, np.full(power.shape, 2.0), np.ones(power.shape))
        found = get_detector("ca", pfa=self.pfa, training=self.training, guard=self.guard).detect(
            power, looks, cells
        )
        mask, threshold, noise = found.mask, found.threshold.copy(), found.noise.copy()
        match self.fault:
            case "raises":
                raise ZeroDivisionError("no luck")
            case "warns":
                warnings.warn("hm", RuntimeWarning, stacklevel=1)
            case "refuses":
                raise InputError("not this map")
            case "nan":
                noise.flat[0] = np.nan
            case "other mask":
                mask = ~mask
            case "random":
                noise += noise * 1e-9 * (1 + time.perf_counter_ns() % 997)
            case "other where listed" if cells is not None:
                threshold *= 1 + 1e-9
            case "reads memory" if not power.flags.c_contiguous:
                threshold *= 1 + 1e-9
            case "absolute threshold":
                threshold += 1e-3
                mask = (power if cells is None else power[cells]) > threshold
            case "biased":
                noise *= 1 + 1e-9
            case "detects":
                threshold *= 0.0
                mask = (power if cells is None else power[cells]) > threshold
            case "single alone" if power.dtype == np.float32:
                threshold *= 1 + 1e-5
            case "leans":
                threshold *= np.linspace(1, 1 + 1e-9, threshold.size).reshape(threshold.shape)
            case "any rate":
                threshold *= self.pfa
                mask = (power if cells is None else power[cells]) > threshold
            case "factor 1.001":
                threshold *= 1.001
                mask = (power if cells is None else power[cells]) > threshold
            case "one rate":
                threshold = noise * 7.0
                mask = (power if cells is None else power[cells]) > threshold
            case "mask of another rate" if self.pfa < 1e-3:
                threshold *= 2.0
            case "more at half the rate" if self.pfa < 1e-3:
                mask, threshold = power >= 0, threshold * (1 + 1e-9)
            case "echoes lost at half the rate" if self.pfa < 1e-3:
                mask = power < 0
        return Detection(mask, threshold, noise)


def broken(case, detector):
    return [verdict.promise for verdict in examine(case, detector) if verdict.outcome in BROKEN]


@pytest.mark.parametrize(
    ("fault", "case", "promise"),
    [
        ("raises", MapLevel(), "finite"),
        ("warns", MapLevel(), "finite"),
        ("refuses", MapLevel(), "finite"),
        ("nan", MapLevel(), "finite"),
        ("other mask", MapLevel(), "finite"),
        ("random", MapLevel(), "repeat"),
        ("other where listed", MapLevel(), "listed cells"),
        ("reads memory", MapLevel(), "memory order"),
        ("absolute threshold", MapLevel(), "scale by powers of two"),
        ("absolute threshold", MapLevel(), "scale"),
        ("biased", MapRange(), "known noise"),
        ("detects", ConstantMap(), "nothing detected"),
        ("detects", BlankMap(filled="smallest"), "nothing detected"),
        ("single alone", MapLevel(), "single precision"),
        ("leans", MapLevel(), "turned"),
        ("any rate", Rate(), "order of rates"),
        ("one rate", Rate(), "order of rates"),
        ("mask of another rate", Rate(), "order of rates"),
        ("more at half the rate", Rate(), "order of rates"),
        ("echoes lost at half the rate", Rate(), "order of rates"),
        ("factor 1.001", Rate(), "known factor"),
        ("factor 1.001", Rate(exponent=-0.31, looks=16), "known factor"),
        ("biased", MapWindow(), "known noise"),
        ("any window", MapWindow(length=8), "refused"),
    ],
)
def test_a_fault_breaks_the_promise_that_is_there_for_it(fault, case, promise):
    class Narrow(type(case)):
        """Of its promises the first and the one that is meant."""

        @property
        def promises(self):
            first, *others = super().promises
            return (first, *(one for one in others if one.name == promise))

    assert promise in broken(Narrow(**dataclasses.asdict(case)), Faulty(fault=fault))


@pytest.mark.parametrize("family", families_of("detector"))
def test_without_a_fault_every_promise_is_kept_on_a_case_of_every_family(family):
    assert not broken(family.table()[-1], Faulty())


def test_every_promise_of_a_detector_is_broken_by_some_fault():
    [parameters] = [
        mark for mark in test_a_fault_breaks_the_promise_that_is_there_for_it.pytestmark if mark.args[1:]
    ]
    named = {one.name for one in vars(map_promises).values() if isinstance(one, Promise)}
    assert named == {promise for _, _, promise in parameters.args[1]}


HOSTILE = (
    MapLevel(exponent=-322.0),
    MapLevel(exponent=306.0),
    MapRange(range_db=300.0),
    ConstantMap(exponent=308.0),
    BlankMap(filled="ends"),
    BlankMap(filled="few_smallest"),
    MapWindow(n_axes=3, length=5, width=7, training=1, guard=1),
    MapWindow(length=9, width=8),
    Rate(exponent=-15.0, looks=16),
    Rate(exponent=-0.31, looks=2),
)


def in_turn(cases):
    """Gives every case to every second detector, and to the others among the slow tests."""
    return [
        pytest.param(name, case, id=f"{name}-{case.spec}", marks=() if (i + j) % 2 else pytest.mark.slow)
        for i, case in enumerate(cases)
        for j, name in enumerate(NAMES)
    ]


@pytest.mark.parametrize(("name", "case"), in_turn(HOSTILE))
def test_built_in_detectors_keep_every_promise(name, case):
    assert not broken(case, get_detector(name))


@given(
    case=st.sampled_from([MapLevel, MapRange, ConstantMap, BlankMap, MapWindow]).flatmap(cases_from),
    name=st.sampled_from(NAMES),
)
@settings(max_examples=6, deadline=None)
def test_built_in_detectors_keep_the_promises_of_whatever_the_search_draws(case, name):
    assert not broken(case, get_detector(name))


@pytest.mark.parametrize(
    ("name", "parameters", "noise"),
    [
        ("ca", {"guard": 0}, [4.0, 3.5, 5.0, 4.0]),
        ("os", {"guard": 0, "rank_fraction": 1.0}, [6.0, 6.0, 8.0, 6.0]),
        ("osca", {"guard": 0}, [2.0, 1.0, 2.0, 2.0]),
        ("osca", {"guard": None}, [2.0, 2.0, 6.0, 6.0]),
        ("goca", {"guard": 0}, [4.0, 6.0, 8.0, 4.0]),
        ("soca", {"guard": 0}, [4.0, 1.0, 2.0, 4.0]),
        ("tm", {"guard": 0, "trim_low": 0.5}, [6.0, 6.0, 8.0, 6.0]),
    ],
)
def test_known_noise_of_four_cells_is_what_the_definition_says(name, parameters, noise):
    detector = get_detector(name, training=1, **parameters)
    assert known_noise(detector, np.array([1.0, 2.0, 6.0, 8.0])).tolist() == noise


def test_noise_of_a_detector_that_is_not_built_in_is_not_known():
    @dataclass(frozen=True)
    class Stranger(Faulty):
        name: ClassVar[str] = "stranger"

    with pytest.raises(NotApplicableError, match="not known"):
        known_noise(Stranger(), np.ones((9, 9)))
    outcomes = {verdict.promise: verdict.outcome for verdict in examine(MapLevel(), Stranger())}
    assert outcomes["known noise"] == outcomes["turned"] == "skipped"
    outcomes = {verdict.promise: verdict.outcome for verdict in examine(Rate(), Stranger())}
    assert outcomes["known factor"] == "skipped"


@pytest.mark.parametrize(
    ("name", "case"), in_turn([case for case in Rate.table() if case.threshold == "exact"])
)
def test_factors_of_built_in_detectors_are_known_but_for_trimmed_means_of_many_looks(name, case):
    tested = case.subject(get_detector(name), 0)
    if name == "tm" and case.looks > 16:
        with pytest.raises(NotApplicableError, match="too long"):
            map_promises.KNOWN_FACTOR.drift(tested)
    else:
        assert map_promises.KNOWN_FACTOR.drift(tested) < 1e-8


@pytest.mark.parametrize("name", NAMES)
def test_an_echo_is_detected_at_every_rate_of_the_table(name):
    for case in Rate.table():
        tested = case.subject(get_detector(name), 0)
        strict = dataclasses.replace(tested.detector, pfa=tested.detector.pfa / 2)
        for detector in (tested.detector, strict):
            assert detector.detect(tested.power, tested.looks, cells=([0], [0])).mask.all()


def test_a_printed_factor_is_not_held_against_the_rate():
    outcomes = {
        verdict.promise: verdict.outcome for verdict in examine(Rate(), get_detector("ca", threshold="paper"))
    }
    assert outcomes["known factor"] == "skipped"


def test_a_detector_without_the_parameter_of_a_case_is_left_out():
    @dataclass(frozen=True)
    class Fixed:
        name: ClassVar[str] = "fixed"

    with pytest.raises(NotApplicableError, match="no parameter pfa"):
        Rate().subject(Fixed(), 0)
    [verdict] = examine(Rate(), Fixed())
    assert verdict.outcome == "skipped"


def test_families_of_detectors_make_maps_of_power_that_follow_from_the_seed():
    for family in families_of("detector"):
        assert issubclass(family, DetectorCase)
        for case in family.table():
            power = case.power(1)
            assert power.dtype == np.float64
            assert np.isfinite(power).all()
            assert (power >= 0).all()
            assert np.array_equal(power, case.power(1))
