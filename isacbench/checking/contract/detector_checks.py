"""Checks of detectors: what a detection must be, and that the false-alarm rate is the nominal one."""

from __future__ import annotations

import dataclasses
import inspect
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from isacbench.checking.contract.class_checks import BUILT, CLASS_CHECKS, PluginSubject
from isacbench.checking.contract.conduct import (
    pickled,
    refuse_global_random_numbers,
    refuse_prints,
    refuse_warnings,
    refuse_writes,
    timed_call,
)
from isacbench.checking.contract.findings import BrokenContractError, Check
from isacbench.errors import InputError
from isacbench.plugins.contracts import Detection

Power = NDArray[np.float64]

SEED = 70_000_000_000
SHAPE = 40, 24
"""Of an ordinary map: no square, and wider than the windows in use."""

LARGE = 512, 512
RATE = 1e-2
"""Probability of false alarm that is measured, where a detector lets it be chosen."""

LOOKS = 1, 16
CONFIDENCE = 1e-9
"""Probability with which a detector of the nominal rate would miss the band; halved to either side."""

DEPENDENCE = 4
"""Cells that count as one in the band, since neighbours share the estimate of their noise."""

SAME_FACTOR = 1e-3
"""Relative difference of factors that rounding may make, and looks exceed."""

RAREST = 10
"""False alarms that must be expected for a rate to be measured."""


class DetectorSubject(PluginSubject):
    """A detector under check."""

    def detect(self, power: Any, *args: Any, plugin: Any = None, **options: Any) -> Detection:
        """Test a map, given as an array of its own."""
        detector = self.plugin if plugin is None else plugin
        detection = detector.detect(np.array(power), *args, **options)
        if not isinstance(detection, Detection):
            raise BrokenContractError(f"detect() must return a Detection, not {type(detection).__name__}")
        return detection


@cache
def _noise(shape: tuple[int, ...], looks: int = 1, stream: int = 0) -> Power:
    """Power of white noise, averaged over looks."""
    rng = np.random.default_rng([SEED, looks, stream])
    power: Power = rng.standard_gamma(looks, shape) / looks
    power.setflags(write=False)
    return power


@cache
def _ordinary(stream: int = 0) -> Power:
    """Noise with a few echoes."""
    power = _noise(SHAPE, 1, stream).copy()
    power[5, 7], power[20, 12], power[39, 0] = 300.0, 1000.0, 100.0
    power.setflags(write=False)
    return power


def _has_a_rate(subject: DetectorSubject) -> str:
    pfa = getattr(subject.plugin, "pfa", None)
    if not isinstance(pfa, (float, np.floating)) or not 0 < pfa < 1:
        raise BrokenContractError(
            f"pfa is {pfa!r}: give it a field pfa, the probability of false alarm per cell, between 0 and 1"
        )
    return ""


def _returns_a_detection(subject: DetectorSubject) -> str:
    detection = subject.detect(_ordinary())
    return f"{np.count_nonzero(detection.mask)} of {np.size(detection.mask)} cells of a map with 3 echoes"


def _has_shapes(subject: DetectorSubject) -> str:
    _require_shapes(subject.detect(_ordinary()), SHAPE)
    return ""


def _require_shapes(detection: Detection, shape: tuple[int, ...]) -> None:
    for name, dtype in (("mask", np.bool_), ("threshold", np.float64), ("noise", np.float64)):
        array = getattr(detection, name)
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
            told = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise BrokenContractError(
                f"{name} is {told}, not {np.dtype(dtype)} {shape}: an array of the map's shape is needed"
            )


def _compares_with_its_threshold(subject: DetectorSubject) -> str:
    power = _ordinary()
    detection = subject.detect(power)
    differing = int(np.sum(detection.mask != (power > detection.threshold)))
    if differing:
        raise BrokenContractError(
            f"mask is not power > threshold in {differing} of {power.size} cells: a cell is detected where "
            "its power exceeds its threshold, nowhere else"
        )
    return ""


def _has_possible_noise(subject: DetectorSubject) -> str:
    detection = subject.detect(_ordinary())
    for name in ("threshold", "noise"):
        array = getattr(detection, name)
        if np.isnan(array).any() or (array < 0).any():
            raise BrokenContractError(
                f"{name} has NaN or negative values: both are powers, in the map's unit"
            )
    return ""


