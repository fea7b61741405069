"""A check of a plugin, and its finding: in words that say what is wrong and how to mend it."""

from __future__ import annotations

import io
import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass, field
from typing import Any, Literal

from isacbench.errors import InputError
from isacbench.files.escaping import visible
from isacbench.plugins.discovery import error_place

HARMLESS = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, ImportWarning)
"""Warnings about outdated libraries: no plugin fails because of them."""

Status = Literal["ok", "warning", "failed", "skipped", "refused", "timeout", "killed"]
"""Refused: an `InputError` where that is a proper answer; timeout, killed: the process was lost."""


class CheckFailedError(Exception):
    """A plugin does not do what a check asks of it; the message says how, and how to mend it."""


class DoubtfulError(Exception):
    """The plugin keeps the contract, but probably not its author's intention; the message says why."""


class NotApplicableError(Exception):
    """A check says nothing about this plugin or this input; the message says why."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A plugin together with its input.

    Attributes
    ----------
    may_refuse : bool
        An `InputError` is a proper answer to this input.
    """

    plugin: Any
    may_refuse: bool = field(default=False, kw_only=True)

    @property
    def plugin_module(self) -> str:
        """Module of the plugin's class."""
        return type(self.plugin).__module__


@dataclass(frozen=True)
class Check:
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
    measure: Callable[[Any], float | str | None]
    bound: float = 0.0
    hint: str = ""
    needs: tuple[str, ...] = ()

    def of(self, subjects: Callable[[Any], Iterable[Any]], *needs: str, name: str = "") -> Check:
        """Make the same check of all the subjects that follow from another one."""

        def measure(subject: Any) -> float:
            return max(float(self.measure(one) or 0.0) for one in subjects(subject))

        return Check(name or self.name, measure, self.bound, self.hint, needs)


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
        Measured difference, 0 where there is nothing to measure, and the largest
        allowed; NaN where the check says something in words or did not come so far.
    """

    check: str
    status: Status
    message: str = ""
    difference: float = math.nan
    bound: float = math.nan
    time_s: float = field(default=math.nan, compare=False)


def run_check(check: Check, subject: Any, *, is_strict: bool = False) -> Finding:
    """Run a check to a finding, whatever the plugin does.

    Strict, on hostile input, a warning fails the check, a check that says nothing is skipped instead of
    passed, and an `InputError` is an answer, if a wrong one unless the subject says that it may refuse.
    """
    start = time.perf_counter()
    caught = (Exception, SystemExit, KeyboardInterrupt) if is_strict else (Exception, SystemExit)
    status: Status = "failed"
    difference = bound = math.nan
    message = ""
    try:
        with warnings_fail() if is_strict else nullcontext():
            measured = check.measure(subject)
        if isinstance(measured, str):
            message = measured
        else:
            difference, bound = measured or 0.0, check.bound
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
        if isinstance(error, InputError) and is_strict:
            status, message = "refused" if getattr(subject, "may_refuse", False) else "failed", str(error)
        else:
            place = error_place(error, getattr(subject, "plugin_module", type(subject).__module__))
            message = f"raises {type(error).__name__}: {error}" + (f" ({place})" if place else "")
    message = visible(message) if is_strict else message
    return Finding(check.name, status, message, difference, bound, time.perf_counter() - start)


def run_checks(checks: Sequence[Check], subject: Any) -> Iterator[Finding]:
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


@contextmanager
def warnings_fail(hint: str = "") -> Iterator[None]:
    """Fail the check with the first warning within, `HARMLESS` ones excepted."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        if not issubclass(warning.category, HARMLESS):
            raise CheckFailedError(f"warns {warning.category.__name__}: {warning.message}{hint}")
