"""Provenance of a row: versions of the code that made it, and the machine."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pandas as pd

import isacbench
from isacbench.bench.suites.scenario_digest import digest
from isacbench.plugins.code_digests import files_digest, plugin_version
from isacbench.plugins.contracts import Detector, Estimator

Environment = dict[str, Any]
"""Origin of a row: ``versions`` (isacbench, plugins, python, packages) and ``machine``."""

PACKAGES = ("numpy", "scipy", "pandas", "pyarrow", "threadpoolctl")
RESULT_PACKAGES = ("numpy", "scipy")
"""Packages whose versions can change a row."""

DIGITS = 16
"""Hexadecimal digits of a digest of isacbench."""

SHOWN_DIGITS, LONGEST_VERSION = 12, 32
"""Digits that are shown of a digest, and the length that no version exceeds."""

GIT_TIMEOUT_S = 30.0

SOURCE = Path(isacbench.__file__).parent

ROW_MAKERS = "bench", "dsp", "link", "metrics", "model", "plugins"
"""Folders of isacbench whose code rows follow from."""


def environment_of(plugin: Estimator | Detector) -> Environment:
    """Describe what makes the rows of an estimator or detector in this process.

    Rows whose ``versions`` are equal may stand in one table: of isacbench with the digest of
    `ROW_MAKERS`, of the plugin and its detectors, of Python, NumPy and SciPy.
    """
    return {
        "versions": {
            "isacbench": {
                "version": isacbench.__version__,
                "digest": files_digest(["isacbench"], ROW_MAKERS)[:DIGITS],
            },
            "plugins": plugin_version(plugin),
            "python": platform.python_version(),
            **{name: package_version(name) for name in RESULT_PACKAGES},
        },
        "machine": machine(),
    }


def environment_id(environment: Environment) -> str:
    """Short name of an environment, equal for equal ones."""
    return digest(environment)[:12]


def differing_versions(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """List what differs in the ``versions`` of two environments, such as ``numpy 2.0.0 instead of 2.1.0``."""
    before, after = _flat(old), _flat(new)
    return [
        f"{name} {_short(before.get(name))} instead of {_short(after.get(name))}"
        for name in dict.fromkeys([*before, *after])
        if before.get(name) != after.get(name)
    ]


@cache
def machine() -> dict[str, Any]:
    """System, processor and cores of this machine."""
    return {"platform": platform.platform(), "processor": _processor(), "cores": os.cpu_count()}


def git_state(checkout: Path = SOURCE.parent) -> dict[str, Any] | None:
    """Commit and dirty flag of the checkout that the code runs from; None without one, or without git."""
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
    """Version of an installed package, or None.

    It is asked once: an imported package stays the same if it is replaced.
    """
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    """Name of the processor as the system reports it."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def _flat(versions: Mapping[str, Any]) -> dict[Any, Any]:
    """Versions by flat names: nested keys joined by spaces."""
    # pandas 2 makes no row of an empty dictionary.
    return pd.json_normalize(dict(versions), sep=" ").to_dict("records")[0] if versions else {}


def _short(version: str | None) -> str:
    """Version, or the first digits of a digest."""
    text = version or "none"
    return text if len(text) <= LONGEST_VERSION else text[:SHOWN_DIGITS]
