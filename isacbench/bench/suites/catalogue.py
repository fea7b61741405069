"""The catalogue: every estimator, detector, scenario, family and suite that a name reaches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from isacbench.bench.suites.suite import find_suite, suite_names
from isacbench.files.toml_files import find_toml
from isacbench.model.scenes.scenario import scenario_names
from isacbench.model.scenes.scene_families import FAMILIES
from isacbench.plugins.registry import describe_plugin

if TYPE_CHECKING:
    from pathlib import Path

    from isacbench.model.scenes.scene_families import Family


def catalogue() -> dict[str, list[dict[str, Any]]]:
    """Describe everything that is registered or built in.

    Returns
    -------
    dict of str to list of dict
        ``estimators``, ``detectors`` and ``metrics`` as `isacbench.plugins.registry.describe_plugin`
        gives them; ``scenarios`` and ``suites`` with ``name`` and
        ``description``, the comment that their file starts with; ``families`` of
        scenes with ``name``, ``version``, ``description`` and ``parameters`` (name to
        ``type``, and where there are such ``allowed`` and ``default``).
    """
    return {
        "estimators": describe_plugin("estimator"),
        "detectors": describe_plugin("detector"),
        "metrics": describe_plugin("metric"),
        "scenarios": [
            {"name": name, "description": _first_comment(find_toml(name, "scenario"))}
            for name in scenario_names()
        ],
        "families": [_describe_family(family) for family in FAMILIES.values()],
        "suites": [{"name": name, "description": _first_comment(find_suite(name))} for name in suite_names()],
    }


def _describe_family(family: Family) -> dict[str, Any]:
    """Name, version, description and parameters of a family."""
    parameters = family.parameters.model_json_schema()["properties"]
    return {
        "name": family.name,
        "version": family.version,
        "description": family.description,
        "parameters": {name: _describe_parameter(schema) for name, schema in parameters.items()},
    }


def _describe_parameter(schema: dict[str, Any]) -> dict[str, Any]:
    """Type, allowed values and default of a parameter from its JSON schema."""
    schema = {**schema.get("anyOf", [{}])[0], **schema}
    described = {"type": schema["type"]}
    if "enum" in schema:
        described["allowed"] = " or ".join(schema["enum"])
    elif "minimum" in schema:
        described["allowed"] = f"{schema['minimum']} to {schema['maximum']}"
    return described | {key: schema[key] for key in ("default",) if key in schema}


def _first_comment(path: Path) -> str:
    """First line of a file if it is a comment, without its sign."""
    first = path.read_text(encoding="utf-8").partition("\n")[0]
    return first.removeprefix("#").strip() if first.startswith("#") else ""
