"""Versions of plugins: of their packages, and digests of the code that they run.

A checkout changes its code without changing its version. The digest tells.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from typing import Any

from isacbench.plugins.class_code import ClassCode, attributes_digest, class_code, has_a_file
from isacbench.plugins.discovery import GROUPS, RegisteredPlugin, entries, local_plugins
from isacbench.plugins.import_closure import digest_of, import_closure, is_importable, is_installed
from isacbench.plugins.local_files import PluginFile
from isacbench.plugins.parameters import parameter_fields

LIBRARY = "isacbench"
OWN = "isacbench.", "isacbench_algorithms."

VERSIONED = {*sys.stdlib_module_names, "numpy", "scipy"} - {"__main__"}
"""Packages whose versions every row has."""


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
        their modules and of all that these import from the same top-level
        package, None where they are not on disk. Of a script or a notebook,
        and of classes that are made in functions, the classes count, with all
        functions and values that they use, and the modules that these come
        from; of other people's packages the version alone. What is imported
        from `isacbench` itself, `library_code` tells.

    Examples
    --------
    >>> from isacbench.plugins.registry import get_estimator
    >>> found = plugin_version(get_estimator("oracle"))
    >>> list(found), found["isacbench"]["version"], len(found["isacbench"]["digest"])
    (['isacbench'], '0.2.0', 64)
    """
    local = {file.module_name: file for file in local_plugins()}
    found: dict[str, dict[str, str | None]] = {}
    packaged: dict[tuple[str, str | None], set[str]] = {}
    for module in _modules(plugin):
        if module in local:
            found[_shown(local[module])] = {"version": None, "digest": local[module].digest}
        elif is_importable(module) and module.partition(".")[0] != LIBRARY:
            packaged.setdefault(_distribution(_root(module)), set()).add(module)
    for (package, version), modules in packaged.items():
        is_released = all(map(_is_released, modules))
        found[package] = {"version": version, "digest": None if is_released else _digest(modules)}
    for base, code in own_codes(plugin).items():
        found[f"{base.__module__}.{base.__qualname__}"] = {"version": None, "digest": code.digest}
    for part in plugin_parts(plugin):
        name = f"{type(part).__module__}.{type(part).__qualname__}"
        parameters = [field.name for field in parameter_fields(part)]
        if not name.startswith(OWN) and (digest := attributes_digest(part, parameters)):
            found[f"attributes of {name}"] = {"version": None, "digest": digest}
    return dict(sorted(found.items()))


def library_code(plugin: object, harness: Iterable[str] = ()) -> str:
    """Compute the digest of the code of isacbench that a plugin and the harness run.

    Parameters
    ----------
    plugin : Estimator, TruthEstimator or Detector
        Together with the detectors in its parameters.
    harness : iterable of str
        Modules of isacbench that every row follows from.

    Returns
    -------
    str
        SHA-256, hexadecimal.

    Examples
    --------
    >>> from isacbench.plugins.registry import get_estimator
    >>> library_code(get_estimator("music2d")) == library_code(get_estimator("nomp4d"))
    False
    """
    local = {file.module_name: file.source for file in local_plugins()}
    modules = _modules(plugin)
    sources = tuple((name, local[name]) for name in sorted(modules & local.keys()))
    others = (module for module in modules - local.keys() if is_importable(module))
    found = frozenset(module for module in others if not _is_released(module))
    return _library_digest(found, frozenset(harness), sources)


def _shown(file: PluginFile) -> str:
    """Name of a local file, with a part of its digest where another one has the same name."""
    namesakes = [other for other in local_plugins() if other.filename == file.filename]
    return file.filename if len(namesakes) == 1 else file.code_name


