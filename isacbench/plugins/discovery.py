"""Discovery of plugins: names registered by entry points of packages, and by plugin files of this process."""

from __future__ import annotations

import hashlib
import inspect
import linecache
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.metadata import Distribution, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

from isacbench.errors import InputError
from isacbench.files.checked_files import SOURCE_BYTES, read_text
from isacbench.process_state import process_state_kept

PluginKind = Literal["estimator", "detector", "metric"]

GROUPS: dict[PluginKind, str] = {kind: f"isacbench.{kind}s" for kind in get_args(PluginKind)}

METHODS: dict[PluginKind, str] = {"estimator": "estimate", "detector": "detect", "metric": "score"}
"""Method that makes a class with a name a plugin of a kind."""

LIBRARIES = {"isacbench", "numpy", "scipy", "threadpoolctl", *sys.stdlib_module_names} - {"__main__"}
"""Packages that call a plugin, or that a plugin calls."""


@dataclass(frozen=True)
class PluginFile:
    """A Python file by its content, so that another process or machine can have the same.

    Attributes
    ----------
    filename : str
        Without folders, such as ``strongest.py``.
    source : str
    path : str
        Where it was read, as it was named; empty if it was not.
    """

    filename: str
    source: str
    path: str = field(default="", compare=False)

    @classmethod
    def read(cls, path: str | Path) -> PluginFile:
        """Read a file of Python source."""
        path = Path(path)
        if path.suffix != ".py":
            raise InputError(f"plugin {path}: allowed is a Python file that ends in .py")
        return cls(path.name, read_text(path, SOURCE_BYTES), str(path))

    @property
    def digest(self) -> str:
        """SHA-256 of the text, hexadecimal; what the file is called does not matter."""
        return hashlib.sha256(self.source.encode()).hexdigest()

    @property
    def code_name(self) -> str:
        """Name of the file in tracebacks: its name, and digits that tell files of one name apart."""
        return f"plugin-{self.digest[:8]}/{self.filename}"

    @property
    def module_name(self) -> str:
        """Name in `sys.modules`: the same wherever the content is."""
        stem = re.sub(r"\W", "_", Path(self.filename).stem)
        return f"isacbench_plugin_{stem}_{self.digest[:16]}"


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


_files: dict[PluginFile, tuple[RegisteredPlugin, ...]] = {}
"""Plugin files of this process, and what each registers."""


def entries(kind: PluginKind) -> dict[str, RegisteredPlugin]:
    """Look up everything registered of a kind, by name, which two packages or files must not share."""
    local = [entry for registered in _files.values() for entry in registered if entry.kind == kind]
    named: dict[str, RegisteredPlugin] = {}
    for entry in (*_installed(kind, tuple(sys.path)), *local):
        if entry.name in named:
            first, second = (f"{one.origin} ({one.target})" for one in (named[entry.name], entry))
            raise InputError(
                f"{entry.kind} {entry.name!r} is registered twice, by {first} and by {second}: "
                "names must be unique, uninstall or rename one"
            )
        named[entry.name] = entry
    return named


def load_plugin_file(path: str | Path) -> list[str]:
    """Register the plugins that a Python file defines, and list their names in order.

    The file may import what is installed, but no file next to it, because other processes get its
    content alone.
    """
    return register_plugin(PluginFile.read(path))


def register_plugin(file: PluginFile) -> list[str]:
    """Register what a plugin file defines, and list the names; equal content is registered once."""
    if not entries_of(file):
        with ExitStack() as stack:
            stack.callback(_forget, file)
            _files[file] = _defined(file, _run(file))
            for kind in GROUPS:
                entries(kind)  # refuses names that are registered already
            stack.pop_all()
    return list(dict.fromkeys(entry.name for entry in entries_of(file)))


def entries_of(file: PluginFile) -> tuple[RegisteredPlugin, ...]:
    """Look up what a file of this content has registered, whatever it was called; empty if nothing."""
    return next((found for other, found in _files.items() if other.digest == file.digest), ())


def local_plugins() -> tuple[PluginFile, ...]:
    """List the plugin files of this process in order; another process registers them for the same names."""
    return tuple(_files)


