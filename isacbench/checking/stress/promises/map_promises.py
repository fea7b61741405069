"""Tested maps: a detector and a power map, what is promised of every detection, and how it may move."""

from __future__ import annotations

import dataclasses
import inspect
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.checking.stress.case import BrokenPromiseError, NotApplicableError, Promise
from isacbench.checking.stress.promises.known_factor import known_rate
from isacbench.checking.stress.promises.known_noise import known_noise
from isacbench.dsp.cell_detection import detect_listed
from isacbench.errors import InputError
from isacbench.plugins.contracts import Detection

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from isacbench.plugins.contracts import Detector

    Power = NDArray[np.floating[Any]]

EXACT = 1e-12
"""What rounding may do to a noise estimate, or the order of its sums to a threshold."""

RATE = 1e-6
"""What quadrature may do to a rate: that of a factor, and the one it is held against."""

TIE = 1e-10
"""Relative distance of power and threshold within which rounding may decide."""

ODD = 1.7
"""A factor that rounds."""

LIMITS = -900, 900
"""Exponents of the weakest and the strongest cell of scaled maps: nothing is subnormal or overflows."""

SMALLEST = 5e-324
SINGLE_LIMITS = 2.0**-100, 2.0**100
"""Powers that float32 holds in full."""

BY_HALVES = ("goca", "soca")
SYMMETRIC = ("ca", "os", "osca", "tm", *BY_HALVES)


@dataclass(frozen=True, eq=False)
class TestedMap:
    """A detector and what it tests.

    Attributes
    ----------
    detector : Detector
    power : ndarray of float64
    looks : int
    """

    detector: Detector
    power: NDArray[np.float64]
    looks: int = 1

    @cached_property
    def found(self) -> Detection:
        """Detection of the map."""
        return self.detect(self.power)

    def detect(self, power: Power) -> Detection:
        """Detection of another map, given as it lies in memory."""
        return self.detector.detect(power, self.looks)

    def drift(self, other: Detection) -> float:
        """How far the noise or a threshold of another detection of the same map is from its own.

        Raises
        ------
        BrokenPromiseError
            If a cell is detected in one of the two alone, though its power is
            not within rounding of its threshold.
        """
        with np.errstate(over="ignore"):  # thresholds may be the largest float64
            near = np.abs(self.power - self.found.threshold) <= TIE * self.found.threshold
        differing = int(np.count_nonzero((other.mask != self.found.mask) & ~near))
        if differing:
            raise BrokenPromiseError(f"{differing} of {near.size} cells are decided otherwise")
        return max(_relative(self.found.noise, other.noise), _relative(self.found.threshold, other.threshold))


def _relative(one: NDArray[np.float64], two: NDArray[np.float64]) -> float:
    """Largest relative difference; the smallest float64 counts as none."""
    apart = np.maximum(np.abs(one - two) - SMALLEST, 0)
    return float(np.max(np.divide(apart, one, out=apart.copy(), where=one > 0), initial=0.0))


def _finite(tested: TestedMap) -> float:
    """Finite and not negative, detected where a power exceeds its threshold and nowhere else."""
    _refuse_inconsistent(tested.found, tested.power.copy())
    return 0.0


def _refuse_inconsistent(found: Detection, power: NDArray[np.float64], where: str = "") -> None:
    for name in ("noise", "threshold"):
        values = getattr(found, name)
        if values.shape != power.shape or not np.isfinite(values).all() or (values < 0).any():
            raise BrokenPromiseError(
                f"{name}{where}: finite numbers >= 0 of the shape {power.shape} are needed"
            )
    differing = int(np.count_nonzero(found.mask != (power > found.threshold)))
    if differing:
        raise BrokenPromiseError(f"mask{where} is not power > threshold in {differing} of {power.size} cells")


def _repeats(tested: TestedMap) -> float:
    return _moved(tested, tested.detect(tested.power.copy()))


def _moved(tested: TestedMap, other: Detection) -> float:
    """Drift of a detection that must decide every cell alike."""
    if not np.array_equal(other.mask, tested.found.mask):
        raise BrokenPromiseError("other cells are detected")
    return tested.drift(other)


