"""Where rows come from: named the same wherever they are made, and otherwise as soon as anything differs."""

import copy
import subprocess

import numpy as np
import pytest

import isacbench
from isacbench.bench.cells.provenance import (
    differing_versions,
    environment_id,
    environment_of,
    git_state,
    package_version,
)
from isacbench.plugins.registry import get_detector, get_estimator


@pytest.mark.parametrize("plugin", [get_estimator("music2d"), get_detector("ca")], ids=["image", "map"])
def test_an_environment_names_all_that_rows_follow_from(plugin):
    environment = environment_of(plugin)
    versions, machine = environment["versions"], environment["machine"]
    assert list(versions) == ["isacbench", "plugins", "python", "numpy", "scipy"]
    assert versions["isacbench"]["version"] == isacbench.__version__
    assert len(versions["isacbench"]["digest"]) == 16
    assert versions["numpy"] == np.__version__
    assert "isacbench" in versions["plugins"]
    assert list(machine) == ["platform", "processor", "cores"]
    assert machine["cores"] >= 1
    assert package_version("isacbench-nowhere") is None


def test_equal_environments_have_equal_names_and_others_others():
    environment = environment_of(get_estimator("oracle"))
    assert environment_id(environment) == environment_id(copy.deepcopy(environment))
    for path in (("versions", "numpy"), ("versions", "isacbench"), ("machine", "processor")):
        other = copy.deepcopy(environment)
        other[path[0]][path[1]] = "another"
        assert environment_id(other) != environment_id(environment)


def test_versions_that_differ_are_named_from_top_to_bottom():
    old = {"numpy": "1", "scipy": "1", "plugins": {"mine": {"version": "1", "digest": "a"}}}
    new = {"numpy": "2", "scipy": "1", "plugins": {"mine": {"version": "1", "digest": "b"}, "yours": "3"}}
    assert differing_versions(old, new) == [
        "numpy 1 instead of 2",
        "plugins mine digest a instead of b",
        "plugins yours none instead of 3",
    ]
    assert differing_versions(old, old) == []


def git(folder, *words):
    identity = ["-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false"]
    return subprocess.run(
        ["git", *identity, "-C", folder, *words], check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def checkout(tmp_path):
    git(tmp_path, "init", "-q")
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "-q", "-m", "first")
    return tmp_path


def test_a_checkout_has_a_commit_and_may_be_dirty(checkout, tmp_path_factory):
    assert git_state(tmp_path_factory.mktemp("plain")) is None
    commit = git(checkout, "rev-parse", "HEAD")
    assert git_state(checkout) == {"commit": commit, "dirty": False}
    (checkout / "file").write_text("two")
    assert git_state(checkout) == {"commit": commit, "dirty": True}


def test_without_git_there_is_no_state(checkout, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert git_state(checkout) is None


def test_looking_at_a_checkout_takes_no_lock_in_it(checkout, monkeypatch):
    seen = {}

    def run(command, **options):
        seen.update(options["env"])
        return subprocess.CompletedProcess(command, 0, stdout="# branch.oid abc\n")

    monkeypatch.setattr(subprocess, "run", run)
    assert git_state(checkout) == {"commit": "abc", "dirty": False}
    assert seen["GIT_OPTIONAL_LOCKS"] == "0"
