"""TOML files from users and from the package: found by name or path, validated, refused in one clear line."""

import re
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from isacbench.errors import InputError, did_you_mean, unknown_name
from isacbench.files.checked_files import TOML_BYTES, read_text, require_file
from isacbench.files.escaping import quoted

Table = TypeVar("Table", bound=BaseModel)
Location = tuple[int | str, ...]
PACKAGE = "isacbench_scenarios"


def builtin_names(folder: str = ".") -> list[str]:
    """Names of the TOML files that ship in a folder of the scenario package, sorted."""
    return sorted(path.stem for path in _builtin_folder(folder).glob("*.toml"))


def find_toml(name_or_path: str | Path, what: str, folder: str = ".", others: str = "") -> Path:
    """Find a TOML file by its built-in name in a folder, or by path if it has the suffix ``.toml``.

    `what` is its kind in messages, and `others` what the caller allows besides.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml":
        try:
            require_file(path, missing="no such file")
        except InputError as error:
            raise InputError(f"{what} {error}") from error
        return path
    names = builtin_names(folder)
    if str(name_or_path) in names:
        return _builtin_folder(folder) / f"{name_or_path}.toml"
    unknown = unknown_name(what, str(name_or_path), names)
    raise InputError(f"{unknown}, {others}or the path of a .toml file")


def read_toml(path: Path, model: type[Table]) -> Table:
    """Read a TOML file and validate it; refuse an offending key with its value and what is allowed."""
    text = read_text(path, TOML_BYTES, missing="cannot be read: No such file or directory")
    try:
        return model.model_validate(tomllib.loads(text))
    except ValidationError as error:
        raise InputError(f"{path}: {describe_mistake(error, model)}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error


def describe_mistake(error: ValidationError, model: type[BaseModel]) -> str:
    """Put a validation error in one line: key, value and what is allowed.

    Of several mistakes an unknown key comes first: a key that seems to be
    missing is often there, but misspelt.
    """
    mistake = min(error.errors(include_url=False), key=lambda mistake: mistake["type"] != "extra_forbidden")
    location, context = mistake["loc"], mistake.get("ctx", {})
    key, tag_key = _dotted(location), context.get("discriminator", "").strip("'")
    match mistake["type"]:
        case "extra_forbidden":
            known = list(_schema_at(model, location[:-1])["properties"])
            return f"unknown key {key}: {did_you_mean(str(location[-1]), known)}"
        case "missing":
            return f"missing key {key}"
        case "union_tag_not_found":
            return f"missing key {key}.{tag_key}"
        case "union_tag_invalid":
            allowed = sorted(context["expected_tags"].replace("'", "").split(", "))
            return f"{key}.{tag_key} = {quoted(context['tag'])}: {did_you_mean(context['tag'], allowed)}"
    message = re.sub("[Tt]uple", "list", mistake["msg"].removeprefix("Value error, "))  # TOML has lists
    return f"{key} = {quoted(mistake['input'])}: {message[0].lower()}{message[1:]}"


def _builtin_folder(folder: str) -> Path:
    return Path(str(resources.files(PACKAGE))) / folder


def _dotted(location: Location) -> str:
    """Write a location as TOML would: ``objects[2].size_m``; the tag of a union is not a key."""
    text = ""
    for index, part in enumerate(location):
        if isinstance(part, int):
            text += f"[{part}]"
        elif not (0 < index < len(location) - 1 and isinstance(location[index - 1], int)):
            text += f".{part}" if text else part
    return text


def _schema_at(model: type[BaseModel], location: Location) -> dict[str, Any]:
    """JSON schema of what is at a location."""
    schema = model.model_json_schema()
    definitions, table = schema.get("$defs", {}), schema
    for part in location:
        if isinstance(part, int):
            table = table["items"]
        elif "discriminator" in table:
            table = {"$ref": table["discriminator"]["mapping"][part]}
        else:
            table = table["properties"][part]
        if "$ref" in table:
            table = definitions[table["$ref"].rsplit("/", 1)[-1]]
    return table
