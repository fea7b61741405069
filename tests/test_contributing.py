"""The recipes of CONTRIBUTING.md do what they say."""

import re
import textwrap
from pathlib import Path

import pytest

from isacbench.conformance import check_plugin, find_plugins

RECIPES = Path(__file__).parent.parent / "CONTRIBUTING.md"


@pytest.mark.parametrize(("name", "kind"), [("strongest", "estimator"), ("median", "detector")])
def test_the_example_of_an_estimator_and_of_a_detector_keep_the_contract(write_plugin, name, kind):
    blocks = re.findall(r"```python\n(.*?)```", RECIPES.read_text(encoding="utf-8"), flags=re.DOTALL)
    (source,) = [block for block in blocks if f'name: ClassVar[str] = "{name}"' in block]
    path = write_plugin(f"{name}.py", textwrap.dedent(source))
    assert find_plugins(str(path)) == [(kind, name)]
    assert {finding.status for finding in check_plugin(kind, name)} == {"ok"}