@contextmanager
def isolated_plugins() -> Iterator[None]:
    """Forget at the end which plugin files were registered within."""
    before = set(_files)
    try:
        yield
    finally:
        for file in _files.keys() - before:
            _forget(file)


def error_place(error: BaseException, module: str = "") -> str:
    """Find where the code of a plugin has raised an exception: file, line and function.

    It is the innermost frame of the plugin's own package, where its module is known, else of any
    code but `LIBRARIES`; empty if there is none.
    """
    own = others = ""
    # By the names of modules: a plugin's file may lie in any folder, one called numpy as well.
    for frame, line in traceback.walk_tb(error.__traceback__):
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        place = f"{Path(frame.f_code.co_filename).name}, line {line}, in {frame.f_code.co_name}"
        if package == module.partition(".")[0]:
            own = place
        elif package not in LIBRARIES:
            others = place
    return own or others


@lru_cache(maxsize=8)
def _installed(kind: PluginKind, _path: tuple[str, ...]) -> tuple[RegisteredPlugin, ...]:
    """Entries of the packages on the import path; looked up once, because a run asks often."""
    return tuple(
        RegisteredPlugin(kind, one.name, one.value, *_name_and_version(one.dist), one.load)
        for one in entry_points(group=GROUPS[kind])
        if one.dist
    )


@cache
def _name_and_version(package: Distribution) -> tuple[str, str]:
    """Name and version of a package, which reads its metadata each time that it is asked."""
    return package.name, package.version


def _defined(file: PluginFile, module: ModuleType) -> tuple[RegisteredPlugin, ...]:
    """Plugins among the classes that a file defines; imported classes and abstract ones do not count."""
    classes: list[Any] = [
        value
        for key, value in vars(module).items()
        if inspect.isclass(value) and value.__module__ == module.__name__ and key == value.__name__
    ]
    found = tuple(
        entry
        for one in classes
        if not inspect.isabstract(one)
        for entry in class_entries(one, file.code_name, file.filename)
    )
    if not found:
        raise InputError(
            f"plugin {file.filename}: it defines no class with a class attribute `name` and a method "
            f"`estimate`, `detect` or `score`; its classes are "
            f"{', '.join(one.__name__ for one in classes) or 'none'}"
        )
    return found


def class_entries(plugin: Any, module: str, package: str) -> list[RegisteredPlugin]:
    """Describe a class with a name as if it was registered, for each kind that it has the method of."""
    name, target = getattr(plugin, "name", None), f"{module}:{plugin.__qualname__}"
    return [
        RegisteredPlugin(kind, name, target, package, None, lambda: plugin)
        for kind, method in METHODS.items()
        if isinstance(name, str) and callable(getattr(plugin, method, None))
    ]


def _run(file: PluginFile) -> ModuleType:
    """Execute a file as a module that pickle, type hints and tracebacks find."""
    module = ModuleType(file.module_name)
    module.__file__ = file.code_name
    # Without a time of modification an entry stays, though no such file exists.
    lines = file.source.splitlines(keepends=True)
    linecache.cache[file.code_name] = len(file.source), None, lines, file.code_name
    sys.modules[file.module_name] = module
    try:
        with process_state_kept(at_import=True):
            exec(compile(file.source, file.code_name, "exec", dont_inherit=True), vars(module))
    except (Exception, SystemExit) as error:
        # A syntax error has no frame in the file.
        frames: list[Any] = [*traceback.extract_tb(error.__traceback__), error]
        lines_in = [one.lineno for one in frames if getattr(one, "filename", None) == file.code_name]
        place = f"line {lines_in[-1]}: " if lines_in else ""
        reason = f"{place}{type(error).__name__}: {error}"
        raise InputError(f"plugin {file.filename}: cannot be imported: {reason}") from error
    return module


def _forget(file: PluginFile) -> None:
    """Undo the registration of a plugin file."""
    _files.pop(file, None)
    sys.modules.pop(file.module_name, None)
    linecache.cache.pop(file.code_name, None)
