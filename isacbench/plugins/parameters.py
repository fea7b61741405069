"""Parameters of plugins: the fields of their dataclasses, and the values that these may have."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
from typing import Any, get_type_hints

from isacbench.errors import InputError
from isacbench.files.escaping import shortened
from isacbench.plugins.contracts import Detector
from isacbench.plugins.discovery import METHODS
from isacbench.specifications import QuotedText

MOST_BITS = 4096
"""Of an integer that is a parameter."""

ALLOWED = "finite numbers, texts, booleans, none, tuples of these, and detectors"
"""Values of parameters, which a run can store, a command can spell, and another process can have."""


def canonical_params(plugin: object) -> str:
    """Write every parameter of a dataclass, such as an estimator or a detector, as canonical JSON.

    Sorted keys, no spaces, defaults included; a nested detector is an object with its ``name`` beside its
    parameters. Equal parameters give equal strings. A value that is not one of `ALLOWED` is refused, naming
    plugin and parameter.
    """
    return json.dumps(_plain_params(plugin), sort_keys=True, separators=(",", ":"), allow_nan=False)


def is_frozen_dataclass(plugin: object) -> bool:
    """Tell whether an object is a class, a dataclass and frozen."""
    parameters = getattr(plugin, "__dataclass_params__", None)
    return inspect.isclass(plugin) and bool(getattr(parameters, "frozen", False))


def parameter_fields(plugin: Any) -> list[dataclasses.Field[Any]]:
    """List the fields of a dataclass, or of an instance, that are parameters and not made of others."""
    return [field for field in dataclasses.fields(plugin) if field.init]


def required_fields(plugin: Any) -> list[str]:
    """List the fields of a dataclass that have no default."""
    return [
        field.name
        for field in parameter_fields(plugin)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]


def field_defaults(plugin: Any) -> dict[str, Any]:
    """Collect the defaults of the fields of a dataclass that have one."""
    return {
        field.name: field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        for field in parameter_fields(plugin)
        if field.name not in required_fields(plugin)
    }


def parameter_types(kind: str, plugin: type[Any]) -> dict[str, Any]:
    """Resolve the types of a plugin's fields; `Detector` may be imported for type checking only."""
    try:
        hints = get_type_hints(plugin, localns={"Detector": Detector}, include_extras=True)
    except NameError as error:
        raise InputError(
            f"{kind} {plugin.name}: the type of a parameter cannot be resolved ({error}): "
            "import it at run time, not under TYPE_CHECKING"
        ) from error
    refuse_init_variables(kind, plugin)
    return {field.name: hints[field.name] for field in parameter_fields(plugin)}


def refuse_init_variables(kind: str, plugin: type[Any]) -> None:
    """Refuse a dataclass with values that its instances do not keep: no row could name them."""
    for base in plugin.__mro__:
        for key, hint in vars(base).get("__annotations__", {}).items():
            if "InitVar" in str(hint):
                raise InputError(
                    f"{kind} {plugin.name}: {key} is an InitVar, which is not kept: make it a field"
                )


def plain_value(where: str, key: str, value: Any) -> Any:
    """Convert a parameter's value to types of JSON, or refuse it; plugin and key are for messages."""
    value = python_number(value)
    if value is None or type(value) is bool or (type(value) is float and math.isfinite(value)):
        return value
    if type(value) is int and value.bit_length() <= MOST_BITS:
        return value
    if _is_unicode(value):
        return str(value)
    if type(value) is tuple:
        return [plain_value(where, key, item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and isinstance(value, Detector):
        return {"name": value.name, **_plain_params(value)}
    shown = hex(value) if type(value) is int else repr(value)  # decimal digits have a limit in Python
    shown = " ".join(shortened(shown).split())
    raise InputError(f"{where}: {key} = {shown}: allowed are {ALLOWED}")


def _plain_params(plugin: Any) -> dict[str, Any]:
    kind = next((kind for kind, method in METHODS.items() if hasattr(plugin, method)), "class")
    where = f"{kind} {getattr(plugin, 'name', type(plugin).__name__)}"
    names = [field.name for field in parameter_fields(plugin)]
    return {name: plain_value(where, name, getattr(plugin, name)) for name in names}


def python_number(value: Any) -> Any:
    """Take Python's number, text or truth value for one of NumPy; other values stay."""
    return (
        value.item() if type(value).__module__ == "numpy" and getattr(value, "shape", None) == () else value
    )


def _is_unicode(value: Any) -> bool:
    """Tell whether something is a text that can be stored: one without halves of characters."""
    return type(value) in (str, QuotedText) and value.encode(errors="replace").decode() == value
