"""When rows are stale: a case for each way to change the code that made them, and what changes nothing."""

import importlib
import os
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from isacbench_algorithms.omp4d import Omp4d

import isacbench
from isacbench.bench.cells.provenance import ROW_MAKERS
from isacbench.cores import one_blas_thread
from isacbench.plugins.code_digests import class_code, files_digest, plugin_version
from isacbench.plugins.discovery import PluginFile, register_plugin
from isacbench.plugins.registry import build_estimator, get_detector, get_estimator

SOURCE = """
import enum
import functools
import io
import re
from collections import OrderedDict, namedtuple
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

import neighbour
from neighbour import helped
from isacbench.dsp.floating_point import round_step

GAIN = 2.5
WORDS = {"deep": [1, {"er": (2, 3)}], "other": {"a", "b", "c"}}
WEIGHTS = np.arange(6.0)
TABLE = pd.DataFrame({"a": [1, 2]})
PLACE = Path("here")
MODE = enum.Enum("Mode", "SLOW FAST")
ORDER = OrderedDict(first=1)
POINT = namedtuple("Point", "x y")(1, 2)
seen = 0

@dataclass(frozen=True)
class Setup:
    level: float = 7.0

    @functools.cached_property
    def costly(self):
        return 1

SETUP = Setup(level=3.5)

class Tool:
    factor = 11

    def turn(self):
        return 12

def rounded(x, digits=4, *, base=10):
    return round(x, digits)

def traced(function):
    @functools.wraps(function)
    def inner(*args):
        return function(*args)
    return inner

def scaled_by(k):
    def scaled(x):
        return k * x
    return scaled

TWICE = scaled_by(13)
HALF = functools.partial(rounded, 0.125, digits=5)
SQUARE = lambda x: x + 14
unused = 15

def wound(function):
    @functools.wraps(function)
    def inner(*args):
        return 41 * function(*args)
    return inner

WOUND, LOOK, TEXT = wound(helped), (42, 43).__getitem__, io.StringIO("text 44")
PATTERN = re.compile("a+")
NEAR, FAR = scaled_by(31), scaled_by(32)
TURNED = [lambda x, k=k: x + k for k in (33, 34)]

class Wrapper:
    def __init__(self, function, strength):
        functools.update_wrapper(self, function)
        self.strength = strength

def called(x):
    try:
        y = len(x)
    except TypeError:
        y = 0
    return y

called.gain = 35
WRAPPED = Wrapper(rounded, 40)

@dataclass(slots=True)
class Slotted:
    depth: int = 36
    parts: list = field(default_factory=lambda: [37])

class Meta(type):
    order = 38

class WithMeta(metaclass=Meta):
    pass

class Base:
    def begin(self):
        return 16

class Plugged(Base):
    name: ClassVar[str] = "plugged"
    steps = [17, 18]
    kernel = np.ones(3)
    half = property(lambda self: 19)
    tool = functools.partialmethod(lambda self, x: x, 20)

    @staticmethod
    def fixed():
        return 21

    @functools.cached_property
    def kept(self):
        return 22

    @functools.lru_cache(maxsize=4)
    def cached(self, x):
        return 23

    @traced
    def behind(self):
        return 24

    def estimate(self, observation, start=25):
        global seen
        seen = seen + 1
        values = [one * GAIN for one in WORDS]
        self.unused = WEIGHTS, TABLE, PLACE, MODE.SLOW, ORDER, POINT, SETUP.level, Tool(), rounded
        self.more = PATTERN, NEAR, FAR, TURNED, WRAPPED, called, Slotted, WithMeta
        self.most = WOUND, LOOK, TEXT
        return TWICE, HALF, SQUARE, helped, neighbour.CONSTANT, round_step

@dataclass(frozen=True)
class Frozen(Plugged):
    pass
"""

SET = """
class First:
    def own(self): return First

class Second:
    def own(self): return Second, 1

CLASSES = {First, Second}

class Frozen:
    def estimate(self): return CLASSES
"""

DETECTOR = """
from dataclasses import dataclass
from typing import ClassVar

@dataclass(frozen=True)
class Never:
    name: ClassVar[str] = "never"
    pfa: float = 1e-3
    def detect(self, power, looks=1): ...
"""

HEIR = """
from dataclasses import dataclass
from typing import ClassVar
from isacbench.plugins.contracts import Estimator
from isacbench_algorithms.music2d import Music2d

@dataclass(frozen=True)
class Heir(Music2d, Estimator):
    name: ClassVar[str] = "heir"
"""

