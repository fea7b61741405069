"""Promises of detections: properties of every tested map, and invariances of the detector."""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from isacbench.checking.promises.promise import BrokenPromiseError, NotApplicableError, Promise
from isacbench.dsp.cell_detection import detect_listed
from isacbench.errors import InputError
from isacbench.plugins.contracts import Detection, Detector

Power = NDArray[np.floating[Any]]

EXACT = 1e-12
"""Largest drift that another order of summation may cause."""

TIE = 1e-10
"""Relative distance of power and threshold within which rounding may decide."""

ODD = 1.7
"""Scale factor that is not a power of two, so that products round."""

SCALES = -200, 200
"""Binary exponents of the factors of scaled maps."""

STRIP = 13, 20_000
"""Shape of a noise map in which the windows of most cells touch a border."""

CONFIDENCE = 1e-9
"""Probability that a detector of the nominal rate falls outside the band, half of it on either side."""

DEPENDENCE = 4
"""Number of cells that count as one independent trial: neighbours share their noise estimate."""

APPROXIMATION = 0.03
"""Relative error of the rate that an approximate factor may cause at high rates."""

RAREST = 10
"""Least expected number of false alarms for which a rate is measured."""

BORDER_MAPS = 256, 32, 32
"""Number and shape of the noise maps whose borders are looked at; many, for a map has four corners."""

BORDERS: dict[str, Any] = {
    "first rows": np.s_[:, :2, 2:-2],
    "last rows": np.s_[:, -2:, 2:-2],
    "first columns": np.s_[:, 2:-2, :2],
    "last columns": np.s_[:, 2:-2, -2:],
    "corners": np.s_[:, [[0], [1], [-2], [-1]], [[0, 1, -2, -1]]],
    "next rows": np.s_[:, 2:8, 2:-2],
    "rows before the last": np.s_[:, -8:-2, 2:-2],
    "next columns": np.s_[:, 2:-2, 2:8],
    "columns before the last": np.s_[:, 2:-2, -8:-2],
}
"""Cells within two of a border, where the window lacks most cells, and in the next six rows and columns."""


@dataclass(frozen=True, eq=False)
class TestedMap:
    """A detector and the map that it tests."""

    detector: Detector
    power: NDArray[np.float64]
    looks: int = 1

    @cached_property
    def found(self) -> Detection:
        """Detection of the map."""
        return self.detect(self.power.copy())

    def detect(self, power: Power) -> Detection:
        """Test another map.

        Parameters
        ----------
        power : ndarray of float
            Given to the detector as it lies in memory.

        Raises
        ------
        BrokenPromiseError
            If the detector returns anything else.
        """
        found = self.detector.detect(power, self.looks)
        if not isinstance(found, Detection):
            raise BrokenPromiseError(f"detect() must return a Detection, not {type(found).__name__}")
        return found

    def drift(self, other: Detection) -> float:
        """Largest relative difference of noise and thresholds of another detection of the same map.

        Raises
        ------
        BrokenPromiseError
            If a cell is detected in only one of the two although its power
            differs from its threshold by more than rounding.
        """
        near = np.abs(self.power - self.found.threshold) <= TIE * self.found.threshold
        differing = int(np.count_nonzero((other.mask != self.found.mask) & ~near))
        if differing:
            raise BrokenPromiseError(f"{differing} of {near.size} cells are decided otherwise")
        return max(_relative(self.found.noise, other.noise), _relative(self.found.threshold, other.threshold))


def white_noise_map(shape: tuple[int, ...], seed: int, looks: int = 1) -> NDArray[np.float64]:
    """Power of white noise of mean 1, averaged over looks."""
    return np.random.default_rng([seed, looks]).standard_gamma(looks, shape) / looks


def _relative(one: NDArray[Any], two: NDArray[Any]) -> float:
    """Largest relative difference."""
    apart = np.abs(one - two)
    return float(np.max(np.divide(apart, one, out=apart.copy(), where=one > 0), initial=0.0))


def _has_shapes(tested: TestedMap) -> float:
    shape = tested.power.shape
    for name, dtype in (("mask", np.bool_), ("threshold", np.float64), ("noise", np.float64)):
        array = getattr(tested.found, name)
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
            given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise BrokenPromiseError(
                f"{name} is {given}, not {np.dtype(dtype)} {shape}: an array of the map's shape is needed"
            )
    return 0.0


def _has_possible_powers(tested: TestedMap) -> float:
    for name in ("threshold", "noise"):
        array = getattr(tested.found, name)
        if not np.isfinite(array).all() or (array < 0).any():
            raise BrokenPromiseError(
                f"{name} has NaN, infinite or negative values: both are powers, in the map's unit"
            )
    return 0.0


