"""Contract check: each finding says what is wrong with an estimator or a detector."""

from __future__ import annotations

from isacbench.checking.contract.contract_check import check, check_names, check_plugin, iterate_checks
from isacbench.checking.contract.findings import CheckReport, Finding, PluginFindings, Status
from isacbench.checking.contract.targets import find_plugins

__all__ = [
    "CheckReport",
    "Finding",
    "PluginFindings",
    "Status",
    "check",
    "check_names",
    "check_plugin",
    "find_plugins",
    "findings",
    "guarded_checks",
    "iterate_checks",
    "targets",
]
