"""Checks and what they find: one finding a check, in words that say what is wrong and how to mend it."""

from __future__ import annotations

import io
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Literal, TypeVar

__all__ = ["BrokenContractError", "Check", "DoubtfulError", "Finding", "Status", "raised_at", "run_checks"]

Status = Literal["ok", "warning", "failed", "skipped"]

Subject = TypeVar("Subject")

_LIBRARIES = frozenset({"isacbench", "numpy", "scipy"})
"""Folders of code that a plugin calls, or that calls it."""


class BrokenContractError(Exception):
    """The plugin breaks the contract; the message says how, and how to mend it."""


class DoubtfulError(Exception):
    """The plugin keeps the contract, but hardly does what was meant."""


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes
    ----------
    check : str
        Its name.
    status : {"ok", "warning", "failed", "skipped"}
        Skipped where a check that it builds on has failed.
    message : str
        What is wrong and how to mend it; of a check that passed, what was
        measured, if anything.
    """

    check: str
    status: Status
    message: str = ""


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """A property that is held to the contract.

    Attributes
    ----------
    name : str
    look : callable
        Takes the subject and returns what it measured; raises
        `BrokenContractError` or `DoubtfulError`. Anything else that it raises
        is the plugin's own failure.
    needs : tuple of str
        Names of checks without which it says nothing.
    """

    name: str
    look: Callable[[Subject], str]
    needs: tuple[str, ...] = ()


def run_checks(checks: Sequence[Check[Subject]], subject: Subject) -> Iterator[Finding]:
    """Run checks in their order; what a plugin prints or warns of is kept from the terminal.

    Parameters
    ----------
    checks : sequence of Check
    subject : object
        What they look at.

    Yields
    ------
    Finding
    """
    found: dict[str, Finding] = {}
    for check in checks:
        missing = [name for name in check.needs if found[name].status in ("failed", "skipped")]
        if missing:
            found[check.name] = Finding(check.name, "skipped", f"needs {missing[0]!r}")
        else:
            with redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found[check.name] = _found(check, subject)
        yield found[check.name]


def _found(check: Check[Subject], subject: Subject) -> Finding:
    try:
        return Finding(check.name, "ok", check.look(subject))
    except DoubtfulError as error:
        return Finding(check.name, "warning", str(error))
    except BrokenContractError as error:
        return Finding(check.name, "failed", str(error))
    except (Exception, SystemExit) as error:
        return Finding(check.name, "failed", raised_at(error))


def raised_at(error: BaseException) -> str:
    """Say what was raised, and where."""
    return f"raises {type(error).__name__}: {error} ({_place(error)})"


def _place(error: BaseException) -> str:
    """Where an exception was raised: the innermost line that is the plugin's own, if one is."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not _LIBRARIES.intersection(Path(frame.filename).parts)]
    frame = (own or frames)[-1]
    return f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}"
