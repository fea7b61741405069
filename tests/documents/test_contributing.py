"""The recipes of CONTRIBUTING.md do what they say."""

import importlib
import re
import textwrap
from pathlib import Path

import pytest

from isacbench.checking.plugin_check import check_plugin, find_plugins
from isacbench.checking.stress import run_case
from isacbench.plugins.registry import get_estimator

RECIPES = Path(__file__).parents[2] / "CONTRIBUTING.md"


@pytest.mark.parametrize(("name", "kind"), [("strongest", "estimator"), ("median", "detector")])
def test_the_example_of_an_estimator_and_of_a_detector_keep_the_contract(write_plugin, name, kind):
    blocks = re.findall(r"```python\n(.*?)```", RECIPES.read_text(encoding="utf-8"), flags=re.DOTALL)
    (source,) = [block for block in blocks if f'name: ClassVar[str] = "{name}"' in block]
    path = write_plugin(f"{name}.py", textwrap.dedent(source))
    assert find_plugins(str(path)) == [(kind, name)]
    assert {finding.status for finding in check_plugin(kind, name)} == {"ok"}


def test_the_example_of_a_stress_case_is_one_that_estimators_keep(tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```", RECIPES.read_text(encoding="utf-8"), flags=re.DOTALL)
    (source,) = [block for block in blocks if "def faint" in block]
    (tmp_path / "faint_case.py").write_text(textwrap.dedent(source), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    for case in importlib.import_module("faint_case").faint.cases():
        assert {finding.status for finding in run_case(case, get_estimator("music2d"))} == {"ok"}
