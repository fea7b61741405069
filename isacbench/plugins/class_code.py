"""Code of a class that no file holds: a digest of its functions and of all values that these use.

A class of a notebook, of a script, or made in a function is what its methods say, and
what constants, defaults, closures and containers hold at the time.
"""

from __future__ import annotations

import copyreg
import dataclasses
import dis
import hashlib
import pickle
import sys
import sysconfig
import uuid
from collections.abc import Collection, Iterator
from functools import cached_property
from io import BytesIO, IOBase, StringIO
from itertools import count
from pathlib import Path
from threading import Lock, RLock
from types import (
    BuiltinFunctionType,
    ClassMethodDescriptorType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MappingProxyType,
    MemberDescriptorType,
    MethodDescriptorType,
    MethodType,
    MethodWrapperType,
    ModuleType,
    WrapperDescriptorType,
)
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary, WeakValueDictionary, ref

from isacbench.errors import InputError
from isacbench.plugins.import_closure import is_importable, is_installed

PLAIN = bool, int, float, complex, str, type(None), type(Ellipsis)

MADE_BY_NUMPY = "<__array_function__ internals>"
"""Name that NumPy gives to the file of functions that it makes."""

LIBRARIES = {*map(sysconfig.get_path, ("stdlib", "platstdlib")), str(Path(__file__).parents[1])}
"""Folders of Python and of isacbench."""

UNKNOWN = uuid.uuid4
"""Makes a text for what nothing is known of; it is never the same."""

PROTOCOL = 4
"""Of the state of objects, as `pickle` takes it."""

STATELESS = type(Lock()), type(RLock()), IOBase, WeakKeyDictionary, WeakValueDictionary
"""Types of tools and caches, whose content does not change what an object computes."""

HEAP_TYPE = 1 << 9
"""Flag of the types that were not compiled in."""

DESCRIPTORS = (
    *(GetSetDescriptorType, MemberDescriptorType, MethodDescriptorType, WrapperDescriptorType),
    ClassMethodDescriptorType,
)
"""Types of members that code in C has."""

BY_NAME = {"globals", "eval", "exec"}
"""Built-in functions that values are found with that no instruction names."""

MADE_BY_PYTHON = {
    *("__module__", "__qualname__", "__doc__", "__dict__", "__weakref__", "__slotnames__", "__match_args__"),
    *("__annotations__", "__annotate__", "__annotate_func__", "__annotations_cache__", "__type_params__"),
    *("__firstlineno__", "__static_attributes__", "__abstractmethods__", "__orig_bases__", "__parameters__"),
    *("__dataclass_fields__", "__dataclass_params__", "_abc_impl", "_is_protocol", "__protocol_attrs__"),
    *("_is_runtime_protocol", "__non_callable_proto_members__"),
}
"""Members of classes that no author has written."""

MADE_BY_DATACLASS = {
    *("__init__", "__repr__", "__eq__", "__lt__", "__le__", "__gt__", "__ge__", "__hash__"),
    *("__setattr__", "__delattr__", "__getstate__", "__setstate__", "__replace__"),
}


class ClassCode(NamedTuple):
    """Code of a class.

    Attributes
    ----------
    name : str
        Its qualified name.
    digest : str
        SHA-256, hexadecimal, of its functions, of those that they use, and of all values.
    modules : frozenset of str
        Modules with a file, whose code it uses besides.
    homes : frozenset of str
        Modules without a file that its code is in.
    """

    name: str
    digest: str
    modules: frozenset[str]
    homes: frozenset[str]


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
    if not isinstance(module, str) or "<locals>" in name or not is_importable(module):
        return False
    if module == "builtins":  # of Python, or made by exec without the name of a module
        return isinstance(thing, type) and not thing.__flags__ & HEAP_TYPE
    members = vars(thing).values() if isinstance(thing, type) else (thing,)
    return all(_is_of_a_file(one) for one in members if isinstance(one, FunctionType))


def _is_of_a_file(function: FunctionType) -> bool:
    """Tell whether a function is of the module that it names; a wrapper names that of what it wraps."""
    module, path = function.__module__ or "", function.__code__.co_filename
    if path.startswith("<"):
        return is_importable(module) and (path == MADE_BY_NUMPY or function.__name__ in MADE_BY_DATACLASS)
    root = sys.modules.get(module.partition(".")[0])
    homes = {*LIBRARIES, getattr(root, "__file__", None), *getattr(root, "__path__", ())}
    is_known = is_installed(path) or not homes.isdisjoint({path, *map(str, Path(path).parents)})
    return is_known and is_importable(module)


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
    return _code_of(plugin_class, plugin_class.__qualname__)


