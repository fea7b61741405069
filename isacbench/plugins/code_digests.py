"""Digests of the code of plugins: of packages' files, and of classes that no file holds, which travel.

A class of a notebook, of a script, or made in a function is what its methods say, and what
constants, defaults, closures and containers hold at the time. The instructions of its functions
are read and not their source: that is not there in a worker or a prompt, and a script's file may
have been edited since it was started. So such a class also travels to other processes by its code; one
that they can import travels by its name, as pickle has it.
"""

from __future__ import annotations

import builtins
import copy
import copyreg
import dataclasses
import dis
import hashlib
import io
import os
import pickle
import re
import sys
import uuid
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property, lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec
from pathlib import Path
from threading import Lock
from types import CodeType, FunctionType, ModuleType
from typing import Any, ClassVar, NamedTuple
from weakref import WeakKeyDictionary

import cloudpickle

from isacbench.errors import InputError
from isacbench.plugins.contracts import Estimator
from isacbench.plugins.discovery import local_plugins
from isacbench.plugins.registry import parameter_fields

CODE_SUFFIXES = tuple(SOURCE_SUFFIXES + EXTENSION_SUFFIXES)

ALGORITHMS = "isacbench_algorithms"
VERSIONED = {*sys.stdlib_module_names, "numpy", "scipy", "isacbench"} - {"__main__"}
"""Packages that every row names anyway."""

IMPORTS = re.compile(rb"(?:^|[;:])[ \t]*(?:from[ \t]+(\w+)|import[ \t]+([\w., \t]+))", re.MULTILINE)
NAMES = re.compile(rb"(?:^|,)\s*(\w+)")
"""Outermost names in what follows ``import``."""

CONTAINERS = {list, tuple, dict, set, frozenset}
WRAPPED = "fget", "fset", "fdel", "__func__", "func"
"""Attributes of properties and other members of classes that hold their functions."""

PLAIN = {bool, int, float, complex, str, bytes, type(None), type(Ellipsis)}

UNKNOWN = uuid.uuid4
"""Makes a text for what nothing is known of; it is never the same."""

PROTOCOL = 4
"""Of the state of objects, as `pickle` takes it."""


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


class ClassCode(NamedTuple):
    """Qualified name of a class, the digest of its code, and all modules that this is in or uses."""

    name: str
    digest: str
    modules: frozenset[str]


known_codes: WeakKeyDictionary[type[Any], ClassCode] = WeakKeyDictionary()
"""Codes of classes that another process has sent, which it has found where the class was made."""


def plugin_parts(plugin: object) -> Iterator[object]:
    """Yield a plugin and the dataclasses among its parameters, at any depth."""
    if isinstance(plugin, (list, tuple)):
        for item in plugin:
            yield from plugin_parts(item)
    elif dataclasses.is_dataclass(plugin):
        yield plugin
        for field in dataclasses.fields(plugin):
            yield from plugin_parts(getattr(plugin, field.name))


def foreign_classes(plugin: object) -> tuple[str, ...]:
    """Name the classes of a plugin and of its parts that are not of isacbench."""
    kinds = {type(part) for part in plugin_parts(plugin)}
    return tuple(sorted(f"{one.__module__}.{one.__qualname__}" for one in kinds if not _is_built_in(one)))


def plugin_classes(plugin: object) -> set[type[Any]]:
    """Classes of a plugin and of its parts, and their bases, but for those that every row names anyway."""
    classes = {base for part in plugin_parts(plugin) for base in type(part).__mro__}
    return {base for base in classes if not (root_of(base.__module__) in VERSIONED and has_a_file(base))}


def own_codes(plugin: object) -> dict[type[Any], ClassCode]:
    """Codes of a plugin's classes whose files, if there are any, do not say all about them."""
    local = {file.module_name for file in local_plugins()}
    classes = (base for base in plugin_classes(plugin) if base.__module__ not in local)
    return {base: class_code(base) for base in classes if not has_a_file(base)}


def has_a_file(thing: Any) -> bool:
    """Tell whether the file of its module says all about a class or a function.

    Not so where another process does not find the module, for what a function has made, and
    where a notebook has replaced a method.
    """
    module, name = getattr(thing, "__module__", None), getattr(thing, "__qualname__", "<locals>")
    if not isinstance(module, str) or "<locals>" in name or not is_importable(module):
        return False
    if module == "builtins":  # of Python, or made by exec without the name of a module
        return hasattr(builtins, name)
    functions = vars(thing).values() if isinstance(thing, type) else (thing,)
    # A wrapper names the module of what it wraps; its globals are of its own.
    homes = {str(one.__globals__.get("__name__")) for one in functions if isinstance(one, FunctionType)}
    return all(map(is_importable, homes))


def class_code(plugin_class: type[Any]) -> ClassCode:
    """Find the code of a class without a file, as it is now, equal in every process for equal values."""
    return known_codes.get(plugin_class) or _code_of(plugin_class, plugin_class.__qualname__)


