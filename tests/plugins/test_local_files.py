import dataclasses
import inspect
import pickle
import subprocess
import sys
import traceback
from typing import get_type_hints

import pytest

from isacbench.bench.suites.suite_kinds import catalogue
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.plugins.discovery import (
    PluginFile,
    entries,
    isolated_plugins,
    load_plugin_file,
    local_plugins,
    register_plugin,
)
from isacbench.plugins.registry import (
    build_estimator,
    describe_plugin,
    estimator_names,
    get_detector,
    get_estimator,
)

LOCAL = '''
"""Two plugins and what they need."""
from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isacbench.plugins.contracts import Detection, Detector
from isacbench.model.cloud import PointCloud


class Base(ABC):
    name: ClassVar[str] = "base"

    @abstractmethod
    def estimate(self, observation): ...


@dataclass(frozen=True)
class Half:
    """Half of the highest power."""

    pfa: float = 0.5
    name: ClassVar[str] = "half"

    def detect(self, power, looks=1):
        threshold = np.full(power.shape, power.max() / 2)
        return Detection(power > threshold, threshold, threshold)


@dataclass(frozen=True)
class Nothing(Base):
    """Sees nothing."""

    detector: Detector = Half()
    size: int = 1
    name: ClassVar[str] = "nothing"

    def estimate(self, observation):
        if self.size < 0:
            raise ValueError("no such size")
        return PointCloud.empty()
'''


def test_classes_that_a_file_defines_are_registered_beside_the_installed_ones(write_plugin):
    before = estimator_names()
    assert load_plugin_file(write_plugin("local.py", LOCAL)) == ["half", "nothing"]
    assert set(estimator_names()) == {*before, "nothing"}
    nothing = build_estimator("nothing[detector=half[pfa=0.25],size=3]")
    assert (nothing.detector, nothing.size) == (get_detector("half", pfa=0.25), 3)
    assert isinstance(nothing.estimate(None), PointCloud)
    assert build_estimator("music2d[detector=half]").detector.name == "half"


def test_a_local_plugin_is_described_with_its_file_as_its_package(write_plugin):
    load_plugin_file(write_plugin("local.py", LOCAL))
    described = next(entry for entry in describe_plugin("estimator") if entry["name"] == "nothing")
    assert described["package"] == entries("detector")["half"].origin == "local.py"
    assert described["description"] == "Sees nothing."
    assert described["parameters"]["size"] == {"type": "int", "default": 1}
    assert described in catalogue()["estimators"]


def test_equal_content_is_registered_once_whatever_the_file_is_called(write_plugin):
    load_plugin_file(write_plugin("local.py", LOCAL))
    assert load_plugin_file(write_plugin("other.py", LOCAL)) == ["half", "nothing"]
    assert register_plugin(PluginFile("local.py", LOCAL)) == ["half", "nothing"]
    assert local_plugins() == (PluginFile("local.py", LOCAL),)


def test_a_name_of_a_file_with_other_content_is_refused_and_leaves_nothing_behind(write_plugin):
    load_plugin_file(write_plugin("local.py", LOCAL))
    changed = write_plugin("local.py", LOCAL.replace("size: int = 1", "size: int = 2"))
    with pytest.raises(InputError, match="'nothing' is registered twice") as caught:
        load_plugin_file(changed)
    for file in (PluginFile("local.py", LOCAL), PluginFile.read(changed)):
        assert f"local.py ({file.code_name}:" in str(caught.value)
    assert PluginFile.read(changed).module_name not in sys.modules
    assert get_estimator("nothing").size == 1


def test_imported_classes_are_not_registered(write_plugin):
    imported = LOCAL + "\nfrom isacbench_algorithms.music2d import Music2d\nAlias = Half\n"
    assert load_plugin_file(write_plugin("local.py", imported)) == ["half", "nothing"]


