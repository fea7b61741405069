"""Checks of detections: what every tested map must be, its rate of false alarms, what must change nothing."""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from isacbench.checking.checks import Check, CheckFailedError, NotApplicableError
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
class MapSubject:
    """A detector and the power map that it tests."""

    detector: Detector
    power: NDArray[np.float64]
    looks: int = 1

    @property
    def plugin_module(self) -> str:
        """Module of the detector's class."""
        return type(self.detector).__module__

    @cached_property
    def found(self) -> Detection:
        """Detection of the map."""
        return self.detect(self.power.copy())

    def detect(self, power: Power) -> Detection:
        """Test another map, given to the detector as it lies in memory; fail if it returns no detection."""
        found = self.detector.detect(power, self.looks)
        if not isinstance(found, Detection):
            raise CheckFailedError(f"detect() must return a Detection, not {type(found).__name__}")
        return found

    def difference(self, other: Detection, *, has_ties: bool = False) -> float:
        """Largest relative difference of noise and thresholds of another detection of the same map.

        Fails if a cell is detected in only one of the two; ties are cells whose power rounding may take for
        less or for more than their threshold.
        """
        differs = other.mask != self.found.mask
        if has_ties:
            differs &= np.abs(self.power - self.found.threshold) > TIE * self.found.threshold
        if differs.any():
            raise CheckFailedError(f"{differs.sum()} of {differs.size} cells are decided otherwise")
        return max(_relative(self.found.noise, other.noise), _relative(self.found.threshold, other.threshold))


def white_noise_map(shape: tuple[int, ...], seed: int, looks: int = 1) -> NDArray[np.float64]:
    """Power of white noise of mean 1, averaged over looks."""
    return np.random.default_rng([seed, looks]).standard_gamma(looks, shape) / looks


def _relative(one: NDArray[Any], two: NDArray[Any]) -> float:
    """Largest relative difference."""
    apart = np.abs(one - two)
    return float(np.max(np.divide(apart, one, out=apart.copy(), where=one > 0), initial=0.0))


def _has_shapes(subject: MapSubject) -> float:
    shape = subject.power.shape
    for name, dtype in (("mask", np.bool_), ("threshold", np.float64), ("noise", np.float64)):
        array = getattr(subject.found, name)
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
            given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise CheckFailedError(
                f"{name} is {given}, not {np.dtype(dtype)} {shape}: an array of the map's shape is needed"
            )
    return 0.0


def _has_possible_powers(subject: MapSubject) -> float:
    for name in ("threshold", "noise"):
        array = getattr(subject.found, name)
        if not np.isfinite(array).all() or (array < 0).any():
            raise CheckFailedError(
                f"{name} has NaN, infinite or negative values: both are powers, in the map's unit"
            )
    return 0.0


def _compares_with_its_threshold(subject: MapSubject) -> float:
    differing = int(np.sum(subject.found.mask != (subject.power > subject.found.threshold)))
    if differing:
        raise CheckFailedError(
            f"mask is not power > threshold in {differing} of {subject.power.size} cells: a cell is detected "
            "where its power exceeds its threshold, nowhere else"
        )
    return 0.0


def _finite(subject: MapSubject) -> float:
    return max(
        measure(subject) for measure in (_has_shapes, _has_possible_powers, _compares_with_its_threshold)
    )


def _repeats(subject: MapSubject) -> float:
    return subject.difference(subject.detect(subject.power.copy()))


