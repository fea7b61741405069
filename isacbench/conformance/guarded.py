"""Checks in a process of their own: a plugin that hangs or dies fails the check that it does it in."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import TimeoutError as DeadlineError

from pebble import ProcessExpired, ProcessPool

from isacbench.conformance import check_names, iterate_checks
from isacbench.conformance.findings import Finding
from isacbench.entries import Kind, local_plugins, register_plugin
from isacbench.plugin_files import PluginFile
from isacbench.processes import process_context

__all__ = ["CHECK_TIMEOUT_S", "check_guarded"]

CHECK_TIMEOUT_S = 120.0
"""A check images small scenes a few times; what takes longer hangs."""


def check_guarded(kind: Kind, name: str, timeout_s: float = CHECK_TIMEOUT_S) -> list[Finding]:
    """Put a plugin through the contract as `check_plugin` does, whatever it does to its process.

    Parameters
    ----------
    kind : {"estimator", "detector"}
    name : str
        A registered name.
    timeout_s : float
        Longest time of one check in s.

    Returns
    -------
    list of Finding
        The check during which the plugin hung or lost its process has
        failed, those after it are skipped.
    """
    names = check_names(kind)
    found: list[Finding] = []
    pool = ProcessPool(
        1, initializer=_start, initargs=[kind, name, local_plugins()], context=process_context()
    )
    try:
        while len(found) < len(names):
            found.append(pool.schedule(_next, timeout=timeout_s).result())
    except DeadlineError:
        found.append(Finding(names[len(found)], "failed", f"takes more than {timeout_s:g} s: does it hang?"))
    except ProcessExpired as death:
        found.append(Finding(names[len(found)], "failed", f"ends its process: {_cause(death.exitcode)}"))
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()
    return found + [Finding(name, "skipped", f"needs {found[-1].check!r}") for name in names[len(found) :]]


def _cause(exit_code: int) -> str:
    return f"exit code {exit_code}" if exit_code >= 0 else signal.Signals(-exit_code).name


# What follows runs in the process of the checks.

_checks: Iterator[Finding] = iter(())


def _start(kind: Kind, name: str, plugins: tuple[PluginFile, ...]) -> None:
    global _checks
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    for plugin in plugins:
        register_plugin(plugin)
    _checks = iterate_checks(kind, name)


def _next() -> Finding:
    return next(_checks)