def attributes_digest(plugin: object) -> str | None:
    """Digest of what an instance holds besides its parameters; None if that is nothing, or isacbench's."""
    kind = type(plugin)
    names = {field.name for field in parameter_fields(plugin)}
    held = {name: value for name, value in sorted(_state(plugin).items()) if name not in names}
    return _code_of(held, kind.__qualname__).digest if held and not _is_built_in(kind) else None


def _is_built_in(kind: type[Any]) -> bool:
    return root_of(kind.__module__) in ("isacbench", ALGORITHMS)


def _code_of(thing: object, name: str) -> ClassCode:
    walk = _Walk()
    try:
        return ClassCode(name, walk.text(thing), frozenset(walk.modules))
    except RecursionError as error:
        raise InputError(f"{name}: uses values that are nested too deeply to be known again") from error


class _Walk:
    """Walk over values. What has a file is named, all else is a digest."""

    def __init__(self) -> None:
        self.modules: set[str] = set()
        self._texts: dict[int, str] = {}
        self._kept: list[Any] = []  # so that none of the addresses is used again

    def text(self, value: Any) -> str:
        """Text of a value, equal for equal ones."""
        if type(value) in PLAIN:
            return repr(value)
        if id(value) not in self._texts:
            self._kept.append(value)
            self._texts[id(value)] = f"within itself: {len(self._kept)}"
            self._texts[id(value)] = hashlib.sha256(self._walked(value).encode()).hexdigest()
        return self._texts[id(value)]

    def _walked(self, value: Any) -> str:
        name = type(value).__name__
        match value:
            case ModuleType():
                self.modules.add(value.__name__)
                return value.__name__ if is_importable(value.__name__) else str(UNKNOWN())
            case type() | FunctionType():
                self.modules.add(str(value.__module__))
                if has_a_file(value):
                    return f"{value.__module__}.{value.__qualname__}"
                return self._class(value) if isinstance(value, type) else self._function(value)
            case list() | tuple() | dict() | set() | frozenset() if type(value) in CONTAINERS:
                texts = [*map(self.text, value.items() if isinstance(value, dict) else value)]
                return f"{name} {sorted(texts) if isinstance(value, (set, frozenset)) else texts}"
            case property() | staticmethod() | classmethod() | cached_property():
                return f"{name} {self.text([getattr(value, one, None) for one in WRAPPED])}"
            case CodeType():
                counts = value.co_argcount, value.co_posonlyargcount, value.co_kwonlyargcount, value.co_flags
                names = value.co_names, value.co_varnames, value.co_freevars, value.co_cellvars
                return self.text((counts, names, value.co_code, value.co_exceptiontable, value.co_consts))
        return self._object(value)

    def _object(self, value: Any) -> str:
        """Class and state of an object, as `pickle` would take it; of what it refuses, the attributes."""
        kind = type(value)
        if value is getattr(sys.modules.get("numpy.random.mtrand"), "_rand", UNKNOWN):
            return "the generator of numpy.random"  # which every cell seeds anew
        reduce = copyreg.dispatch_table.get(kind)
        try:
            parts = reduce(value) if reduce else value.__reduce_ex__(PROTOCOL)
        except Exception:  # an object may refuse in any way
            parts = ""
        if isinstance(parts, str):  # a name, or nothing
            module = vars(pickle)["whichmodule"](value, parts) if parts else ""
            if is_importable(module):
                self.modules.add(module)
                return f"{module}.{parts}"
            return f"{self.text(kind)} {self.text(_state(value) or str(UNKNOWN()))}"
        # Iterators are over the items of a list or a dictionary.
        parts = [list(part) if isinstance(part, Iterator) else part for part in parts]
        parts = [_without_cache(kind, part) if isinstance(part, dict) else part for part in parts]
        return f"{self.text(kind)} {self.text(parts)}"

    def _class(self, thing: type[Any]) -> str:
        members = {name: value for name, value in sorted(vars(thing).items()) if _is_written(name, value)}
        is_dataclass = "__dataclass_params__" in vars(thing)
        fields = [
            (one.name, one.default, one.default_factory, one.init)
            for one in (dataclasses.fields(thing) if is_dataclass else ())
        ]
        params = repr(vars(thing).get("__dataclass_params__"))
        name = f"{thing.__module__}.{thing.__qualname__}"
        return self.text((name, type(thing), thing.__mro__[1:], members, fields, params))

    def _function(self, thing: FunctionType) -> str:
        known, steps = thing.__globals__, list(_steps(thing.__code__))
        read = {name for operation, name in steps if operation in ("LOAD_GLOBAL", "LOAD_NAME")}
        # But for state that it sets itself.
        read -= {name for operation, name in steps if operation == "STORE_GLOBAL"}
        names = {name: known[name] for name in sorted(read) if name in known}
        self.modules |= {name for operation, name in steps if operation == "IMPORT_NAME"}
        # A script may have set them since the module was imported.
        words = sorted({name for _, name in steps})
        modules = [one for one in names.values() if isinstance(one, ModuleType)]
        constants = [(word, vars(one)[word]) for one in modules for word in words if word in vars(one)]
        constants = [one for one in constants if type(one[1]) in PLAIN]
        cells = [_content(cell) for cell in thing.__closure__ or ()]
        used = names, constants, thing.__defaults__, thing.__kwdefaults__, cells, vars(thing)
        return self.text((f"{thing.__module__}.{thing.__qualname__}", thing.__code__, used))


