"""The recipes of CONTRIBUTING.md do what they say."""

import importlib

import pytest

from isacbench.checking.plugin_check import check_plugin, find_plugins
from isacbench.checking.stress import run_case
from isacbench.plugins.registry import get_estimator
from tests.documents.sources import recipe


@pytest.mark.parametrize(("name", "kind"), [("strongest", "estimator"), ("median", "detector")])
def test_the_example_of_an_estimator_and_of_a_detector_keep_the_contract(write_plugin, name, kind):
    path = write_plugin(f"{name}.py", recipe(f'name: ClassVar[str] = "{name}"'))
    [entry] = find_plugins(str(path))
    assert (entry.kind, entry.name) == (kind, name)
    assert {finding.status for finding in check_plugin(entry)} == {"ok"}


def test_the_example_of_a_stress_case_is_one_that_estimators_keep(tmp_path, monkeypatch):
    (tmp_path / "faint_case.py").write_text(recipe("def faint"), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    for case in importlib.import_module("faint_case").faint.cases():
        assert {finding.status for finding in run_case(case, get_estimator("music2d"))} == {"ok"}
