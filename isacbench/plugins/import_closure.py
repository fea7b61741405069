"""Import closure: a module and all that it imports, directly or not, within some packages.

It is the code on which a row of results depends. It is read from the import
statements at any depth, without those for type checkers; no module is imported.
"""

from __future__ import annotations

import ast
import hashlib
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache, lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec, PathFinder
from pathlib import Path
from typing import NamedTuple

CODE_SUFFIXES = tuple(SOURCE_SUFFIXES + EXTENSION_SUFFIXES)

BLOCKS = "body", "orelse", "finalbody", "handlers", "cases"
"""Attributes of a statement that hold further statements."""

BY_NAME = re.compile(rb"\b(?:import_module|__import__)\b")
"""Functions that import a module by its name, which no import statement shows."""


class _Code(NamedTuple):
    """Content of a module's file, and the names that it imports, some of which may be no modules."""

    content: bytes
    imports: tuple[str, ...]


def import_closure(
    modules: Iterable[str], packages: Collection[str], sources: Mapping[str, str] | None = None
) -> dict[str, bytes]:
    """Collect the code of modules and of all that they import.

    Parameters
    ----------
    modules : iterable of str
        Dotted names of modules.
    packages : collection of str
        Top-level packages and modules whose code counts, besides those of the user: of a
        folder that no packages are installed into.
    sources : mapping of str to str, optional
        Text of modules that have no file.

    Returns
    -------
    dict of str to bytes
        Code by dotted name, sorted. Where a module of a package calls
        `import_module`, the whole package is included. isacbench is the
        exception: it imports plugins in this way.

    Raises
    ------
    ModuleNotFoundError
        If one of the modules cannot be found.

    Examples
    --------
    >>> found = import_closure(["isacbench.dsp.stable_order"], ["isacbench"])
    >>> sorted(found)[:3]
    ['isacbench', 'isacbench.checkout', 'isacbench.dsp']
    """
    sources = sources or {}
    wanted = list(modules)
    found: dict[str, _Code] = {
        name: _Code(text.encode(), source_imports(text, name, False)) for name, text in sources.items()
    }
    for name in wanted:
        if name not in sources and _code(name) is None:
            raise ModuleNotFoundError(f"module {name}: there is no such file of code")
    waiting = [*wanted, *(name for code in found.values() for name in code.imports)]
    while waiting:
        for name in _with_parents(waiting.pop(), packages):
            code = None if name in found else _code(name)
            if code is not None:
                found[name] = code
                waiting += code.imports
    for package in {name.partition(".")[0] for name in found}:
        own = [code for name, code in found.items() if name.partition(".")[0] == package]
        if package != "isacbench" and any(BY_NAME.search(code.content) for code in own):
            found |= {name: _Code(content, ()) for name, content in _whole(package)}
    return {name: found[name].content for name in sorted(found)}


def is_importable(module: str) -> bool:
    """Tell whether another process with the same paths finds a module by its name.

    Parameters
    ----------
    module : str

    Returns
    -------
    bool
    """
    return module.partition(".")[0] != "__main__" and _spec(module) is not None


def is_installed(path: str) -> bool:
    """Tell whether a file is in a folder that packages are installed into.

    Parameters
    ----------
    path : str

    Returns
    -------
    bool
    """
    return not {"site-packages", "dist-packages"}.isdisjoint(Path(path).parts)


def digest_of(code: Mapping[str, bytes]) -> str:
    """Compute the digest of code and of its names.

    Parameters
    ----------
    code : mapping of str to bytes

    Returns
    -------
    str
        SHA-256, hexadecimal.
    """
    total = hashlib.sha256()
    for name, content in sorted(code.items()):
        total.update(f"{name}\0{len(content)}\0".encode() + content)
    return total.hexdigest()


