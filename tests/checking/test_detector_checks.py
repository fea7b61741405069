"""Each check of a detector fails one that breaks it, and no other check does; see those of an estimator."""

import pytest

from isacbench.checking import checks
from isacbench.checking.checks import Finding
from isacbench.checking.map_checks import BORDERS
from tests.checking.changed_plugins import failed, findings_of_changed, indented
from tests.documents.sources import recipe

RETURN = "        return Detection(mask, threshold, noise)\n"
SOUND = recipe('"median"').replace('"median"', '"broken"') + "\nLAST = []\n"
SOUND = SOUND.replace(
    RETURN.replace("mask", "power > threshold"), f"        mask = power > threshold\n{RETURN}"
)
SIGNATURE = "looks: int = 1) -> Detection:\n"


def put(line):
    """Put statements before the result."""
    return RETURN, indented(line) + RETURN


def scaled(factor):
    """Scale the threshold."""
    return put(f"threshold = {factor} * threshold; mask = power > threshold")


REMEMBERS = """total = power.sum()
noise = noise + (0.0 if LAST[-1:] in ([], [total]) else 0.01)
LAST.append(total)"""
COMPARE = "mask = power > threshold"
IN_ROWS = "factor = np.ones(power.shape); factor[:2] = 0.2; threshold = factor * threshold"
CHOOSES = "looks=1, cells=None):\n        power = power if cells is None else power[cells]\n"

