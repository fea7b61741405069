"""The examples of docs/python.md and docs/chain.md do what they say."""

import re
import sys
from types import ModuleType

import pytest

from tests.documents.sources import ROOT, python_blocks


@pytest.fixture
def script(tmp_path, monkeypatch):
    """Return a module in which examples run, in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    module = ModuleType("script")
    monkeypatch.setitem(sys.modules, "script", module)
    return module


def without_numbers(text):
    return re.sub(r"-?\d[\d.]*", "#", text)


def test_the_examples_run_and_print_what_is_shown(script):
    text = (ROOT / "docs" / "python.md").read_text("utf-8")
    first, *others = python_blocks("docs/python.md")
    exec(first, vars(script))
    assert f">>> observation\n{script.observation!r}\n" in text
    # Which points there are may differ between processors.
    assert without_numbers(f">>> cloud\n{script.cloud!r}\n") in without_numbers(text)
    for example in others:
        exec(example, vars(script))
    assert (len(script.stored.clouds), len(script.rows)) == (4, 2)
    assert f">>> report\n{script.report!r}\n".replace("(script)", "(__main__)") in text


def test_the_examples_of_the_chain_run(script):
    for example in python_blocks("docs/chain.md"):
        exec(example, vars(script))
    assert len(script.cloud)
