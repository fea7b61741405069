"""Checks of detectors: of maps anywhere, and the contract, which asks for more on a few of them."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from isacbench.checking import checks
from isacbench.checking.checks import ODD, Check, CheckFailedError, NotApplicableError, require
from isacbench.dsp.detection import detect_listed
from isacbench.errors import InputError
from isacbench.plugins.contracts import Detection, Detector

EXACT = 1e-12
"""Largest drift that another order of summation may cause."""

TIE = 1e-10
"""Relative distance of power and threshold within which rounding may decide."""

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


@dataclass(frozen=True, eq=False)
class MapSubject(checks.Subject):
    """A detector and the power map that it tests."""

    power: NDArray[np.float64]
    looks: int = 1

    @cached_property
    def detection(self) -> Detection:
        """Detection of the map."""
        return self.detect(self.power.copy())

    def detect(self, power: NDArray[np.floating[Any]]) -> Detection:
        """Test another map, given to the detector as it lies in memory; fail if it returns no detection."""
        found = self.plugin.detect(power, self.looks)
        is_detection = isinstance(found, Detection)
        require(is_detection, f"detect() must return a Detection, not {type(found).__name__}")
        return found

    def difference(self, other: Detection, *, has_ties: bool = False) -> float:
        """Largest relative difference of noise and thresholds of another detection of the same map.

        Fails if a cell is detected in only one of the two; ties are cells whose power rounding may take for
        less or for more than their threshold.
        """
        differs = other.mask != self.detection.mask
        if has_ties:
            differs &= np.abs(self.power - self.detection.threshold) > TIE * self.detection.threshold
        require(not differs.any(), f"{differs.sum()} of {differs.size} cells are decided otherwise")
        return _apart(self.detection, other)


def white_noise_map(shape: tuple[int, ...], seed: int, looks: int = 1) -> NDArray[np.float64]:
    """Power of white noise of mean 1, averaged over looks."""
    return np.random.default_rng([seed, looks]).standard_gamma(looks, shape) / looks


def _relative(one: NDArray[Any], two: NDArray[Any]) -> float:
    """Largest relative difference."""
    apart = np.abs(one - two)
    return float(np.max(np.divide(apart, one, out=apart.copy(), where=one > 0), initial=0.0))


def _apart(one: Detection, two: Detection) -> float:
    return max(_relative(one.noise, two.noise), _relative(one.threshold, two.threshold))


def _has_shapes(subject: MapSubject) -> None:
    shape = subject.power.shape
    for name, dtype in (("mask", np.bool_), ("threshold", np.float64), ("noise", np.float64)):
        array = getattr(subject.detection, name)
        if not isinstance(array, np.ndarray) or array.shape != shape or array.dtype != dtype:
            given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise CheckFailedError(
                f"{name} is {given}, not {np.dtype(dtype)} {shape}: an array of the map's shape is needed"
            )


def _has_possible_powers(subject: MapSubject) -> None:
    for name in ("threshold", "noise"):
        array = getattr(subject.detection, name)
        require(
            np.isfinite(array).all() and not (array < 0).any(),
            f"{name} has NaN, infinite or negative values: both are powers, in the map's unit",
        )


def _compares_with_its_threshold(subject: MapSubject) -> None:
    differing = int(np.sum(subject.detection.mask != (subject.power > subject.detection.threshold)))
    require(
        not differing,
        f"mask is not power > threshold in {differing} of {subject.power.size} cells: a cell is detected "
        "where its power exceeds its threshold, nowhere else",
    )


def _finite(subject: MapSubject) -> None:
    for measure in (_has_shapes, _has_possible_powers, _compares_with_its_threshold):
        measure(subject)


def _cell_list(subject: MapSubject) -> float:
    """Difference if all cells are listed from the last to the first, and if one is listed alone."""
    if "cells" not in inspect.signature(subject.plugin.detect).parameters:
        raise NotApplicableError("takes whole maps only")
    differences = []
    n_cells = subject.power.size
    for order in (np.arange(n_cells)[::-1], np.array([n_cells // 2])):
        cells = np.unravel_index(order, subject.power.shape)
        listed = detect_listed(subject.plugin, subject.power.copy(), subject.looks, cells)
        for name in ("mask", "threshold", "noise"):
            part, whole = getattr(listed, name), getattr(subject.detection, name)[cells]
            require(part.shape == whole.shape, f"{name} of {order.size} listed cells has shape {part.shape}")
            differences.append(_relative(whole.astype(np.float64), part.astype(np.float64)))
    return max(differences)


def _layout(subject: MapSubject) -> float:
    """Difference for maps in Fortran order, with gaps, backwards, in the other byte order, and read-only."""
    power, read_only = subject.power, subject.power.copy()
    read_only.flags.writeable = False
    layouts = [
        *(np.asfortranarray(power), np.repeat(power, 2, axis=-1)[..., ::2], power[::-1].copy()[::-1]),
        *(power.astype(power.dtype.newbyteorder()), read_only),
    ]
    return max(subject.difference(subject.detect(laid)) for laid in layouts)


def _scaled(subject: MapSubject, factor: float, *, has_ties: bool = False) -> float:
    found = subject.detect(subject.power * factor)
    scaled = Detection(found.mask, found.threshold / factor, found.noise / factor)
    return subject.difference(scaled, has_ties=has_ties)


def _nothing(subject: MapSubject) -> None:
    n_detected = int(np.count_nonzero(subject.detection.mask))
    require(
        not n_detected,
        f"detects {n_detected} of {subject.power.size} cells: a detected cell exceeds its threshold, "
        "strictly",
    )


def _single_precision(subject: MapSubject) -> float:
    """Difference of noise and thresholds only: cells near their threshold may be decided differently."""
    if max(np.abs(np.log2(subject.power[subject.power > 0])), default=0.0) > -np.finfo(np.float32).minexp:
        raise NotApplicableError("float32 does not hold it in full")
    return _apart(subject.detection, subject.detect(subject.power.astype(np.float32)))


def _rate_order(subject: MapSubject) -> float:
    """Largest relative fall of a threshold when the rate is halved; thresholds must not fall."""
    rarer = dataclasses.replace(subject.plugin, pfa=subject.plugin.pfa / 2)
    strict = dataclasses.replace(subject, plugin=rarer)
    _finite(strict)
    is_new = strict.detection.mask & ~subject.detection.mask
    require(not is_new.any(), "a cell is detected at half the rate that is not at the whole one")
    has_risen = strict.detection.threshold > subject.detection.threshold
    require(has_risen.any(), "no threshold rises at half the rate")
    between = dataclasses.replace(subject, power=subject.power.copy())
    middle = tuple(n // 2 for n in subject.power.shape)
    between.power[middle] = (subject.detection.threshold[middle] + strict.detection.threshold[middle]) / 2
    for one in (between, dataclasses.replace(between, plugin=strict.plugin)):
        _compares_with_its_threshold(one)
    fallen = np.maximum(subject.detection.threshold - strict.detection.threshold, 0.0)
    return _relative(subject.detection.threshold, subject.detection.threshold - fallen)


def require_rate(
    detector: Detector, looks: int, shape: tuple[int, ...] = STRIP, seed: int = 0, margin: int = 0
) -> float:
    """Measure the false-alarm rate of a detector in white noise.

    The map's border, of `margin` cells, does not count. Says nothing where the detector's `pfa` is too rare.
    """
    pfa: float = getattr(detector, "pfa")  # noqa: B009, no part of the protocol
    mask = MapSubject(detector, white_noise_map(shape, seed, looks), looks).detection.mask
    mask = mask[tuple(slice(margin, length - margin) for length in shape)]
    low, high = _rate_limits(pfa, mask.size)
    rate = float(mask.mean())
    require(
        low <= rate <= high,
        f"at pfa = {pfa:g} and {looks} looks, {rate:.3g} of the cells of white noise are detected, not "
        f"{low:.3g} to {high:.3g}: derive the factor from the distribution of the noise estimate "
        "(isacbench.dsp.cfar.factors)",
    )
    return rate


def _rate_limits(pfa: float, n_cells: int) -> tuple[float, float]:
    """Limits of the measured rate of a detector that keeps it; refuse rates too rare to measure."""
    n_trials = n_cells // DEPENDENCE
    if pfa * n_trials < RAREST:
        raise NotApplicableError(f"too rare to measure at pfa = {pfa:g}")
    low, high = binom.interval(1 - CONFIDENCE, n_trials, pfa)
    return (1 - APPROXIMATION) * low / n_trials, (1 + APPROXIMATION) * high / n_trials


def _keeps_an_exact_rate(subject: MapSubject) -> None:
    if getattr(subject.plugin, "threshold", "exact") != "exact":
        raise NotApplicableError("its threshold is not meant to keep the rate")
    require_rate(subject.plugin, subject.looks)


def _refused(subject: MapSubject) -> None:
    try:
        subject.detect(subject.power)
    except InputError:
        return
    raise CheckFailedError(f"a map of {subject.power.shape} cells is smaller than the window, and tested")


MAP_SHAPES = Check("shapes", _has_shapes)
MAP_POWERS = Check("threshold and noise", _has_possible_powers)
MASK = Check("mask", _compares_with_its_threshold)
MAP_FINITE = Check("finite", _finite)
MAP_REPEAT = Check("repeat", lambda subject: subject.difference(subject.detect(subject.power.copy())))
LISTED = Check("listed cells", _cell_list, EXACT, "cells says where to test, and changes no test")
MAP_LAYOUT = Check("memory order", _layout, EXACT)
MAP_TWO_POWER_SCALE = Check(
    "scale by powers of two",
    lambda subject: max(_scaled(subject, 2.0**exponent) for exponent in SCALES),
    hint="thresholds follow from the noise of the map, without constants in the map's unit",
)
MAP_ANY_SCALE = Check("scale", lambda subject: _scaled(subject, ODD, has_ties=True), 1e-10)
NOTHING = Check("nothing detected", _nothing)
MAP_SINGLE_PRECISION = Check("single precision", _single_precision, 2.0**-23)
RATE_ORDER = Check("order of rates", _rate_order)
FALSE_ALARM_RATE = Check("false-alarm rate", _keeps_an_exact_rate)
REFUSED = Check("refused", _refused)

EVERY_MAP = MAP_FINITE, MAP_REPEAT, LISTED, MAP_LAYOUT
"""Checks of every map."""

MAP_INVARIANT = MAP_TWO_POWER_SCALE, MAP_ANY_SCALE
"""Checks of maps without ties."""


# The contract.


@cache
def _noise_with_echoes(stream: int) -> NDArray[np.float64]:
    """Map of noise with three echoes, read-only."""
    power = white_noise_map(SHAPE, SEED + stream)
    power[5, 7], power[20, 12], power[39, 0] = 300.0, 1000.0, 100.0
    power.setflags(write=False)
    return power


class DetectorSubject(checks.PluginSubject):
    """A detector under check."""

    @cached_property
    def ordinary(self) -> MapSubject:
        """Noise with three echoes, tested by the detector."""
        return MapSubject(self.plugin, _noise_with_echoes(0))

    def answer(self, plugin: Any = None, *, other: bool = False) -> list[NDArray[Any]]:
        """Test a map of noise with three echoes: mask, threshold and noise."""
        power = 10 * _noise_with_echoes(1) if other else _noise_with_echoes(0).copy()
        found = MapSubject(plugin or self.plugin, power).detection
        return [found.mask, found.threshold, found.noise]

    def prepare_call(self, *, writable: bool) -> tuple[Callable[[], object], str]:
        """Prepare to test a large map."""
        power = white_noise_map(LARGE, SEED)
        power.setflags(write=writable)
        return partial(self.plugin.detect, power), f"{LARGE[0]} x {LARGE[1]} cells"


def _has_a_rate(subject: DetectorSubject) -> None:
    pfa = getattr(subject.plugin, "pfa", None)
    require(
        isinstance(pfa, (float, np.floating)) and 0 < pfa < 1,
        f"pfa is {pfa!r}: give it a field pfa, the probability of false alarm per cell, between 0 and 1",
    )


def _returns_a_detection(subject: DetectorSubject) -> str:
    mask = subject.ordinary.detection.mask
    return f"{np.count_nonzero(mask)} of {np.size(mask)} cells of a map with 3 echoes"


def _takes_looks(subject: DetectorSubject) -> None:
    power = _noise_with_echoes(0)
    unsaid, one = (subject.plugin.detect(power.copy(), *looks) for looks in ((), (1,)))
    require(np.array_equal(unsaid.threshold, one.threshold), "looks=1 is not the default: let it be")
    many = subject.plugin.detect(power.copy(), looks=max(LOOKS))
    # Compare threshold / noise of both, multiplied out because the noise may be 0.
    require(
        not np.allclose(many.threshold * one.noise, one.threshold * many.noise, rtol=SAME_FACTOR, atol=0),
        "the factor between noise and threshold does not depend on looks: noise averaged over more looks "
        "strays less, gamma-distributed with that shape",
    )


def _takes_maps(*maps: NDArray[np.float64]) -> Callable[[DetectorSubject], str]:
    """Make a measurement that takes unusual maps; the detector may refuse them with an `InputError`."""

    def measure(subject: DetectorSubject) -> str:
        refused = ""
        for power in maps:
            try:
                _has_shapes(MapSubject(subject.plugin, power))
            except InputError as error:
                refused = f"refused in words: {error}"
        return refused

    return measure


def _takes_silence(subject: DetectorSubject) -> None:
    with checks.warnings_fail(": expect a map without any power"):
        _nothing(MapSubject(subject.plugin, np.zeros(SHAPE)))


def _refuses_bad_maps(subject: DetectorSubject) -> None:
    for what, cell in (("complex", 1j), ("NaN", np.nan), ("negative", -1.0)):
        power = _noise_with_echoes(0).astype(np.result_type(cell))
        power[3, 4] = cell
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
    rates = [require_rate(detector, looks, LARGE, SEED, margin=LARGE[0] // 16) for looks in LOOKS]
    measured = ", ".join(f"{rate:.4f} at {looks} looks" for rate, looks in zip(rates, LOOKS, strict=True))
    return f"{detector.pfa:g} nominal, {measured}"


def _keeps_its_rate_at_borders(subject: DetectorSubject) -> str:
    """Measure at borders, where a mean over the whole map hides it; at a rate of 0, no cell is tested."""
    try:
        detector = _at_rate(subject.plugin, BORDER_RATE)
        measured = {looks: _border_rates(detector, looks) for looks in LOOKS}
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
            raise checks.DoubtfulError(
                f"detects nothing in the {', '.join(untested)} of maps: echoes there are lost; let the "
                "window shift inwards (isacbench.dsp.cfar.windows_of)"
            )
    every = [rate for rates in measured.values() for rate, *_ in rates.values()]
    return f"{detector.pfa:g} nominal, {min(every):.3f} to {max(every):.3f} in rows, columns and corners"


def _border_rates(detector: Any, looks: int) -> dict[str, tuple[float, float, float]]:
    """Rate of false alarms and its limits, by the part of the border."""
    noise = white_noise_map(BORDER_MAPS, SEED, looks)
    _rate_limits(detector.pfa, noise[BORDERS["corners"]].size)
    masks = np.stack([MapSubject(detector, power, looks).detection.mask for power in noise])
    parts = {name: masks[where] for name, where in BORDERS.items()}
    return {
        name: (float(part.mean()), *_rate_limits(detector.pfa, part.size)) for name, part in parts.items()
    }


def _at_rate(detector: Any, pfa: float) -> Any:
    """Give a detector another rate, if it has a field for it."""
    has_field = any(field.name == "pfa" for field in dataclasses.fields(detector))
    return dataclasses.replace(detector, pfa=pfa) if has_field else detector


def _ordinary(subject: DetectorSubject) -> tuple[MapSubject]:
    return (subject.ordinary,)


TESTED = "detection"
SHAPED = "shapes"
DETECTOR_CHECKS = (
    *checks.CLASS_CHECKS,
    Check("pfa", _has_a_rate, needs=(checks.BUILT,)),
    Check(TESTED, _returns_a_detection, needs=(checks.CALLABLE,)),
    MAP_SHAPES.of(_ordinary, TESTED),
    MASK.of(_ordinary, SHAPED),
    MAP_POWERS.of(_ordinary, SHAPED),
    *checks.conduct_checks(SHAPED, "map"),
    MAP_TWO_POWER_SCALE.of(_ordinary, "no memory", name="scale"),
    Check("looks", _takes_looks, needs=("no memory", "threshold and noise")),
    Check("1-D map", _takes_maps(_noise_with_echoes(0)[:, 7]), needs=(SHAPED,)),
    Check("small maps", _takes_maps(np.ones((1, 1)), _noise_with_echoes(0)[:2, :3]), needs=(SHAPED,)),
    Check("silence", _takes_silence, needs=(SHAPED,)),
    Check("bad maps", _refuses_bad_maps, needs=(TESTED,)),
    Check("false-alarm rate", _keeps_its_rate, needs=("pfa", SHAPED, "looks")),
    Check("rate at borders", _keeps_its_rate_at_borders, needs=("false-alarm rate",)),
    LISTED.of(_ordinary, SHAPED),
    Check("time", checks.is_fast, needs=(TESTED,)),
)
