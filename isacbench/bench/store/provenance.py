"""Provenance of a row: versions of the code that made it, and the machine."""

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
"""Origin of a row: ``versions`` (isacbench, plugins, python, packages) and ``machine``."""

PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "threadpoolctl")
RESULT_PACKAGES = ("numpy", "scipy")
"""Packages whose versions can change a row."""

DIGITS = 16
"""Hexadecimal digits of a digest of code."""

GIT_TIMEOUT_S = 30.0

SOURCE = Path(isacbench.__file__).parent

ROW_MAKERS = "isacbench.bench.plan.job", "isacbench.bench.workers.workbench", *PLANNERS
"""Modules that plan cells and make rows. Rows depend on them and on all modules that they import."""


def environment_of(plugin: Estimator | Detector) -> Environment:
    """Describe what makes the rows of an estimator or detector in this process.

    Parameters
    ----------
    plugin : Estimator or Detector

    Returns
    -------
    dict
        ``versions``: of isacbench with `code_digest`, of the packages of the
        plugin and its detectors likewise, of Python, NumPy and SciPy.
        ``machine``: its system, processor and cores. Rows whose ``versions``
        are equal may stand in one table.
    """
    return {
        "versions": {
            "isacbench": {"version": isacbench.__version__, "digest": code_digest(plugin)},
            "plugins": plugin_version(plugin),
            "python": platform.python_version(),
            **{name: package_version(name) for name in RESULT_PACKAGES},
        },
        "machine": machine(),
    }


def environment_id(environment: Environment) -> str:
    """Short name of an environment.

    Parameters
    ----------
    environment : dict

    Returns
    -------
    str
        Equal for equal environments.
    """
    return digest(environment)[:12]


def code_digest(plugin: Estimator | Detector) -> str:
    """Digest of the code of isacbench that the rows of an estimator or detector follow from.

    It covers the modules that make rows, those of the plugin and its
    detectors, and all modules that these import.

    Parameters
    ----------
    plugin : Estimator or Detector

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    return library_code(plugin, ROW_MAKERS)[:DIGITS]


@cache
def machine() -> dict[str, Any]:
    """System, processor and cores of this machine."""
    return {"platform": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}


def git_state(checkout: Path = SOURCE.parent) -> dict[str, Any] | None:
    """Commit and dirty flag of the checkout that the code runs from.

    Parameters
    ----------
    checkout : Path

    Returns
    -------
    dict or None
        ``commit`` and ``dirty``; None without a checkout or without git.
    """
    if not (checkout / ".git").exists():
        return None
    try:
        status = subprocess.run(
            ["git", "-C", str(checkout), "status", "--porcelain=v2", "--branch"],
            capture_output=True,
            text=True,
            check=True,
            timeout=GIT_TIMEOUT_S,
            # Reading the state must not lock the checkout against somebody who works in it.
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
        )
    except (OSError, subprocess.SubprocessError):
        return None
    lines = status.stdout.splitlines()
    commit = next((line.split()[2] for line in lines if line.startswith("# branch.oid")), None)
    return {"commit": commit, "dirty": any(not line.startswith("#") for line in lines)}


def package_versions() -> dict[str, str | None]:
    """Versions of the packages that isacbench is built on."""
    return {name: package_version(name) for name in PACKAGES}


@cache
def package_version(package: str) -> str | None:
    """Version of an installed package, asked once: an imported package stays the same if it is replaced.

    Parameters
    ----------
    package : str

    Returns
    -------
    str or None
        None if it is not installed.
    """
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
    """Name of the processor as the system reports it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


class Made(NamedTuple):
    """Outcome with the description of its environment; the record has the environment's name."""

    outcome: Outcome
    environment: Environment