def _is_written(name: str, value: object) -> bool:
    """Tell whether a member of a class is its author's, and not made by Python or for a dataclass."""
    if not name.startswith("__"):
        return name != "_abc_impl"
    if not isinstance(value, (FunctionType, classmethod, staticmethod, property)):
        return False
    is_made = isinstance(value, FunctionType) and value.__code__.co_filename == "<string>"
    return not (is_made or name.startswith("__annotate"))


def _state(value: object) -> dict[str, Any]:
    """Attributes of an object, in slots or not."""
    names = {name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())}
    held = {name: getattr(value, name) for name in sorted(names) if hasattr(value, name)}
    return _without_cache(type(value), held | getattr(value, "__dict__", {}))


def _without_cache(kind: type[Any], state: dict[Any, Any]) -> dict[Any, Any]:
    """State but for what is computed once: it is there or not, and means the same."""
    return {
        name: value
        for name, value in state.items()
        if not isinstance(getattr(kind, str(name), None), cached_property)
    }


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


class Instances(Mapping[str, "Estimator"]):
    """Estimators that are objects, by the texts that stand for them.

    A copy of them in this process has the same classes. In another process they are
    unpickled where they are first asked for, when the files of their plugins are
    registered, with the codes of their classes as they were when they were sent.
    """

    def __init__(self, estimators: Mapping[str, Estimator] | None = None) -> None:
        self._estimators: Mapping[str, Estimator] | None = estimators or {}
        self._packed = b""

    def __getitem__(self, text: str) -> Estimator:
        return self._unpacked()[text]

    def __iter__(self) -> Iterator[str]:
        return iter(self._unpacked())

    def __len__(self) -> int:
        return len(self._unpacked())

    def _unpacked(self) -> Mapping[str, Estimator]:
        if self._estimators is None:
            try:
                self._estimators, codes = pickle.loads(self._packed)
            except Exception as error:
                raise InputError(
                    f"estimators: cannot be had in a worker process ({type(error).__name__}: {error}): leave "
                    "out jobs and dask, or put the class and what it uses into a module or a plugin file"
                ) from error
            for cls, code in codes.items():
                cls.__qualname__ = code.name  # which cloudpickle does not keep
            known_codes.update(codes)
        return self._estimators

    def __getstate__(self) -> dict[str, Any]:
        return {"_estimators": None, "_packed": self._packed or _packed(self._unpacked())}

    def __deepcopy__(self, memo: dict[int, Any]) -> Instances:
        return Instances(copy.deepcopy(dict(self._unpacked()), memo))


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]
    """Pickler of classes by their code, for which a field of a dataclass that lacks a default still does."""

    dispatch_table: ClassVar = ChainMap(
        {type(dataclasses.MISSING): lambda _: "MISSING"}, cloudpickle.Pickler.dispatch_table
    )


def _packed(estimators: Mapping[str, Estimator]) -> bytes:
    """Pickle estimators, those by their code whose modules no other process can import."""
    packed = io.BytesIO()
    with _packing, _by_value(estimators.values()):
        for text, one in estimators.items():
            try:
                _Pickler(io.BytesIO()).dump(one)
            except Exception as error:
                reason = f"cannot be sent to a worker process ({type(error).__name__}: {error})"
                raise InputError(
                    f"estimator {text}: {reason}: leave out jobs and dask, or put its class and what it uses "
                    "into a module or a plugin file"
                ) from error
        codes = [own_codes(one) for one in estimators.values()]
        _Pickler(packed).dump((dict(estimators), dict(ChainMap(*codes))))
    return packed.getvalue()


_packing = Lock()


@contextmanager
def _by_value(plugins: Iterable[object]) -> Iterator[None]:
    """Let cloudpickle send classes of some modules by their code; those of ``__main__`` go so in any case."""
    codes = (code for plugin in plugins for code in own_codes(plugin).values())
    names = {name for code in codes for name in code.modules} - {"__main__", "builtins"}
    names -= cloudpickle.list_registry_pickle_by_value()
    modules = [sys.modules[name] for name in sorted(names & sys.modules.keys()) if not is_importable(name)]
    try:
        for module in modules:
            cloudpickle.register_pickle_by_value(module)
        yield
    finally:
        for module in modules:
            cloudpickle.unregister_pickle_by_value(module)
