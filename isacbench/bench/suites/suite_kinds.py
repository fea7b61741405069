"""The kinds of suites by name, suites read from files and manifests, and the catalogue of all names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, field_validator

from isacbench.bench.kinds.detection import DetectionKind
from isacbench.bench.kinds.drops import DropsKind
from isacbench.bench.kinds.efficiency import EfficiencyKind
from isacbench.bench.kinds.imaging import ImagingKind
from isacbench.bench.kinds.kind import Kind
from isacbench.bench.kinds.link import LinkKind
from isacbench.bench.kinds.population import PopulationKind
from isacbench.bench.kinds.resolution import ResolutionKind
from isacbench.bench.suites.suite import Suite, find_suite, suite_names
from isacbench.errors import InputError
from isacbench.files.toml_files import builtin_names, find_toml, read_toml
from isacbench.model.scenes.scene_families import FAMILIES
from isacbench.plugins.discovery import GROUPS
from isacbench.plugins.registry import describe_plugin
from isacbench.specifications import parse_spec

S = TypeVar("S", bound=Suite)

KINDS: dict[str, Kind] = {
    kind.name: kind()
    for kind in (
        *(ImagingKind, EfficiencyKind, ResolutionKind, DetectionKind, LinkKind, PopulationKind),
        DropsKind,
    )
}
"""Kinds of suites by the value of the key ``kind``. A new one is entered here, and nowhere else."""


class _KindOnly(BaseModel):
    """Key that decides which other keys a suite has."""

    kind: str = ImagingKind.name

    @field_validator("kind")
    @classmethod
    def _require_known(cls, value: str) -> str:
        if value not in KINDS:
            raise ValueError(f"allowed are {', '.join(map(repr, KINDS))}")
        return value


def kind_of(suite: Suite) -> Kind:
    """Look up the kind of a suite, which must be of the class of the kind's suites."""
    kind = KINDS.get(suite.kind)
    if kind is None or type(suite) is not kind.suite:
        allowed = ", ".join(f"{name!r} with {one.suite.__name__}" for name, one in KINDS.items())
        raise InputError(f"kind = {suite.kind!r} with {type(suite).__name__}: allowed are {allowed}")
    return kind


def with_metrics(suite: S, further: str | Iterable[str]) -> S:
    """Give a suite further metrics, each in place of one of the same name."""
    added = (further,) if isinstance(further, str) else tuple(further)
    named = {parse_spec(spec).name: spec for spec in (*kind_of(suite).metric_specs(suite), *added)}
    return suite.replace(metrics=tuple(named.values())) if added else suite


def load_suite(name_or_path: str | Path) -> Suite:
    """Load a built-in suite by name, or any suite by the path of its TOML file.

    Paths of scenarios are resolved against the suite's own folder.

    Examples
    --------
    >>> load_suite("paper").trials
    10
    """
    path = find_suite(name_or_path)
    suite = read_toml(path, KINDS[read_toml(path, _KindOnly).kind].suite)
    scenarios = (str(path.parent / one) if one.endswith(".toml") else one for one in suite.scenarios)
    return suite.model_copy(update={"scenarios": tuple(scenarios)})


def restore_suite(content: Mapping[str, Any]) -> Suite:
    """Build a suite from the result of its ``model_dump``; a missing kind is ``imaging``."""
    return KINDS[_KindOnly.model_validate(content).kind].suite.model_validate(content)


def catalogue() -> dict[str, list[dict[str, Any]]]:
    """Describe everything that is registered or built in, by name.

    Plugins as `isacbench.plugins.registry.describe_plugin` does; scenarios and suites by the comment that
    their file starts with; families of scenes with their parameters: ``type``, ``allowed``, ``default``.
    """
    scenarios = {name: find_toml(name, "scenario") for name in builtin_names()}
    suites = {name: find_suite(name) for name in suite_names()}
    return {
        **{f"{kind}s": describe_plugin(kind) for kind in GROUPS},
        "scenarios": _describe_files(scenarios),
        "families": [
            {
                "name": family.name,
                "version": family.version,
                "description": family.description,
                "parameters": {
                    name: _describe_parameter(schema)
                    for name, schema in family.parameters.model_json_schema()["properties"].items()
                },
            }
            for family in FAMILIES.values()
        ],
        "suites": _describe_files(suites),
    }


def _describe_files(paths: Mapping[str, Path]) -> list[dict[str, Any]]:
    """Names and first lines of files, where these are comments, without their sign."""
    first_lines = {name: path.read_text(encoding="utf-8").partition("\n")[0] for name, path in paths.items()}
    return [
        {"name": name, "description": line.removeprefix("#").strip() if line.startswith("#") else ""}
        for name, line in first_lines.items()
    ]


def _describe_parameter(schema: dict[str, Any]) -> dict[str, Any]:
    """Type, allowed values and default of a parameter from its JSON schema."""
    schema = {**schema.get("anyOf", [{}])[0], **schema}
    described = {"type": schema["type"]}
    if "enum" in schema:
        described["allowed"] = " or ".join(schema["enum"])
    elif "minimum" in schema:
        described["allowed"] = f"{schema['minimum']} to {schema['maximum']}"
    return described | ({"default": schema["default"]} if "default" in schema else {})
