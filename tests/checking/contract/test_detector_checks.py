"""Each check of a detector fails one that breaks it, and no other check does."""

import pytest

from tests.checking.contract.changed_plugins import failed, findings_of_changed, indented

SOUND = '''
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from isacbench.plugins.contracts import Detection
from isacbench.dsp.cfar import checked_power

LAST = []


@dataclass(frozen=True)
class Broken:
    """Breaks the contract: else the median of the map as its noise."""

    name: ClassVar[str] = "broken"
    pfa: float = 1e-3

    def detect(self, power, looks=1):
        given = power
        power = checked_power(power, looks)
        noise = np.full(power.shape, np.median(power) * looks / gammaincinv(looks, 0.5))
        threshold = noise * gammainccinv(looks, self.pfa) / looks
        mask = power > threshold
        return Detection(mask, threshold, noise)
'''

RETURN = "        return Detection(mask, threshold, noise)\n"


def put(line):
    """Put statements before the result."""
    return RETURN, indented(line) + RETURN


BROKEN = [
    (
        "frozen dataclass",
        ("@dataclass(frozen=True)", "@dataclass"),
        "decorate it with @dataclass(frozen=True)",
    ),
    ("name", ("name: ClassVar[str]", "name: str"), "annotate it as ClassVar[str]"),
    ("default parameters", ("pfa: float = 1e-3", "pfa: float"), "parameter pfa has no default"),
    ("parameter types", ("    def", "    n: int = 1.5\n    def"), "n = 1.5: should be a valid integer"),
    (
        "canonical parameters",
        ("    def", "    n: Any = frozenset()\n    def"),
        "broken: n = frozenset(): allowed are finite numbers",
    ),
    ("pfa", ("pfa: float = 1e-3", "pfa: ClassVar = None\n    rate: float = 1e-3"), "give it a field pfa"),
    ("detection", (RETURN, "        return mask\n"), "must return a Detection, not ndarray"),
    ("detection", put("raise KeyError('gone')"), "raises KeyError: 'gone' (broken.py, line "),
    ("shapes", put("mask = mask.astype(int)"), "mask is int64 (40, 24), not bool (40, 24)"),
    ("shapes", put("noise = noise.ravel()"), "noise is float64 (960,), not float64 (40, 24)"),
    ("mask", put("mask.flat[0] |= power.max() > 0"), "mask is not power > threshold in 1 of 960 cells"),
    ("threshold and noise", put("noise = -noise"), "noise has NaN, infinite or negative values"),
    ("map unchanged", put("given *= 2"), "writes to the map ("),
    (
        "repeatable",
        put("noise = noise + np.random.default_rng().random()"),
        "gives another result the second time",
    ),
    (
        "no memory",
        put(
            "total = power.sum()\n"
            "noise = noise + (0.0 if LAST[-1:] in ([], [total]) else 0.01)\n"
            "LAST.append(total)"
        ),
        "other input in between changes the result",
    ),
    (
        "pickling",
        ("    def", "    def __reduce__(self): raise TypeError('no luck')\n    def"),
        "cannot be pickled (TypeError: no luck)",
    ),
    ("random numbers", put("np.random.random()"), "numpy.random.default_rng(seed)"),
    ("stdout", put("print('testing')"), "prints 'testing\\n' to stdout"),
    (
        "scale",
        put("threshold = threshold + 1e-9; mask = power > threshold"),
        "without constants in the map's unit",
    ),
    (
        "looks",
        ("gammainccinv(looks, self.pfa) / looks", "-np.log(self.pfa)"),
        "does not depend on looks",
    ),
    ("looks", ("looks=1", "looks=2"), "looks=1 is not the default"),
    ("1-D map", put("rows, columns = power.shape"), "raises ValueError: not enough values to unpack"),
    ("small maps", put("power.ravel()[6]"), "raises IndexError"),
    ("silence", put("mask = power >= threshold"), "a detected cell exceeds its threshold, strictly"),
    ("silence", put("power / threshold"), "warns RuntimeWarning: invalid value"),
    (
        "bad maps",
        ("checked_power(power, looks)", "np.abs(np.nan_to_num(power))"),
        "accepts a map with complex cells",
    ),
    (
        "false-alarm rate",
        put("threshold = 0.9 * threshold; mask = power > threshold"),
        "of white noise are detected",
    ),
    (
        "false-alarm rate",
        put("threshold = 1.1 * threshold; mask = power > threshold"),
        "of white noise are detected",
    ),
    (
        "listed cells",
        ("looks=1):\n", "looks=1, cells=None):\n        power = power if cells is None else power[cells]\n"),
        "cells says where to test, and changes no test",
    ),
]


def check(old="", new=""):
    """Findings about the sound detector with a part of its source replaced."""
    source = SOUND.replace("self.pfa", "self.rate") if "rate: float" in new else SOUND
    return findings_of_changed("detector", source, old, new)


def test_a_sound_detector_passes_every_check():
    findings = check()
    assert {finding.status for finding in findings.values()} == {"ok"}
    assert findings["listed cells"].message == "takes whole maps only"


@pytest.mark.parametrize(("name", "change", "message"), BROKEN)
def test_a_broken_detector_fails_the_check_of_what_it_breaks_and_no_other(name, change, message):
    findings = check(*change)
    assert failed(findings) == {name}, findings
    assert message in findings[name].message


def test_every_check_has_a_detector_that_breaks_it():
    assert {name for name, *_ in BROKEN} | {"import", "time"} == set(check())


def test_a_detector_that_refuses_small_maps_in_words_passes():
    refusal = put("from isacbench.errors import InputError\nif power.size < 9: raise InputError('too small')")
    findings = check(*refusal)
    assert not failed(findings)
    assert findings["small maps"].message == "refused in words: too small"


def test_a_rate_that_cannot_be_chosen_is_measured_where_it_is_not_too_rare():
    findings = check("pfa: float = 1e-3", "pfa: ClassVar[float] = 1e-9")
    assert findings["false-alarm rate"].message == "too rare to measure at pfa = 1e-09"
