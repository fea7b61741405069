"""What `isacbench.check` and `isacbench check` find, in what, and how they answer."""

import json
import os
import sys
import threading
import time
from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import pytest
from isacbench_algorithms import references
from typer.testing import CliRunner

import isacbench
from isacbench.checking import image_checks, map_checks, plugin_check
from isacbench.checking.plugin_check import check_guarded, check_names, check_plugin, find_plugins
from isacbench.cli import app
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import Needs
from isacbench.plugins.discovery import PluginFile, entries, isolated_plugins, register_plugin
from isacbench.plugins.registry import detector_names, estimator_names, get_detector, metric_names
from tests.conftest import estimator_source

LOCAL = (
    estimator_source("nothing")
    + estimator_source("loud", 'print("loud")').partition("\n\n\n")[2]
    + 'print("imported")\n'
)

QUIET = """
from dataclasses import dataclass
from typing import ClassVar

from isacbench_algorithms.fft4d import Fft4d


@dataclass(frozen=True)
class Quiet(Fft4d):
    name: ClassVar[str] = "quiet"
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
def small_maps_and_few_images(monkeypatch):
    """Measure rates on small and few maps, and read what an image holds off one image of a scene.

    What asks for an answer of the plugin, in order to compare two, gets an image of its own.
    """
    monkeypatch.setattr(map_checks, "LARGE", (128, 128))
    monkeypatch.setattr(map_checks, "BORDER_MAPS", (32, 32, 32))
    monkeypatch.setattr(map_checks, "LOOKS", (1, 4))
    monkeypatch.setattr(references, "N_REALISATIONS", 8)
    image, images = image_checks.EstimatorSubject.of, {}

    def of(subject, scene, *asked):
        return image(subject, scene, *asked) if asked else images.setdefault(scene, image(subject, scene))

    monkeypatch.setattr(image_checks.EstimatorSubject, "of", of)


@pytest.mark.parametrize("entry", find_plugins("isacbench"), ids=lambda entry: f"{entry.kind}-{entry.name}")
@pytest.mark.usefixtures("small_maps_and_few_images")
def test_the_built_in_plugins_keep_the_contract(entry):
    assert {finding.status for finding in check_plugin(entry)} == {"ok"}


# What is checked.


def found(package_or_file):
    """Kinds and names of what is found."""
    return [(entry.kind, entry.name) for entry in find_plugins(package_or_file)]


def test_a_distribution_and_its_package_name_everything_they_register():
    names = {"estimator": estimator_names(), "detector": detector_names()}
    expected = {(kind, name) for kind, of_kind in names.items() for name in of_kind}
    assert set(found("isacbench_algorithms")) == expected
    assert set(found("isacbench")) == expected | {("metric", name) for name in metric_names()}


@pytest.mark.parametrize("name", ["test-plugins", "test_plugins"])
def test_packages_are_found_in_both_spellings(plugins, name):
    estimators = [("estimator", one) for one in ("blob", "seer", "trouble")]
    assert found(name) == [*estimators, ("detector", "level")]


def test_a_registered_name_is_itself_and_a_file_all_that_it_defines(plugins, write_plugin):
    assert found("level") == [("detector", "level")]
    path = str(write_plugin("local.py", LOCAL))
    assert found(path) == found(path) == [("estimator", "nothing"), ("estimator", "loud")]
    assert found("loud") == [("estimator", "loud")]


def test_what_is_neither_is_answered_with_what_is_near():
    with pytest.raises(InputError, match=r"'music2' is no registered name, .*did you mean 'music2d'"):
        find_plugins("music2")


# In this process.


def test_a_name_is_checked_as_the_command_does():
    report = isacbench.check("fixed")
    (plugin,) = report.plugins
    assert (plugin.kind, plugin.name) == ("detector", "fixed")
    assert plugin.package == entries("detector")["fixed"].origin
    assert [finding.check for finding in plugin.findings] == check_names("detector")
    assert repr(report) == f"Check of detector fixed ({plugin.package}): {len(plugin.findings)} ok"
    assert isacbench.check(get_detector("fixed", pfa=1e-2)).ok


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


@pytest.mark.parametrize("plugin", [int, 3, dataclass, object()])
def test_what_is_no_plugin_is_refused(plugin):
    with pytest.raises(InputError, match="is not a plugin: allowed are a registered name"):
        isacbench.check(plugin)


PLACES = {
    "numpy/mine.py": "raise KeyError('gone')",
    "isacbench/mine.py": "raise KeyError('gone')",
    "site-packages/scipy/mine.py": "np.linalg.inv(np.ones((2, 3)))",
    "mine.py": "import functools; functools.reduce(lambda one, two: one / two, [1, 0])",
    "own/mine.py": "import helping; helping.fail()",  # its own code comes before that of other packages
}


@pytest.mark.parametrize("path", PLACES)
def test_the_place_of_an_exception_is_in_the_module_of_the_plugin_whatever_its_folder(
    path, tmp_path, monkeypatch
):
    """The module is imported, so that its frames have the path of its file."""
    file = tmp_path / path
    file.parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "helping.py").write_text("def fail():\n    raise KeyError('gone')\n")
    source = estimator_source("mine", PLACES[path])
    file.write_text(source)
    for folder in (tmp_path, file.parent):
        monkeypatch.syspath_prepend(folder)
    with monkeypatch.context() as patch:
        for name in ("mine", "helping"):
            patch.delitem(sys.modules, name, raising=False)
        report = isacbench.check(import_module("mine").Mine)
        for name in ("mine", "helping"):
            sys.modules.pop(name, None)
    [message] = [one.message for one in report.plugins[0].findings if one.check == "image"]
    line = source[: source.index(PLACES[path])].count("\n") + 1
    assert f"(mine.py, line {line}, in " in message


# In a process of its own.


def test_guarded_findings_are_those_of_this_process():
    guarded, here = check_guarded(*find_plugins("fixed")), check_plugin(*find_plugins("fixed"))
    assert [(one.check, one.status) for one in guarded] == [(one.check, one.status) for one in here]


@pytest.fixture
def deadly():
    """Register an estimator that does something deadly."""
    with isolated_plugins():
        yield lambda deed: register_plugin(PluginFile("deadly.py", estimator_source("deadly", deed)))


def test_a_check_that_runs_on_is_told_while_it_does(deadly, monkeypatch):
    monkeypatch.setattr(plugin_check, "LONG_S", 0.2)
    deadly("time.sleep(0.5 if observation.array.shape == (2, 2) else 0)")
    told = []
    check_guarded(*find_plugins("deadly"), still_at=told.append)
    assert "2 x 2 array" in told
    assert told == [name for name in check_names("estimator") if name in told]


def test_no_thread_that_tells_of_a_check_is_left(deadly, monkeypatch):
    monkeypatch.setattr(plugin_check, "LONG_S", 0.0)
    deadly("pass")
    last = check_names("estimator")[-1]
    check_guarded(*find_plugins("deadly"), still_at=lambda name: time.sleep(0.5 * (name == last)))
    assert not any(isinstance(one, threading.Timer) for one in threading.enumerate())


@pytest.mark.parametrize(
    ("deed", "message"),
    [
        ("os._exit(5)", "ends its process: the process exited with code 5"),
        ("os._exit(0)", "ends its process: the process exited with code 0"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "ends its process: the process died by SIGKILL"),
        ("signal.pause()", "takes more than 2 s: does it hang?"),
    ],
)
def test_a_deadly_plugin_fails_the_check_that_it_dies_in_and_skips_the_rest(deadly, deed, message):
    deadly(deed)
    findings = check_guarded(*find_plugins("deadly"), timeout_s=2)
    assert [finding.check for finding in findings] == check_names("estimator")
    (failed,) = (finding for finding in findings if finding.status == "failed")
    assert (failed.check, failed.message) == ("image", message)
    after = findings[findings.index(failed) + 1 :]
    assert {finding.status for finding in after} == {"skipped"}


# The command.


@pytest.fixture
def cli(write_plugin, tmp_path, monkeypatch):
    """Run the command line in a folder that holds a plugin file."""
    monkeypatch.chdir(tmp_path)
    write_plugin("local.py", LOCAL)
    write_plugin("quiet.py", QUIET)
    return lambda *args: CliRunner().invoke(app, ["check", *args])


def test_check_prints_a_line_a_check_and_exits_with_3_where_one_failed(cli):
    result = cli("local.py")
    assert result.exit_code == 3
    lines = result.stdout.splitlines()
    assert lines[0] == "estimator nothing (local.py)"
    assert any(line.split()[:2] == ["FAILED", "stdout"] for line in lines)
    assert any(line.split()[:3] == ["FAILED", "lone", "scatterer"] for line in lines)
    assert lines[-1].startswith("2 plugins: ")
    assert lines[-1].endswith(" ok, 3 FAILED")


def test_check_exits_with_0_where_all_pass_and_2_where_nothing_is_found(cli):
    assert cli("quiet.py").exit_code == 0
    assert cli("quiet", "--plugin", "quiet.py").exit_code == 0
    result = cli("no_such")
    assert result.exit_code == 2
    assert "no registered name" in result.stderr
    assert cli("gone.py").exit_code == 2


def test_check_prints_json_and_nothing_else_though_a_plugin_prints(cli, monkeypatch):
    monkeypatch.setattr(plugin_check, "LONG_S", 0.0)
    result = cli("local.py", "--json")
    assert result.exit_code == 3
    content = json.loads(result.stdout)
    nothing, loud = content["plugins"]
    assert (nothing["kind"], nothing["name"], nothing["package"]) == ("estimator", "nothing", "local.py")
    assert [f["check"] for f in loud["findings"] if f["status"] == "failed"] == ["lone scatterer", "stdout"]
    assert content["counts"]["failed"] == 3
    assert sum(content["counts"].values()) == len(nothing["findings"]) + len(loud["findings"])
    assert "isacbench: estimator nothing: still at 'import'\n" in result.stderr
