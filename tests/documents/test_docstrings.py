"""The examples in docstrings do what they show."""

import doctest
import importlib
from functools import cache

import pytest

import isacbench
from tests.documents.sources import FILES

WITH_EXAMPLES = [name for name, path in FILES.items() if ">>> " in path.read_text(encoding="utf-8")]


@pytest.fixture(scope="module")
def scenes_made_once():
    """Remember scenes and observations: many examples begin with the same street."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("load_scenario", "observe"):
            patch.setattr(isacbench, name, cache(getattr(isacbench, name)))
        yield


@pytest.mark.usefixtures("scenes_made_once")
@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_the_examples_of_a_module_hold(name):
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_modules_of_all_packages_are_looked_at_and_have_examples():
    assert {"isacbench", "isacbench.dsp.windows", "isacbench_algorithms.music2d"} <= {*FILES}
    assert {
        "isacbench.dsp.windows",
        "isacbench.model.cloud",
        "isacbench.checking.contract.contract_check",
    } <= {*WITH_EXAMPLES}
