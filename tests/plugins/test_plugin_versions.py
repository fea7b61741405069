import hashlib
import sys

import pytest
from isacbench_algorithms.omp4d import Omp4d

import isacbench
from isacbench.cores import one_blas_thread
from isacbench.plugins.class_code import class_code
from isacbench.plugins.discovery import register_plugin
from isacbench.plugins.local_files import PluginFile
from isacbench.plugins.plugin_versions import library_code, plugin_version
from isacbench.plugins.registry import build_estimator, get_detector, get_estimator
from tests.conftest import forget_code

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


pytestmark = pytest.mark.usefixtures("unknown_code")  # packages of different tests have equal names


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
    forget_code()
    return plugin_version(plugin)[package]["digest"]


def test_built_in_plugins_are_of_this_package():
    for plugin in (get_estimator("music2d"), get_detector("os")):
        assert list(plugin_version(plugin)) == ["isacbench"]
        assert plugin_version(plugin)["isacbench"]["version"] == isacbench.__version__


def test_a_changed_file_that_the_plugin_imports_changes_its_digest_and_other_files_do_not(package):
    plugin = get_estimator("packaged")
    assert plugin_version(plugin)["packed-plugins"]["version"] == "1.0"
    before = digest(plugin, "packed-plugins")
    (package / "notes.txt").write_text("nothing")
    (package / "other.py").write_text("# of another plugin")
    assert digest(plugin, "packed-plugins") == before
    (package / "helper.py").write_text("HELP = 2\n")
    changed = digest(plugin, "packed-plugins")
    assert changed != before
    (package / "helper.py").rename(package / "renamed.py")
    assert digest(plugin, "packed-plugins") not in (before, changed)


def test_of_a_package_that_imports_by_name_every_file_counts(package):
    plugin = get_estimator("packaged")
    (package / "helper.py").write_text("from importlib import import_module\nHELP = 1\n")
    before = digest(plugin, "packed-plugins")
    (package / "other.py").write_text("# perhaps imported")
    assert digest(plugin, "packed-plugins") != before


def test_of_the_library_those_files_count_that_a_plugin_imports(write_plugin):
    register_plugin(PluginFile("local.py", DETECTOR))
    register_plugin(PluginFile("heir.py", HEIR))
    music, pursuit = get_estimator("music2d"), get_estimator("nomp4d")
    assert len({library_code(one) for one in (music, pursuit, get_detector("never"))}) == 3
    # Through its base.
    assert library_code(get_estimator("heir")) == library_code(music)


def test_a_single_module_is_its_file_alone(plugins):
    (versions,) = plugin_version(get_estimator("blob")).values()
    code = (plugins.path / "test_plugins.py").read_bytes()
    content = f"test_plugins\0{len(code)}\0".encode() + code
    assert versions == {"version": "1.0", "digest": hashlib.sha256(content).hexdigest()}


def test_a_local_file_is_its_content_and_has_no_version(write_plugin):
    file = PluginFile("local.py", DETECTOR)
    register_plugin(file)
    assert plugin_version(get_detector("never")) == {"local.py": {"version": None, "digest": file.digest}}


def test_nested_detectors_count_where_they_come_from(plugins, write_plugin):
    register_plugin(PluginFile("local.py", DETECTOR))
    assert list(plugin_version(build_estimator("blob[detector=never]"))) == ["local.py", "test-plugins"]
    assert list(plugin_version(build_estimator("music2d[spectrum_detector=level]"))) == [
        "isacbench",
        "test-plugins",
    ]


def test_bases_count_and_the_harness_itself_does_not(write_plugin):
    register_plugin(PluginFile("heir.py", HEIR))
    versions = plugin_version(get_estimator("heir"))
    assert list(versions) == ["heir.py", "isacbench"]
    assert versions["isacbench"]["digest"] == digest(get_estimator("music2d"), "isacbench")


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
