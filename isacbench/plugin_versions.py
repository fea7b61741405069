"""Which code a plugin is: its version, and a digest of its sources, which a checkout changes without one."""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES
from pathlib import Path
from typing import Any

from isacbench.entries import GROUPS, entries, local_plugins
from isacbench.plugin_files import PluginFile

__all__ = ["plugin_version"]

CODE_SUFFIXES = tuple(SOURCE_SUFFIXES + EXTENSION_SUFFIXES)


def plugin_version(plugin: object) -> dict[str, dict[str, str | None]]:
    """Identify the code of an estimator or a detector, and of the detectors in its parameters.

    Parameters
    ----------
    plugin : Estimator or Detector

    Returns
    -------
    dict of str to dict
        For each distribution, or local file, that the classes and their bases
        come from: ``version``, None for a file, and ``digest``, the SHA-256 of
        the files of code in the top-level package, None where they are not on
        disk. What every plugin builds on, the package `isacbench` itself, is
        not looked at.

    Examples
    --------
    >>> from isacbench.registry import get_estimator
    >>> found = plugin_version(get_estimator("oracle"))
    >>> list(found), found["isacbench"]["version"], len(found["isacbench"]["digest"])
    (['isacbench'], '0.1.0', 64)
    """
    local = {file.module_name: file for file in local_plugins()}
    found: dict[str, dict[str, str | None]] = {}
    roots: dict[tuple[str, str | None], set[str]] = {}
    for module in {module for part in _parts(plugin) for module in _modules(type(part))}:
        if module in local:
            found[_shown(local[module])] = {"version": None, "digest": local[module].digest}
        else:
            root = _root(module)
            roots.setdefault(_distribution(root), set()).add(root)
    for (package, version), names in roots.items():
        found[package] = {"version": version, "digest": _digest(*sorted(names))}
    return dict(sorted(found.items()))


def _shown(file: PluginFile) -> str:
    """Name of a local file, with a part of its digest where another one has the same name."""
    namesakes = [other for other in local_plugins() if other.filename == file.filename]
    return file.filename if len(namesakes) == 1 else file.code_name


def _parts(plugin: object) -> Iterator[object]:
    """Yield a plugin and the dataclasses among its parameters, at any depth."""
    if isinstance(plugin, (list, tuple)):
        for item in plugin:
            yield from _parts(item)
    elif dataclasses.is_dataclass(plugin):
        yield plugin
        for field in dataclasses.fields(plugin):
            yield from _parts(getattr(plugin, field.name))


def _modules(plugin: type[Any]) -> Iterator[str]:
    """Modules that a class and its bases are defined in, without Python's and the harness's own."""
    for base in plugin.__mro__:
        if base.__module__.partition(".")[0] not in {*sys.stdlib_module_names, "isacbench"}:
            yield base.__module__


def _root(module: str) -> str:
    """Outermost package of a module that has code of its own: a namespace has none, and many owners."""
    parts = module.split(".")
    names = [".".join(parts[: n + 1]) for n in range(len(parts))]
    return next((name for name in names if import_module(name).__file__ is not None), module)


@cache
def _distribution(root: str) -> tuple[str, str | None]:
    """Name and version of the distribution that registers plugins of a package, else the package's own."""
    for kind in GROUPS:
        for entry in entries(kind).values():
            if entry.version is not None and (entry.module == root or entry.module.startswith(f"{root}.")):
                return entry.package, entry.version
    return root, getattr(sys.modules[root], "__version__", None)


@cache
def _digest(*roots: str) -> str | None:
    """Digest of the files of code of packages and single modules."""
    files = [found for root in roots for found in _code_files(root)]
    if not files:
        return None
    content = hashlib.sha256()
    for name, path in sorted(files):
        code = path.read_bytes()
        content.update(f"{name}\0{len(code)}\0".encode() + code)
    return content.hexdigest()


def _code_files(root: str) -> Iterator[tuple[str, Path]]:
    """Files of code of a package, or of a single module, each with its path from the package on."""
    module = import_module(root)
    folders = [Path(folder) for folder in getattr(module, "__path__", ())]
    for folder in folders:
        for path in folder.rglob("*"):
            if path.name.endswith(CODE_SUFFIXES):
                yield f"{root}/{path.relative_to(folder).as_posix()}", path
    if not folders and module.__file__ is not None and Path(module.__file__).is_file():
        yield root, Path(module.__file__)
