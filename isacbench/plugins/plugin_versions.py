"""Versions of plugins: of their packages, and digests of the code that they run.

A checkout changes its code without changing its version. The digest tells.
"""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from inspect import unwrap
from types import CodeType, FunctionType
from typing import Any

from isacbench.plugins.discovery import GROUPS, entries, local_plugins
from isacbench.plugins.import_closure import digest_of, import_closure, is_importable
from isacbench.plugins.local_files import PluginFile

LIBRARY = "isacbench"

PLAIN = bool, int, float, complex, str, bytes, type(None), tuple
"""Types of class attributes that count in a digest."""

MADE_BY_PYTHON = "__module__", "__doc__", "__firstlineno__", "__static_attributes__"


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
        package, None where they are not on disk. Of a script or a notebook
        the classes count, and the functions that they use; likewise of classes
        that are made in functions. What is imported from `isacbench` itself,
        `library_code` tells.

    Examples
    --------
    >>> from isacbench.plugins.registry import get_estimator
    >>> found = plugin_version(get_estimator("oracle"))
    >>> list(found), found["isacbench"]["version"], len(found["isacbench"]["digest"])
    (['isacbench'], '0.1.0', 64)
    """
    local = {file.module_name: file for file in local_plugins()}
    found: dict[str, dict[str, str | None]] = {}
    packaged: dict[tuple[str, str | None], set[str]] = {}
    for module in _modules(plugin):
        if module in local:
            found[_shown(local[module])] = {"version": None, "digest": local[module].digest}
        elif is_importable(module):
            packaged.setdefault(_distribution(_root(module)), set()).add(module)
        else:
            found[module] = {"version": None, "digest": class_digest(_classes(plugin), module)}
    for (package, version), modules in packaged.items():
        found[package] = {"version": version, "digest": _digest(frozenset(modules))}
    for base in _classes(plugin):  # of two that functions of one module make, its file tells nothing
        if "<locals>" in base.__qualname__ and is_importable(base.__module__):
            name = f"{base.__module__}.{base.__qualname__}"
            found[name] = {"version": None, "digest": class_digest([base], base.__module__)}
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
    found = frozenset(module for module in modules - local.keys() if is_importable(module))
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


def _classes(plugin: object) -> set[type[Any]]:
    """Classes of a plugin and of its parts, and their bases, but for Python's own and the library's."""
    classes = {base for part in plugin_parts(plugin) for base in type(part).__mro__}
    own = {*sys.stdlib_module_names, LIBRARY} - {"__main__"}
    return {base for base in classes if base.__module__.partition(".")[0] not in own}


def _modules(plugin: object) -> frozenset[str]:
    """Modules of those classes."""
    return frozenset(base.__module__ for base in _classes(plugin))


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
def _digest(modules: frozenset[str]) -> str | None:
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


def class_digest(classes: Iterable[type[Any]], module: str) -> str:
    """Compute the digest of classes without a file, and of all of their module that they use.

    Parameters
    ----------
    classes : iterable of type
    module : str
        Classes of other modules do not count.

    Returns
    -------
    str
        SHA-256, hexadecimal: the same in every process of one version of
        Python that has the classes by their code.
    """
    waiting: list[Any] = [one for one in classes if one.__module__ == module]
    texts: dict[str, str] = {}
    while waiting:
        thing = waiting.pop()
        if thing.__qualname__ in texts:
            continue
        members = _members(thing)
        constants = sorted(f"{name}={value!r}" for name, value in members if isinstance(value, PLAIN))
        functions = [one for _, member in sorted(members) for one in _unwrapped(member)]
        texts[thing.__qualname__] = repr([*constants, *(_text(one.__code__) for one in functions)])
        for function in functions:
            used = (function.__globals__.get(name) for name in _names(function.__code__))
            waiting += [
                one for one in used if isinstance(one, (FunctionType, type)) and one.__module__ == module
            ]
    return hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()


def _members(thing: Any) -> list[tuple[str, Any]]:
    """Members of a class but for those that dataclasses make, or a function itself."""
    if isinstance(thing, FunctionType):
        return [("", thing)]
    return [
        (name, value)
        for name, value in vars(thing).items()
        if name not in MADE_BY_PYTHON and not (name.startswith("__") and _is_made(value))
    ]


def _is_made(value: object) -> bool:
    """Tell whether a function was compiled from a text of the library of dataclasses."""
    return isinstance(value, FunctionType) and value.__code__.co_filename == "<string>"


def _unwrapped(member: Any) -> list[FunctionType]:
    """Functions behind a member of a class: a property, a class method, a decorated function or itself."""
    if isinstance(member, property):
        found = [member.fget, member.fset, member.fdel]
    else:
        found = [getattr(member, "__func__", getattr(member, "func", member))]
    functions = [one for one in found if isinstance(one, FunctionType)]
    return [one for function in functions for one in dict.fromkeys([function, unwrap(function)])]


def _names(code: CodeType) -> Iterator[str]:
    """Global names that code uses, that of functions inside included."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _text(code: CodeType) -> str:
    """Instructions, names and constants of code, but neither its file nor its lines."""
    constants = [
        _text(one)
        if isinstance(one, CodeType)
        else repr(sorted(one, key=repr))
        if isinstance(one, frozenset)
        else repr(one)
        for one in code.co_consts
    ]
    return repr((code.co_name, code.co_code.hex(), code.co_names, code.co_varnames, constants))
