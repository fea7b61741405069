"""The contract check: an estimator, a detector or a metric goes through all checks of its kind."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

from isacbench.bench.cells.process import GuardedProcess, ProcessLostError
from isacbench.checking.checks import Check, Finding, PluginSubject, Status, run_checks
from isacbench.checking.image_checks import ESTIMATOR_CHECKS, EstimatorSubject
from isacbench.checking.map_checks import DETECTOR_CHECKS, DetectorSubject
from isacbench.checking.metric_checks import METRIC_CHECKS, MetricSubject
from isacbench.cores import one_blas_thread
from isacbench.errors import InputError, did_you_mean
from isacbench.files.escaping import escape_control, quoted
from isacbench.plugins import discovery
from isacbench.plugins.contracts import Detector, Estimator, Metric
from isacbench.plugins.discovery import GROUPS, PluginFile, PluginKind, RegisteredPlugin, entries
from isacbench.plugins.registry import registered
from isacbench.process_state import process_state_kept

CONTRACTS: dict[PluginKind, tuple[tuple[Check, ...], type[PluginSubject]]] = {
    "estimator": (ESTIMATOR_CHECKS, EstimatorSubject),
    "detector": (DETECTOR_CHECKS, DetectorSubject),
    "metric": (METRIC_CHECKS, MetricSubject),
}
"""Checks of each kind of plugin, and the class of their subject."""

CHECK_TIMEOUT_S = 120.0
"""Longest time of a check in s; it images small scenes a few times."""

LONG_S = 1.0
"""Time in s from which a check that still runs is reported."""

LOSSES = {"timeout": "takes {}: does it hang?", "killed": "ends its process: {}"}


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
class CheckReport:
    """Findings about the plugins that were checked."""

    plugins: tuple[PluginFindings, ...]

    @property
    def ok(self) -> bool:
        """True if no check of any plugin has failed; warnings are allowed."""
        return all(plugin.ok for plugin in self.plugins)

    @property
    def counts(self) -> dict[Status, int]:
        """Number of findings of every status."""
        number = Counter(finding.status for plugin in self.plugins for finding in plugin.findings)
        statuses: tuple[Status, ...] = ("ok", "warning", "failed", "skipped")
        return {status: number[status] for status in statuses}

    def __repr__(self) -> str:
        """Write the counts, and a line for each warning and each failure."""
        counts = ", ".join(f"{number} {status}" for status, number in self.counts.items() if number)
        lines = [f"Check of {', '.join(map(str, self.plugins))}: {counts}"]
        for plugin in self.plugins:
            of = f"{plugin.name}, " if len(self.plugins) > 1 else ""
            lines += [
                f"  {finding.status}: {of}{finding.check}: {finding.message}"
                for finding in plugin.findings
                if finding.status in ("warning", "failed")
            ]
        return "\n".join(map(escape_control, lines))


def check(plugin: str | Path | type[Any] | Estimator | Detector | Metric) -> CheckReport:
    """Put estimators, detectors and metrics through the contract, as the command ``isacbench check`` does.

    The checks run in this process, where a debugger reaches them. A plugin
    that hangs or dies takes the process with it; the command has a process
    for each plugin, and goes on.

    Parameters
    ----------
    plugin : str, Path, type, Estimator, Detector or Metric
        A registered name; the name of a package, for all that it registers;
        a Python file, which is read anew and not registered; a class; or an
        instance, which is then checked instead of one with default
        parameters.

    Returns
    -------
    CheckReport
        One finding a check; `CheckReport.ok` tells whether none has failed.

    Raises
    ------
    InputError
        If it is none of these, or the file or the package provides nothing.

    Examples
    --------
    >>> check("ca").ok
    True
    """
    if isinstance(plugin, (str, Path)):
        with discovery.isolated_plugins():
            return CheckReport(tuple(map(_findings, find_plugins(str(plugin)))))
    plugin_class, instance = (plugin, None) if isinstance(plugin, type) else (type(plugin), plugin)
    found = discovery.class_entries(plugin_class, plugin_class.__module__, plugin_class.__module__)
    if not found:
        raise InputError(
            f"{quoted(plugin_class)} is not a plugin: allowed are a registered name, the name of a package, "
            "a file that ends in .py, a class with a class attribute `name` and a method `estimate` or "
            "`detect`, and an instance of such a class"
        )
    return CheckReport(tuple(_findings(entry, instance) for entry in found))


def check_plugin(entry: RegisteredPlugin, plugin: object = None) -> Iterator[Finding]:
    """Put a class, or an instance of it, through the contract on small scenes and maps, a finding a check."""
    checks, subject = CONTRACTS[entry.kind]
    return run_checks(checks, subject(entry, plugin))


def check_names(kind: PluginKind) -> list[str]:
    """Names of the checks of a kind of plugin, in their order."""
    return [check.name for check in CONTRACTS[kind][0]]


def _findings(entry: RegisteredPlugin, plugin: object = None) -> PluginFindings:
    """All findings about a class, or about an instance of it, which leave this process as it was."""
    with process_state_kept(), one_blas_thread():
        return PluginFindings(entry.kind, entry.name, entry.origin, tuple(check_plugin(entry, plugin)))


def find_plugins(package_or_file: str) -> list[RegisteredPlugin]:
    """Find every plugin that a package, a registered name or a file provides; registers the file.

    Those of a file come in the order of definition, else estimators first, each kind by name.

    Examples
    --------
    >>> [(entry.kind, entry.name) for entry in find_plugins("oracle")]
    [('estimator', 'oracle')]
    """
    if package_or_file.endswith(".py"):
        file = PluginFile.read(package_or_file)
        discovery.register_plugin(file)
        return [*discovery.entries_of(file)]
    every = [entry for kind in GROUPS for _, entry in sorted(entries(kind).items())]
    found = [entry for entry in every if package_or_file in _names(entry)]
    if not found:
        known = sorted({name for entry in every for name in _names(entry)})
        raise InputError(
            f"{package_or_file!r} is no registered name, and no package with entry points in "
            f"{' or '.join(GROUPS.values())}: {did_you_mean(package_or_file, known)}, or a file that ends "
            "in .py"
        )
    return found


def _names(entry: RegisteredPlugin) -> set[str]:
    """Names by which an entry is asked for: its own, its distribution's in two spellings, its package's."""
    if entry.version is None:
        return {entry.name}
    normalised = re.sub(r"[-_.]+", "-", entry.package).lower()
    return {entry.name, entry.package, normalised, entry.module.partition(".")[0]}


def check_guarded(
    entry: RegisteredPlugin,
    timeout_s: float = CHECK_TIMEOUT_S,
    still_at: Callable[[str], object] = lambda running: None,
) -> list[Finding]:
    """Put a registered plugin through the contract, in a process that it may lose.

    The check during which the plugin hung or lost its process has failed, those after it are skipped.
    `still_at` is given the name of each check that has run for `LONG_S`, from another thread.
    """
    names = check_names(entry.kind)
    found: list[Finding] = []
    with GuardedProcess(_start, entry.kind, entry.name, discovery.local_plugins()) as process:
        for running in names:
            timer = Timer(LONG_S, still_at, [running])
            timer.start()
            try:
                found.append(process.call(_next, timeout_s=timeout_s))
            except ProcessLostError as loss:
                found.append(Finding(running, "failed", LOSSES[loss.status].format(loss.reason)))
                break
            finally:
                timer.cancel()
                timer.join()  # a thread that is left would end the command without its exit handlers
    return found + [Finding(name, "skipped", f"needs {found[-1].check!r}") for name in names[len(found) :]]


# What follows runs in the process of the checks.

_checks: Iterator[Finding] = iter(())


def _start(kind: PluginKind, name: str, plugins: tuple[PluginFile, ...]) -> None:
    global _checks
    for plugin in plugins:
        discovery.register_plugin(plugin)
    _checks = check_plugin(registered(kind, name))


@one_blas_thread()
def _next() -> Finding:
    return next(_checks)
