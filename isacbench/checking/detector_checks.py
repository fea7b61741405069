"""Contract of detectors: the form of a detection, and the rate of false alarms."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.checking import map_checks
from isacbench.checking.checks import (
    Check,
    CheckFailedError,
    DoubtfulError,
    refuse_warnings,
)
from isacbench.checking.class_checks import (
    BUILT,
    CALLABLE,
    CLASS_CHECKS,
    PluginSubject,
    conduct_checks,
    refuse_writes,
    timed_call,
)
from isacbench.checking.map_checks import MapSubject, white_noise_map
from isacbench.errors import InputError

SEED = 70_000_000_000
SHAPE = 40, 24
"""Shape of an ordinary map: not square, and wider than the usual windows."""

LARGE = 512, 512
RATE = 1e-2
"""Probability of false alarm to measure at, if the detector has a field for it."""

BORDER_RATE = 0.1
"""The same at the borders of maps, which have few cells."""

LOOKS = 1, 16

SAME_FACTOR = 1e-3
"""Relative difference of two factors: rounding stays below it, a change of looks exceeds it."""


@cache
def _noise_with_echoes(stream: int) -> NDArray[np.float64]:
    """Map of noise with three echoes, read-only."""
    power = white_noise_map(SHAPE, SEED + stream)
    power[5, 7], power[20, 12], power[39, 0] = 300.0, 1000.0, 100.0
    power.setflags(write=False)
    return power


class DetectorSubject(PluginSubject):
    """A detector under check."""

    @cached_property
    def ordinary(self) -> MapSubject:
        """Noise with three echoes, tested by the detector."""
        return MapSubject(self.plugin, _noise_with_echoes(0))

    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Test a map of noise with three echoes: mask, threshold and noise."""
        power = 10 * _noise_with_echoes(1) if other else _noise_with_echoes(0).copy()
        found = MapSubject(plugin or self.plugin, power).found
        return [found.mask, found.threshold, found.noise]


def _has_a_rate(subject: DetectorSubject) -> None:
    pfa = getattr(subject.plugin, "pfa", None)
    if not isinstance(pfa, (float, np.floating)) or not 0 < pfa < 1:
        raise CheckFailedError(
            f"pfa is {pfa!r}: give it a field pfa, the probability of false alarm per cell, between 0 and 1"
        )


def _returns_a_detection(subject: DetectorSubject) -> str:
    mask = subject.ordinary.found.mask
    return f"{np.count_nonzero(mask)} of {np.size(mask)} cells of a map with 3 echoes"


def _leaves_the_map(subject: DetectorSubject) -> None:
    refuse_writes(lambda: subject.plugin.detect(_noise_with_echoes(0)), "the map")


def _takes_looks(subject: DetectorSubject) -> None:
    power = _noise_with_echoes(0)
    unsaid, one = (subject.plugin.detect(power.copy(), *looks) for looks in ((), (1,)))
    if not np.array_equal(unsaid.threshold, one.threshold):
        raise CheckFailedError("looks=1 is not the default: let it be")
    many = subject.plugin.detect(power.copy(), looks=max(LOOKS))
    # Compare threshold / noise of both, multiplied out because the noise may be 0.
    if np.allclose(many.threshold * one.noise, one.threshold * many.noise, rtol=SAME_FACTOR, atol=0):
        raise CheckFailedError(
            "the factor between noise and threshold does not depend on looks: noise averaged over more looks "
            "strays less, gamma-distributed with that shape"
        )


def _takes_maps(*maps: NDArray[np.float64]) -> Callable[[DetectorSubject], str]:
    """Make a measurement that takes unusual maps; the detector may refuse them with an `InputError`."""

    def measure(subject: DetectorSubject) -> str:
        refused = ""
        for power in maps:
            try:
                map_checks.MAP_SHAPES.measure(MapSubject(subject.plugin, power))
            except InputError as error:
                refused = f"refused in words: {error}"
        return refused

    return measure


def _takes_silence(subject: DetectorSubject) -> None:
    silence = MapSubject(subject.plugin, np.zeros(SHAPE))
    refuse_warnings(lambda: map_checks.NOTHING.measure(silence), ": expect a map without any power")


def _refuses_bad_maps(subject: DetectorSubject) -> None:
    nan, negative = _noise_with_echoes(0).copy(), _noise_with_echoes(0).copy()
    nan[3, 4], negative[3, 4] = np.nan, -1.0
    for what, power in (("complex", _noise_with_echoes(0) + 1j), ("NaN", nan), ("negative", negative)):
        try:
            subject.plugin.detect(power)
        except Exception:
            continue
        raise CheckFailedError(
            f"accepts a map with {what} cells; raise InputError instead, as "
            "isacbench.dsp.cfar.checked_power does"
        )


