"""Each check of an estimator fails one that breaks it, and no other check does."""

import numpy as np
import pytest

from isacbench.bench.cells.radio_coordinates import radio_places, rayleigh_cells
from isacbench.checking.contract import class_checks, find_plugins
from isacbench.checking.contract.estimator_checks import MISS_CELLS
from isacbench.checking.promises import small_scenes
from tests.checking.contract.changed_plugins import failed, findings_of, findings_of_changed, indented

SOUND = '''
from dataclasses import dataclass
from typing import Any, ClassVar
import sys
import warnings

import numpy as np

from isacbench.plugins.contracts import Needs
from isacbench.model.cloud import PointCloud

LAST = []


def strongest(observation):
    """The strongest cell's beam."""
    power = np.mean(np.abs(observation.cells) ** 2, axis=(2, 3))
    row, column = np.unravel_index(np.where(observation.gate.reachable, power, 0).argmax(), power.shape)
    beams = np.fft.ifft2(observation.cells[row, column], (128, 128), norm="forward")
    i, j = np.unravel_index(np.abs(beams).argmax(), beams.shape)
    cosine = 2 * np.fft.fftfreq(128)
    return observation.cloud(
        [observation.gate.range_bins[row]],
        [observation.gate.doppler_bins[column]],
        [cosine[i]],
        [cosine[j]],
        [power[row, column] / observation.system.processing_gain],
    )


@dataclass(frozen=True)
class Broken:
    """Breaks the contract."""

    name: ClassVar[str] = "broken"
    n: int = 1

    def estimate(self, observation):
        pass
        cloud = strongest(observation)
        return cloud
'''

BEFORE = "        pass\n"
AFTER = "        return cloud\n"


def put(part, line):
    """Indent a statement of the method."""
    return part, indented(line) + (AFTER if part == AFTER else "")


def setting(attribute, value):
    """Overwrite an attribute of the cloud behind its constructor's back."""
    return put(AFTER, f"object.__setattr__(cloud, {attribute!r}, {value})")


def declaring(needs):
    """Declare needs beside the name."""
    return "    n: int = 1\n", f"    needs = {needs}\n    n: int = 1\n"