def _compares_with_its_threshold(tested: TestedMap) -> float:
    differing = int(np.sum(tested.found.mask != (tested.power > tested.found.threshold)))
    if differing:
        raise BrokenPromiseError(
            f"mask is not power > threshold in {differing} of {tested.power.size} cells: a cell is detected "
            "where its power exceeds its threshold, nowhere else"
        )
    return 0.0


def _finite(tested: TestedMap) -> float:
    return max(promise.drift(tested) for promise in (MAP_SHAPES, MAP_POWERS, MASK))


def _moved(tested: TestedMap, other: Detection) -> float:
    """Drift of a detection that must decide every cell in the same way."""
    differing = int(np.count_nonzero(other.mask != tested.found.mask))
    if differing:
        raise BrokenPromiseError(f"{differing} of {tested.power.size} cells are decided otherwise")
    return tested.drift(other)


def _repeats(tested: TestedMap) -> float:
    return _moved(tested, tested.detect(tested.power.copy()))


def _listed(tested: TestedMap) -> float:
    """Drift if all cells are listed from the last to the first, and if one is listed alone."""
    if "cells" not in inspect.signature(tested.detector.detect).parameters:
        raise NotApplicableError("takes whole maps only")
    drifts = []
    n_cells = tested.power.size
    for order in (np.arange(n_cells)[::-1], np.array([n_cells // 2])):
        cells = np.unravel_index(order, tested.power.shape)
        listed = detect_listed(tested.detector, tested.power.copy(), tested.looks, cells)
        for name in ("mask", "threshold", "noise"):
            part, whole = getattr(listed, name), getattr(tested.found, name)[cells]
            if part.shape != whole.shape:
                raise BrokenPromiseError(f"{name} of {order.size} listed cells has shape {part.shape}")
            drifts.append(_relative(whole.astype(np.float64), part.astype(np.float64)))
    return max(drifts)


def _layout(tested: TestedMap) -> float:
    """Drift for maps in Fortran order, with gaps, backwards, in the other byte order, and read-only."""
    power = tested.power
    read_only = power.copy()
    read_only.flags.writeable = False
    return max(
        _moved(tested, tested.detect(laid))
        for laid in (
            np.asfortranarray(power),
            np.repeat(power, 2, axis=-1)[..., ::2],
            power[::-1].copy()[::-1],
            power.astype(power.dtype.newbyteorder()),
            read_only,
        )
    )


def _two_power_scale(tested: TestedMap) -> float:
    drifts = []
    for exponent in SCALES:
        found = tested.detect(np.ldexp(tested.power, exponent))
        threshold, noise = np.ldexp(found.threshold, -exponent), np.ldexp(found.noise, -exponent)
        drifts.append(_moved(tested, Detection(found.mask, threshold, noise)))
    return max(drifts)


def _any_scale(tested: TestedMap) -> float:
    found = tested.detect(tested.power * ODD)
    return tested.drift(Detection(found.mask, found.threshold / ODD, found.noise / ODD))


def _nothing(tested: TestedMap) -> float:
    n_detected = int(np.count_nonzero(tested.found.mask))
    if n_detected:
        raise BrokenPromiseError(
            f"detects {n_detected} of {tested.power.size} cells: a detected cell exceeds its threshold, "
            "strictly"
        )
    return 0.0


def _single_precision(tested: TestedMap) -> float:
    """Drift of noise and thresholds only: cells near their threshold may be decided differently."""
    if max(np.abs(np.log2(tested.power[tested.power > 0])), default=0.0) > -np.finfo(np.float32).minexp:
        raise NotApplicableError("float32 does not hold it in full")
    found = tested.detect(tested.power.astype(np.float32))
    return max(_relative(tested.found.noise, found.noise), _relative(tested.found.threshold, found.threshold))


def _rate_order(tested: TestedMap) -> float:
    """Largest relative fall of a threshold when the rate is halved; thresholds must not fall."""
    detector: Any = tested.detector
    strict = TestedMap(dataclasses.replace(detector, pfa=detector.pfa / 2), tested.power, tested.looks)
    _finite(strict)
    if np.any(strict.found.mask & ~tested.found.mask):
        raise BrokenPromiseError("a cell is detected at half the rate that is not at the whole one")
    if not np.any(strict.found.threshold > tested.found.threshold):
        raise BrokenPromiseError("no threshold rises at half the rate")
    between = TestedMap(detector, tested.power.copy(), tested.looks)
    middle = tuple(n // 2 for n in tested.power.shape)
    between.power[middle] = (tested.found.threshold[middle] + strict.found.threshold[middle]) / 2
    for one in (between, dataclasses.replace(between, detector=strict.detector)):
        _compares_with_its_threshold(one)
    fallen = np.maximum(tested.found.threshold - strict.found.threshold, 0.0)
    return _relative(tested.found.threshold, tested.found.threshold - fallen)


def require_rate(
    detector: Detector, looks: int, shape: tuple[int, ...] = STRIP, seed: int = 0, margin: int = 0
) -> float:
    """Measure the false-alarm rate of a detector in white noise.

    Parameters
    ----------
    shape : tuple of int
        Shape of the noise map.
    margin : int
        Cells from each border that do not count.

    Raises
    ------
    NotApplicableError
        If the detector's `pfa` is too low to be measured on that map.
    BrokenPromiseError
        If the rate is not the nominal one.
    """
    pfa: float = getattr(detector, "pfa")  # noqa: B009, no part of the protocol
    found = TestedMap(detector, white_noise_map(shape, seed, looks), looks).found
    mask = found.mask[tuple(slice(margin, length - margin) for length in shape)]
    low, high = _rate_limits(pfa, mask.size)
    rate = float(mask.mean())
    if not low <= rate <= high:
        raise BrokenPromiseError(
            f"at pfa = {pfa:g} and {looks} looks, {rate:.3g} of the cells of white noise are detected, not "
            f"{low:.3g} to {high:.3g}: derive the factor from the distribution of the noise estimate "
            "(isacbench.dsp.cfar.factors)"
        )
    return rate


def _rate_limits(pfa: float, n_cells: int) -> tuple[float, float]:
    """Limits of the measured rate of a detector that keeps it; refuse rates too rare to measure."""
    n_trials = n_cells // DEPENDENCE
    if pfa * n_trials < RAREST:
        raise NotApplicableError(f"too rare to measure at pfa = {pfa:g}")
    low, high = binom.interval(1 - CONFIDENCE, n_trials, pfa)
    return (1 - APPROXIMATION) * low / n_trials, (1 + APPROXIMATION) * high / n_trials


def border_rates(detector: Detector, looks: int, seed: int = 0) -> dict[str, tuple[float, float, float]]:
    """Measure false-alarm rates at the borders of maps, where a mean over the whole map hides them.

    Returns
    -------
    dict of str to (float, float, float)
        By the part of the border, of `BORDERS`: the rate and its limits.

    Raises
    ------
    NotApplicableError
        If the detector's `pfa` is too low to be measured on these maps.
    """
    noise = white_noise_map(BORDER_MAPS, seed, looks)
    pfa: float = getattr(detector, "pfa")  # noqa: B009, no part of the protocol
    _rate_limits(pfa, noise[BORDERS["corners"]].size)
    masks = np.stack([TestedMap(detector, power, looks).found.mask for power in noise])
    parts = {name: masks[where] for name, where in BORDERS.items()}
    return {name: (float(part.mean()), *_rate_limits(pfa, part.size)) for name, part in parts.items()}


def _keeps_its_rate(tested: TestedMap) -> float:
    if getattr(tested.detector, "threshold", "exact") != "exact":
        raise NotApplicableError("its threshold is not meant to keep the rate")
    require_rate(tested.detector, tested.looks)
    return 0.0


def _refused(tested: TestedMap) -> float:
    try:
        tested.detect(tested.power)
    except InputError:
        return 0.0
    raise BrokenPromiseError(f"a map of {tested.power.shape} cells is smaller than the window, and tested")


MAP_SHAPES = Promise("shapes", 0.0, _has_shapes)
MAP_POWERS = Promise("threshold and noise", 0.0, _has_possible_powers)
MASK = Promise("mask", 0.0, _compares_with_its_threshold)
MAP_FINITE = Promise("finite", 0.0, _finite)
MAP_REPEAT = Promise("repeat", 0.0, _repeats)
LISTED = Promise("listed cells", EXACT, _listed, "cells says where to test, and changes no test")
MAP_LAYOUT = Promise("memory order", EXACT, _layout)
MAP_TWO_POWER_SCALE = Promise(
    "scale by powers of two",
    0.0,
    _two_power_scale,
    "thresholds follow from the noise of the map, without constants in the map's unit",
)
MAP_ANY_SCALE = Promise("scale", 1e-10, _any_scale)
NOTHING = Promise("nothing detected", 0.0, _nothing)
MAP_SINGLE_PRECISION = Promise("single precision", 2.0**-23, _single_precision)
RATE_ORDER = Promise("order of rates", 0.0, _rate_order)
FALSE_ALARM_RATE = Promise("false-alarm rate", 0.0, _keeps_its_rate)
REFUSED = Promise("refused", 0.0, _refused)

EVERY_MAP = MAP_FINITE, MAP_REPEAT, LISTED, MAP_LAYOUT
"""Promises of every map."""

MAP_INVARIANT = MAP_TWO_POWER_SCALE, MAP_ANY_SCALE
"""Promises of maps without ties."""