def _leaves_the_map(subject: DetectorSubject) -> str:
    power = _ordinary().copy()
    subject.plugin.detect(power)
    if not np.array_equal(power, _ordinary()):
        raise BrokenContractError("writes to the map, which the next detector sees: copy before changing")
    power.setflags(write=False)
    refuse_writes(lambda: subject.plugin.detect(power), "the map")
    return ""


def _repeats(subject: DetectorSubject) -> str:
    subject.detect(_ordinary())  # so that what came before counts for `_forgets` alone
    _require_equal(
        subject.detect(_ordinary()),
        subject.detect(_ordinary()),
        "two tests of one map differ: draw random numbers from a generator with a fixed seed",
    )
    return ""


def _forgets(subject: DetectorSubject) -> str:
    subject.detect(_ordinary())
    before = subject.detect(_ordinary())
    subject.detect(10 * _ordinary(1))
    _require_equal(
        before,
        subject.detect(_ordinary()),
        "another map in between changes the result: keep nothing from one call to the next",
    )
    return ""


def _is_pickled(subject: DetectorSubject) -> str:
    twin = pickled(subject.plugin)
    subject.detect(_ordinary())
    _require_equal(
        subject.detect(_ordinary()),
        subject.detect(_ordinary(), plugin=twin),
        "it tests otherwise after pickling: keep all that it needs in its parameters",
    )
    return ""


def _require_equal(first: Detection, second: Detection, complaint: str) -> None:
    for name in ("mask", "threshold", "noise"):
        if not np.array_equal(getattr(first, name), getattr(second, name)):
            raise BrokenContractError(f"{complaint} (in {name})")


def _leaves_random_numbers(subject: DetectorSubject) -> str:
    refuse_global_random_numbers(lambda: subject.detect(_ordinary()))
    return ""


def _is_quiet(subject: DetectorSubject) -> str:
    refuse_prints(lambda: subject.detect(_ordinary()))
    return ""


def _knows_no_unit(subject: DetectorSubject) -> str:
    mask = subject.detect(_ordinary()).mask
    for exponent in (-60, 60):
        differing = int(np.sum(mask != subject.detect(np.ldexp(_ordinary(), exponent)).mask))
        if differing:
            raise BrokenContractError(
                f"{differing} cells are tested otherwise when the map is scaled by 2^{exponent}: thresholds "
                "follow from the noise of the map, without constants in the map's unit"
            )
    return ""


def _takes_looks(subject: DetectorSubject) -> str:
    one = subject.detect(_ordinary(), 1)
    _require_equal(subject.detect(_ordinary()), one, "looks=1 is not the default: let it be")
    many = subject.detect(_ordinary(), looks=max(LOOKS))
    _require_shapes(many, SHAPE)
    # Their factors between noise and threshold, multiplied out where there is no noise.
    if np.allclose(many.threshold * one.noise, one.threshold * many.noise, rtol=SAME_FACTOR, atol=0):
        raise BrokenContractError(
            "the factor between noise and threshold does not depend on looks: noise averaged over more looks "
            "strays less, gamma-distributed with that shape"
        )
    return ""


def _takes_lines(subject: DetectorSubject) -> str:
    power = _ordinary()[:, 7]
    try:
        detection = subject.detect(power)
    except InputError as error:
        return f"refused in words: {error}"
    _require_shapes(detection, power.shape)
    return ""


def _takes_small_maps(subject: DetectorSubject) -> str:
    refused = ""
    for shape in ((1, 1), (2, 3)):
        try:
            _require_shapes(subject.detect(_noise(shape)), shape)
        except InputError as error:
            refused = f"refused in words: {error}"
    return refused


def _takes_silence(subject: DetectorSubject) -> str:
    detection = refuse_warnings(lambda: subject.detect(np.zeros(SHAPE)), ": expect a map without any power")
    if np.any(detection.mask):
        raise BrokenContractError(
            f"detects {np.count_nonzero(detection.mask)} cells of a map that is zero everywhere: a detected "
            "cell exceeds its threshold, strictly"
        )
    return ""


