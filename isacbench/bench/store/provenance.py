"""Provenance of a row: the versions of everything that it follows from, and the machine that made it."""

from __future__ import annotations

import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from threadpoolctl import threadpool_info

import isacbench
from isacbench.bench.suites.scenario_digest import digest
from isacbench.bench.suites.suite_kinds import PLANNERS
from isacbench.plugins.plugin_versions import library_code, plugin_version

if TYPE_CHECKING:
    from isacbench.bench.cells.record import Outcome
    from isacbench.plugins.contracts import Detector, Estimator

Environment = dict[str, Any]
"""What made a row: ``versions`` (isacbench, plugins, python, packages) and ``machine``."""

PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "pebble", "threadpoolctl")
RESULT_PACKAGES = ("numpy", "scipy")
"""Packages whose versions rows can hang on."""

DIGITS = 16
"""Hexadecimal digits of a digest of code."""

GIT_TIMEOUT_S = 30.0

SOURCE = Path(isacbench.__file__).parent

ROW_MAKERS = "isacbench.bench.plan.job", "isacbench.bench.workers.workbench", *PLANNERS
"""Modules that plan cells and make their rows: with what they import, the part of the harness that rows
follow from."""


def environment_of(plugin: Estimator | Detector) -> Environment:
    """Describe what makes the rows of an estimator or detector in this process.

    Returns
    -------
    dict
        ``versions``: of isacbench with `code_digest`, of the packages that
        the plugin and its detectors come from likewise, of Python, NumPy and
        SciPy. ``machine``: its system, processor and cores.
        Rows whose ``versions`` are equal may stand in one table.
    """
    return {
        "versions": {
            "isacbench": {"version": isacbench.__version__, "digest": code_digest(plugin)},
            "plugins": plugin_version(plugin),
            "python": python_version(),
            **{name: package_version(name) for name in RESULT_PACKAGES},
        },
        "machine": machine(),
    }


def environment_id(environment: Environment) -> str:
    """Short name of an environment, equal for equal ones."""
    return digest(environment)[:12]


def code_digest(plugin: Estimator | Detector) -> str:
    """Digest of the code of isacbench that the rows of an estimator or detector follow from.

    It is that of the modules that make rows, of those that the plugin and its
    detectors come from, and of all that these import.
    """
    return library_code(plugin, ROW_MAKERS)[:DIGITS]


@cache
def machine() -> dict[str, Any]:
    """System, processor and cores of this machine."""
    return {"platform": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}


def git_state(checkout: Path = SOURCE.parent) -> dict[str, Any] | None:
    """Commit and dirty flag of the checkout that the code runs from; None where there is none, or no git."""
    if not (checkout / ".git").exists():
        return None
    try:
        status = subprocess.run(
            ["git", "-C", str(checkout), "status", "--porcelain=v2", "--branch"],
            capture_output=True,
            text=True,
            check=True,
            timeout=GIT_TIMEOUT_S,
            # A look at it must not get in the way of who works in it.
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
        )
    except (OSError, subprocess.SubprocessError):
        return None
    lines = status.stdout.splitlines()
    commit = next((line.split()[2] for line in lines if line.startswith("# branch.oid")), None)
    return {"commit": commit, "dirty": any(not line.startswith("#") for line in lines)}


def python_version() -> str:
    """Version of Python."""
    return platform.python_version()


def package_versions() -> dict[str, str | None]:
    """Versions of the packages that isacbench is built on."""
    return {name: package_version(name) for name in PACKAGES}


@cache
def package_version(package: str) -> str | None:
    """Version of an installed package, asked once: what is imported stays, whatever replaces it."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def blas_libraries() -> list[dict[str, Any]]:
    """Linear algebra libraries of this process."""
    return [
        {key: library.get(key) for key in ("user_api", "internal_api", "version", "architecture")}
        for library in threadpool_info()
    ]


def _processor() -> str:
    """Name of the processor as its maker writes it, where the system tells."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


class Made(NamedTuple):
    """An outcome, and the environment that made it, whose name the record has."""

    outcome: Outcome
    environment: Environment
