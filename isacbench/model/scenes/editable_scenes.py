"""Scenarios written out as TOML files that can be edited."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import tomli_w

from isacbench.errors import InputError
from isacbench.files.checked_files import TOML_BYTES, read_text, require_new, require_utf8, write_errors
from isacbench.files.escaping import escape_control
from isacbench.model.scenes.generators import scene_table
from isacbench.model.scenes.scenario import MAX_NAME, load_scenario
from isacbench.model.scenes.scene_families import family_specs, is_family_spec, scenario_file

_NUMBERS = re.compile(r"\[\n((?: +[-+.\de]+,\n)+)\]")
"""Array of numbers as the writer of TOML lays it out, a number a line."""


def scene_toml(name_or_path: str) -> str:
    """Write a scenario as TOML, under its own name, with a comment on its origin; other comments are lost."""
    load_scenario(name_or_path)
    return _toml_of(_content(name_or_path), name_or_path)


def write_scene(name_or_path: str, out: Path) -> None:
    """Write a scenario to a new TOML file, named after the file.

    The name seeds the noise and the errors of the array. The scatterers are the same, bit for bit.
    One that reads other files, which lie beside its own file, can only be written there.
    """
    if out.suffix != ".toml" or len(out.stem) > MAX_NAME:
        raise InputError(f"{out}: allowed is a name of at most {MAX_NAME} characters that ends in .toml")
    require_new(out)
    require_utf8(out)
    load_scenario(name_or_path)
    content = _content(name_or_path)
    _require_same_folder(content, name_or_path, out)
    text = _toml_of({**content, "name": out.stem}, name_or_path)
    with write_errors(out), out.open("x", encoding="utf-8") as file:
        file.write(text)


def _content(name_or_path: str) -> dict[str, Any]:
    """Content of the file of a scenario, or of the one that its family would have."""
    if is_family_spec(name_or_path):
        return scene_table(family_specs(name_or_path)[0])
    return tomllib.loads(read_text(scenario_file(name_or_path), TOML_BYTES))


def _toml_of(content: dict[str, Any], name_or_path: str) -> str:
    """Text of a file, with a comment on its origin."""
    text = _NUMBERS.sub(lambda array: f"[{' '.join(array[1].split())[:-1]}]", tomli_w.dumps(content))
    return f"# Written from {_origin(name_or_path)}.\n{text}"


def _origin(name_or_path: str) -> str:
    """Specification and version of a family, or name or path of a file."""
    if is_family_spec(name_or_path):
        (spec,) = family_specs(name_or_path)
        return f"{spec.name}, version {spec.family.version} of the family"
    return escape_control(name_or_path)


def _require_same_folder(content: dict[str, Any], name_or_path: str, out: Path) -> None:
    """Refuse a copy that would not find the files of its original."""
    objects = content.get("objects", [])
    files = [entry["file"] for entry in objects if "file" in entry]
    folder = scenario_file(name_or_path).parent if files else out.parent
    if folder.resolve() != out.parent.resolve():
        raise InputError(
            f"{out}: the scenario reads {files[0]!r} beside its own file; allowed is a file in {folder}"
        )
