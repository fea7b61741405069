"""Code of a class that no file holds: a digest of its functions and of all values that these use.

A class of a notebook, of a script, or made in a function is what its methods say, and
what constants, defaults, closures and containers hold at the time.
"""

from __future__ import annotations

import dis
import hashlib
from collections.abc import Iterator
from functools import cached_property
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from isacbench.errors import InputError
from isacbench.plugins.import_closure import is_importable

PLAIN = bool, int, float, complex, str, type(None), type(Ellipsis)
PROTOCOL = 4
"""Of the state of objects, as `pickle` takes it."""


class ClassCode(NamedTuple):
    """Code of a class.

    Attributes
    ----------
    digest : str
        SHA-256, hexadecimal, of its functions, of those that they use, and of all values.
    modules : frozenset of str
        Modules with a file, whose code it uses besides.
    """

    digest: str
    modules: frozenset[str]


known_codes: WeakKeyDictionary[type[Any], ClassCode] = WeakKeyDictionary()
"""Codes of classes that another process has sent, which it has found where the class was made."""


def has_a_file(thing: Any) -> bool:
    """Tell whether the file of its module says all about a class or a function.

    Parameters
    ----------
    thing : type or function

    Returns
    -------
    bool
        False where the module has no file, as that of a notebook, and for what a function has made.
    """
    module = getattr(thing, "__module__", None)
    name = getattr(thing, "__qualname__", "<locals>")
    return isinstance(module, str) and "<locals>" not in name and is_importable(module)


def class_code(plugin_class: type[Any]) -> ClassCode:
    """Find the code of a class without a file, as it is now.

    Parameters
    ----------
    plugin_class : type

    Returns
    -------
    ClassCode
        Equal for equal code and values, in every process of one version of Python.
    """
    if plugin_class in known_codes:
        return known_codes[plugin_class]
    walk = _Walk()
    walk.text(plugin_class)
    try:
        definitions = sorted(walk.definitions())
    except RecursionError as error:
        name = plugin_class.__qualname__
        raise InputError(f"{name}: uses values that are nested too deeply to be known again") from error
    return ClassCode(hashlib.sha256(repr(definitions).encode()).hexdigest(), frozenset(walk.modules))


