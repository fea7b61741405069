"""Versions of plugins: digests of the files of their packages, and of classes that no file holds.

A class of a notebook, of a script, or made in a function is what its methods say, and what
constants, defaults, closures and containers hold at the time. The instructions of its functions
are read and not their source: that is not there in a worker or a prompt, and a script's file may
have been edited since it was started.
"""

from __future__ import annotations

import dataclasses
import dis
import hashlib
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache
from importlib import import_module
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec
from itertools import product
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from isacbench.plugins.discovery import GROUPS, LIBRARIES, entries, local_plugins
from isacbench.plugins.registry import parameter_fields

CODE_SUFFIXES = tuple(SOURCE_SUFFIXES + EXTENSION_SUFFIXES)

ALGORITHMS = "isacbench_algorithms"
VERSIONED = LIBRARIES - {"threadpoolctl"}
"""Packages that every row names anyway."""

IMPORTS = re.compile(rb"(?:^|[;:])[ \t]*(?:from[ \t]+(\w+)|import[ \t]+([\w., \t]+))", re.MULTILINE)
NAMES = re.compile(rb"(?:^|,)\s*(\w+)")
"""Outermost names in what follows ``import``."""

PLAIN = {bool, int, float, complex, str, bytes, type(None), type(Ellipsis)}
WRAPPED = "fget", "fset", "fdel", "__func__", "func"
"""Attributes of properties and other members of classes that hold their functions."""

CODE_PARTS = (
    *("co_code", "co_exceptiontable", "co_consts", "co_flags"),
    *("co_argcount", "co_posonlyargcount", "co_kwonlyargcount"),
    *("co_names", "co_varnames", "co_freevars", "co_cellvars"),
)
"""Attributes of a function's code that say what it does."""

Version = dict[str, str | None]
"""``version``, None if there is none, and ``digest``, SHA-256, None where the version says all."""


def plugin_version(plugin: object) -> dict[str, Version]:
    """Identify the code of an estimator or a detector, and of the detectors in its parameters.

    The result names each distribution, plugin file and class without a file. Of a package that registers
    plugins, or is the user's own, all files count, and those of the user's packages that it imports; of a
    plugin file its text; of a class of a notebook or a script its functions and all values that they use.
    Other people's packages have a version alone.

    Examples
    --------
    >>> from isacbench.plugins.registry import get_estimator
    >>> found = plugin_version(get_estimator("oracle"))
    >>> list(found), found["isacbench"]["version"], len(found["isacbench"]["digest"])
    (['isacbench'], '0.2.0', 64)
    """
    codes, files = class_codes(plugin), {file.module_name: file for file in local_plugins()}
    modules = {base.__module__ for base in _classes(plugin)}
    modules = modules.union(*(code.modules for code in codes.values()))
    roots = {_root_of(module) for module in modules - files.keys() if is_importable(module)}
    digests = {_full_name(base): code.digest for base, code in codes.items()}
    filenames = [file.filename for file in files.values()]
    for file in (files[module] for module in modules & files.keys()):
        is_alone = filenames.count(file.filename) == 1
        digests[file.filename if is_alone else file.code_name] = file.digest
        roots |= _users_packages(_imported_roots(file.source.encode()))
    for part in _parts_of(plugin):
        if digest := _attributes_digest(part):
            digests[f"attributes of {_full_name(type(part))}"] = digest
    found: dict[str, Version] = {name: {"version": None, "digest": one} for name, one in digests.items()}
    packages: dict[tuple[str, str | None, bool], set[str]] = {}
    for root in _with_imports(roots - VERSIONED):
        packages.setdefault(_distribution(root), set()).add(root)
    for (name, number, is_released), members in packages.items():
        found[name] = {"version": number, "digest": None if is_released else files_digest(members)}
    return dict(sorted(found.items()))


def _distribution(root: str) -> tuple[str, str | None, bool]:
    """Name and version of the distribution of a package, and whether the version says all about its code."""
    for kind in GROUPS:
        for entry in entries(kind).values():
            if entry.version is not None and _root_of(entry.module) == root:
                return entry.package, entry.version, False
    if not _is_installed(root):  # a name in the text of a plugin, which may never import it
        return root, None, False
    number = getattr(import_module(root), "__version__", None)
    return root, number, number is not None


def foreign_classes(plugin: object) -> tuple[str, ...]:
    """Name the classes of a plugin and of its parts that are not of isacbench."""
    kinds = {type(part) for part in _parts_of(plugin)}
    return tuple(sorted(_full_name(one) for one in kinds if not _is_built_in(one)))


def _parts_of(plugin: object) -> Iterator[object]:
    """Yield a plugin and the dataclasses among its parameters, at any depth."""
    if isinstance(plugin, (list, tuple)):
        for item in plugin:
            yield from _parts_of(item)
    elif dataclasses.is_dataclass(plugin):
        yield plugin
        for field in dataclasses.fields(plugin):
            yield from _parts_of(getattr(plugin, field.name))


