"""The examples in docstrings do what they show."""

import doctest
import importlib
from functools import cache

import pytest

import isacbench
from isacbench.checking import map_checks
from tests.documents.sources import FILES

WITH_EXAMPLES = [name for name, path in FILES.items() if ">>> " in path.read_text(encoding="utf-8")]


@pytest.fixture(scope="module")
def scenes_made_once():
    """Remember scenes and observations, as many examples begin with the same street, and take small maps."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("load_scenario", "observe"):
            patch.setattr(isacbench, name, cache(getattr(isacbench, name)))
        patch.setattr(map_checks, "LARGE", (128, 128))
        yield


@pytest.mark.usefixtures("scenes_made_once")
@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_module_hold(name):
    runner = doctest.DocTestRunner()
    for found in doctest.DocTestFinder().find(importlib.import_module(name)):
        if found.examples:  # a run without any looks at all files that are read already
            runner.run(found)
    assert runner.failures == 0
    assert runner.tries > 0


def test_modules_of_all_packages_are_looked_at_and_have_examples():
    assert {"isacbench", "isacbench.dsp.windows", "isacbench_algorithms.music2d"} <= {*WITH_EXAMPLES}
