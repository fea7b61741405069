"""Objects that print a few lines."""

from __future__ import annotations

import dataclasses
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike

WIDTH = 110
"""Characters of a line, unless it takes longer ones to keep to few."""

MOST_FACT_LINES = 2
MOST_OF_A_FIELD = 80
INDENT = "  "
NO_BREAK = "\u00a0"


class Description(NamedTuple):
    """An object in words.

    Attributes
    ----------
    title : str
        Its type, and how large it is.
    facts : mapping of str to str
        Names and values with their units.
    """

    title: str
    facts: Mapping[str, str]


class Displayed(ABC):
    """Object whose ``repr`` takes one to three lines.

    A dataclass that derives from it takes ``repr=False``.
    """

    @abstractmethod
    def _description(self) -> Description:
        """Return what is shown; in whatever state the object is, this neither fails nor takes long."""

    def __repr__(self) -> str:
        title, facts = self._description()
        parts = [f"{name} {value};".replace(" ", NO_BREAK) for name, value in facts.items()]
        if not parts:
            return title
        text = " ".join(parts).removesuffix(";")
        lines = _wrapped(text, WIDTH)
        if len(lines) > MOST_FACT_LINES:
            lines = _wrapped(text, len(text) // MOST_FACT_LINES + max(map(len, parts)) + len(INDENT))
        return "\n".join([title, *lines]).replace(NO_BREAK, " ")


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, initial_indent=INDENT, subsequent_indent=INDENT)


def range_text(values: ArrayLike, unit: str = "") -> str:
    """Write the smallest and the largest of some numbers, with those that are not finite counted.

    Examples
    --------
    >>> range_text([3.0, 1.25, float("nan")], "m")
    '1.25 to 3 m (1 not finite)'
    >>> range_text([])
    'none'
    """
    import numpy as np

    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        return array_text(array)
    finite = array[np.isfinite(array)]
    n_others = array.size - finite.size
    others = f" ({n_others} not finite)" if n_others else ""
    if not finite.size:
        return f"none{others}"
    ends = dict.fromkeys(f"{end:.4g}" for end in (finite.min(), finite.max()))
    return f"{' to '.join(ends)} {unit}".rstrip() + others


def array_text(array: np.ndarray[Any, Any]) -> str:
    """Write the type and the shape of an array."""
    return f"{array.dtype} {array.shape}"


def short_repr(instance: Any) -> str:
    """Write a dataclass with the types and shapes of its arrays and tables instead of their values.

    To be assigned to ``__repr__`` in the body of a dataclass.
    """
    fields = (
        f"{field.name}={_brief_value(getattr(instance, field.name))}"
        for field in dataclasses.fields(instance)
    )
    return f"{type(instance).__name__}({', '.join(fields)})"


def _brief_value(value: Any) -> str:
    """Write one field of `short_repr`; arrays and tables are known by their attributes, without an import."""
    if hasattr(value, "columns") and hasattr(value, "shape"):
        return f"{type(value).__name__} {value.shape}"
    if getattr(value, "shape", ()) and hasattr(value, "dtype"):
        return array_text(value)
    if isinstance(value, Displayed):
        return value._description().title
    return shortened(repr(value), MOST_OF_A_FIELD)
