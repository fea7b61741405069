"""Files of code of a package or a module: what they import, and a digest that tells if they changed."""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Iterable, Sequence
from functools import lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec
from pathlib import Path

CODE_SUFFIXES = tuple(SOURCE_SUFFIXES + EXTENSION_SUFFIXES)

ALGORITHMS = "isacbench_algorithms"
VERSIONED = {*sys.stdlib_module_names, "numpy", "scipy", "isacbench"} - {"__main__"}
"""Packages that every row names anyway."""


IMPORTS = re.compile(rb"(?:^|[;:])[ \t]*(?:from[ \t]+(\w+)|import[ \t]+([\w., \t]+))", re.MULTILINE)
NAMES = re.compile(rb"(?:^|,)\s*(\w+)")
"""Outermost names in what follows ``import``."""


def root_of(module: str) -> str:
    """Outermost package of a module, or the module itself."""
    return module.partition(".")[0]


def is_importable(module: str) -> bool:
    """Tell whether another process with the same paths finds a module by its name."""
    return root_of(module) in VERSIONED or _spec(module) is not None


def is_installed(root: str) -> bool:
    """Tell whether a package is in a folder that packages are installed into."""
    spec = _spec(root)
    places = (spec.origin, *(spec.submodule_search_locations or ())) if spec else ()
    return any(not {"site-packages", "dist-packages"}.isdisjoint(Path(one).parts) for one in places if one)


def imported_roots(source: bytes) -> set[str]:
    """Outermost packages that a source imports, but for Python's and those of isacbench itself."""
    found = IMPORTS.findall(source)
    names = {name.decode() for one, several in found for name in (one, *NAMES.findall(several))}
    return names - VERSIONED - {""}


def own_packages(roots: Iterable[str]) -> set[str]:
    """Those of some packages that are the user's, not installed, and the estimators of isacbench."""
    return {one for one in roots if one == ALGORITHMS or (is_importable(one) and not is_installed(one))}


def with_imports(roots: Iterable[str]) -> set[str]:
    """Packages or modules, and what they import of the user's packages, directly or not."""
    found, waiting = {*roots}, [*roots]
    while waiting:
        root = waiting.pop()
        files = {} if root == ALGORITHMS or is_installed(root) else _files(root)
        imported = set().union(*(_read(path)[1] for path in files.values())) - found
        new = own_packages(imported)
        found |= new
        waiting += new
    return found


def files_digest(roots: Iterable[str], folders: Sequence[str] = ("",)) -> str:
    """SHA-256 of all files of code of packages or modules, or of some folders of theirs."""
    total = hashlib.sha256()
    for root in sorted(roots):
        for module, path in sorted(_files(root, folders).items()):
            total.update(f"{module} {_file_digest(module, path)}\n".encode())
    return total.hexdigest()


def _spec(module: str) -> ModuleSpec | None:
    """Find the outermost package of a module, not in `sys.modules`: some was made in this process alone."""
    root = root_of(module)
    found = (finder.find_spec(root, None) for finder in sys.meta_path if root not in ("", "__main__"))
    return next((spec for spec in found if spec), None)


def _files(root: str, folders: Sequence[str] = ("",)) -> dict[str, str]:
    """Files of code of a package or a module, by the names of their modules."""
    spec = _spec(root)
    if spec is None or spec.submodule_search_locations is None:
        return {root: spec.origin} if spec and spec.has_location and spec.origin else {}
    found = {}
    for top in spec.submodule_search_locations:
        for folder, _, names in (one for part in folders for one in os.walk(Path(top, part))):
            package = root + folder[len(top) :].replace(os.sep, ".")
            for name in names:
                if name.endswith(CODE_SUFFIXES):
                    module = f"{package}.{name.partition('.')[0]}".removesuffix(".__init__")
                    found[module] = f"{folder}{os.sep}{name}"
    return found


_seen: dict[str, tuple[ModuleSpec | None, str]] = {}


def _file_digest(module: str, path: str) -> str:
    """Digest of a file.

    A module that is loaded again, as in a notebook, counts as its file is then. If the file has
    changed since, nobody knows which code runs, here and in workers: both count.
    """
    loaded, now = getattr(sys.modules.get(module), "__spec__", None), _read(path)[0]
    if path not in _seen or _seen[path][0] is not loaded:
        _seen[path] = loaded, now
    before = _seen[path][1]
    return now if before == now else f"{before} {now}"


def _read(path: str) -> tuple[str, set[str]]:
    """Digest of a file, and the packages that it imports."""
    status = Path(path).stat()
    return _read_once(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4096)
def _read_once(path: str, _time_ns: int, _size: int) -> tuple[str, set[str]]:
    content = Path(path).read_bytes()
    return hashlib.sha256(content).hexdigest(), imported_roots(content)