PACKAGED = """
from dataclasses import dataclass
from typing import ClassVar
from .helper import HELP

@dataclass(frozen=True)
class Packaged:
    name: ClassVar[str] = "packaged"
    def estimate(self, observation): ...
"""

COUNTS = [
    ("GAIN = 2.5", "GAIN = 2.6"),
    ("(2, 3)", "(2, 4)"),
    ('"c"}', '"d"}'),
    ("np.arange(6.0)", "np.arange(6)"),
    ('{"a": [1, 2]}', '{"a": [1, 3]}'),
    ('Path("here")', 'Path("there")'),
    ('"SLOW FAST"', '"FAST SLOW"'),
    ("first=1", "first=2"),
    ('"Point", "x y")(1, 2)', '"Point", "x y")(1, 3)'),
    ("level=3.5", "level=3.6"),
    ("factor = 11", "factor = 12"),
    ("return 12\n", "return 13\n"),
    ("digits=4", "digits=5"),
    ("base=10", "base=11"),
    ("round(x, digits)", "round(x, 3)"),
    ("return function(*args)", "return function(*args) or None"),
    ("scaled_by(13)", "scaled_by(14)"),
    ("0.125", "0.25"),
    ("digits=5)", "digits=6)"),
    ("x + 14", "x + 15"),
    ("return 16", "return 17"),
    ("[17, 18]", "[17, 19]"),
    ("np.ones(3)", "np.ones(4)"),
    ("lambda self: 19", "lambda self: 20"),
    ("x, 20)", "x, 21)"),
    ("return 21", "return 22"),
    ("return 22", "return 23"),
    ("return 23", "return 24"),
    ("return 24", "return 25"),
    ("start=25", "start=26"),
    ('"a+"', '"b+"'),
    ("NEAR, FAR =", "FAR, NEAR ="),
    ("(33, 34)", "(34, 33)"),
    ("Wrapper(rounded, 40)", "Wrapper(rounded, 41)"),
    ("        y = len(x)\n    except TypeError:\n", "        y = 0\n    except TypeError:\n"),
    ("        y = 0\n    return y", "        y = 0\n    else:\n        y = y\n    return y"),
    ("def called(x)", "def called(*x)"),
    ("gain = 35", "gain = 36"),
    ("depth: int = 36", "depth: int = 37"),
    ("lambda: [37]", "lambda: [38]"),
    ("order = 38", "order = 39"),
    ("41 * function(*args)", "42 * function(*args)"),
    ("(42, 43)", "(42, 44)"),
    ("text 44", "text 45"),
]
DOES_NOT = [
    ("GAIN = 2.5", "# moved down\n\nGAIN = 2.5"),
    ("unused = 15", "unused = 16"),
    ("seen = 0", "seen = 4"),
    ("class Plugged(Base):\n", 'class Plugged(Base):\n    """Say what it does."""\n'),
]


