"""Fields that a frozen dataclass got after its first rows were stored.

Rows are known by the parameters of their estimator, scenarios by a digest of
what they consist of. A new field would make all that is stored another's. So it
says which of its values stands for the behaviour before it was there, and at
that value it is no part of the identity.
"""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

T = TypeVar("T")

BEFORE = "isacbench.before"
"""Key of a field's metadata."""


def added_field(default: T, *, before: T) -> T:
    """Declare a field of a frozen dataclass that older rows lack.

    Parameters
    ----------
    default : object
        Immutable.
    before : object
        Value at which everything is as it was without the field; often the
        default.

    Returns
    -------
    dataclasses.Field
        Typed as the default, as `dataclasses.field` is.

    Examples
    --------
    >>> @dataclasses.dataclass(frozen=True)
    ... class Mine:
    ...     n: int = 3
    ...     polish: bool = added_field(True, before=False)
    >>> [identity_fields(Mine(polish=polish)) for polish in (True, False)]
    [{'n': 3, 'polish': True}, {'n': 3}]
    """
    return dataclasses.field(default=default, metadata={BEFORE: before})


def identity_fields(instance: Any) -> dict[str, Any]:
    """List the values of a dataclass, without those that stand for the behaviour before their field.

    Parameters
    ----------
    instance : object
        Instance of a dataclass.

    Returns
    -------
    dict of str to object
        Not copied, in the order of the fields.
    """
    values = {field.name: getattr(instance, field.name) for field in dataclasses.fields(instance)}
    before = values_before(instance)
    return {
        name: value
        for name, value in values.items()
        if not (name in before and _is_equal(value, before[name]))
    }


def values_before(plugin: Any) -> dict[str, Any]:
    """List the values that stand for the behaviour before the later fields of a dataclass.

    Parameters
    ----------
    plugin : dataclass

    Returns
    -------
    dict of str to object
        By name of the field.
    """
    fields = dataclasses.fields(plugin)
    return {field.name: field.metadata[BEFORE] for field in fields if BEFORE in field.metadata}


def _is_equal(value: object, before: object) -> bool:
    """Tell whether two values are the same; 1 and True are not, and arrays are compared by identity."""
    return value is before or (type(value) is type(before) and isinstance(value, _PLAIN) and value == before)


_PLAIN = (bool, int, float, str, tuple)
