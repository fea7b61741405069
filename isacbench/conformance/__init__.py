"""Conformance: whether an estimator or a detector keeps the contract, and what to mend where it does not."""

from __future__ import annotations

from collections.abc import Iterator

from isacbench.conformance.findings import Finding, Status, run_checks
from isacbench.conformance.targets import find_plugins
from isacbench.entries import Kind, entries
from isacbench.errors import unknown_name

__all__ = ["Finding", "Status", "check_names", "check_plugin", "find_plugins", "iterate_checks"]


def check_plugin(kind: Kind, name: str) -> list[Finding]:
    """Put an estimator or a detector through the contract, on small scenes and maps.

    Parameters
    ----------
    kind : {"estimator", "detector"}
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

    Examples
    --------
    >>> findings = check_plugin("detector", "ca")
    >>> {finding.status for finding in findings}
    {'ok'}
    """
    return list(iterate_checks(kind, name))


def iterate_checks(kind: Kind, name: str) -> Iterator[Finding]:
    """Put an estimator or a detector through the contract, one finding after the other.

    Raises
    ------
    InputError
        If nothing of that name is registered.
    """
    registered = entries(kind)
    if name not in registered:
        raise unknown_name(kind, name, sorted(registered))
    if kind == "estimator":
        from isacbench.conformance.estimators import ESTIMATOR_CHECKS, EstimatorSubject

        return run_checks(ESTIMATOR_CHECKS, EstimatorSubject(registered[name]))
    from isacbench.conformance.detectors import DETECTOR_CHECKS, DetectorSubject

    return run_checks(DETECTOR_CHECKS, DetectorSubject(registered[name]))


def check_names(kind: Kind) -> list[str]:
    """Names of the checks of estimators or of detectors, in their order."""
    from isacbench.conformance.detectors import DETECTOR_CHECKS
    from isacbench.conformance.estimators import ESTIMATOR_CHECKS

    return [check.name for check in (ESTIMATOR_CHECKS if kind == "estimator" else DETECTOR_CHECKS)]