def attributes_digest(plugin: object, parameters: Collection[str]) -> str | None:
    """Compute the digest of what an instance holds besides its parameters.

    Parameters
    ----------
    plugin : object
    parameters : collection of str

    Returns
    -------
    str or None
        SHA-256, hexadecimal; None if it holds nothing else.
    """
    kind = type(plugin)
    held = {
        name: value
        for name, value in sorted(_attributes(plugin).items())
        if name not in parameters and not isinstance(getattr(kind, name, None), cached_property)
    }
    return _code_of(held, kind.__qualname__).digest if held else None


def _code_of(thing: object, name: str) -> ClassCode:
    walk = _Walk()
    try:
        definitions = [walk.text(thing), *walk.definitions()]
    except RecursionError as error:
        raise InputError(f"{name}: uses values that are nested too deeply to be known again") from error
    digest = hashlib.sha256(repr(definitions).encode()).hexdigest()
    return ClassCode(name, digest, frozenset(walk.modules), frozenset(walk.homes))


class _Walk:
    """Walk over values. Classes and functions without a file are named in texts, and defined once."""

    def __init__(self) -> None:
        self.modules: set[str] = set()
        self.homes: set[str] = set()
        self._waiting: list[tuple[str, Any]] = []
        self._numbers = count(1)
        self._texts: dict[int, str] = {}
        self._kept: list[Any] = []  # so that none of the addresses is used again

    def definitions(self) -> Iterator[str]:
        """Yield the text of each class and function that was named, in the order of their names."""
        while self._waiting:
            name, thing = self._waiting.pop(0)
            yield f"{name}: {self._class(thing) if isinstance(thing, type) else self._function(thing)}"

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
            case bytes() | bytearray() | memoryview() if type(value) in (bytes, bytearray, memoryview):
                return f"{type(value).__name__} {hashlib.sha256(value).hexdigest()}"
            case list() | tuple() if type(value) in (list, tuple):
                return f"{type(value).__name__}({', '.join(map(self.text, value))})"
            case dict() | MappingProxyType() if type(value) in (dict, MappingProxyType):
                return f"dict({', '.join(map(self.text, value.items()))})"
            case set() | frozenset() if type(value) in (set, frozenset):
                texts = sorted(map(self.text, sorted(value, key=_first_look)))
                return f"{type(value).__name__}({', '.join(texts)})"
            case MethodType():
                return f"{self.text(value.__func__)} of {self.text(value.__self__)}"
            case MethodWrapperType():
                return f"{value.__name__} of {self.text(value.__self__)}"
            case BytesIO() | StringIO():
                return f"{type(value).__name__} {value.getvalue()!r}"
            case BuiltinFunctionType() if isinstance(value.__self__, (ModuleType, type(None))):
                return f"{value.__module__}.{value.__qualname__}"
            case property():
                return f"property({', '.join(map(self.text, (value.fget, value.fset, value.fdel)))})"
            case staticmethod() | classmethod():
                return f"{type(value).__name__}({self.text(value.__func__)})"
            case _ if isinstance(value, DESCRIPTORS):
                return f"{type(value).__name__} {value.__name__}"
            case CodeType():
                return _code_text(value)
            case ref():
                return f"reference to {self.text(value())}"
        return self._object(value)

    def _named(self, thing: Any) -> str:
        """Name of a class or a function; what has no file has a number as well, and is defined."""
        name = f"{thing.__module__}.{thing.__qualname__}"
        if has_a_file(thing):
            self.modules.add(thing.__module__)
            return name
        self.homes.add(str(thing.__module__))
        name = f"{name} {next(self._numbers)}"
        self._waiting.append((name, thing))
        return name

    def _object(self, value: Any) -> str:
        """Class and state of an object, as `pickle` would take it; of what it refuses, the attributes."""
        kind = type(value)
        if isinstance(value, STATELESS) or _is_shared_generator(value):
            return self.text(kind)
        reduce = copyreg.dispatch_table.get(kind)
        try:
            parts: Any = reduce(value) if reduce else value.__reduce_ex__(PROTOCOL)
        except Exception:
            parts = ""
        if isinstance(parts, str):  # a name, or nothing
            attributes = _attributes(value)
            is_found = parts != "" and vars(pickle)["whichmodule"](value, parts) != "__main__"
            parts = parts, attributes or (parts if is_found else UNKNOWN())
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
        is_dataclass = "__dataclass_params__" in vars(thing)
        members = {
            name: value
            for name, value in sorted(vars(thing).items())
            if name not in MADE_BY_PYTHON and not (is_dataclass and _is_made(thing, name, value))
        }
        fields = [
            (one.name, one.default, one.default_factory, one.init)
            for one in (dataclasses.fields(thing) if is_dataclass else ())
        ]
        params = repr(vars(thing).get("__dataclass_params__"))
        return self.text((type(thing), thing.__mro__[1:], members, fields, params))

    def _function(self, thing: FunctionType) -> str:
        known = thing.__globals__
        steps = list(_steps(thing.__code__))
        read = {name for op, name in steps if op in ("LOAD_GLOBAL", "LOAD_NAME")}
        # But for state that it sets itself.
        read -= {name for op, name in steps if op == "STORE_GLOBAL"}
        names = {name: known[name] for name in sorted(read) if name in known}
        if BY_NAME & read - names.keys():
            names["by name"] = str(UNKNOWN())
        modules = [one for one in names.values() if isinstance(one, ModuleType)]
        words = {name for _, name in steps}
        self._import(
            {*(one.__name__ for one in modules), *(name for op, name in steps if op == "IMPORT_NAME")}, words
        )
        # A script may have set them since the module was imported.
        constants = {
            f"{one.__name__}.{name}": vars(one)[name]
            for one in modules
            for name in sorted(words & vars(one).keys())
            if isinstance(vars(one)[name], PLAIN)
        }
        cells = [_content(cell) for cell in thing.__closure__ or ()]
        used = names, constants, thing.__defaults__, thing.__kwdefaults__, cells, vars(thing)
        return f"{_code_text(thing.__code__)} {self.text(used)}"

    def _import(self, modules: set[str], words: set[str]) -> None:
        """Count modules, and those below them that words may name."""
        inner = (name for name in list(sys.modules) if words.issuperset(name.split(".")[1:]))
        below = {name for name in inner for one in modules if name.startswith(f"{one}.")}
        self.modules |= {name for name in modules | below if is_importable(name)}


