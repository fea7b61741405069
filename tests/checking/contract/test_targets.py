"""What `isacbench check` finds and how it answers; the built-in plugins pass it."""

import json

import pytest
from isacbench_algorithms import chance, oracle
from typer.testing import CliRunner

from isacbench.checking.contract import (
    check_plugin,
    detector_checks,
    estimator_checks,
    find_plugins,
    guarded_checks,
)
from isacbench.cli import app
from isacbench.errors import InputError
from isacbench.plugins.registry import detector_names, estimator_names, metric_names
from tests.conftest import estimator_source

LOCAL = f"""{estimator_source("nothing")}
{estimator_source("loud", "print('loud')")}
print("imported")
"""

QUIET = """
from dataclasses import dataclass
from typing import ClassVar

from isacbench_algorithms.fft4d import Fft4d


@dataclass(frozen=True)
class Quiet(Fft4d):
    name: ClassVar[str] = "quiet"
"""


@pytest.fixture
def cli(write_plugin, tmp_path, monkeypatch):
    """Run the command line in a folder that holds a plugin file."""
    monkeypatch.chdir(tmp_path)
    write_plugin("local.py", LOCAL)
    write_plugin("quiet.py", QUIET)
    return lambda *args: CliRunner().invoke(app, ["check", *args])


@pytest.fixture
def small_maps_and_few_images(monkeypatch):
    """Measure rates on a sixteenth of the map, and read what an image holds off one image of a scene.

    What asks for an answer of the plugin, in order to compare two, gets an image of its own.
    """
    monkeypatch.setattr(detector_checks, "LARGE", (128, 128))
    monkeypatch.setattr(detector_checks, "LOOKS", (1, 4))
    for reference in (oracle, chance):
        monkeypatch.setattr(reference, "N_REALISATIONS", 8)
    image, images = estimator_checks.EstimatorSubject.imaging, {}

    def imaging(subject, shot, *asked):
        return image(subject, shot, *asked) if asked else images.setdefault(shot, image(subject, shot))

    monkeypatch.setattr(estimator_checks.EstimatorSubject, "imaging", imaging)


@pytest.mark.parametrize(("kind", "name"), find_plugins("isacbench"))
@pytest.mark.usefixtures("small_maps_and_few_images")
def test_the_built_in_plugins_keep_the_contract(kind, name):
    assert {finding.status for finding in check_plugin(kind, name)} == {"ok"}


def test_a_distribution_and_its_package_name_everything_they_register():
    names = {"estimator": estimator_names(), "detector": detector_names()}
    expected = {(kind, name) for kind, of_kind in names.items() for name in of_kind}
    assert set(find_plugins("isacbench_algorithms")) == expected
    assert set(find_plugins("isacbench")) == expected | {("metric", name) for name in metric_names()}


@pytest.mark.parametrize("name", ["test-plugins", "test_plugins"])
def test_packages_are_found_in_both_spellings(plugins, name):
    assert find_plugins(name) == [
        ("estimator", "blob"),
        ("estimator", "seer"),
        ("estimator", "trouble"),
        ("detector", "level"),
    ]


def test_a_registered_name_is_itself_and_a_file_all_that_it_defines(plugins, write_plugin):
    assert find_plugins("level") == [("detector", "level")]
    path = str(write_plugin("local.py", LOCAL))
    assert find_plugins(path) == find_plugins(path) == [("estimator", "nothing"), ("estimator", "loud")]
    assert find_plugins("loud") == [("estimator", "loud")]


def test_what_is_neither_is_answered_with_what_is_near():
    with pytest.raises(InputError, match=r"'music2' is no registered name, .*did you mean 'music2d'"):
        find_plugins("music2")
    with pytest.raises(InputError, match="unknown detector 'cs'"):
        check_plugin("detector", "cs")


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


def test_check_prints_json_and_nothing_else_though_a_plugin_prints(cli):
    result = cli("local.py", "--json")
    assert result.exit_code == 3
    content = json.loads(result.stdout)
    nothing, loud = content["plugins"]
    assert (nothing["kind"], nothing["name"], nothing["package"]) == ("estimator", "nothing", "local.py")
    assert [f["check"] for f in loud["findings"] if f["status"] == "failed"] == ["lone scatterer", "stdout"]
    assert content["counts"]["failed"] == 3
    assert sum(content["counts"].values()) == len(nothing["findings"]) + len(loud["findings"])


def test_what_is_running_is_told_on_stderr_beside_json(cli, monkeypatch):
    monkeypatch.setattr(guarded_checks, "TOLD_S", 0.0)
    result = cli("quiet.py", "--json")
    assert json.loads(result.stdout)["plugins"][0]["name"] == "quiet"
    assert "isacbench: estimator quiet: still at 'import'\n" in result.stderr
