"""The exception and the warning of a user's mistake, and words that help."""

from __future__ import annotations

import difflib
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from types import ModuleType


class InputError(ValueError):
    """Bad input from outside: a file, a key, a name, a parameter.

    The message names what is wrong, where, and what is allowed. The command
    line prints it alone, without a traceback, and exits with code 2.
    """


class AccessError(InputError):
    """A file that the system does not let us read, which says nothing about its content."""


class InputWarning(UserWarning):
    """Input that is allowed, but hardly what was meant; the command line prints the message alone."""


def nearest(name: str, allowed: Iterable[str]) -> str | None:
    """Find the name that was probably meant by one that does not exist.

    Examples
    --------
    >>> nearest("16-qam", ["qpsk", "16qam"]), nearest("QPSK", ["qpsk", "16qam"])
    ('16qam', 'qpsk')
    """
    if not isinstance(name, str):
        return None
    allowed = list(allowed)
    for spelling in (name, name.lower(), name.upper()):
        if close := difflib.get_close_matches(spelling, allowed, n=1):
            return close[0]
    return None


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Answer a name that does not exist with the nearest one that does, and with all of them.

    Examples
    --------
    >>> did_you_mean("quik", ["paper", "quick"])
    "did you mean 'quick'? allowed are paper, quick"
    """
    allowed = list(allowed)
    close = nearest(name, allowed)
    hint = "" if close is None else f"did you mean {close!r}? "
    return f"{hint}allowed are {', '.join(allowed) or 'none'}"


def unknown_name(what: str, name: str, allowed: Iterable[str]) -> InputError:
    """Build the exception for a name of some kind that does not exist."""
    return InputError(f"unknown {what} {name!r}: {did_you_mean(name, allowed)}")


def require_known(what: str, name: str, allowed: Iterable[str]) -> None:
    """Refuse a name of some kind that does not exist."""
    if name not in (known := tuple(allowed)):
        raise unknown_name(what, name, known)


def require(allowed: bool, name: str, value: object, limits: str) -> None:
    """Refuse a parameter whose value is not allowed."""
    if not allowed:
        raise InputError(f"{name} = {value!r}: allowed is {limits}")


def require_least(owner: object, **least: float) -> None:
    """Refuse attributes below the least value that each may have."""
    for name, smallest in least.items():
        value = getattr(owner, name)
        require(value >= smallest, name, value, f"{smallest} and more")


def require_positive(owner: object, *names: str) -> None:
    """Refuse attributes that are not above 0."""
    for name in names:
        value = getattr(owner, name)
        require(value > 0, name, value, "above 0")


def require_option(owner: object, name: str, options: Iterable[str]) -> None:
    """Refuse an attribute that is none of a few words."""
    value, options = getattr(owner, name), tuple(options)
    require(value in options, name, value, f"one of {', '.join(options)}")


def import_extra(module: str, extra: str, what: str) -> ModuleType:
    """Import a module that only an extra of isacbench installs; say which extra, where it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise InputError(f"{what}: needs {library}: pip install 'isacbench[{extra}]'") from error
