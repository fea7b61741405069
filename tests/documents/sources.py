"""Sources of the library and of the built-in estimators, found by module name and parsed once a process."""

import ast
import gc
import re
import textwrap
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILES = {
    ".".join(("isacbench_algorithms" if parts[0] == "algorithms" else parts[0], *parts[1:])).removesuffix(
        ".__init__"
    ): ROOT.joinpath(*parts).with_suffix(".py")
    for folder in ("isacbench", "algorithms")
    for parts in (
        path.relative_to(ROOT).with_suffix("").parts for path in sorted((ROOT / folder).rglob("*.py"))
    )
}


def python_blocks(page):
    """Blocks of Python code in a page of the repository."""
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), flags=re.DOTALL)


def recipe(text):
    """The one block of code of CONTRIBUTING.md that holds a text."""
    (source,) = [block for block in python_blocks("CONTRIBUTING.md") if text in block]
    return textwrap.dedent(source)


@cache
def trees():
    """Syntax trees by module name, for tests that ask: parsing takes as long as many tests."""
    gc.disable()  # which would look through all nodes again and again
    try:
        return {name: ast.parse(path.read_text("utf-8")) for name, path in FILES.items()}
    finally:
        gc.freeze()
        gc.enable()


def statements(node):
    """Yields all statements of a tree, wherever they stand; expressions hold none."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.expr):
            yield child
            yield from statements(child)