def _listed(subject: MapSubject) -> float:
    """Difference if all cells are listed from the last to the first, and if one is listed alone."""
    if "cells" not in inspect.signature(subject.detector.detect).parameters:
        raise NotApplicableError("takes whole maps only")
    differences = []
    n_cells = subject.power.size
    for order in (np.arange(n_cells)[::-1], np.array([n_cells // 2])):
        cells = np.unravel_index(order, subject.power.shape)
        listed = detect_listed(subject.detector, subject.power.copy(), subject.looks, cells)
        for name in ("mask", "threshold", "noise"):
            part, whole = getattr(listed, name), getattr(subject.found, name)[cells]
            if part.shape != whole.shape:
                raise CheckFailedError(f"{name} of {order.size} listed cells has shape {part.shape}")
            differences.append(_relative(whole.astype(np.float64), part.astype(np.float64)))
    return max(differences)


def _layout(subject: MapSubject) -> float:
    """Difference for maps in Fortran order, with gaps, backwards, in the other byte order, and read-only."""
    power = subject.power
    read_only = power.copy()
    read_only.flags.writeable = False
    return max(
        subject.difference(subject.detect(laid))
        for laid in (
            np.asfortranarray(power),
            np.repeat(power, 2, axis=-1)[..., ::2],
            power[::-1].copy()[::-1],
            power.astype(power.dtype.newbyteorder()),
            read_only,
        )
    )


def _scaled(subject: MapSubject, factor: float, *, has_ties: bool = False) -> float:
    found = subject.detect(subject.power * factor)
    scaled = Detection(found.mask, found.threshold / factor, found.noise / factor)
    return subject.difference(scaled, has_ties=has_ties)


def _nothing(subject: MapSubject) -> float:
    n_detected = int(np.count_nonzero(subject.found.mask))
    if n_detected:
        raise CheckFailedError(
            f"detects {n_detected} of {subject.power.size} cells: a detected cell exceeds its threshold, "
            "strictly"
        )
    return 0.0


def _single_precision(subject: MapSubject) -> float:
    """Difference of noise and thresholds only: cells near their threshold may be decided differently."""
    if max(np.abs(np.log2(subject.power[subject.power > 0])), default=0.0) > -np.finfo(np.float32).minexp:
        raise NotApplicableError("float32 does not hold it in full")
    found = subject.detect(subject.power.astype(np.float32))
    return max(
        _relative(subject.found.noise, found.noise), _relative(subject.found.threshold, found.threshold)
    )


def _rate_order(subject: MapSubject) -> float:
    """Largest relative fall of a threshold when the rate is halved; thresholds must not fall."""
    detector: Any = subject.detector
    strict = MapSubject(dataclasses.replace(detector, pfa=detector.pfa / 2), subject.power, subject.looks)
    _finite(strict)
    if np.any(strict.found.mask & ~subject.found.mask):
        raise CheckFailedError("a cell is detected at half the rate that is not at the whole one")
    if not np.any(strict.found.threshold > subject.found.threshold):
        raise CheckFailedError("no threshold rises at half the rate")
    between = MapSubject(detector, subject.power.copy(), subject.looks)
    middle = tuple(n // 2 for n in subject.power.shape)
    between.power[middle] = (subject.found.threshold[middle] + strict.found.threshold[middle]) / 2
    for one in (between, dataclasses.replace(between, detector=strict.detector)):
        _compares_with_its_threshold(one)
    fallen = np.maximum(subject.found.threshold - strict.found.threshold, 0.0)
    return _relative(subject.found.threshold, subject.found.threshold - fallen)


def require_rate(
    detector: Detector, looks: int, shape: tuple[int, ...] = STRIP, seed: int = 0, margin: int = 0
) -> float:
    """Measure the false-alarm rate of a detector in white noise.

    The map's border, of `margin` cells, does not count. Says nothing where the detector's `pfa` is too rare.
    """
    pfa: float = getattr(detector, "pfa")  # noqa: B009, no part of the protocol
    found = MapSubject(detector, white_noise_map(shape, seed, looks), looks).found
    mask = found.mask[tuple(slice(margin, length - margin) for length in shape)]
    low, high = _rate_limits(pfa, mask.size)
    rate = float(mask.mean())
    if not low <= rate <= high:
        raise CheckFailedError(
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

    By the part of the border, of `BORDERS`: the rate and its limits. Says nothing where the detector's `pfa`
    is too rare.
    """
    noise = white_noise_map(BORDER_MAPS, seed, looks)
    pfa: float = getattr(detector, "pfa")  # noqa: B009, no part of the protocol
    _rate_limits(pfa, noise[BORDERS["corners"]].size)
    masks = np.stack([MapSubject(detector, power, looks).found.mask for power in noise])
    parts = {name: masks[where] for name, where in BORDERS.items()}
    return {name: (float(part.mean()), *_rate_limits(pfa, part.size)) for name, part in parts.items()}


def _keeps_its_rate(subject: MapSubject) -> float:
    if getattr(subject.detector, "threshold", "exact") != "exact":
        raise NotApplicableError("its threshold is not meant to keep the rate")
    require_rate(subject.detector, subject.looks)
    return 0.0


def _refused(subject: MapSubject) -> float:
    try:
        subject.detect(subject.power)
    except InputError:
        return 0.0
    raise CheckFailedError(f"a map of {subject.power.shape} cells is smaller than the window, and tested")


MAP_SHAPES = Check("shapes", _has_shapes)
MAP_POWERS = Check("threshold and noise", _has_possible_powers)
MASK = Check("mask", _compares_with_its_threshold)
MAP_FINITE = Check("finite", _finite)
MAP_REPEAT = Check("repeat", _repeats)
LISTED = Check("listed cells", _listed, EXACT, "cells says where to test, and changes no test")
MAP_LAYOUT = Check("memory order", _layout, EXACT)
MAP_TWO_POWER_SCALE = Check[MapSubject](
    "scale by powers of two",
    lambda subject: max(_scaled(subject, 2.0**exponent) for exponent in SCALES),
    hint="thresholds follow from the noise of the map, without constants in the map's unit",
)
MAP_ANY_SCALE = Check[MapSubject]("scale", lambda subject: _scaled(subject, ODD, has_ties=True), 1e-10)
NOTHING = Check("nothing detected", _nothing)
MAP_SINGLE_PRECISION = Check("single precision", _single_precision, 2.0**-23)
RATE_ORDER = Check("order of rates", _rate_order)
FALSE_ALARM_RATE = Check("false-alarm rate", _keeps_its_rate)
REFUSED = Check("refused", _refused)

EVERY_MAP = MAP_FINITE, MAP_REPEAT, LISTED, MAP_LAYOUT
"""Checks of every map."""

MAP_INVARIANT = MAP_TWO_POWER_SCALE, MAP_ANY_SCALE
"""Checks of maps without ties."""