def _refuses_bad_maps(subject: DetectorSubject) -> str:
    nan, negative = _ordinary().copy(), _ordinary().copy()
    nan[3, 4], negative[3, 4] = np.nan, -1.0
    for what, power in (("complex", _ordinary() + 1j), ("NaN", nan), ("negative", negative)):
        try:
            subject.detect(power)
        except Exception:
            continue
        raise BrokenContractError(
            f"takes a map with {what} cells without a word: refuse it, as "
            "isacbench.dsp.cfar.checked_power does"
        )
    return ""


def _keeps_its_rate(subject: DetectorSubject) -> str:
    detector, told = subject.plugin, []
    if any(field.name == "pfa" for field in dataclasses.fields(detector)):
        detector = dataclasses.replace(detector, pfa=RATE)
    n_cells = int(np.prod(LARGE)) // DEPENDENCE
    if detector.pfa * n_cells < RAREST:
        return f"too rare to measure at pfa = {detector.pfa:g}"
    low, high = (
        float(binom.ppf(tail, n_cells, detector.pfa)) / n_cells
        for tail in (CONFIDENCE / 2, 1 - CONFIDENCE / 2)
    )
    for looks in LOOKS:
        rate = float(subject.detect(_noise(LARGE, looks), looks, plugin=detector).mask.mean())
        if not low <= rate <= high:
            raise BrokenContractError(
                f"at pfa = {detector.pfa:g} and {looks} looks, {rate:.3g} of the cells of white noise are "
                f"detected, not {low:.3g} to {high:.3g}: derive the factor from the distribution of the "
                "noise estimate (isacbench.dsp.cfar.factors)"
            )
        told.append(f"{rate:.4f} at {looks} looks")
    return f"{detector.pfa:g} nominal, {', '.join(told)}"


def _picks_listed_cells(subject: DetectorSubject) -> str:
    if "cells" not in inspect.signature(subject.plugin.detect).parameters:
        return "takes whole maps only"
    cells = np.array([0, 5, 20, 20, 39]), np.array([0, 7, 12, 23, 0])
    whole, picked = subject.detect(_ordinary()), subject.detect(_ordinary(), 1, cells=cells)
    _require_shapes(picked, (cells[0].size,))
    for name in ("mask", "threshold", "noise"):
        wanted = getattr(whole, name)[cells]
        if not np.allclose(getattr(picked, name), wanted, rtol=1e-9, atol=0):
            raise BrokenContractError(
                f"{name} of listed cells is not that of the same cells of the whole map: cells says where to "
                "test, and changes no test"
            )
    return ""


def _is_fast(subject: DetectorSubject) -> str:
    power = _noise(LARGE)
    return timed_call(lambda: subject.detect(power), f"{LARGE[0]} x {LARGE[1]} cells")


TESTED = "detection"
SHAPED = "shapes"
DETECTOR_CHECKS: tuple[Check[Any], ...] = (
    *CLASS_CHECKS,
    Check("pfa", _has_a_rate, (BUILT,)),
    Check(TESTED, _returns_a_detection, (BUILT,)),
    Check(SHAPED, _has_shapes, (TESTED,)),
    Check("mask", _compares_with_its_threshold, (SHAPED,)),
    Check("threshold and noise", _has_possible_noise, (SHAPED,)),
    Check("map unchanged", _leaves_the_map, (TESTED,)),
    Check("repeatable", _repeats, (SHAPED,)),
    Check("no memory", _forgets, ("repeatable",)),
    Check("pickling", _is_pickled, ("canonical parameters", "repeatable")),
    Check("random numbers", _leaves_random_numbers, (TESTED,)),
    Check("stdout", _is_quiet, (TESTED,)),
    Check("scale", _knows_no_unit, ("no memory",)),
    Check("looks", _takes_looks, ("no memory", "threshold and noise")),
    Check("1-D map", _takes_lines, (SHAPED,)),
    Check("small maps", _takes_small_maps, (SHAPED,)),
    Check("silence", _takes_silence, (SHAPED,)),
    Check("bad maps", _refuses_bad_maps, (TESTED,)),
    Check("false-alarm rate", _keeps_its_rate, ("pfa", SHAPED, "looks")),
    Check("listed cells", _picks_listed_cells, (SHAPED,)),
    Check("time", _is_fast, (TESTED,)),
)