def _first_look(value: object) -> str:
    """Text by which the members of a set are put in an order, as far as they can be."""
    code = getattr(value, "__code__", None)
    if code is not None:
        return f"{getattr(value, '__qualname__', '')} {_code_text(code)}"
    return repr(value) if isinstance(value, PLAIN) else type(value).__qualname__


def _is_made(thing: type[Any], name: str, value: object) -> bool:
    """Tell whether the library of dataclasses has made a member."""
    if name == "__init__" and not vars(thing)["__dataclass_params__"].init:
        return False
    if name == "__hash__" and value is None:
        return True
    made = isinstance(value, FunctionType) and value.__code__.co_filename == "<string>"
    return name in MADE_BY_DATACLASS and made


def _is_shared_generator(value: object) -> bool:
    """Tell whether something is the generator of `numpy.random`, which every cell seeds anew."""
    module = sys.modules.get("numpy.random.mtrand")
    return module is not None and value is vars(module)["_rand"]


def _attributes(value: object) -> dict[str, Any]:
    """Attributes of an object, in slots or not."""
    slots = (name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ()))
    found = {name: getattr(value, name) for name in slots if hasattr(value, name)}
    return {**found, **getattr(value, "__dict__", {})}


def _content(cell: Any) -> Any:
    """Content of a cell of a closure; some are empty."""
    try:
        return cell.cell_contents
    except ValueError:
        return ...


def _steps(code: CodeType) -> Iterator[tuple[str, str]]:
    """Yield operations and the names that they are on, those of functions inside included."""
    for step in dis.get_instructions(code):
        if isinstance(step.argval, str):
            yield step.opname, step.argval
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _steps(constant)


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
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    names = code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    return repr((names, counts, code.co_code.hex(), code.co_exceptiontable.hex(), constants))
