"""Targets of a check: a file, a package, or a registered name."""

from __future__ import annotations

import re
from typing import Any

from isacbench.errors import InputError, did_you_mean
from isacbench.files.escaping import quoted
from isacbench.plugins.discovery import (
    GROUPS,
    METHODS,
    PluginFile,
    PluginKind,
    RegisteredPlugin,
    entries,
    entries_of,
    register_plugin,
)


def find_plugins(package_or_file: str) -> list[tuple[PluginKind, str]]:
    """Find every estimator and detector that a package or a file provides.

    Parameters
    ----------
    package_or_file : str
        A Python file, which is registered; the name of a distribution, or of
        an import package; or a registered name.

    Returns
    -------
    list of (str, str)
        Kind and name: of a file in the order of definition, else estimators
        first, each kind by name.

    Raises
    ------
    InputError
        If it is none of these, or provides nothing.
    """
    if package_or_file.endswith(".py"):
        file = PluginFile.read(package_or_file)
        register_plugin(file)
        return [(entry.kind, entry.name) for entry in entries_of(file)]
    found = [entry for entry in _registered() if package_or_file in _names(entry)]
    if not found:
        known = sorted({name for entry in _registered() for name in _names(entry)})
        raise InputError(
            f"{package_or_file!r} is no registered name, and no package with entry points in "
            f"{' or '.join(GROUPS.values())}: {did_you_mean(package_or_file, known)}, or a file that ends "
            "in .py"
        )
    return [(entry.kind, entry.name) for entry in found]


def entries_of_class(plugin: type[Any]) -> list[RegisteredPlugin]:
    """Describe a class as if it was registered under its own name.

    Parameters
    ----------
    plugin : type
        Of an estimator or a detector, or of both.

    Returns
    -------
    list of RegisteredPlugin
        One for each kind that it has the method of.

    Raises
    ------
    InputError
        If it is neither.
    """
    name = getattr(plugin, "name", None)
    kinds = [kind for kind, method in METHODS.items() if callable(getattr(plugin, method, None))]
    if not kinds or not isinstance(name, str):
        raise InputError(
            f"{quoted(plugin)} is not a plugin: allowed are a registered name, the name of a package, a file "
            "that ends in .py, a class with a class attribute `name` and a method `estimate` or `detect`, "
            "and an instance of such a class"
        )
    target, module = f"{plugin.__module__}:{plugin.__qualname__}", plugin.__module__
    return [RegisteredPlugin(kind, name, target, module, None, lambda: plugin) for kind in kinds]


def _registered() -> list[RegisteredPlugin]:
    return [entry for kind in GROUPS for _, entry in sorted(entries(kind).items())]


def _names(entry: RegisteredPlugin) -> set[str]:
    """Names by which an entry is asked for: its own, its distribution's in two spellings, its package's."""
    if entry.version is None:
        return {entry.name}
    normalised = re.sub(r"[-_.]+", "-", entry.package).lower()
    return {entry.name, entry.package, normalised, entry.module.partition(".")[0]}