def _listed(tested: TestedMap) -> float:
    """All cells, listed from the last to the first, and one alone."""
    if "cells" not in inspect.signature(tested.detector.detect).parameters:
        raise NotApplicableError("it tests whole maps only")
    drifts = []
    n_cells = tested.power.size
    for order in (np.arange(n_cells)[::-1], np.array([n_cells // 2])):
        cells = np.unravel_index(order, tested.power.shape)
        listed = detect_listed(tested.detector, tested.power, tested.looks, cells)
        for name in ("mask", "threshold", "noise"):
            whole, part = getattr(tested.found, name)[cells], getattr(listed, name)
            drifts.append(_relative(whole.astype(np.float64), part.astype(np.float64)))
    return max(drifts)


def _layout(tested: TestedMap) -> float:
    """Fortran order, every second item of a larger array, from the end to the start, the other byte order."""
    power = tested.power
    swapped = power.astype(power.dtype.newbyteorder())
    every_second = np.repeat(power, 2, axis=-1)[..., ::2]
    read_only = power.copy()
    read_only.flags.writeable = False
    return max(
        _moved(tested, tested.detect(laid))
        for laid in (np.asfortranarray(power), every_second, power[::-1].copy()[::-1], swapped, read_only)
    )


def _two_power_scale(tested: TestedMap) -> float:
    """To both ends of what float64 holds in full, as far as that rounds no cell, and back."""
    strongest, weakest = _exponents(tested)
    exponents = [
        exponent
        for exponent in (LIMITS[1] - strongest, LIMITS[0] - weakest)
        if strongest + exponent <= LIMITS[1] and (exponent >= 0 or weakest + exponent >= LIMITS[0])
    ]
    if not exponents:
        raise NotApplicableError("it is at both ends of float64 already")
    return max(
        _moved(tested, _scaled_back(tested.detect(np.ldexp(tested.power, exponent)), exponent))
        for exponent in exponents
    )


def _exponents(tested: TestedMap) -> tuple[int, int]:
    """Exponents of the strongest cell, and of the weakest that is not 0."""
    seen = tested.power[tested.power > 0]
    if not seen.size:
        raise NotApplicableError("nothing is there to be scaled")
    return math.frexp(float(seen.max()))[1], math.frexp(float(seen.min()))[1]


def _scaled_back(found: Detection, exponent: int) -> Detection:
    """Divide by a power of two; what overflows is the largest float64."""
    with np.errstate(over="ignore"):
        threshold, noise = np.ldexp(found.threshold, -exponent), np.ldexp(found.noise, -exponent)
    largest = np.finfo(np.float64).max
    return Detection(found.mask, np.minimum(threshold, largest), np.minimum(noise, largest))


def _any_scale(tested: TestedMap) -> float:
    strongest, weakest = _exponents(tested)
    if weakest < LIMITS[0] or strongest > LIMITS[1]:
        raise NotApplicableError("it is at the ends of float64 already")
    found = tested.detect(tested.power * ODD)
    return tested.drift(Detection(found.mask, found.threshold / ODD, found.noise / ODD))


def _known_noise(tested: TestedMap) -> float:
    return _relative(known_noise(tested.detector, tested.power), tested.found.noise)


def _nothing(tested: TestedMap) -> float:
    n_detected = int(np.count_nonzero(tested.found.mask))
    if n_detected:
        raise BrokenPromiseError(f"{n_detected} of {tested.power.size} cells are detected")
    return 0.0


def _single_precision(tested: TestedMap) -> float:
    """Noise and thresholds alone: cells near their threshold may be decided otherwise."""
    seen = tested.power[tested.power > 0]
    if not seen.size or seen.min() < SINGLE_LIMITS[0] or seen.max() > SINGLE_LIMITS[1]:
        raise NotApplicableError("float32 does not hold it in full")
    found = tested.detect(tested.power.astype(np.float32))
    return max(_relative(tested.found.noise, found.noise), _relative(tested.found.threshold, found.threshold))


def _turned(tested: TestedMap) -> float:
    """Turn the map around all axes at once: windows and their halves mirror themselves."""
    if tested.detector.name not in SYMMETRIC:
        raise NotApplicableError("whether its window mirrors itself is not known here")
    found = tested.detect(np.flip(tested.power))
    return tested.drift(Detection(np.flip(found.mask), np.flip(found.threshold), np.flip(found.noise)))


def _known_factor(tested: TestedMap) -> float:
    """Rate that thresholds keep of noise alone, in the middle of the map and in its corner."""
    if getattr(tested.detector, "threshold", "exact") != "exact":
        raise NotApplicableError("its factor is not meant to keep the rate")
    return max(
        _rate_drift(tested, cell)
        for cell in (tuple(n // 2 for n in tested.power.shape), (0,) * tested.power.ndim)
    )


def _rate_drift(tested: TestedMap, cell: tuple[int, ...]) -> float:
    factor = float(tested.found.threshold[cell] / tested.found.noise[cell])
    rate = known_rate(tested.detector, factor, tested.power.shape, cell, tested.looks)
    return abs(rate / tested.detector.pfa - 1)


def _rate_order(tested: TestedMap) -> float:
    """Half the rate: thresholds rise, and cells are lost, one between the two thresholds among them."""
    strict = TestedMap(_at_half_the_rate(tested.detector), tested.power, tested.looks)
    _refuse_inconsistent(strict.found, tested.power, " at half the rate")
    if np.any(strict.found.mask & ~tested.found.mask):
        raise BrokenPromiseError("a cell is detected at half the rate that is not at the whole one")
    if not np.any(strict.found.threshold > tested.found.threshold):
        raise BrokenPromiseError("no threshold rises at half the rate")
    middle = tuple(n // 2 for n in tested.power.shape)
    power = tested.power.copy()
    power[middle] = (tested.found.threshold[middle] + strict.found.threshold[middle]) / 2
    for one, where in ((tested, ""), (strict, " at half the rate")):
        _refuse_inconsistent(one.detect(power), power, f" of a cell near its threshold{where}")
    fallen = tested.found.threshold - strict.found.threshold
    return float(np.max(fallen / np.maximum(tested.found.threshold, SMALLEST), initial=0.0))


def _at_half_the_rate(detector: Detector) -> Detector:
    strict: Detector = dataclasses.replace(detector, pfa=detector.pfa / 2)  # type: ignore[type-var]
    return strict


def _refused(tested: TestedMap) -> float:
    try:
        tested.detect(tested.power)
    except InputError:
        return 0.0
    raise BrokenPromiseError(f"a map of {tested.power.shape} cells is smaller than the window, and tested")


def _promise(name: str, bound: float, drift: Callable[[TestedMap], float]) -> Promise[TestedMap]:
    return Promise(name, bound, drift)


MAP_FINITE = _promise("finite", 0.0, _finite)
MAP_REPEAT = _promise("repeat", 0.0, _repeats)
LISTED = _promise("listed cells", EXACT, _listed)
MAP_LAYOUT = _promise("memory order", EXACT, _layout)
MAP_TWO_POWER_SCALE = _promise("scale by powers of two", 0.0, _two_power_scale)
MAP_ANY_SCALE = _promise("scale", 1e-10, _any_scale)
KNOWN_NOISE = _promise("known noise", EXACT, _known_noise)
KNOWN_FACTOR = _promise("known factor", RATE, _known_factor)
NOTHING = _promise("nothing detected", 0.0, _nothing)
MAP_SINGLE_PRECISION = _promise("single precision", 2.0**-23, _single_precision)
TURNED = _promise("turned", EXACT, _turned)
RATE_ORDER = _promise("order of rates", 0.0, _rate_order)
REFUSED = _promise("refused", 0.0, _refused)

EVERY_MAP = MAP_FINITE, MAP_REPEAT, LISTED, MAP_LAYOUT
"""What holds of every map."""

MAP_INVARIANT = MAP_TWO_POWER_SCALE, MAP_ANY_SCALE, TURNED
"""What holds where nothing is left to a tie."""
