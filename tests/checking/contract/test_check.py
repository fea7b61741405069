"""`isacbench.check`: names, packages, files, classes and instances, and its report."""

import os
import sys
from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import pytest

import isacbench
from isacbench.checking.contract import check_names, detector_checks
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Needs
from isacbench.plugins.discovery import entries
from isacbench.plugins.registry import distribution, get_detector
from tests.conftest import estimator_source


@dataclass(frozen=True)
class Blind:
    """Sees nothing, and says what a class of a script can say."""

    name: ClassVar[str] = "blind"
    needs: ClassVar[Needs] = Needs(elements="none", integration=None, cells="none")
    n: int = 1

    def estimate(self, observation):
        if self.n < 0:
            raise ArithmeticError("below zero")
        os.environ["BLIND"] = "changed"
        return PointCloud.empty()


@pytest.fixture
def small_maps(monkeypatch):
    """Measure rates on a sixteenth of the map."""
    monkeypatch.setattr(detector_checks, "LARGE", (128, 128))


@pytest.mark.usefixtures("small_maps")
def test_a_name_is_checked_as_the_command_does():
    report = isacbench.check("ca")
    (plugin,) = report.plugins
    assert (plugin.kind, plugin.name) == ("detector", "ca")
    assert plugin.package == distribution("detector", "ca")
    assert [finding.check for finding in plugin.findings] == check_names("detector")
    assert report.ok
    assert repr(report) == f"Check of detector ca ({plugin.package}): {len(plugin.findings)} ok"


def test_a_file_is_read_anew_each_time_and_not_registered(write_plugin):
    path = write_plugin("still.py", estimator_source("still", "print('loud')"))
    assert "failed: stdout" in repr(isacbench.check(path))
    write_plugin("still.py", estimator_source("still"))
    report = isacbench.check(str(path))
    assert "failed: stdout" not in repr(report)
    assert report.plugins[0].package == "still.py"
    assert "still" not in entries("estimator")


def test_a_class_is_checked_without_being_registered(monkeypatch):
    monkeypatch.delenv("BLIND", raising=False)
    report = isacbench.check(Blind)
    assert not report.ok
    assert [finding.check for finding in report.plugins[0].findings] == check_names("estimator")
    assert "failed: lone scatterer: images nothing" in repr(report)
    assert "BLIND" not in os.environ


def test_of_an_instance_its_own_parameters_are_checked():
    report = isacbench.check(Blind(n=-1))
    assert not report.ok
    title, *lines = repr(report).split("\n")
    assert title.startswith("Check of estimator blind (")
    assert any("failed: image: raises ArithmeticError: below zero" in line for line in lines)


@pytest.mark.usefixtures("small_maps")
def test_an_instance_of_a_registered_detector_is_checked():
    assert isacbench.check(get_detector("ca", pfa=1e-2)).ok


@pytest.mark.parametrize("plugin", [int, 3, dataclass, object()])
def test_what_is_no_plugin_is_refused(plugin):
    with pytest.raises(InputError, match="is not a plugin: allowed are a registered name"):
        isacbench.check(plugin)


PLACES = {
    "numpy/mine.py": "raise KeyError('gone')",
    "isacbench/mine.py": "raise KeyError('gone')",
    "site-packages/scipy/mine.py": "np.linalg.inv(np.ones((2, 3)))",
    "mine.py": "functools.reduce(lambda one, two: one / two, [1, 0])",
}


@pytest.mark.parametrize("path", PLACES)
def test_the_place_of_an_exception_is_in_the_module_of_the_plugin_whatever_its_folder(
    path, tmp_path, monkeypatch
):
    """The module is imported, so that its frames have the path of its file."""
    file = tmp_path / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("import functools\n" + estimator_source("still", PLACES[path]))
    monkeypatch.syspath_prepend(file.parent)
    monkeypatch.delitem(sys.modules, "mine", raising=False)
    report = isacbench.check(import_module("mine").Still)
    [message] = [one.message for one in report.plugins[0].findings if one.check == "image"]
    monkeypatch.delitem(sys.modules, "mine")
    line = file.read_text()[: file.read_text().index(PLACES[path])].count("\n") + 1
    assert f"(mine.py, line {line}, in " in message


def test_the_place_is_in_the_plugins_own_code_before_that_of_other_packages(tmp_path, monkeypatch):
    (tmp_path / "helping.py").write_text("def fail():\n    raise KeyError('gone')\n")
    source = "from helping import fail\n" + estimator_source("still", "fail()")
    (tmp_path / "mine.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("mine", "helping"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    report = isacbench.check(import_module("mine").Still)
    [message] = [one.message for one in report.plugins[0].findings if one.check == "image"]
    for name in ("mine", "helping"):
        monkeypatch.delitem(sys.modules, name)
    line = source[: source.index("fail()")].count("\n") + 1
    assert message == f"raises KeyError: 'gone' (mine.py, line {line}, in estimate)"