def source_imports(text: str, module: str, is_package: bool) -> tuple[str, ...]:
    """List the names in the import statements of a source, sorted: modules, and what may be modules in them.

    Parameters
    ----------
    text : str
        Source code; if its syntax is wrong, nothing is listed.
    module : str
        Dotted name, which relative imports refer to.
    is_package : bool
        True for the ``__init__`` of a package.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> source_imports("from .near import thing", "far.away", False)
    ('far.near', 'far.near.thing')
    """
    package = module if is_package else module.rpartition(".")[0]
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return ()
    names: set[str] = set()
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return tuple(sorted(names))


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Statements at any depth, except those that only type checkers read."""
    is_for_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    for block in BLOCKS[is_for_types:]:
        for statement in getattr(node, block, ()):
            yield statement
            yield from _statements(statement)


def _with_parents(name: str, packages: Collection[str]) -> Iterator[str]:
    """A module and the packages above it, which run before it; nothing outside of `packages`."""
    parts = name.split(".")
    if parts[0] in packages or _is_own(parts[0]):
        yield from (".".join(parts[: n + 1]) for n in range(len(parts)))
        # A package may load a name on first use (PEP 562).
        owner = sys.modules.get(".".join(parts[:-1]))
        if owner is not None and "__getattr__" in vars(owner):
            home = getattr(getattr(owner, parts[-1], None), "__module__", name)
            if home != name:
                yield from _with_parents(home, packages)


@cache
def _is_own(root: str) -> bool:
    """Tell whether a top-level module is neither installed, nor Python's, nor of isacbench."""
    spec = None if root in {*sys.stdlib_module_names, "isacbench"} else _spec(root)
    return spec is not None and spec.origin is not None and not is_installed(spec.origin)


_codes: dict[str, tuple[object, _Code | None]] = {}


def _code(name: str) -> _Code | None:
    """Code of a module; None where there is no such file.

    A module that is loaded again, as in a notebook, gets a new specification, and its file counts as it is
    then. If the file has changed since, nobody knows which code runs, here and in workers: both count.
    """
    loaded, now = getattr(sys.modules.get(name), "__spec__", None), _read(name)
    if name not in _codes or _codes[name][0] is not loaded:
        _codes[name] = loaded, now
    before = _codes[name][1]
    if before is None or now is None or before.content == now.content:
        return now
    return _Code(before.content + now.content, before.imports + now.imports)


def _read(name: str) -> _Code | None:
    """Code of a module as its file is."""
    spec = _spec(name)
    if spec is None or spec.origin is None:
        return None
    try:
        status = Path(spec.origin).stat()
        return _read_once(name, spec.origin, status.st_mtime_ns, status.st_size)
    except OSError:
        return None


@lru_cache(maxsize=4096)
def _read_once(name: str, origin: str, _time_ns: int, _size: int) -> _Code:
    content = Path(origin).read_bytes()
    if not origin.endswith(tuple(SOURCE_SUFFIXES)):
        return _Code(content, ())
    spec = _spec(name)
    is_package = spec is not None and spec.submodule_search_locations is not None
    return _Code(content, source_imports(content.decode("utf-8", "replace"), name, is_package))


@cache
def _spec(name: str) -> ModuleSpec | None:
    """Find a module without importing anything."""
    parent, _, _ = name.rpartition(".")
    if not parent:
        # Not from sys.modules: another process does not find modules that were only made there.
        found = (finder.find_spec(name, None) for finder in sys.meta_path)
        return next((spec for spec in found if spec is not None), None)
    above = _spec(parent)
    if above is None or above.submodule_search_locations is None:
        return None
    return PathFinder.find_spec(name, above.submodule_search_locations)


def _whole(package: str) -> Iterator[tuple[str, bytes]]:
    """All files of code of a package, each with its own name."""
    spec = _spec(package)
    for folder in map(Path, (spec and spec.submodule_search_locations) or ()):
        for path in sorted(folder.rglob("*")):
            if path.name.endswith(CODE_SUFFIXES):
                yield f"{package}/{path.relative_to(folder).as_posix()}", path.read_bytes()