def _keeps_its_rate(subject: DetectorSubject) -> str:
    detector = _at_rate(subject.plugin, RATE)
    rates = [map_checks.require_rate(detector, looks, LARGE, SEED, margin=LARGE[0] // 16) for looks in LOOKS]
    measured = ", ".join(f"{rate:.4f} at {looks} looks" for rate, looks in zip(rates, LOOKS, strict=True))
    return f"{detector.pfa:g} nominal, {measured}"


def _keeps_its_rate_at_borders(subject: DetectorSubject) -> str:
    """Measure at borders; a rate of 0 there is allowed, but no cell is tested."""
    try:
        detector = _at_rate(subject.plugin, BORDER_RATE)
        measured = {looks: map_checks.border_rates(detector, looks, SEED) for looks in LOOKS}
    except InputError as error:
        return f"refused in words: {error}"
    for looks, rates in measured.items():
        wrong = {name: rate for name, (rate, low, high) in rates.items() if not low <= rate <= high}
        untested = [name for name, rate in wrong.items() if not rate]
        if wrong and (not untested or any(rate > rates[name][2] for name, rate in wrong.items())):
            shares = ", ".join(f"{rate:.3g} in the {name}" for name, rate in wrong.items())
            raise CheckFailedError(
                f"at pfa = {detector.pfa:g} and {looks} looks, the share of detected cells of white noise is "
                f"{shares}: pad maps with nothing, let the window shift inwards there, and take the factor "
                "of the cells that it then has (isacbench.dsp.cfar.windows_of)"
            )
        if untested:
            raise DoubtfulError(
                f"detects nothing in the {', '.join(untested)} of maps: echoes there are lost; let the "
                "window shift inwards (isacbench.dsp.cfar.windows_of)"
            )
    every = [rate for rates in measured.values() for rate, *_ in rates.values()]
    return f"{detector.pfa:g} nominal, {min(every):.3f} to {max(every):.3f} in rows, columns and corners"


def _at_rate(detector: Any, pfa: float) -> Any:
    """Give a detector another rate, if it has a field for it."""
    has_field = any(field.name == "pfa" for field in dataclasses.fields(detector))
    return dataclasses.replace(detector, pfa=pfa) if has_field else detector


def _is_fast(subject: DetectorSubject) -> str:
    power = white_noise_map(LARGE, SEED)
    return timed_call(lambda: subject.plugin.detect(power), f"{LARGE[0]} x {LARGE[1]} cells")


def _of_ordinary_map(check: Check[MapSubject], needs: str, name: str = "") -> Check[DetectorSubject]:
    """Ask for a property of detections on the ordinary map."""
    return Check(
        name or check.name,
        lambda subject: check.measure(subject.ordinary),
        check.bound,
        check.hint,
        (needs,),
    )


TESTED = "detection"
SHAPED = "shapes"
DETECTOR_CHECKS: tuple[Check[Any], ...] = (
    *CLASS_CHECKS,
    Check("pfa", _has_a_rate, needs=(BUILT,)),
    Check(TESTED, _returns_a_detection, needs=(CALLABLE,)),
    _of_ordinary_map(map_checks.MAP_SHAPES, TESTED),
    _of_ordinary_map(map_checks.MASK, SHAPED),
    _of_ordinary_map(map_checks.MAP_POWERS, SHAPED),
    Check("map unchanged", _leaves_the_map, needs=(TESTED,)),
    *conduct_checks(SHAPED),
    _of_ordinary_map(map_checks.MAP_TWO_POWER_SCALE, "no memory", "scale"),
    Check("looks", _takes_looks, needs=("no memory", "threshold and noise")),
    Check("1-D map", _takes_maps(_noise_with_echoes(0)[:, 7]), needs=(SHAPED,)),
    Check("small maps", _takes_maps(np.ones((1, 1)), _noise_with_echoes(0)[:2, :3]), needs=(SHAPED,)),
    Check("silence", _takes_silence, needs=(SHAPED,)),
    Check("bad maps", _refuses_bad_maps, needs=(TESTED,)),
    Check("false-alarm rate", _keeps_its_rate, needs=("pfa", SHAPED, "looks")),
    Check("rate at borders", _keeps_its_rate_at_borders, needs=("false-alarm rate",)),
    _of_ordinary_map(map_checks.LISTED, SHAPED),
    Check("time", _is_fast, needs=(TESTED,)),
)
