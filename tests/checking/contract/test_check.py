"""`isacbench.check`: names, packages, files, classes and instances, and its report."""

import os
from dataclasses import dataclass
from typing import ClassVar

import pytest

import isacbench
from isacbench.checking.contract import check_names, detector_checks
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Needs
from isacbench.plugins.discovery import entries
from isacbench.plugins.registry import distribution, get_detector

FILE = """
from dataclasses import dataclass
from typing import ClassVar

from isacbench.model.cloud import PointCloud


@dataclass(frozen=True)
class Still:
    name: ClassVar[str] = "still"

    def estimate(self, observation):
        {deed}
        return PointCloud.empty()
"""


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
    path = write_plugin("still.py", FILE.format(deed="print('loud')"))
    assert not isacbench.check(path).ok
    write_plugin("still.py", FILE.format(deed="pass"))
    report = isacbench.check(str(path))
    assert report.ok
    assert report.plugins[0].package == "still.py"
    assert "still" not in entries("estimator")


def test_a_class_is_checked_without_being_registered(monkeypatch):
    monkeypatch.delenv("BLIND", raising=False)
    report = isacbench.check(Blind)
    assert report.ok
    assert [finding.check for finding in report.plugins[0].findings] == check_names("estimator")
    assert "warning: lone scatterer: images nothing" in repr(report)
    assert "BLIND" not in os.environ


def test_of_an_instance_its_own_parameters_are_checked():
    report = isacbench.check(Blind(n=-1))
    assert not report.ok
    title, *lines = repr(report).split("\n")
    assert title.startswith("Check of estimator blind (")
    assert any("failed: image: raises ArithmeticError: below zero" in line for line in lines)
    assert "raises ArithmeticError" in report._repr_html_()


@pytest.mark.usefixtures("small_maps")
def test_an_instance_of_a_registered_detector_is_checked():
    assert isacbench.check(get_detector("ca", pfa=1e-2)).ok


@pytest.mark.parametrize("plugin", [int, 3, dataclass, object()])
def test_what_is_no_plugin_is_refused(plugin):
    with pytest.raises(InputError, match="is not a plugin: allowed are a registered name"):
        isacbench.check(plugin)
