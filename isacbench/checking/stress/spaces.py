"""Spaces of a case's parameters: the fixed table picks from them, the random search draws from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Whole:
    """Integers between two limits, both included."""

    low: int
    high: int

    def __contains__(self, value: Any) -> bool:
        return type(value) is int and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"whole numbers from {self.low} to {self.high}"


@dataclass(frozen=True)
class Real:
    """Numbers between two limits, both included."""

    low: float
    high: float

    def __contains__(self, value: Any) -> bool:
        return type(value) in (int, float) and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"numbers from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Choice:
    """One of a few words or numbers."""

    values: tuple[str | int, ...]

    def __contains__(self, value: object) -> bool:
        return any(type(value) is type(one) and value == one for one in self.values)

    def __str__(self) -> str:
        return f"one of {', '.join(map(str, self.values))}"


Space = Whole | Real | Choice


def whole(low: int, high: int, default: int) -> Any:
    """Field of a case that holds an integer.

    Parameters
    ----------
    low, high : int
        Limits, both included.
    """
    return field(default=default, metadata={"space": Whole(low, high)})


def real(low: float, high: float, default: float) -> Any:
    """Field of a case that holds a number.

    Parameters
    ----------
    low, high : float
        Limits, both included.
    """
    return field(default=default, metadata={"space": Real(low, high)})


def choice(*values: str | int) -> Any:
    """Field of a case that holds one of a few values.

    Parameters
    ----------
    *values : str or int
        The first is the default.
    """
    return field(default=values[0], metadata={"space": Choice(values)})