def plugin_parts(plugin: object) -> Iterator[object]:
    """Yield a plugin and the dataclasses among its parameters, at any depth.

    Parameters
    ----------
    plugin : object

    Yields
    ------
    object
    """
    if isinstance(plugin, (list, tuple)):
        for item in plugin:
            yield from plugin_parts(item)
    elif dataclasses.is_dataclass(plugin):
        yield plugin
        for field in dataclasses.fields(plugin):
            yield from plugin_parts(getattr(plugin, field.name))


def foreign_classes(plugin: object) -> tuple[str, ...]:
    """Name the classes of a plugin and of its parts that are not of isacbench.

    Parameters
    ----------
    plugin : object

    Returns
    -------
    tuple of str
    """
    parts = {f"{type(part).__module__}.{type(part).__qualname__}" for part in plugin_parts(plugin)}
    return tuple(sorted(name for name in parts if not name.startswith(OWN)))


def _classes(plugin: object) -> set[type[Any]]:
    """Classes of a plugin and of its parts, and their bases, but for Python's own and the library's."""
    classes = {base for part in plugin_parts(plugin) for base in type(part).__mro__}
    return {base for base in classes if not (_is_versioned(base.__module__) and has_a_file(base))}


def _is_versioned(module: str) -> bool:
    """Tell whether a module is Python's own, the library's, or of a package whose version every row has."""
    return module.partition(".")[0] in {*VERSIONED, LIBRARY}


def own_codes(plugin: object) -> dict[type[Any], ClassCode]:
    """Find the codes of a plugin's classes whose files, if there are any, do not say all about them.

    Parameters
    ----------
    plugin : object

    Returns
    -------
    dict of type to ClassCode
    """
    local = {file.module_name for file in local_plugins()}
    classes = (base for base in _classes(plugin) if base.__module__ not in local)
    return {base: class_code(base) for base in classes if not has_a_file(base)}


def _modules(plugin: object) -> frozenset[str]:
    """Modules of those classes, and of what those without a file use."""
    used = (code.modules for code in own_codes(plugin).values())
    modules = frozenset(base.__module__ for base in _classes(plugin)).union(*used)
    return frozenset(module for module in modules if module.partition(".")[0] not in VERSIONED)


def _root(module: str) -> str:
    """Outermost package of a module that has code of its own: a namespace has none, and many owners."""
    parts = module.split(".")
    names = [".".join(parts[: n + 1]) for n in range(len(parts))]
    files = ((name, getattr(import_module(name), "__file__", None)) for name in names)
    return next((name for name, file in files if file is not None), module)


def _is_released(module: str) -> bool:
    """Tell whether a module is of an installed package with a version, that registers no plugins."""
    root = _root(module)
    is_there = is_installed(getattr(sys.modules[root], "__file__", None) or "")
    return is_there and _distribution(root)[1] is not None and not (root == LIBRARY or _registered_by(root))


def _registered_by(root: str) -> RegisteredPlugin | None:
    """Some plugin of a distribution that registers plugins of a package."""
    registered = (entry for kind in GROUPS for entry in entries(kind).values() if entry.version is not None)
    return next((one for one in registered if f"{one.module}.".startswith(f"{root}.")), None)


@cache
def _distribution(root: str) -> tuple[str, str | None]:
    """Name and version of the distribution that registers plugins of a package, else the package's own."""
    entry = _registered_by(root)
    return (
        (entry.package, entry.version) if entry else (root, getattr(sys.modules[root], "__version__", None))
    )


def _digest(modules: Iterable[str]) -> str | None:
    """Digest of modules and of what they import from their own packages."""
    code = import_closure(modules, {_root(module) for module in modules})
    return digest_of(code) if code else None


@cache
def _library_digest(
    modules: frozenset[str], harness: frozenset[str], sources: tuple[tuple[str, str], ...]
) -> str:
    """Digest of what modules, and texts of modules, import from isacbench, and of the harness."""
    packages = {LIBRARY, *(_root(module) for module in modules)}
    code = import_closure(modules | harness, packages, dict(sources))
    return digest_of({name: text for name, text in code.items() if name.partition(".")[0] == LIBRARY})