BROKEN = [
    ("needs", declaring("Needs('cross')"), "declare what it reads"),
    ("needs", declaring("Needs('none')"), "declare what it reads"),
    ("needs", declaring("'cross'"), "must be a Needs, not str"),
    (
        "frozen dataclass",
        ("@dataclass(frozen=True)", "@dataclass"),
        "decorate it with @dataclass(frozen=True)",
    ),
    ("name", ("name: ClassVar[str]", "name: str"), "annotate it as ClassVar[str]"),
    ("default parameters", ("n: int = 1", "n: int"), "parameter n has no default"),
    (
        "default parameters",
        ("n: int = 1", "n: int = 1\n    def __post_init__(self): 1 / 0"),
        "ZeroDivisionError",
    ),
    ("parameter types", ("n: int = 1", "n: int = None"), "n = None: should be a valid integer"),
    ("parameter types", ("n: int = 1", "n: 'Unheard' = 1"), "cannot be resolved"),
    (
        "canonical parameters",
        ("n: int = 1", "n: Any = frozenset()"),
        "broken: n = frozenset(): allowed are finite numbers",
    ),
    (
        "truth",
        (
            "def estimate(self, observation)",
            "needs_truth: ClassVar = True\n    def estimate(self, observation, truth)",
        ),
        "which only the built-in oracle and chance may see",
    ),
    (
        "image",
        put(BEFORE, "return [1, 2]"),
        "raises TypeError: estimate() must return a PointCloud, not list",
    ),
    ("image", put(BEFORE, "raise KeyError('gone')"), "raises KeyError: 'gone' (broken.py, line "),
    ("image", put(BEFORE, "sys.exit(0)"), "raises SystemExit: 0"),
    ("region", setting("xyz", "cloud.xyz + 100"), "outside the region"),
    ("velocity", setting("velocity", "cloud.velocity * 1000"), "give them in m/s"),
    ("power", setting("power", "cloud.power - 10"), "0 or more and no dB"),
    ("observation unchanged", put(BEFORE, "observation.cells[0] = 0"), "writes to the observation ("),
    (
        "observation unchanged",
        put(BEFORE, "observation.gate.range_bins[0] += 1\nobservation.gate.range_bins[0] -= 1"),
        "writes to the observation (",
    ),
    (
        "repeatable",
        setting("velocity", "cloud.velocity + 0.01 * np.random.default_rng().random()"),
        "a generator with a fixed seed",
    ),
    (
        "no memory",
        put(
            AFTER,
            "mean = observation.cells.mean()\n"
            "shift = 0.0 if LAST[-1:] in ([], [mean]) else 0.01\n"
            "LAST.append(mean)\n"
            "object.__setattr__(cloud, 'power', cloud.power + shift)",
        ),
        "keep nothing from one call to the next",
    ),
    (
        "pickling",
        ("n: int = 1", "n: int = 1\n    def __reduce__(self): raise TypeError('no luck')"),
        "cannot be pickled (TypeError: no luck)",
    ),
    (
        "pickling",
        ("n: int = 1", "n: int = 1\n    def __reduce__(self): return Broken, (7,)"),
        "has other parameters",
    ),
    (
        "pickling",
        (
            "n: int = 1",
            "n: int = 1\n    def __reduce__(self): LAST.append(1); return Broken, ()\n"
            "    def __post_init__(self): object.__setattr__(self, 'late', len(LAST))",
        ),
        "keep all that it needs in its parameters",
    ),
    (
        "random numbers",
        put(BEFORE, "np.random.seed(20310); np.random.random()"),
        "numpy.random.default_rng(seed)",
    ),
    ("random numbers", put(BEFORE, "import random; random.seed(1)"), "numpy.random.default_rng(seed)"),
    ("stdout", put(BEFORE, "print('looking')"), "prints 'looking\\n' to stdout"),
    (
        "minimal gate",
        put(
            BEFORE,
            "mask = observation.gate.reachable\nif mask.sum() == 1 < mask.size: raise IndexError(3)",
        ),
        "raises IndexError: 3",
    ),
    (
        "noise alone",
        put(
            AFTER,
            "n = int((np.abs(observation.cells[..., 0, 0]) > 0)[observation.gate.reachable].sum())\n"
            "middle = (observation.region.lower_m + observation.region.upper_m) / 2\n"
            "more = np.tile([*middle, 0.0, 1.0], (n, 1))\n"
            "return PointCloud.from_array(np.concatenate([cloud.to_array(), more]))",
        ),
        "a threshold that follows from the noise",
    ),
    (
        "silence",
        put(BEFORE, "np.sum(np.abs(observation.cells)) / np.abs(observation.cells).max()"),
        "RuntimeWarning",
    ),
    ("2 x 2 array", put(BEFORE, "observation.cells[:, :, 2]"), "raises IndexError"),
    (
        "other arrays",
        put(BEFORE, "observation.cells[..., 0] + observation.cells[..., 0, :]"),
        "raises ValueError: operands could not be broadcast",
    ),
]


def check(old="", new=""):
    """Findings about the sound estimator with a part of its source replaced."""
    source = SOUND
    # Where the memory of the class's twin matters, it does in the image.
    if "late" in new:
        source = source.replace(AFTER, setting("power", "cloud.power + 0.01 * self.late")[1])
    return findings_of_changed("estimator", source, old, new)


def test_a_sound_estimator_passes_every_check():
    assert {finding.status for finding in check().values()} == {"ok"}


@pytest.mark.parametrize(("name", "change", "message"), BROKEN)
def test_a_broken_estimator_fails_the_check_of_what_it_breaks_and_no_other(name, change, message):
    findings = check(*change)
    assert failed(findings) == {name}, findings
    assert message in findings[name].message


def test_every_check_has_an_estimator_that_breaks_it():
    elsewhere = {"import", "lone scatterer", "time"}
    assert {name for name, *_ in BROKEN} | elsewhere == set(check())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (setting("velocity", "0 * cloud.velocity"), "Rayleigh cells off in velocity"),
        (setting("xyz", "cloud.xyz * [0.3, 1, 1]"), "Rayleigh cells off in range"),
        (
            ("[observation.gate.range_bins[row]]", "[10 * observation.gate.range_bins[row]]"),
            "or all detections fall outside the region",
        ),
        (setting("power", "1000 * cloud.power"), "power of a lone unit scatterer"),
        (put(BEFORE, "return PointCloud.empty()"), "images nothing"),
    ],
)
def test_an_image_that_is_allowed_but_hardly_meant_is_warned_of(change, message):
    findings = check(*change)
    assert not failed(findings)
    assert findings["lone scatterer"].status == "warning"
    assert message in findings["lone scatterer"].message


