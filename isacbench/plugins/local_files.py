"""Local plugin files: self-contained, identified by their content, imported without an installation."""

from __future__ import annotations

import hashlib
import inspect
import linecache
import re
import sys
import traceback
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from isacbench.errors import InputError
from isacbench.files.checked_files import SOURCE_BYTES, read_text, require_file
from isacbench.process_state import process_state_kept

METHODS = {"estimator": "estimate", "detector": "detect", "metric": "score"}
"""Method that makes a class with a name a plugin of a kind."""

DIGEST_SHOWN = 8
"""Digits of the digest that tell files of one name apart in tracebacks."""


@dataclass(frozen=True)
class PluginFile:
    """A Python file by its content, so that another process or machine can have the same.

    Attributes
    ----------
    filename : str
        Without folders, such as ``strongest.py``.
    source : str
        Its text.
    path : str
        Where it was read, as it was named; empty if it was not.
    """

    filename: str
    source: str
    path: str = field(default="", compare=False)

    @classmethod
    def read(cls, path: str | Path) -> PluginFile:
        """Read a file.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        PluginFile

        Raises
        ------
        InputError
            If there is no such file, or it is no Python source.
        """
        path = Path(path)
        if path.suffix != ".py":
            raise InputError(f"plugin {path}: allowed is a Python file that ends in .py")
        require_file(path)
        return cls(path.name, read_text(path, SOURCE_BYTES), str(path))

    @property
    def digest(self) -> str:
        """SHA-256 of the text, hexadecimal; what the file is called does not matter."""
        return hashlib.sha256(self.source.encode()).hexdigest()

    @property
    def code_name(self) -> str:
        """Name of the file in tracebacks: a part of its digest, and its name."""
        return f"plugin-{self.digest[:DIGEST_SHOWN]}/{self.filename}"

    @property
    def module_name(self) -> str:
        """Name in `sys.modules`: the same wherever the content is."""
        stem = re.sub(r"\W", "_", Path(self.filename).stem)
        return f"isacbench_plugin_{stem}_{self.digest[:16]}"


def import_plugins(file: PluginFile) -> list[tuple[str, type[Any]]]:
    """Run a plugin file as a module and find the plugins among the classes that it defines.

    Parameters
    ----------
    file : PluginFile

    Returns
    -------
    list of (str, type)
        Kind, a key of `METHODS`, and class, in the order of definition.
        Imported classes and abstract ones do not count.

    Raises
    ------
    InputError
        If the file fails, with its line, or defines no plugin.
    """
    module = _run(file)
    defined = [
        value
        for key, value in vars(module).items()
        if inspect.isclass(value) and value.__module__ == module.__name__ and key == value.__name__
    ]
    found = [
        (kind, plugin)
        for plugin in defined
        for kind, method in METHODS.items()
        if isinstance(getattr(plugin, "name", None), str)
        and callable(getattr(plugin, method, None))
        and not inspect.isabstract(plugin)
    ]
    if not found:
        forget_module(file)
        raise InputError(
            f"plugin {file.filename}: it defines no class with a class attribute `name` and a method "
            f"`estimate`, `detect` or `score`; its classes are "
            f"{', '.join(cls.__name__ for cls in defined) or 'none'}"
        )
    return found


def forget_module(file: PluginFile) -> None:
    """Undo the import of a plugin file.

    Parameters
    ----------
    file : PluginFile
    """
    sys.modules.pop(file.module_name, None)
    linecache.cache.pop(file.code_name, None)


def _run(file: PluginFile) -> ModuleType:
    """Execute a file as a module that pickle, type hints and tracebacks find."""
    module = ModuleType(file.module_name)
    module.__file__ = file.code_name
    # Without a time of modification an entry stays, though no such file exists.
    lines = file.source.splitlines(keepends=True)
    linecache.cache[file.code_name] = len(file.source), None, lines, file.code_name
    sys.modules[file.module_name] = module
    try:
        # What it prints is no part of a command's output, which may be JSON.
        with process_state_kept(at_import=True), redirect_stdout(sys.stderr):
            exec(compile(file.source, file.code_name, "exec", dont_inherit=True), vars(module))
    except BaseException as error:
        forget_module(file)
        if not isinstance(error, (Exception, SystemExit)):
            raise
        reason = f"{_place(file, error)}{type(error).__name__}: {error}"
        raise InputError(f"plugin {file.filename}: cannot be imported: {reason}") from error
    return module


def _place(file: PluginFile, error: BaseException) -> str:
    """Line of the file at which an error arose, where it arose in one."""
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename == file.code_name and frame.lineno
    ]
    if isinstance(error, SyntaxError) and error.filename == file.code_name and error.lineno:
        lines.append(error.lineno)
    return f"line {lines[-1]}: " if lines else ""