def _classes(plugin: object) -> set[type[Any]]:
    """Classes of a plugin and of its parts, and their bases."""
    return {base for part in _parts_of(plugin) for base in type(part).__mro__}


def _is_built_in(kind: type[Any]) -> bool:
    return _root_of(kind.__module__) in ("isacbench", ALGORITHMS)


def _full_name(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"


# Modules and files.


def _root_of(module: str) -> str:
    """Outermost package of a module, or the module itself."""
    return module.partition(".")[0]


def _spec(root: str) -> ModuleSpec | None:
    """Find an outermost package, not in `sys.modules`: some was made in this process alone."""
    found = (finder.find_spec(root, None) for finder in sys.meta_path if root not in ("", "__main__"))
    return next((spec for spec in found if spec), None)


def is_importable(module: str) -> bool:
    """Tell whether another process with the same paths finds a module by its name."""
    root = _root_of(module)
    return root in VERSIONED or _spec(root) is not None


def _is_installed(root: str) -> bool:
    """Tell whether a package is in a folder that packages are installed into."""
    spec = _spec(root)
    places = (spec.origin, *(spec.submodule_search_locations or ())) if spec else ()
    return any(not {"site-packages", "dist-packages"}.isdisjoint(Path(one).parts) for one in places if one)


def _imported_roots(source: bytes) -> set[str]:
    """Outermost packages that a source imports, but for those that every row names anyway."""
    found = IMPORTS.findall(source)
    names = {name.decode() for one, several in found for name in (one, *NAMES.findall(several))}
    return names - VERSIONED - {""}


def _users_packages(roots: Iterable[str]) -> set[str]:
    """Those of some packages that are the user's, not installed, and the estimators of isacbench."""
    return {one for one in roots if one == ALGORITHMS or (is_importable(one) and not _is_installed(one))}


def _with_imports(roots: Iterable[str]) -> set[str]:
    """Packages or modules, and what they import of the user's packages, directly or not."""
    found, waiting = set(), {*roots}
    while waiting:
        root = waiting.pop()
        found.add(root)
        if root != ALGORITHMS and not _is_installed(root):
            for path in _files(root).values():
                waiting |= _users_packages(_read(path)[1] - found)
    return found


def files_digest(roots: Iterable[str], folders: Sequence[str] = ("",)) -> str:
    """SHA-256 of all files of code of packages or modules, or of some folders of theirs."""
    total = hashlib.sha256()
    for root in sorted(roots):
        for module, path in sorted(_files(root, folders).items()):
            total.update(f"{module} {_file_digest(module, path)}\n".encode())
    return total.hexdigest()


def _files(root: str, folders: Sequence[str] = ("",)) -> dict[str, str]:
    """Files of code of a package or a module, by the names of their modules."""
    spec = _spec(root)
    if spec is None or spec.submodule_search_locations is None:
        return {root: spec.origin} if spec and spec.has_location and spec.origin else {}
    found = {}
    for top, folder in product(spec.submodule_search_locations, folders):
        for path in Path(top, folder).rglob("*"):
            if path.name.endswith(CODE_SUFFIXES):
                parts = root, *path.relative_to(top).parent.parts, path.name.partition(".")[0]
                found[".".join(parts).removesuffix(".__init__")] = str(path)
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
    return hashlib.sha256(content).hexdigest(), _imported_roots(content)


# Classes and values.


class ClassCode(NamedTuple):
    """Qualified name of a class, the digest of its code, and all modules that this is in or uses."""

    name: str
    digest: str
    modules: frozenset[str]


received_codes: WeakKeyDictionary[type[Any], ClassCode] = WeakKeyDictionary()
"""Codes of classes that another process has sent, which it has found where the class was made."""


def class_codes(plugin: object) -> dict[type[Any], ClassCode]:
    """Codes of a plugin's classes whose files, if there are any, do not say all about them."""
    local = {file.module_name for file in local_plugins()}
    classes = (base for base in _classes(plugin) if base.__module__ not in local)
    return {base: class_code(base) for base in classes if not _has_a_file(base)}


def class_code(plugin_class: type[Any]) -> ClassCode:
    """Find the code of a class without a file, as it is now, equal in every process for equal values."""
    if plugin_class in received_codes:
        return received_codes[plugin_class]
    walk = _Walk()
    digest = walk.text(plugin_class)
    return ClassCode(plugin_class.__qualname__, digest, frozenset(walk.modules))


def _attributes_digest(plugin: object) -> str | None:
    """Digest of what an instance holds besides its parameters; None if that is nothing, or isacbench's."""
    names = {field.name for field in parameter_fields(plugin)}
    held = {name: value for name, value in sorted(_attributes(plugin).items()) if name not in names}
    return _Walk().text(held) if held and not _is_built_in(type(plugin)) else None


def _has_a_file(thing: Any) -> bool:
    """Tell whether the file of its module says all about a class or a function.

    Not so where another process does not find the module, for what a function has made, and
    where a notebook has replaced a method.
    """
    module, name = getattr(thing, "__module__", None), getattr(thing, "__qualname__", "<locals>")
    if not isinstance(module, str) or "<locals>" in name or not is_importable(module):
        return False
    functions = vars(thing).values() if isinstance(thing, type) else (thing,)
    # A wrapper names the module of what it wraps; its globals are of its own.
    homes = {str(one.__globals__.get("__name__")) for one in functions if isinstance(one, FunctionType)}
    return all(map(is_importable, homes))


class _Walk:
    """Walk over values that writes canonical texts: what has a file is named, all else is a digest.

    Each value is taken apart into its name or class and other values, and these likewise.
    """

    def __init__(self) -> None:
        self.modules: set[str] = set()
        self._texts: dict[int, str] = {}
        self._walked: list[Any] = []  # so that none of the addresses is used again
        self._depth = 0

    def text(self, value: Any) -> str:
        """Text of a value, equal for equal ones."""
        if type(value) in PLAIN:
            return repr(value)
        if id(value) not in self._texts:
            self._walked.append(value)
            self._texts[id(value)] = f"within itself: {self._depth}"
            self._depth += 1
            content = " ".join(map(self.text, self._parts(value)))
            self._depth -= 1
            self._texts[id(value)] = hashlib.sha256(content.encode()).hexdigest()
        return self._texts[id(value)]

    def _parts(self, value: Any) -> Iterable[Any]:
        kind = type(value)
        match value:
            case ModuleType():
                self.modules.add(value.__name__)
                return [value.__name__]
            case type() | FunctionType():
                self.modules.add(str(value.__module__))
                if _has_a_file(value):
                    return [_full_name(value)]
                parts = _class_parts(value) if isinstance(value, type) else self._function_parts(value)
                return [_full_name(value), *parts]
            case property() | staticmethod() | classmethod() | cached_property():
                return [kind.__name__, *(getattr(value, one, None) for one in WRAPPED)]
            case CellType():
                return ["cell", value.cell_contents]
            case CodeType():
                return [getattr(value, name) for name in CODE_PARTS]
        if kind in (list, tuple, dict):
            return [kind.__name__, *(value.items() if kind is dict else value)]
        if kind in (set, frozenset):
            return [kind.__name__, *sorted(map(self.text, value))]
        return self._object_parts(value)

    def _object_parts(self, value: Any) -> list[Any]:
        """Class and state of an object, as `pickle` would take it; of what it refuses, the attributes."""
        kind, parts = type(value), None
        with suppress(Exception):  # an object may refuse in any way
            parts = value.__reduce_ex__(4)
        if isinstance(parts, tuple):
            # Iterators are over the items of a list or a dictionary.
            parts = tuple(list(part) if isinstance(part, Iterator) else part for part in parts)
            return [kind, *(_without_cache(kind, part) if isinstance(part, dict) else part for part in parts)]
        module = str(getattr(value, "__module__", None))
        if parts and is_importable(module):
            self.modules.add(module)
            return [f"{module}.{parts}"]
        return [kind, _attributes(value) or repr(value)]

    def _function_parts(self, function: FunctionType) -> list[Any]:
        known, steps = function.__globals__, list(_steps(function.__code__))
        self.modules |= {name for operation, name in steps if operation == "IMPORT_NAME"}
        read = {name for operation, name in steps if operation in ("LOAD_GLOBAL", "LOAD_NAME")}
        read -= {name for operation, name in steps if operation == "STORE_GLOBAL"}  # its own state
        values = {name: known[name] for name in sorted(read & known.keys())}
        # A script may have set constants of modules since they were imported.
        words = sorted({name for _, name in steps})
        modules = [vars(one) for one in values.values() if isinstance(one, ModuleType)]
        found = [(word, one[word]) for one in modules for word in words if word in one]
        constants = [pair for pair in found if type(pair[1]) in PLAIN]
        defaults = function.__defaults__, function.__kwdefaults__
        return [function.__code__, values, constants, *defaults, function.__closure__, vars(function)]


def _class_parts(kind: type[Any]) -> list[Any]:
    members = {name: value for name, value in sorted(vars(kind).items()) if _is_written(name, value)}
    return [type(kind), kind.__mro__[1:], members]


def _is_written(name: str, value: Any) -> bool:
    """Tell whether a member of a class is its author's, and not made by Python or for a dataclass."""
    if not name.startswith("__") or name == "__dataclass_fields__":
        return name != "_abc_impl"
    is_method = isinstance(value, FunctionType) and not name.startswith("__annotate")
    return is_method and str(value.__code__.co_filename) != "<string>"


def _steps(code: CodeType) -> Iterator[tuple[str, str]]:
    """Yield operations and the names that they are on, those of functions inside included."""
    for step in dis.get_instructions(code):
        if isinstance(step.argval, str):
            yield step.opname, step.argval
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _steps(constant)


def _attributes(value: object) -> dict[str, Any]:
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
