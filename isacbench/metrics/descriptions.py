"""Descriptions of scores: enough to label an axis, to rank by it, and to judge an image without points."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, get_args

from isacbench.errors import require

Direction = Literal["lower", "higher", "neither"]

ANY_KIND = "*"
"""Part of a column's name that stands for each kind of object of a scenario."""


@dataclass(frozen=True)
class ScoreColumn:
    """Meaning of a column.

    Attributes
    ----------
    name : str
        Key of the score. ``detected_*`` stands for a column for each kind of object of a scenario, such as
        ``detected_car``.
    description : str
        One line, without the unit.
    unit : str
        Such as ``m``; empty for a number without one.
    better : {"lower", "higher", "neither"}
        Direction that is better.
    empty : float or None
        Score of an image without points, NaN if it has none; None where it depends on the scene.

    Raises
    ------
    InputError
        If `better` is another word.
    """

    name: str
    description: str
    unit: str = ""
    better: Direction = "lower"
    empty: float | None = None

    def __post_init__(self) -> None:
        words = get_args(Direction)
        require(self.better in words, f"score column {self.name}: better", self.better, ", ".join(words))

    @property
    def title(self) -> str:
        """Description with its unit in brackets."""
        return f"{self.description} [{self.unit}]" if self.unit else self.description

    def of_kind(self, kind: str) -> ScoreColumn:
        """Describe the column of one kind of object."""
        name, description = (text.replace(ANY_KIND, kind) for text in (self.name, self.description))
        return ScoreColumn(name, description, self.unit, self.better, self.empty)


def expanded(columns: Iterable[ScoreColumn], kinds: Iterable[str]) -> dict[str, ScoreColumn]:
    """List columns by name, with one for each kind of object in place of those with ``*``.

    Parameters
    ----------
    kinds : iterable of str
        Of objects, as `object_kind` writes them.
    """
    listed = tuple(kinds)
    found = [
        one
        for column in columns
        for one in (map(column.of_kind, listed) if ANY_KIND in column.name else [column])
    ]
    return {column.name: column for column in found}


@lru_cache(maxsize=1024)  # every image asks for each of its scatterers
def object_kind(name: str) -> str:
    """Kind of an object such as ``lamp_post 2``, as columns are named by it; empty for points of none."""
    kind = re.sub(r"\W+", "_", re.sub(r"\W*\d+$", "", name).strip()).lower()
    return "" if kind == "points" else kind
