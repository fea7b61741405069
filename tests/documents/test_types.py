"""The README's example is one that `mypy` type-checks, as the project's configuration has it do."""

from tests.documents.sources import ROOT, python_blocks


def test_what_mypy_checks_is_the_example_of_the_readme():
    (example,) = [block for block in python_blocks("README.md") if "get_estimator" in block]
    checked = (ROOT / "tests" / "types" / "readme.py").read_text(encoding="utf-8")
    assert checked == example, "copy the README's example to tests/types/readme.py, and run mypy"
