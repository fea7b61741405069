"""Spaces of a case's parameters: what the fixed table picks from and the random search draws from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Whole:
    """Integers between two limits, both included."""

    low: int
    high: int

    def __contains__(self, value: object) -> bool:
        return isinstance(value, int) and not isinstance(value, bool) and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"whole numbers from {self.low} to {self.high}"


@dataclass(frozen=True)
class Real:
    """Numbers between two limits, both included."""

    low: float
    high: float

    def __contains__(self, value: object) -> bool:
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return is_number and math.isfinite(value) and self.low <= value <= self.high  # type: ignore[operator, arg-type]

    def __str__(self) -> str:
        return f"numbers from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Choice:
    """One of a few words or numbers."""

    values: tuple[str | int | float, ...]

    def __contains__(self, value: object) -> bool:
        return any(type(value) is type(one) and value == one for one in self.values)

    def __str__(self) -> str:
        return f"one of {', '.join(map(str, self.values))}"


Space = Whole | Real | Choice


def whole(low: int, high: int, default: int) -> Any:
    """Field of a case that holds an integer between two limits."""
    return field(default=default, metadata={"space": Whole(low, high)})


def real(low: float, high: float, default: float) -> Any:
    """Field of a case that holds a number between two limits."""
    return field(default=default, metadata={"space": Real(low, high)})


def choice(*values: str | int | float) -> Any:
    """Field of a case that holds one of a few values, the first by default."""
    return field(default=values[0], metadata={"space": Choice(values)})
