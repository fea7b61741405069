"""The contract check: an estimator, a detector or a metric goes through all checks of its kind."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from isacbench.checking.contract.findings import Check, CheckReport, Finding, PluginFindings, run_checks
from isacbench.checking.contract.targets import entries_of_class, find_plugins
from isacbench.cores import one_blas_thread
from isacbench.errors import unknown_name
from isacbench.plugins.discovery import PluginKind, RegisteredPlugin, entries, isolated_plugins

if TYPE_CHECKING:
    from isacbench.plugins.contracts import Detector, Estimator, Metric


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
        with isolated_plugins():
            found = [entries(kind)[name] for kind, name in find_plugins(str(plugin))]
            return CheckReport(tuple(map(_findings, found)))
    plugin_class = plugin if isinstance(plugin, type) else type(plugin)
    instance = None if isinstance(plugin, type) else plugin
    return CheckReport(tuple(_findings(entry, instance) for entry in entries_of_class(plugin_class)))


def check_plugin(kind: PluginKind, name: str) -> list[Finding]:
    """Put a plugin through the contract, on small scenes and maps.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}
    name : str
        A registered name.

    Returns
    -------
    list of Finding
        One a check, in the order in which they ran. Whatever the plugin
        raises is the failure of that check.

    Raises
    ------
    InputError
        If nothing of that name is registered.
    """
    return list(iterate_checks(kind, name))


def iterate_checks(kind: PluginKind, name: str) -> Iterator[Finding]:
    """Put a plugin through the contract, one finding after the other.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}
    name : str
        A registered name.

    Raises
    ------
    InputError
        If nothing of that name is registered.
    """
    registered = entries(kind)
    if name not in registered:
        raise unknown_name(kind, name, sorted(registered))
    return _checked(registered[name])


def check_names(kind: PluginKind) -> list[str]:
    """Names of the checks of a kind of plugin, in their order.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}
    """
    return [check.name for check in _checks_of(kind)[0]]


def _checks_of(kind: PluginKind) -> tuple[tuple[Check[Any], ...], type[Any]]:
    """Checks of a kind of plugin, and the class of their subject."""
    from isacbench.checking.contract import detector_checks, estimator_checks, metric_checks

    if kind == "estimator":
        return estimator_checks.ESTIMATOR_CHECKS, estimator_checks.EstimatorSubject
    if kind == "metric":
        return metric_checks.METRIC_CHECKS, metric_checks.MetricSubject
    return detector_checks.DETECTOR_CHECKS, detector_checks.DetectorSubject


def _checked(entry: RegisteredPlugin, plugin: object = None) -> Iterator[Finding]:
    """Findings about a class, or about an instance of it."""
    checks, subject_class = _checks_of(entry.kind)
    return run_checks(checks, subject_class(entry, plugin))


def _findings(entry: RegisteredPlugin, plugin: object = None) -> PluginFindings:
    """All findings about a class, or about an instance of it, which leave this process as it was."""
    from isacbench.process_state import process_state_kept

    with process_state_kept(), one_blas_thread():
        return PluginFindings(entry.kind, entry.name, entry.origin, tuple(_checked(entry, plugin)))