def placing(u="cosine[i]", w="cosine[j]", doppler="observation.gate.doppler_bins[column]"):
    """Change what the sound estimator takes for the place of its detection."""
    right = "[observation.gate.doppler_bins[column]],\n        [cosine[i]],\n        [cosine[j]]"
    return right, f"[{doppler}], [{u}], [{w}]"


IN_PAPER = "(-1 if type(observation.frame).__name__ == 'PaperFrame' else 1)"
BACKWARDS = "-observation.gate.doppler_bins[column]"
MISTAKES = {
    "u had the wrong sign (panel frame)": placing(u="-cosine[i]"),
    "w had the wrong sign (panel frame)": placing(w="-cosine[j]"),
    "u and w had the wrong signs (panel frame)": placing("-cosine[i]", "-cosine[j]"),
    "u and w were swapped (panel frame)": placing("cosine[j]", "cosine[i]"),
    "u and w were swapped and u had the wrong sign (panel frame)": placing("-cosine[j]", "cosine[i]"),
    "velocity had the wrong sign (panel frame)": placing(doppler=BACKWARDS),
    "velocity and u and w had the wrong signs (panel frame)": placing("-cosine[i]", "-cosine[j]", BACKWARDS),
    "w had the wrong sign (paper frame)": placing(w=f"cosine[j] * {IN_PAPER}"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_of_signs_or_of_order_is_called_by_its_name(mistake):
    findings = check(*MISTAKES[mistake])
    assert not failed(findings)
    assert findings["lone scatterer"].status == "warning"
    assert f"where it would be if {mistake}: " in findings["lone scatterer"].message


@pytest.mark.parametrize("frame", small_scenes.LONE_VIEWS)
def test_no_mistake_of_signs_or_of_order_is_near_the_truth_or_outside_the_region(frame):
    shot = small_scenes.lone(frame)
    [(range_m, _, u, w)] = radio_places(shot.scenario, shot.scenario.truth)
    cells = rayleigh_cells(shot.scenario)[2:]
    mirrored = [(a * p, b * q) for p, q in ((u, w), (w, u)) for a in (1, -1) for b in (1, -1)][1:]
    assert all((np.abs(np.subtract(place, (u, w))) / cells).max() > MISS_CELLS for place in mirrored)
    for place in mirrored:
        xyz = shot.scenario.base_station_m + shot.scenario.frame.offsets([range_m], *np.array([place]).T)
        assert shot.scenario.region.contains(xyz, -1.0).all()


def test_what_builds_on_a_failed_check_is_skipped_and_says_so():
    findings = check(*put(BEFORE, "raise KeyError"))
    assert findings["region"].status == findings["lone scatterer"].status == "skipped"
    assert findings["region"].message == "needs 'image'"
    assert findings["lone scatterer"].message == "needs 'region'"


def test_a_slow_estimator_is_warned_of(monkeypatch):
    monkeypatch.setattr(class_checks, "SLOW_S", 0.0)
    findings = check()
    assert {finding.check for finding in findings.values() if finding.status == "warning"} == {"time"}
    assert "more than 0 s" in findings["time"].message


@pytest.mark.parametrize(
    ("attribute", "source", "message"),
    [
        ("f", "def f(): ...\n", "is no class: register the class, not an instance"),
        ("A", "class A:\n    name = 'odd'\n", "A has no method 'estimate'"),
        ("Gone", "", "raises AttributeError"),
        ("A", "import no_such_module\n", "raises ModuleNotFoundError: No module named 'no_such_module'"),
    ],
)
def test_what_cannot_be_imported_fails_that_check(plugin_folder, attribute, source, message, request):
    package = f"odd-{abs(hash(request.node.name))}"
    plugin_folder.install(package, source, estimators={"odd": attribute})
    assert find_plugins(package) == [("estimator", "odd")]
    findings = findings_of("estimator", "odd")
    assert failed(findings) == {"import"}
    assert message in findings["import"].message


def test_another_name_than_the_registered_one_fails_the_check_of_the_name(plugin_folder):
    plugin_folder.install("misnamed", SOUND, estimators={"unbroken": "Broken"})
    findings = findings_of("estimator", "unbroken")
    assert failed(findings) == {"name"}
    assert "registered as 'unbroken', but its class attribute name is 'broken'" in findings["name"].message
