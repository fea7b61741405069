"""Discovery of plugins: names registered by entry points of packages, and by plugin files of this process."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal, cast, get_args

from isacbench.errors import InputError
from isacbench.plugins.local_files import PluginFile, forget_module, import_plugins

PluginKind = Literal["estimator", "detector", "metric"]

GROUPS: dict[PluginKind, str] = {kind: f"isacbench.{kind}s" for kind in get_args(PluginKind)}


@dataclass(frozen=True)
class RegisteredPlugin:
    """Registered name of a class.

    Attributes
    ----------
    kind : {"estimator", "detector", "metric"}
    name : str
    target : str
        Module, or file, and class.
    package : str
        Distribution, or file, that registers it.
    version : str or None
        Of the distribution.
    load : callable
        Imports the class, or whatever is registered in its stead.
    """

    kind: PluginKind
    name: str
    target: str
    package: str
    version: str | None
    load: Callable[[], Any] = field(repr=False, compare=False)

    @property
    def origin(self) -> str:
        """Package and version, such as ``isacbench 0.1.0``, or the file."""
        return self.package if self.version is None else f"{self.package} {self.version}"

    @property
    def module(self) -> str:
        """Module, or file, without the class."""
        return self.target.partition(":")[0]


Registered = dict[PluginFile, tuple[RegisteredPlugin, ...]]

_everywhere: Registered = {}
_within: ContextVar[Registered] = ContextVar("plugin files of a thread or task", default=_everywhere)
_users: Counter[str] = Counter()
"""Numbers of registrations that have a module in use, by its name."""


def entries(kind: PluginKind) -> dict[str, RegisteredPlugin]:
    """Look up everything registered of a kind, by name.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}

    Returns
    -------
    dict of str to RegisteredPlugin

    Raises
    ------
    InputError
        If two packages or files claim the same name, naming both.
    """
    installed = _installed(kind, _import_path())
    local = [entry for registered in _within.get().values() for entry in registered if entry.kind == kind]
    return _by_name([*installed, *local])


def load_plugin_file(path: str | Path) -> list[str]:
    """Register the estimators, detectors and metrics that a Python file defines.

    Parameters
    ----------
    path : str or Path
        A self-contained file. It may import what is installed, but no file next
        to it, because other processes get its content alone.

    Returns
    -------
    list of str
        Names, in the order of definition.

    Raises
    ------
    InputError
        As `PluginFile.read` and `register_plugin` do.
    """
    return register_plugin(PluginFile.read(path))


def register_plugin(file: PluginFile) -> list[str]:
    """Register what a plugin file defines; a second time with equal content changes nothing.

    Parameters
    ----------
    file : PluginFile

    Returns
    -------
    list of str
        Names, in the order of definition.

    Raises
    ------
    InputError
        If the file fails, defines no plugin, or one whose name is taken.
    """
    if not entries_of(file):
        added = tuple(_local_entry(file, cast("PluginKind", kind), cls) for kind, cls in import_plugins(file))
        try:
            for kind in GROUPS:
                _by_name([*entries(kind).values(), *(entry for entry in added if entry.kind == kind)])
        except InputError:
            forget_module(file)
            raise
        _within.get()[file] = added
        _users[file.module_name] += 1
    return list(dict.fromkeys(entry.name for entry in entries_of(file)))


def entries_of(file: PluginFile) -> tuple[RegisteredPlugin, ...]:
    """Look up what a file of this content has registered.

    Parameters
    ----------
    file : PluginFile
        Its name does not matter.

    Returns
    -------
    tuple of RegisteredPlugin
        Empty if no such file is registered.
    """
    return next((found for other, found in _within.get().items() if other.digest == file.digest), ())


def local_plugins() -> tuple[PluginFile, ...]:
    """List the plugin files of this process in order; another process registers them for the same names."""
    return tuple(_within.get())


@contextmanager
def isolated_plugins() -> Iterator[None]:
    """Forget at the end which plugin files were registered within; other threads do not know of them."""
    before = _within.get()
    own = dict(before)
    token = _within.set(own)
    try:
        yield
    finally:
        _within.reset(token)
        for file in own.keys() - before.keys():
            _users[file.module_name] -= 1
            if not _users[file.module_name]:
                forget_module(file)


@lru_cache(maxsize=8)
def _installed(kind: PluginKind, _path: tuple[object, ...]) -> tuple[RegisteredPlugin, ...]:
    """Entries of the packages on the import path; cached, because a run asks often."""
    return tuple(
        RegisteredPlugin(
            kind,
            entry.name,
            entry.value,
            entry.dist.name if entry.dist else entry.value,
            entry.dist.version if entry.dist else None,
            entry.load,
        )
        for entry in entry_points(group=GROUPS[kind])
    )


def _import_path() -> tuple[tuple[str, int], ...]:
    """Folders that packages are found in, and the time of the last installation or removal in each."""
    folders = (Path(folder) for folder in sys.path)
    return tuple((str(folder), folder.stat().st_mtime_ns) for folder in folders if folder.exists())


def _local_entry(file: PluginFile, kind: PluginKind, plugin: type[Any]) -> RegisteredPlugin:
    target = f"{file.code_name}:{plugin.__qualname__}"
    return RegisteredPlugin(kind, plugin.name, target, file.filename, None, lambda: plugin)


def _by_name(found: Iterable[RegisteredPlugin]) -> dict[str, RegisteredPlugin]:
    """Entries by name, which must be unique."""
    named: dict[str, RegisteredPlugin] = {}
    for entry in found:
        if entry.name in named:
            first, second = (f"{one.origin} ({one.target})" for one in (named[entry.name], entry))
            raise InputError(
                f"{entry.kind} {entry.name!r} is registered twice, by {first} and by {second}: "
                "names must be unique, uninstall or rename one"
            )
        named[entry.name] = entry
    return named
