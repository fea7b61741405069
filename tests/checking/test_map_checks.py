"""Promises of detectors: kept by the built-in ones, and each broken by one that was made to break it."""

import time
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from isacbench.checking import map_checks
from isacbench.checking.cases import blank_map, map_level, map_range, map_window, rate
from isacbench.checking.checks import Check, NotApplicableError
from isacbench.checking.stress import BROKEN, cases_from, find_families, run_case
from isacbench.plugins.contracts import Detection
from isacbench.plugins.registry import detector_names, get_detector
from tests.checking.narrowed import narrowed
from tests.conftest import few

NAMES = detector_names()


@dataclass(frozen=True)
class Faulty:
    """Cell averaging with a fault: a statement that changes `threshold`, `noise` or `mask`."""

    name: ClassVar[str] = "faulty"
    pfa: float = 1e-3
    training: int | tuple[int, ...] = 3
    guard: int | tuple[int, ...] = 1
    fault: str = field(default="pass")

    def detect(self, power, looks=1, cells=None):
        ca = get_detector("ca", pfa=self.pfa, training=self.training, guard=self.guard)
        if self.fault == ANY_WINDOW:
            return Detection(power > 2, np.full(power.shape, 2.0), np.ones(power.shape))
        found = ca.detect(power, looks, cells)
        tested = power if cells is None else power[cells]
        names = {
            **{"threshold": found.threshold.copy(), "noise": found.noise.copy(), "pfa": self.pfa, "ca": ca},
            **{"power": power, "looks": looks, "cells": cells, "tested": tested, "np": np, "time": time},
        }
        exec(self.fault, names)
        mask = names["mask"] if "mask" in names else tested > names["threshold"]
        return Detection(mask, names["threshold"], names["noise"])


def broken(case, detector):
    return [finding.check for finding in run_case(case, detector) if finding.status in BROKEN]


ANY_WINDOW = "takes maps that are smaller than its window"
BEYOND = "threshold = ca.detect(np.pad(power, 4), looks).threshold[4:-4, 4:-4]"  # zeros beyond the border
MORE_AT_HALF_THE_RATE = "if pfa < 1e-3: mask, threshold = power >= 0, threshold * (1 + 1e-9)"
FAULTS = [
    ("noise.flat[0] = np.nan", map_level.case(), "finite"),
    ("noise = noise.ravel()", map_level.case(), "finite"),
    ("mask = tested <= threshold", map_level.case(), "finite"),
    ("noise += noise * 1e-9 * (1 + time.perf_counter_ns() % 997)", map_level.case(), "repeat"),
    ("threshold *= 1 if cells is None else 1 + 1e-9", map_level.case(), "listed cells"),
    ("threshold *= 1 if power.flags.c_contiguous else 1 + 1e-9", map_level.case(), "memory order"),
    ("threshold += 1e-3", map_level.case(), "scale by powers of two"),
    ("threshold *= 1 + 1e-8 * np.frexp(tested.max())[0]", map_level.case(), "scale"),
    ("threshold *= 0.0", blank_map.case(filled="constant"), "nothing detected"),
    ("threshold *= 1 + 1e-5 * (power.dtype == np.float32)", map_level.case(), "single precision"),
    ("threshold *= 1.1", rate.case(exponent=-2.0), "false-alarm rate"),
    ("threshold *= 1.1", rate.case(exponent=-0.31, looks=16), "false-alarm rate"),
    (BEYOND, rate.case(), "false-alarm rate"),
    ("threshold *= pfa", rate.case(), "order of rates"),
    ("threshold = noise * 7.0", rate.case(), "order of rates"),
    ("mask = tested > threshold; threshold *= 2.0 if pfa < 1e-3 else 1", rate.case(), "order of rates"),
    (MORE_AT_HALF_THE_RATE, rate.case(), "order of rates"),
    (ANY_WINDOW, map_window.case(length=8), "refused"),
]


@pytest.mark.parametrize(("fault", "case", "promise"), FAULTS)
def test_a_fault_breaks_the_promise_that_is_there_for_it(fault, case, promise):
    narrow = narrowed(case, lambda one: one.name == promise)
    assert promise in broken(narrow, Faulty(fault=fault))


@pytest.mark.parametrize("family", find_families([], {"detector"}))
def test_without_a_fault_every_promise_is_kept_on_a_case_of_every_family(family):
    assert not broken(family.cases()[-1], Faulty())


def test_every_promise_of_a_detector_is_broken_by_some_fault():
    named = {one.name for one in vars(map_checks).values() if isinstance(one, Check)}
    parts_of_finite = {"shapes", "mask", "threshold and noise"}
    assert named - parts_of_finite == {promise for _, _, promise in FAULTS}


CASES = [
    map_level.case(exponent=76.0),
    map_range.case(range_db=300.0),
    blank_map.case(filled="constant", exponent=-0.3),
    map_window.case(n_axes=1, length=9, training=3, guard=1),
    map_window.case(length=9, width=8),
    rate.case(exponent=-15.0, looks=16),
    rate.case(exponent=-0.31, looks=2),
]


@pytest.mark.parametrize(
    ("name", "case"),
    [
        pytest.param(name, case, id=f"{name}-{case.spec}")
        for i, case in enumerate(CASES)
        for name in NAMES[i % 3 :: 3]
    ],
)
def test_built_in_detectors_keep_every_promise(name, case):
    """Every third each case; all of them go through the whole table among the slow tests of stress."""
    assert not broken(case, get_detector(name))


@given(
    case=st.sampled_from([map_level, map_range, blank_map, map_window]).flatmap(cases_from),
    name=st.sampled_from(NAMES),
)
@few
def test_built_in_detectors_keep_the_promises_of_whatever_the_search_draws(case, name):
    assert not broken(case, get_detector(name))


@pytest.mark.parametrize(
    ("detector", "why"),
    [
        (get_detector("ca", pfa=1e-12), "too rare to measure at pfa = 1e-12"),
        (get_detector("ca", threshold="paper"), "is not meant to keep the rate"),
    ],
)
def test_a_rate_is_measured_where_it_is_promised_and_not_too_rare(detector, why):
    with pytest.raises(NotApplicableError, match=why):
        map_checks.FALSE_ALARM_RATE.measure(map_checks.MapSubject(detector, np.ones((9, 9))))