BROKEN = [
    ("pfa", ("pfa: float = 1e-3", "pfa: ClassVar = None\n    rate: float = 1e-3"), "give it a field pfa"),
    ("arguments", (f", {SIGNATURE}", "):\n"), "arguments): define detect(self, power, looks=1)"),
    ("arguments", (SIGNATURE, "looks):\n"), "missing a required argument: 'looks'"),
    ("arguments", (SIGNATURE, "n=1):\n"), "unexpected keyword argument 'looks'"),
    ("detection", (RETURN, "        return mask\n"), "must return a Detection, not ndarray"),
    ("detection", put("raise KeyError('gone')"), "raises KeyError: 'gone' (broken.py, line "),
    ("shapes", put("mask = mask.astype(int)"), "mask is int64 (40, 24), not bool (40, 24)"),
    ("shapes", put("noise = noise.ravel()"), "noise is float64 (960,), not float64 (40, 24)"),
    ("mask", put("mask[tuple(n // 3 for n in mask.shape)] |= power.max() > 0"), "in 1 of 960 cells"),
    ("threshold and noise", put("noise = -noise"), "noise has NaN, infinite or negative values"),
    (
        "map unchanged",
        ("        power = ", "        power *= 2; power /= 2\n        power = "),
        "writes to the map (",
    ),
    ("repeatable", put("noise = noise + np.random.default_rng().random()"), "another result the second time"),
    ("no memory", put(REMEMBERS), "other input in between changes the result"),
    ("scale", put(f"threshold = threshold + 1e-9; {COMPARE}"), "without constants in the map's"),
    ("looks", ("gammainccinv(looks, self.pfa) / looks", "-np.log(self.pfa)"), "does not depend on looks"),
    ("looks", ("looks: int = 1", "looks: int = 2"), "looks=1 is not the default"),
    ("1-D map", put("rows, columns = power.shape"), "raises ValueError: not enough values to unpack"),
    ("small maps", put("power.ravel()[6]"), "raises IndexError"),
    ("silence", put("mask = power >= threshold"), "a detected cell exceeds its threshold, strictly"),
    ("silence", put("power / threshold"), "warns RuntimeWarning: invalid value"),
    ("bad maps", ("checked_power(power, looks)", "np.abs(np.nan_to_num(power))"), "a map with complex cells"),
    ("false-alarm rate", scaled(0.9), "of white noise are detected"),
    ("false-alarm rate", scaled(1.1), "of white noise are detected"),
    ("rate at borders", put(f"{IN_ROWS}\n{COMPARE}"), " in the first rows, "),
    ("listed cells", (SIGNATURE, CHOOSES), "cells says where to test, and changes no test"),
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
    broken = {name for name, *_ in BROKEN}
    alike = {one.name for one in (*checks.CLASS_CHECKS, *checks.conduct_checks("shapes", "map"))}
    assert broken | alike | {"time"} == set(check())


def windowed(mode, threshold="noise * factor", around="power", part=""):
    """Average 72 cells around each, behind a border that is made up or left out."""
    return put(
        f"""from scipy.ndimage import convolve
from isacbench.dsp.cfar.factors import ca_factor
if power.ndim == 2 and min(power.shape) > 9:
    window = np.ones((9, 9)); window[3:6, 3:6] = 0
    noise = convolve({around}, window / 72, mode={mode!r}){part}
    factor = ca_factor(self.pfa, 72, looks)
    threshold = {threshold}
    mask = power > threshold"""
    )


def borders_of(change):
    findings = check(*change)
    assert findings["false-alarm rate"].status == "ok"  # the mean over the map hides them
    return findings["rate at borders"]


def test_a_window_that_wraps_around_passes_at_the_borders():
    assert borders_of(windowed("wrap")).status == "ok"


MEDIAN = "np.pad(power, 9, constant_values=np.median(power))"
ABOVE = "np.concatenate([power[-9:], power, np.zeros((9, power.shape[1]))])"
ROW = "noise * factor * np.where(np.arange(power.shape[0]) == 3, 0.5, 1)[:, None]"
COLUMN = "noise * factor * np.where(np.arange(power.shape[1]) == 2, 0.5, 1)"


@pytest.mark.parametrize(
    ("change", "parts", "other_words"),
    [
        (windowed("constant"), BORDERS, []),  # zeros beyond the border
        (windowed("wrap", ROW), ["next rows"], []),
        (windowed("wrap", COLUMN), ["next columns"], []),
        (windowed("wrap", around=MEDIAN, part="[9:-9, 9:-9]"), ["corners"], []),
        (windowed("wrap", around=ABOVE, part="[9:-9]"), ["last rows"], ["column", "first"]),
    ],
)
def test_another_rate_at_a_border_fails_its_check_by_the_name_of_the_border(change, parts, other_words):
    finding = borders_of(change)
    assert finding.status == "failed"
    assert all(f" in the {part}" in finding.message for part in parts)
    assert not any(word in finding.message for word in other_words)
    assert "pad maps with nothing" in finding.message


def test_cells_of_the_border_that_are_never_tested_are_warned_of():
    untested = "np.pad((noise * factor)[4:-4], ((4, 4), (0, 0)), constant_values=1e300)"
    findings = check(*windowed("wrap", untested))
    assert not failed(findings) - {"scale"}
    assert findings["rate at borders"].status == "warning"
    assert findings["rate at borders"].message.startswith(
        "detects nothing in the first rows, last rows, corners of maps: echoes there are lost"
    )


def test_a_window_larger_than_the_maps_with_borders_is_no_failure():
    refusal = "from isacbench.errors import InputError\nif power.shape == (32, 32): raise InputError('small')"
    findings = check(*put(refusal))
    assert findings["rate at borders"] == Finding("rate at borders", "ok", "refused in words: small")


def test_a_detector_that_refuses_small_maps_in_words_passes():
    refusal = put("from isacbench.errors import InputError\nif power.size < 9: raise InputError('too small')")
    findings = check(*refusal)
    assert not failed(findings)
    assert findings["small maps"].message == "refused in words: too small"


def test_a_rate_that_cannot_be_chosen_is_measured_where_it_is_not_too_rare():
    findings = check("pfa: float = 1e-3", "pfa: ClassVar[float] = 1e-9")
    for name in ("false-alarm rate", "rate at borders"):
        assert findings[name].message == "too rare to measure at pfa = 1e-09"
