"""The examples in docstrings do what they show."""

import doctest
import importlib
from pathlib import Path

import isacbench_algorithms
import pytest

import isacbench

MODULES = {
    f"{package.__name__}.{'.'.join(path.relative_to(folder).with_suffix('').parts)}".removesuffix(
        ".__init__"
    ): path
    for package in (isacbench, isacbench_algorithms)
    for folder in map(Path, package.__path__)
    for path in sorted(folder.rglob("*.py"))
}
WITH_EXAMPLES = [name for name, path in MODULES.items() if ">>> " in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_module_hold(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_modules_of_all_packages_are_looked_at_and_have_examples():
    assert {"isacbench", "isacbench.dsp.windows", "isacbench_algorithms.music2d"} <= {*MODULES}
    assert {
        "isacbench.dsp.windows",
        "isacbench.model.cloud",
        "isacbench.checking.contract.contract_check",
    } <= {*WITH_EXAMPLES}