class _Walk:
    """Walk over values. Classes and functions without a file are named in texts, and defined once."""

    def __init__(self) -> None:
        self.modules: set[str] = set()
        self._waiting: list[Any] = []
        self._texts: dict[int, str] = {}
        self._kept: list[Any] = []  # so that none of the addresses is used again

    def definitions(self) -> Iterator[str]:
        """Yield the text of each class and function that was named, in any order."""
        while self._waiting:
            thing = self._waiting.pop()
            yield self._class(thing) if isinstance(thing, type) else self._function(thing)

    def text(self, value: Any) -> str:
        """Text of a value, equal for equal ones."""
        if isinstance(value, PLAIN) and type(value) in PLAIN:
            return repr(value)
        if isinstance(value, ModuleType) and is_importable(value.__name__):
            self.modules.add(value.__name__)
            return value.__name__
        if id(value) not in self._texts:
            self._kept.append(value)
            self._texts[id(value)] = f"within itself: {type(value).__qualname__}"
            self._texts[id(value)] = self._walked(value)
        return self._texts[id(value)]

    def _walked(self, value: Any) -> str:
        match value:
            case type() | FunctionType():
                return self._named(value)
            case bytes() | bytearray():
                return f"{type(value).__name__} {hashlib.sha256(value).hexdigest()}"
            case list() | tuple() if type(value) in (list, tuple):
                return f"{type(value).__name__}({', '.join(map(self.text, value))})"
            case dict() if type(value) is dict:
                return (
                    f"dict({', '.join(f'{self.text(key)}: {self.text(one)}' for key, one in value.items())})"
                )
            case set() | frozenset():
                return f"{type(value).__name__}({', '.join(sorted(map(self.text, value)))})"
            case MethodType():
                return f"{self.text(value.__func__)} of {self.text(value.__self__)}"
            case BuiltinFunctionType() if isinstance(value.__self__, (ModuleType, type(None))):
                return f"{value.__module__}.{value.__qualname__}"
            case property():
                return f"property({', '.join(map(self.text, (value.fget, value.fset, value.fdel)))})"
            case staticmethod() | classmethod():
                return f"{type(value).__name__}({self.text(value.__func__)})"
        return self._object(value)

    def _named(self, thing: Any) -> str:
        """Name of a class or a function; what has no file is defined as well."""
        name = f"{thing.__module__}.{thing.__qualname__}"
        if has_a_file(thing):
            self.modules.add(thing.__module__)
            return name
        self._waiting.append(thing)
        code = "" if isinstance(thing, type) else f" {_digest(_code_text(thing.__code__))}"
        return f"{name}{code}"

    def _object(self, value: Any) -> str:
        """Class and state of an object, as `pickle` would take it; of what it refuses, the attributes."""
        kind, attributes = type(value), getattr(value, "__dict__", {})
        if "__wrapped__" in attributes:  # a cache, for example, of which pickle knows but the name
            return f"{self.text(kind)} around {self.text(attributes['__wrapped__'])}"
        try:
            parts = value.__reduce_ex__(PROTOCOL)
        except Exception:
            parts = (attributes,)
        if isinstance(parts, str):
            return f"{self.text(kind)} {parts}"
        texts = []
        for part in parts:
            if isinstance(part, Iterator):  # over the items of a list or a dictionary
                part = list(part)
            elif isinstance(part, dict):  # what is computed once is there or not, and means the same
                part = {
                    name: one
                    for name, one in part.items()
                    if not isinstance(getattr(kind, str(name), None), cached_property)
                }
            texts.append(self.text(part))
        return f"{self.text(kind)} {', '.join(texts)}"

    def _class(self, thing: type[Any]) -> str:
        members = {
            name: value
            for name, value in sorted(vars(thing).items())
            if not (name.startswith("__") or name == "_abc_impl") or _is_written(value)
        }
        return f"{self._own_name(thing)}: {self.text(thing.__mro__[1:])} {self.text(members)}"

    def _function(self, thing: FunctionType) -> str:
        names = {
            name: thing.__globals__[name]
            for name in _global_names(thing.__code__)
            if name in thing.__globals__
        }
        cells = [_content(cell) for cell in thing.__closure__ or ()]
        used = names, thing.__defaults__, thing.__kwdefaults__, cells, getattr(thing, "__wrapped__", None)
        return f"{self._own_name(thing)}: {_code_text(thing.__code__)} {self.text(used)}"

    def _own_name(self, thing: Any) -> str:
        return f"{thing.__module__}.{thing.__qualname__}"


def _is_written(value: object) -> bool:
    """Tell whether somebody has written a function, rather than the library of dataclasses."""
    return isinstance(value, FunctionType) and value.__code__.co_filename != "<string>"


def _content(cell: Any) -> Any:
    """Content of a cell of a closure; some are empty."""
    try:
        return cell.cell_contents
    except ValueError:
        return ...


def _global_names(code: CodeType) -> list[str]:
    """Global names that code reads, functions inside included, but those of state that it sets itself."""
    read: set[str] = set()
    waiting, is_set = [code], set()
    while waiting:
        one = waiting.pop()
        waiting += [constant for constant in one.co_consts if isinstance(constant, CodeType)]
        for step in dis.get_instructions(one):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                read.add(step.argval)
            elif step.opname == "STORE_GLOBAL":
                is_set.add(step.argval)
    return sorted(read - is_set)


def _code_text(code: CodeType) -> str:
    """Instructions, names and constants of code, but neither its file nor its lines."""
    constants = [
        _code_text(one)
        if isinstance(one, CodeType)
        else repr(sorted(one, key=repr))
        if isinstance(one, frozenset)
        else repr(one)
        for one in code.co_consts
    ]
    return repr((code.co_name, code.co_code.hex(), code.co_names, code.co_varnames, constants))


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
