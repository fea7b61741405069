"""A check of a plugin, and its finding: in words that say what is wrong and how to mend it."""

from __future__ import annotations

import io
import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeVar

from isacbench.errors import InputError
from isacbench.files.escaping import visible
from isacbench.plugins.discovery import error_place

HARMLESS = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, ImportWarning)
"""Warnings about outdated libraries: no plugin fails because of them."""

Status = Literal["ok", "warning", "failed", "skipped", "refused", "timeout", "killed"]
"""Refused: an `InputError` where that is a proper answer; timeout, killed: the process was lost."""

Measured = float | str | None

Subject = TypeVar("Subject")
"""A plugin together with its input."""

Result = TypeVar("Result")


class CheckFailedError(Exception):
    """A plugin does not do what a check asks of it; the message says how, and how to mend it."""


class DoubtfulError(Exception):
    """The plugin keeps the contract, but probably not its author's intention; the message says why."""


class NotApplicableError(Exception):
    """A check says nothing about this plugin or this input; the message says why."""


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """Check of a plugin.

    Attributes
    ----------
    measure : callable
        Takes the subject; returns its difference from what is promised, a
        measurement in words, or nothing. Raises one of the errors of this
        module; any other exception is the plugin's, and fails the check.
    bound : float
        Largest difference that is allowed.
    hint : str
        How to mend it.
    needs : tuple of str
        Names of checks that must have passed before; see `run_checks`.
    """

    name: str
    measure: Callable[[Subject], Measured]
    bound: float = 0.0
    hint: str = ""
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """Finding of a check.

    Attributes
    ----------
    check : str
        Name of the check.
    status : {"ok", "warning", "failed", "skipped", "refused", "timeout", "killed"}
        Skipped where a check that it needs has failed, or where it says nothing about the plugin.
    message : str
        What is wrong and how to mend it; a measurement, or nothing, where the
        check has passed.
    difference, bound : float
        Measured difference, and the largest allowed; NaN where there is none.
    """

    check: str
    status: Status
    message: str = ""
    difference: float = math.nan
    bound: float = math.nan
    time_s: float = field(default=math.nan, compare=False)


def run_check(
    check: Check[Subject], subject: Subject, *, is_strict: bool = False, may_refuse: bool = False
) -> Finding:
    """Run a check to a finding, whatever the plugin does.

    Strict, on hostile input, a warning fails the check, a check that says nothing is skipped instead of
    passed, and an `InputError` is an answer, if a wrong one unless the plugin may refuse its input.
    """
    start = time.perf_counter()
    caught = (Exception, SystemExit, KeyboardInterrupt) if is_strict else (Exception, SystemExit)
    status: Status = "failed"
    difference = bound = math.nan
    try:
        measured = refuse_warnings(lambda: check.measure(subject)) if is_strict else check.measure(subject)
        message = measured if isinstance(measured, str) else ""
        if isinstance(measured, float):
            difference, bound = measured, check.bound
            if not difference <= bound:
                raise CheckFailedError(f"off by {difference:.2g}, at most {bound:.2g} is allowed")
        status = "ok"
    except CheckFailedError as error:
        message = f"{error}: {check.hint}" if check.hint else str(error)
    except DoubtfulError as error:
        status, message = "warning", str(error)
    except NotApplicableError as reason:
        status, message = "skipped" if is_strict else "ok", str(reason)
    except caught as error:  # of the plugin
        message = _raised_at(error, subject)
        if isinstance(error, InputError) and is_strict:
            status, message = "refused" if may_refuse else "failed", str(error)
    message = visible(message) if is_strict else message
    return Finding(check.name, status, message, difference, bound, time.perf_counter() - start)


def run_checks(checks: Sequence[Check[Subject]], subject: Subject) -> Iterator[Finding]:
    """Run checks in their order, without a word of the plugin on the terminal.

    A check is skipped where one that it needs has failed.
    """
    found: dict[str, Finding] = {}
    for check in checks:
        missing = [name for name in check.needs if found[name].status in ("failed", "skipped")]
        if missing:
            found[check.name] = Finding(check.name, "skipped", f"needs {missing[0]!r}")
        else:
            with redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found[check.name] = run_check(check, subject)
        yield found[check.name]


def refuse_warnings(act: Callable[[], Result], hint: str = "") -> Result:
    """Call a function and fail with the first of its warnings, `HARMLESS` ones excepted."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = act()
    for warning in caught:
        if not issubclass(warning.category, HARMLESS):
            raise CheckFailedError(f"warns {warning.category.__name__}: {warning.message}{hint}")
    return result


def _raised_at(error: BaseException, subject: object) -> str:
    """Describe an exception of a plugin, with the place in its code where it was raised."""
    place = error_place(error, getattr(subject, "plugin_module", type(subject).__module__))
    return f"raises {type(error).__name__}: {error}" + (f" ({place})" if place else "")
