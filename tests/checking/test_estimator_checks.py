"""Each check of an estimator fails one that breaks it, and no other check does."""

import pytest

from isacbench.checking import checks
from isacbench.checking.plugin_check import find_plugins
from tests.checking.changed_plugins import failed, findings_of, findings_of_changed, indented
from tests.documents.sources import recipe

TOOLS = """
import sys
import warnings
from typing import Any

from isacbench.plugins.contracts import Needs

LAST = []
"""
BEFORE = "        power = np.mean("
AFTER = "        return cloud\n"
FIELD = "n: int = 1"
METHOD = "def estimate(self, observation: Observation) -> PointCloud"
SOUND = TOOLS + recipe('"strongest"').replace('"strongest"', '"broken"') + AFTER
SOUND = SOUND.replace("return observation.cloud", "cloud = observation.cloud")
SOUND = SOUND.replace("    angle_points", f"    {FIELD}\n    angle_points", 1)


def before(line):
    """Put statements before the estimate."""
    return BEFORE, indented(line) + BEFORE


def after(line):
    """Put statements after the estimate."""
    return AFTER, indented(line) + AFTER


def setting(attribute, value):
    """Overwrite an attribute of the cloud behind its constructor's back."""
    return after(f"object.__setattr__(cloud, {attribute!r}, {value})")


def beside(line):
    """Put a statement below the field."""
    return FIELD, f"{FIELD}\n    {line}"


REMEMBERS = """mean = observation.cells.mean()
shift = 0.0 if LAST[-1:] in ([], [mean]) else 0.01
LAST.append(mean)
object.__setattr__(cloud, 'power', cloud.power + shift)"""
COUNTS = """def __reduce__(self): LAST.append(1); return Strongest, ()
    def __post_init__(self): object.__setattr__(self, 'late', len(LAST))"""
FILLS = """n = int((np.abs(observation.cells[..., 0, 0]) > 0)[observation.gate.reachable].sum())
middle = (observation.region.lower_m + observation.region.upper_m) / 2
more = np.tile([*middle, 0.0, 0.0], (n, 1))
return PointCloud.from_array(np.concatenate([cloud.to_array(), more]))"""
GATE = "mask = observation.gate.reachable\nif mask.sum() == 1 < mask.size: raise IndexError(3)"
BORROWS = "observation.gate.range_bins[0] += 1\nobservation.gate.range_bins[0] -= 1"
SEES = "needs_truth: ClassVar = True\n    def estimate(self, observation, truth)"
RANDOM = "cloud.velocity + 0.01 * np.random.default_rng().random()"
SQUARE = "observation.cells[..., 0] + observation.cells[..., 0, :]"
RATIO = "np.sum(np.abs(observation.cells)) / np.abs(observation.cells).max()"

