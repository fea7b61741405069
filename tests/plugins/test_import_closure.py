"""The code that modules run: by their import statements, against a plain reading of the syntax tree."""

import ast
import importlib.util

import pytest

from isacbench.plugins.import_closure import digest_of, import_closure, source_imports
from tests.documents.sources import FILES, trees


def plainly(tree, package):
    """Names of all import statements outside of blocks for type checkers."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.expr):  # which holds no statement
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield from (base, *(f"{base}.{alias.name}" for alias in node.names))
        yield from plainly(node, package)


def test_of_every_module_of_the_library_all_import_statements_are_found():
    for name, tree in trees().items():
        found = set(source_imports(FILES[name].read_text("utf-8"), "some.where.module", False))
        assert set(plainly(tree, "some.where")) <= found, name


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("import a, b.c as d", ["a", "b.c"]),
        ("x = 1; import a", ["a"]),
        ("try: import a\nexcept ImportError: pass", ["a"]),
        ("def f():\n    from . import a", ["p", "p.a"]),
        ("from .q import a", ["p.q", "p.q.a"]),
        ("from a import (  # all )\n    b,\n    c,  # that\n)", ["a", "a.b", "a.c"]),
        ("if TYPE_CHECKING:\n    import a\n\n    import b\nimport c", ["c"]),
        ("if TYPE_CHECKING:\n    import a\nelse:\n    import b", ["b"]),
        ('"""From time to time,\nfrom here to there, import\nimport taxes are due.\n"""', []),
    ],
)
def test_statements_of_any_shape_are_read(text, names):
    assert source_imports(text, "p.m", False) == tuple(sorted(names))


@pytest.fixture
def package(tmp_path, monkeypatch, unknown_code):
    """Return a package of which one module imports another that imports a third."""
    folder = tmp_path / "closed"
    (folder / "inner").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "inner" / "__init__.py").write_text("")
    (folder / "a.py").write_text("from .inner.b import thing\n")
    (folder / "inner" / "b.py").write_text("def thing():\n    from closed import c\n    return c\n")
    (folder / "c.py").write_text("from os import path\n")
    (folder / "d.py").write_text("from closed import a\n")
    monkeypatch.syspath_prepend(tmp_path)
    return folder


def test_what_is_imported_by_what_is_imported_counts_and_who_imports_it_does_not(package):
    found = import_closure(["closed.a"], ["closed"])
    assert list(found) == ["closed", "closed.a", "closed.c", "closed.inner", "closed.inner.b"]
    assert found["closed.c"] == (package / "c.py").read_bytes()


def test_other_packages_do_not_count(package):
    (package / "c.py").write_text("import isacbench.errors, json\n")
    assert not [name for name in import_closure(["closed.a"], ["closed"]) if not name.startswith("closed")]
    assert "isacbench.errors" in import_closure(["closed.a"], ["closed", "isacbench"])


def test_a_module_that_is_not_there_is_told():
    with pytest.raises(ModuleNotFoundError, match=r"isacbench\.bench\.gone"):
        import_closure(["isacbench.bench.gone"], ["isacbench"])


def test_names_that_a_package_loads_on_first_use_lead_to_where_they_live():
    found = import_closure(["mine"], ["isacbench"], {"mine": "from isacbench import PointCloud"})
    assert "isacbench.model.cloud" in found


def test_a_digest_tells_contents_and_names_apart():
    digests = {digest_of(code) for code in ({"a": b"1"}, {"a": b"2"}, {"b": b"1"}, {"a": b"1", "b": b""})}
    assert len(digests) == 4
