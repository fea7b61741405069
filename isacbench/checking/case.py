"""Cases: hostile but finite input, written ``name[param=value,...]``, and the checks that are made on it.

A family of cases is a function with a space for each parameter. Its table lists the cases that are always
gone through; the random search draws from the same spaces, and what it finds is added to the table.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from isacbench.checking.checks import Check, NotApplicableError
from isacbench.errors import InputError, unknown_name


@dataclass(frozen=True)
class Real:
    """Numbers between two limits, both included."""

    types: ClassVar[tuple[type, ...]] = (int, float)
    noun: ClassVar[str] = "numbers"

    low: float
    high: float
    default: float

    def __contains__(self, value: Any) -> bool:
        return type(value) in self.types and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{self.noun} from {self.low:g} to {self.high:g}"


class Whole(Real):
    """Integers between two limits, both included."""

    types = (int,)
    noun = "whole numbers"


class Choice:
    """One of a few words or numbers, by default the first."""

    def __init__(self, *values: str | int) -> None:
        self.values, self.default = values, values[0]

    def __contains__(self, value: Any) -> bool:
        return any(type(value) is type(one) and value == one for one in self.values)

    def __str__(self) -> str:
        return f"one of {', '.join(map(str, self.values))}"


Space = Real | Choice
Make = Callable[..., tuple[Any, Sequence[Check]]]


@dataclass(frozen=True, eq=False)
class Family:
    """A family of cases; see `family`.

    Attributes
    ----------
    kind : {"estimator", "detector"}
        Kind of plugin that it is meant for.
    make : callable
        Takes a plugin, a seed of what is random, and the parameters; returns the subject of the checks and
        the checks. Where the first fails, the others are not made.
    table : sequence of tuple
        Parameters of the cases that are always gone through, in the order of the spaces; those that a row
        lacks have their defaults.
    spaces : mapping of str to Space
        By parameter.
    """

    name: str
    kind: Literal["estimator", "detector"]
    make: Make
    table: Sequence[tuple[Any, ...]]
    spaces: Mapping[str, Space]

    @property
    def description(self) -> str:
        """What its cases are, in a line."""
        return (self.make.__doc__ or "").partition("\n")[0]

    def case(self, **params: Any) -> Case:
        """Make a case, with defaults for what is not given; refuse what lies outside its space."""
        for key in params:
            if key not in self.spaces:
                raise unknown_name(f"parameter of case {self.name}", key, self.spaces)
        values = {key: params.get(key, space.default) for key, space in self.spaces.items()}
        for key, space in self.spaces.items():
            if values[key] not in space:
                raise InputError(f"case {self.name}: {key} = {values[key]!r}; allowed are {space}")
        return Case(self, tuple(values.values()))

    def cases(self) -> list[Case]:
        """Cases of the table."""
        return [self.case(**dict(zip(self.spaces, row, strict=False))) for row in self.table]


@dataclass(frozen=True)
class Case:
    """A case of a family: values of its parameters, in their order."""

    family: Family
    values: tuple[Any, ...]

    @property
    def spec(self) -> str:
        """Specification with all parameters, as `isacbench stress --case` takes it."""
        params = ",".join(map("{}={}".format, self.family.spaces, self.values))
        return f"{self.family.name}[{params}]" if params else self.family.name

    def make(self, plugin: Any, seed: int = 0) -> tuple[Any, Sequence[Check]]:
        """Put plugin and input together into the subject of the checks, and return it with the checks."""
        return self.family.make(plugin, seed, *self.values)


def family(
    name: str, table: Iterable[tuple[Any, ...]], *, kind: Literal["estimator", "detector"], **spaces: Space
) -> Callable[[Make], Family]:
    """Make a family of cases of a function that takes a plugin, a seed, and a value of each space."""
    return lambda make: Family(name, kind, make, [*table], spaces)


def with_parameters(plugin: Any, **params: Any) -> Any:
    """Copy a plugin with some parameters replaced; a case says nothing about one that lacks them."""
    fields = {field.name for field in dataclasses.fields(plugin)}
    if missing := sorted(set(params) - fields):
        raise NotApplicableError(f"it has no parameter {missing[0]}")
    return dataclasses.replace(plugin, **params)
