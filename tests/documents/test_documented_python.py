"""The examples of docs/python.md do what they say."""

import re
import sys
from pathlib import Path
from types import ModuleType

DOCUMENT = Path(__file__).parents[2] / "docs" / "python.md"


def without_numbers(text):
    return re.sub(r"-?\d[\d.]*", "#", text)


def test_the_examples_run_and_print_what_is_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    script = ModuleType("script")
    monkeypatch.setitem(sys.modules, "script", script)
    text = DOCUMENT.read_text(encoding="utf-8")
    first, *others = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(first, vars(script))
    assert f">>> observation\n{script.observation!r}\n" in text
    # Which points there are may differ between processors.
    assert without_numbers(f">>> cloud\n{script.cloud!r}\n") in without_numbers(text)
    for example in others:
        exec(example, vars(script))
    assert (len(script.stored.clouds), len(script.rows)) == (4, 2)
    assert f">>> report\n{script.report!r}\n".replace("(script)", "(__main__)") in text
