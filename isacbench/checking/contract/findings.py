"""Checks and their findings: one finding a check, in words that say what is wrong and how to mend it."""

from __future__ import annotations

import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Literal, TypeVar, get_args

from isacbench.checking.promises.promise import BrokenPromiseError
from isacbench.display import Description, Displayed
from isacbench.files.escaping import visible
from isacbench.plugins.discovery import error_place

if TYPE_CHECKING:
    from isacbench.plugins.discovery import PluginKind

Status = Literal["ok", "warning", "failed", "skipped"]

Subject = TypeVar("Subject")


class DoubtfulError(Exception):
    """The plugin keeps the contract, but probably not its author's intention; the message says why."""


@dataclass(frozen=True)
class Finding:
    """Finding of a check.

    Attributes
    ----------
    check : str
        Name of the check.
    status : {"ok", "warning", "failed", "skipped"}
        Skipped where a check that it needs has failed.
    message : str
        What is wrong and how to mend it; a measurement, or nothing, where the
        check has passed.
    """

    check: str
    status: Status
    message: str = ""


@dataclass(frozen=True)
class PluginFindings:
    """Findings about one plugin.

    Attributes
    ----------
    kind : {"estimator", "detector", "metric"}
    name, package : str
        Its name, and the distribution with its version, the file or the module that it comes from.
    findings : tuple of Finding
        One a check, in the order in which they ran.
    """

    kind: PluginKind
    name: str
    package: str
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """True if no check has failed; warnings are allowed."""
        return all(finding.status != "failed" for finding in self.findings)

    def __str__(self) -> str:
        return f"{self.kind} {self.name} ({self.package})"


@dataclass(frozen=True, repr=False)
class CheckReport(Displayed):
    """Findings about the plugins that were checked."""

    plugins: tuple[PluginFindings, ...]

    @property
    def ok(self) -> bool:
        """True if no check of any plugin has failed; warnings are allowed."""
        return all(plugin.ok for plugin in self.plugins)

    @property
    def counts(self) -> dict[Status, int]:
        """Number of findings of every status."""
        counted = Counter(finding.status for plugin in self.plugins for finding in plugin.findings)
        return {status: counted[status] for status in get_args(Status)}

    def __repr__(self) -> str:
        """Write the counts, and a line for each warning and each failure."""
        lines = [self._title]
        for plugin in self.plugins:
            of = f"{plugin.name}, " if len(self.plugins) > 1 else ""
            lines += [
                visible(f"  {finding.status}: {of}{finding.check}: {finding.message}")
                for finding in plugin.findings
                if finding.status in ("warning", "failed")
            ]
        return "\n".join(lines)

    @property
    def _title(self) -> str:
        told = ", ".join(f"{number} {status}" for status, number in self.counts.items() if number)
        return visible(f"Check of {', '.join(map(str, self.plugins))}: {told}")

    def _description(self) -> Description:
        facts = {
            f"{plugin.name}: {finding.check}": f"{finding.status} {finding.message}"
            for plugin in self.plugins
            for finding in plugin.findings
        }
        return Description(self._title, facts)


@dataclass(frozen=True)
class Check(Generic[Subject]):
    """Check of a plugin.

    Attributes
    ----------
    look : callable
        Takes the subject and returns a measurement in words, possibly empty.
        Raises `BrokenPromiseError` or `DoubtfulError`; any other exception is
        the plugin's own failure.
    needs : tuple of str
        Names of checks that must have passed before.
    """

    name: str
    look: Callable[[Subject], str]
    needs: tuple[str, ...] = ()


def run_checks(checks: Sequence[Check[Subject]], subject: Subject) -> Iterator[Finding]:
    """Run checks in their order, without a word of the plugin on the terminal.

    Parameters
    ----------
    subject : object
        Plugin under check.
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
    except BrokenPromiseError as error:
        return Finding(check.name, "failed", str(error))
    except (Exception, SystemExit) as error:
        return Finding(check.name, "failed", raised_at(error, getattr(subject, "module", "")))


def raised_at(error: BaseException, module: str = "") -> str:
    """Describe an exception of a plugin, with the place where it was raised.

    Parameters
    ----------
    module : str
        The plugin's module.
    """
    place = error_place(error, module)
    return f"raises {type(error).__name__}: {error}" + (f" ({place})" if place else "")