@pytest.fixture
def neighbour(tmp_path, monkeypatch):
    """Return the file of a module beside the notebook."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "neighbour.py").write_text("CONSTANT = 1\ndef helped(): return 1\n")
    importlib.invalidate_caches()
    yield tmp_path / "neighbour.py"
    sys.modules.pop("neighbour", None)


@pytest.fixture
def made(neighbour, monkeypatch):
    """Return a function that makes a module without a file of a text, and the class of its plugin."""

    def run(source=SOURCE):
        module = ModuleType("made_in_a_notebook")
        monkeypatch.setitem(sys.modules, module.__name__, module)
        exec(compile(source, "<notebook>", "exec"), vars(module))
        return module.Frozen

    return run


@pytest.mark.parametrize(
    ("old", "new", "counts"), [*((*one, True) for one in COUNTS), *((*one, False) for one in DOES_NOT)]
)
def test_every_value_that_a_class_uses_counts_and_no_other(made, old, new, counts):
    assert SOURCE.count(old) == 1
    before = class_code(made())
    assert (class_code(made(SOURCE.replace(old, new))) != before) == counts


def test_use_changes_nothing(made):
    plugged = made()
    before = class_code(plugged)
    plugged().estimate.__func__.__globals__["SETUP"].costly  # noqa: B018
    plugged.cached(plugged(), 1)
    assert class_code(plugged) == before


def test_a_method_that_a_notebook_has_replaced_counts(monkeypatch):
    before = plugin_version(get_estimator("fft4d"))
    namespace = {"__name__": "made_in_a_notebook"}
    exec("def estimate(self, observation): return None", namespace)
    monkeypatch.setattr(type(get_estimator("fft4d")), "estimate", namespace["estimate"])
    assert plugin_version(get_estimator("fft4d")) != before


def test_values_within_themselves_end():
    ring = [1]
    ring.append(ring)

    class Local:
        def estimate(self):
            return ring, Local

    assert len(class_code(Local).digest) == 64


def test_the_order_of_a_set_does_not_count(made):
    classes = [made(SET) for _ in range(40)]  # all at addresses of their own, which decide the order
    assert len({class_code(one) for one in classes}) == 1


def test_modules_that_it_uses_count_by_their_files_and_packages_by_their_versions(made, neighbour):
    versions = plugin_version(made()())
    assert versions["neighbour"]["version"] is None
    assert versions["pandas"]["version"] is not None
    assert versions["pandas"]["digest"] is None
    assert not versions.keys() & {"numpy", "functools"}  # which every row names anyway
    neighbour.write_text("CONSTANT = 2\ndef helped(): return 1\n")
    edited = plugin_version(made()())
    assert edited["neighbour"] != versions["neighbour"]  # which code runs, depends on who asks
    importlib.reload(sys.modules["neighbour"])
    assert plugin_version(made()())["neighbour"] not in (versions["neighbour"], edited["neighbour"])


FILES = {
    "inner.py": "CONSTANT = 1",
    "beside.py": "CONSTANT = 1",
    "over/__init__.py": "",
    "over/under.py": "CONSTANT = 1",
    "chained.py": "import beside",
}
USERS = {
    "an import in a method": ("inner.py", "def estimate(self):\n        import inner"),
    "an import of a name in a method": (
        "inner.py",
        "def estimate(self):\n        from inner import CONSTANT",
    ),
    "a module of a package": ("over/under.py", "def estimate(self):\n        return over.under.CONSTANT"),
    "a module that a module beside it imports": ("beside.py", "def estimate(self):\n        return chained"),
}


@pytest.mark.parametrize("way", USERS)
def test_modules_of_the_user_count_whatever_way_leads_to_them(way, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    importlib.invalidate_caches()
    file, method = USERS[way]
    source = "import chained, over.under\n@dataclass(frozen=True)\nclass Made:\n    " + method
    space = {"__name__": "made_in_a_notebook", "dataclass": dataclass}
    exec(source, space)
    before = plugin_version(space["Made"]())
    (tmp_path / file).write_text("CONSTANT = 2")
    after = plugin_version(space["Made"]())
    for module in ("chained", "beside", "over", "over.under"):
        sys.modules.pop(module, None)
    assert after != before


def test_constants_that_a_script_sets_in_a_module_count(made, neighbour):
    plugged = made()
    before = class_code(plugged)
    sys.modules["neighbour"].CONSTANT = 5
    assert class_code(plugged) != before


@dataclass(frozen=True)
class Trained:
    n: int = 3
    weights: object = field(init=False, default=None)

    @cached_property
    def costly(self):
        return 1


def test_what_an_instance_holds_besides_its_parameters_counts():
    def version(weights):
        trained = Trained()
        object.__setattr__(trained, "weights", np.array(weights))
        return plugin_version(trained)

    assert version([1.0]) == version([1.0]) != version([2.0])
    used = Trained()
    used.costly  # noqa: B018
    assert plugin_version(used) == plugin_version(Trained())


def test_the_code_is_the_same_in_every_process(made, neighbour):
    ask = f"import sys; sys.path.insert(0, {str(neighbour.parent)!r})"
    answer = "from isacbench.plugins.code_digests import class_code\nprint(class_code(Frozen).digest)"
    processes = [
        subprocess.run(
            [sys.executable, "-c", "\n".join([ask, SOURCE, answer])],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=False,
        )
        for seed in ("1", "2", "3")
    ]
    assert {process.stderr for process in processes} == {""}
    assert len({process.stdout for process in processes}) == 1


@pytest.fixture
def package(plugin_folder, monkeypatch):
    """Return the folder of an installed package of two modules."""
    plugin_folder.install("packed-plugins", "", estimators={"packaged": "Packaged"})
    (plugin_folder.path / "packed_plugins.py").unlink()
    folder = plugin_folder.path / "packed_plugins"
    folder.mkdir()
    (folder / "__init__.py").write_text(PACKAGED)
    (folder / "helper.py").write_text("HELP = 1\n")
    yield folder
    for name in [name for name in sys.modules if name.partition(".")[0] == "packed_plugins"]:
        del sys.modules[name]


def digest(plugin, package):
    return plugin_version(plugin)[package]["digest"]


def test_built_in_plugins_are_of_this_package_and_an_edit_of_one_makes_the_rows_of_all_stale():
    first, *others = map(
        plugin_version, (get_estimator("music2d"), get_estimator("oracle"), get_detector("os"))
    )
    assert list(first) == ["isacbench"]
    assert first["isacbench"]["version"] == isacbench.__version__
    assert others == [first, first]


def test_every_file_of_code_of_a_package_counts_by_content_and_name_and_no_other(package):
    plugin = get_estimator("packaged")
    assert plugin_version(plugin)["packed-plugins"]["version"] == "1.0"
    before = digest(plugin, "packed-plugins")
    (package / "notes.txt").write_text("nothing")
    assert digest(plugin, "packed-plugins") == before
    (package / "helper.py").write_text("HELP = 2\n")
    changed = digest(plugin, "packed-plugins")
    (package / "helper.py").rename(package / "renamed.py")
    assert len({before, changed, digest(plugin, "packed-plugins")}) == 3


def test_the_folders_of_isacbench_that_make_rows_count_and_no_other(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    paths = [tmp_path / "library" / name for name in ("__init__.py", "model/echo.py", "cli/app.py")]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_text("")
    before = files_digest(["library"], ["model"])
    paths[2].write_text("# edited")
    assert files_digest(["library"], ["model"]) == before
    paths[1].write_text("# edited")
    assert files_digest(["library"], ["model"]) != before
    assert all((Path(isacbench.__file__).parent / name).is_dir() for name in ROW_MAKERS)


@pytest.mark.parametrize(
    "source",
    [HEIR, DETECTOR.replace("detect(", "estimate(") + "from isacbench_algorithms import music2d\n"],
    ids=["base", "import"],
)
def test_what_a_plugin_file_takes_of_the_built_in_estimators_counts(write_plugin, source):
    (name,) = register_plugin(PluginFile("mine.py", source))
    versions = plugin_version(get_estimator(name))
    assert list(versions) == ["isacbench", "mine.py"]
    assert versions["isacbench"]["digest"] == digest(get_estimator("music2d"), "isacbench")


def test_a_local_file_is_its_content_and_has_no_version(write_plugin):
    file = PluginFile("local.py", DETECTOR)
    register_plugin(file)
    assert plugin_version(get_detector("never")) == {"local.py": {"version": None, "digest": file.digest}}


def test_a_module_that_a_plugin_names_is_never_run_for_its_version(write_plugin, tmp_path, monkeypatch):
    (tmp_path / "neverrun.py").write_text("raise SystemExit('it was run')\n")
    monkeypatch.syspath_prepend(tmp_path)
    file = PluginFile("local.py", f"{DETECTOR}\n\ndef train():\n    import neverrun\n")
    register_plugin(file)
    assert {"local.py", "neverrun"} <= set(plugin_version(get_detector("never")))


def test_nested_detectors_count_where_they_come_from(plugins, write_plugin):
    register_plugin(PluginFile("local.py", DETECTOR))
    assert list(plugin_version(build_estimator("blob[detector=never]"))) == ["local.py", "test-plugins"]
    assert list(plugin_version(build_estimator("music2d[spectrum_detector=level]"))) == [
        "isacbench",
        "test-plugins",
    ]


def test_local_files_of_one_name_are_told_apart(write_plugin):
    estimator = HEIR.replace("(Music2d, Estimator)", "(Music2d)")
    for source in (DETECTOR, estimator):
        register_plugin(PluginFile("plugin.py", source))
    versions = plugin_version(build_estimator("heir[detector=never]"))
    digests = {PluginFile("", source).digest for source in (DETECTOR, estimator)}
    assert digests <= {version["digest"] for version in versions.values()}


@pytest.mark.parametrize("base", [Omp4d, object], ids=["decorated by a base", "decorated"])
def test_the_code_behind_a_decorator_counts(base):
    def digest_with(number):
        class Local(base):
            estimate = (lambda *_: 1) if number == 1 else (lambda *_: 2)
            if base is object:
                estimate = one_blas_thread()(estimate)

        assert Local().estimate(None) == number
        return class_code(Local)

    assert digest_with(1) == digest_with(1) != digest_with(2)
