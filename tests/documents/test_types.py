"""The README's example is one that `mypy` type-checks, as the project's configuration has it do."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_what_mypy_checks_is_the_example_of_the_readme():
    blocks = re.findall(
        r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL
    )
    (example,) = [block for block in blocks if "get_estimator" in block]
    checked = (ROOT / "tests" / "types" / "readme.py").read_text(encoding="utf-8")
    assert checked == example, "copy the README's example to tests/types/readme.py, and run mypy"