BROKEN = [
    ("needs", beside("needs = Needs('cross')"), "declare what it reads"),
    ("needs", beside("needs = Needs('none')"), "declare what it reads"),
    ("needs", beside("needs = 'cross'"), "must be a Needs, not str"),
    ("frozen dataclass", ("@dataclass(frozen=True)", "@dataclass"), "decorate it with @dataclass(frozen="),
    ("name", ("name: ClassVar[str]", "name: str"), "annotate it as ClassVar[str]"),
    ("default parameters", (FIELD, "n: int"), "parameter n has no default"),
    ("default parameters", beside("def __post_init__(self): 1 / 0"), "ZeroDivisionError"),
    ("parameter types", (FIELD, "n: int = None"), "n = None: should be a valid integer"),
    ("parameter types", (FIELD, "n: 'Unheard' = 1"), "cannot be resolved"),
    ("canonical parameters", (FIELD, "n: Any = frozenset()"), "n = frozenset(): allowed are finite numbers"),
    ("truth", (METHOD, SEES), "which only the built-in references may see"),
    ("arguments", (METHOD, "def estimate(self, cells, gate)"), "'gate'): define estimate(self, observation)"),
    ("image", before("return [1, 2]"), "raises TypeError: estimate() must return a PointCloud, not list"),
    ("image", before("raise KeyError('gone')"), "raises KeyError: 'gone' (broken.py, line "),
    ("image", before("sys.exit(0)"), "raises SystemExit: 0"),
    ("region", setting("xyz", "cloud.xyz + 100"), "outside the region"),
    ("velocity", setting("velocity", "cloud.velocity * 1000"), "give them in m/s"),
    ("power", setting("power", "cloud.power - 10"), "0 or more and no dB"),
    ("observation unchanged", before("observation.cells[0] = 0"), "writes to the observation ("),
    ("observation unchanged", before(BORROWS), "writes to the observation ("),
    ("repeatable", setting("velocity", RANDOM), "a generator with a fixed seed"),
    ("no memory", after(REMEMBERS), "keep nothing from one call to the next"),
    ("pickling", beside("def __reduce__(self): raise TypeError('no luck')"), "pickled (TypeError: no luck)"),
    ("pickling", beside("def __reduce__(self): return Strongest, (7,)"), "has other parameters"),
    ("pickling", beside(COUNTS), "keep all that it needs in its parameters"),
    ("random numbers", before("np.random.seed(20310); np.random.random()"), "numpy.random.default_rng(seed)"),
    ("random numbers", before("import random; random.seed(1)"), "numpy.random.default_rng(seed)"),
    ("stdout", before("print('looking')"), "prints 'looking\\n' to stdout"),
    ("minimal gate", before(GATE), "raises IndexError: 3"),
    ("noise alone", after(FILLS), "a threshold that follows from the noise"),
    ("silence", before(RATIO), "RuntimeWarning"),
    ("2 x 2 array", before("observation.cells[:, :, 2]"), "raises IndexError"),
    ("other arrays", before(SQUARE), "raises ValueError: operands could not be broadcast"),
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
    ("change", "status", "message"),
    [
        (setting("velocity", "-cloud.velocity"), "failed", "if velocity had the wrong sign: v > 0"),
        (setting("velocity", "0 * cloud.velocity"), "failed", "if velocity was 0: take it from"),
        (setting("xyz", "cloud.xyz * [0.3, 1, 1]"), "failed", ", in Rayleigh cells: "),
        (before("return PointCloud.empty()"), "failed", "images nothing"),
        (setting("power", "1000 * cloud.power"), "warning", "powers of 1 and 0.0001 come out as "),
        (("range_bins[row]", "range_bins[row] + 0.5"), "warning", "about half a bin off in range"),
    ],
)
def test_a_lone_scatterer_elsewhere_fails_its_check_and_half_a_bin_or_a_wrong_power_is_a_warning(
    change, status, message
):
    findings = check(*change)
    assert {name for name, finding in findings.items() if finding.status != "ok"} == {"lone scatterer"}
    assert findings["lone scatterer"].status == status
    assert message in findings["lone scatterer"].message


def test_what_builds_on_a_failed_check_is_skipped_and_says_so():
    findings = check(*before("raise KeyError"))
    assert findings["region"].status == findings["lone scatterer"].status == "skipped"
    assert findings["region"].message == "needs 'image'"
    assert findings["lone scatterer"].message == "needs 'region'"


def test_a_slow_estimator_is_warned_of(monkeypatch):
    monkeypatch.setattr(checks, "SLOW_S", 0.0)
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
    assert [entry.name for entry in find_plugins(package)] == ["odd"]
    findings = findings_of("estimator", "odd")
    assert failed(findings) == {"import"}
    assert message in findings["import"].message


def test_another_name_than_the_registered_one_fails_the_check_of_the_name(plugin_folder):
    plugin_folder.install("misnamed", SOUND, estimators={"unbroken": "Strongest"})
    findings = findings_of("estimator", "unbroken")
    assert failed(findings) == {"name"}
    assert "registered as 'unbroken', but its class attribute name is 'broken'" in findings["name"].message
