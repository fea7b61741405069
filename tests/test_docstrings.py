"""The examples in docstrings do what they show."""

import doctest
import importlib
import pkgutil

import isacbench_algorithms
import pytest

import isacbench

MODULES = [
    name
    for package in (isacbench, isacbench_algorithms)
    for name in (
        package.__name__,
        *(found.name for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")),
    )
    if not name.endswith("__main__")
]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_hold(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_modules_of_all_packages_are_looked_at_and_have_examples():
    assert {"isacbench.dsp.windows", "isacbench.model.cloud", "isacbench_algorithms.music2d"} <= {*MODULES}
    examples = doctest.DocTestFinder().find(importlib.import_module("isacbench.dsp.windows"))
    assert any(found.examples for found in examples)
