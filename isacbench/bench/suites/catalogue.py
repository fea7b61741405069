"""The catalogue: every estimator, detector, scenario and suite that a name reaches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isacbench.bench.suites.suite import find_suite, suite_names
from isacbench.files.toml_files import find_toml
from isacbench.model.scenes.scenario import scenario_names
from isacbench.plugins.registry import describe_plugin

if TYPE_CHECKING:
    from pathlib import Path


def catalogue() -> dict[str, list[dict[str, Any]]]:
    """Describe everything that is registered or built in.

    Returns
    -------
    dict of str to list of dict
        ``estimators`` and ``detectors`` as `isacbench.plugins.registry.describe_plugin`
        gives them; ``scenarios`` and ``suites`` with ``name`` and
        ``description``, the comment that their file starts with.
    """
    return {
        "estimators": describe_plugin("estimator"),
        "detectors": describe_plugin("detector"),
        "scenarios": [
            {"name": name, "description": _first_comment(find_toml(name, "scenario"))}
            for name in scenario_names()
        ],
        "suites": [{"name": name, "description": _first_comment(find_suite(name))} for name in suite_names()],
    }


def _first_comment(path: Path) -> str:
    """First line of a file if it is a comment, without its sign."""
    first = path.read_text(encoding="utf-8").partition("\n")[0]
    return first.removeprefix("#").strip() if first.startswith("#") else ""