@pytest.mark.parametrize(
    ("filename", "source", "message"),
    [
        ("notes.txt", LOCAL, "notes.txt: allowed is a Python file that ends in .py"),
        ("empty.py", "", "empty.py: it defines no class .*its classes are none"),
        ("helper.py", "class Helper:\n    pass\n", "its classes are Helper"),
        ("nameless.py", "class A:\n    def estimate(self, observation): ...\n", "its classes are A"),
        ("syntax.py", "x = 1\ny = = 2\n", "cannot be imported: line 2: SyntaxError"),
        ("missing.py", "\n\nimport no_such_module\n", "line 3: ModuleNotFoundError: .*no_such_module"),
        ("deep.py", "def f():\n    return 1 / 0\n\nf()\n", "line 2: ZeroDivisionError"),
        ("exit.py", "import sys\nsys.exit(7)\n", "line 2: SystemExit: 7"),
        (
            "mine.py",
            LOCAL.replace('"nothing"', '"oracle"'),
            r"'oracle' is registered twice, by isacbench .* and by mine\.py",
        ),
        ("twice.py", f"{LOCAL}\nclass Again(Nothing): ...\n", r"'nothing' is registered twice, .*:Again\)"),
    ],
)
def test_a_file_that_is_no_plugin_or_has_a_name_of_another_is_refused_in_words(
    write_plugin, filename, source, message
):
    path = write_plugin(filename, source)
    with pytest.raises(InputError, match=message):
        load_plugin_file(path)
    assert local_plugins() == ()
    assert not [name for name in sys.modules if name.startswith(f"isacbench_plugin_{path.stem}_")]


def test_an_interrupt_while_a_file_is_imported_is_an_interrupt(write_plugin):
    file = PluginFile.read(write_plugin("stop.py", "raise KeyboardInterrupt\n"))
    with pytest.raises(KeyboardInterrupt):
        register_plugin(file)
    assert file.module_name not in sys.modules


def test_a_local_class_is_held_to_the_contract(write_plugin):
    load_plugin_file(write_plugin("local.py", LOCAL.replace("size: int = 1", "size: Unknown = 1")))
    with pytest.raises(InputError, match="type of a parameter cannot be resolved"):
        get_estimator("nothing")


def test_instances_pickle_types_resolve_and_tracebacks_show_the_source(write_plugin):
    path = write_plugin("local.py", LOCAL)
    load_plugin_file(path)
    plugin = get_estimator("nothing", size=-1)
    assert pickle.loads(pickle.dumps(plugin)) == plugin
    assert get_type_hints(type(plugin))["size"] is int
    assert dataclasses.replace(plugin, size=2).size == 2
    assert "class Nothing(Base):" in inspect.getsource(type(plugin))
    path.unlink()
    with pytest.raises(ValueError, match="no such size") as caught:
        plugin.estimate(None)
    shown = "".join(traceback.format_exception(caught.value))
    assert 'raise ValueError("no such size")' in shown
    assert "local.py" in shown


def test_another_process_has_the_same_plugin_by_its_content(write_plugin):
    load_plugin_file(write_plugin("local.py", LOCAL))
    (file,) = local_plugins()
    script = (
        "import pickle, sys\n"
        "from isacbench.plugins.discovery import register_plugin\n"
        "file, plugin = pickle.load(sys.stdin.buffer)\n"
        "register_plugin(file)\n"
        "print(pickle.loads(plugin).size)\n"
    )
    content = pickle.dumps((file, pickle.dumps(get_estimator("nothing", size=42))))
    done = subprocess.run([sys.executable, "-c", script], input=content, capture_output=True, check=True)
    assert done.stdout.strip() == b"42"


def test_what_is_registered_in_isolation_is_forgotten_and_the_rest_kept(write_plugin):
    load_plugin_file(write_plugin("local.py", LOCAL))
    other = LOCAL.replace('"nothing"', '"zero"').replace('"half"', '"third"')
    with isolated_plugins():
        load_plugin_file(write_plugin("other.py", other))
        assert "zero" in estimator_names()
    assert "zero" not in estimator_names()
    assert "nothing" in estimator_names()
    assert PluginFile("other.py", other).module_name not in sys.modules
