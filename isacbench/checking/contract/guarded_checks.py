"""Checks in a process of their own: a plugin that hangs or dies fails the check, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Timer

from isacbench.bench.workers.guarded_process import GuardedProcess, ProcessLostError
from isacbench.checking.contract.contract_check import check_names, iterate_checks
from isacbench.checking.contract.findings import Finding
from isacbench.cores import one_blas_thread
from isacbench.plugins.discovery import PluginFile, PluginKind, local_plugins, register_plugin

CHECK_TIMEOUT_S = 120.0
"""Longest time of a check in s; it images small scenes a few times."""

TOLD_S = 1.0
"""Time in s from which a check that still runs is told."""

LOSSES = {"timeout": "takes {}: does it hang?", "killed": "ends its process: {}"}


def check_guarded(
    kind: PluginKind,
    name: str,
    timeout_s: float = CHECK_TIMEOUT_S,
    tell: Callable[[str], object] = lambda running: None,
) -> list[Finding]:
    """Put a plugin through the contract as `check_plugin` does, in a process that it may lose.

    Parameters
    ----------
    kind : {"estimator", "detector", "metric"}
    name : str
        A registered name.
    timeout_s : float
        Longest time of one check in s.
    tell : callable, optional
        Given the name of each check that has run for `TOLD_S`, from another thread.

    Returns
    -------
    list of Finding
        The check during which the plugin hung or lost its process has
        failed, those after it are skipped.
    """
    names = check_names(kind)
    found: list[Finding] = []
    with GuardedProcess(_start, kind, name, local_plugins()) as process:
        try:
            while len(found) < len(names):
                timer = Timer(TOLD_S, tell, [names[len(found)]])
                timer.start()
                try:
                    found.append(process.call(_next, timeout_s=timeout_s))
                finally:
                    timer.cancel()
        except ProcessLostError as loss:
            found.append(Finding(names[len(found)], "failed", LOSSES[loss.status].format(loss.reason)))
    return found + [Finding(name, "skipped", f"needs {found[-1].check!r}") for name in names[len(found) :]]


# What follows runs in the process of the checks.

_checks: Iterator[Finding] = iter(())


def _start(kind: PluginKind, name: str, plugins: tuple[PluginFile, ...]) -> None:
    global _checks
    for plugin in plugins:
        register_plugin(plugin)
    _checks = iterate_checks(kind, name)


@one_blas_thread()
def _next() -> Finding:
    return next(_checks)
