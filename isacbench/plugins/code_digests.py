"""Digests of classes that no file holds, or none that another process finds: of their compiled code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from types import CodeType, FunctionType
from typing import Any

PLAIN = bool, int, float, complex, str, bytes, type(None), tuple


def class_digest(classes: Iterable[type[Any]], module: str) -> str:
    """Digest of classes, and of the functions and classes of their module that they use.

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
        if thing.__qualname__ not in texts:
            functions = list(_functions(thing))
            texts[thing.__qualname__] = repr(
                [*_constants(thing), *(_text(one.__code__) for one in functions)]
            )
            for function in functions:
                used = (function.__globals__.get(name) for name in _names(function.__code__))
                waiting += [one for one in used if _is_of(one, module)]
    return hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()


def _is_of(thing: Any, module: str) -> bool:
    return isinstance(thing, (FunctionType, type)) and thing.__module__ == module


def _functions(thing: Any) -> Iterator[FunctionType]:
    """Functions of a class, in the order of their names, or a function itself."""
    members = [thing] if isinstance(thing, FunctionType) else [value for _, value in sorted(_members(thing))]
    for member in members:
        for function in _unwrapped(member):
            if isinstance(function, FunctionType):
                yield function


def _unwrapped(member: Any) -> Iterator[Callable[..., Any] | None]:
    """Functions behind a member of a class: of a property, a class method or a function itself."""
    if isinstance(member, property):
        yield from (member.fget, member.fset, member.fdel)
    else:
        yield getattr(member, "__func__", getattr(member, "func", member))


def _members(thing: type[Any]) -> Iterator[tuple[str, Any]]:
    """Members that somebody wrote; what dataclasses make follows from them."""
    for name, value in vars(thing).items():
        is_made = isinstance(value, FunctionType) and value.__code__.co_filename == "<string>"
        if not (is_made and name.startswith("__")):
            yield name, value


def _constants(thing: Any) -> list[str]:
    """Plain attributes of a class, sorted."""
    if isinstance(thing, FunctionType):
        return []
    skipped = {"__module__", "__doc__", "__firstlineno__", "__static_attributes__"}
    return sorted(
        f"{name}={value!r}"
        for name, value in _members(thing)
        if isinstance(value, PLAIN) and name not in skipped
    )


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
