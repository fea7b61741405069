"""Cases: hostile but finite input, spelled ``name[param=value,...]``, and what is promised on it.

A case is a frozen dataclass. Its class is a family: every field has a space
(`isacbench.checking.stress.spaces`), ``fixed`` lists the members that the table holds,
and the random search draws from the same spaces. What the search finds is
added to ``fixed`` and so kept for good.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

from isacbench.errors import InputError, unknown_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from isacbench.checking.stress.spaces import Space
    from isacbench.plugins.discovery import PluginKind
    from isacbench.plugins.specifications import Spec

Subject = TypeVar("Subject")
"""A plugin together with the input of a case; what its promises are measured on."""


class BrokenPromiseError(Exception):
    """A promise is broken in a way that no drift measures; the message says how."""


class NotApplicableError(Exception):
    """The case says nothing about this plugin; the message says why."""


@dataclass(frozen=True)
class Promise(Generic[Subject]):
    """Something that must hold on a case.

    Attributes
    ----------
    name : str
    bound : float
        Largest drift that is allowed.
    drift : callable
        Takes the subject and returns how far it is from what was promised, 0
        where nothing is to be seen. Raises `BrokenPromiseError` where no
        number says it; every other exception, and every warning, breaks the
        promise as well.
    """

    name: str
    bound: float
    drift: Callable[[Subject], float]


def adapted(plugin: Any, parameters: Mapping[str, Any]) -> Any:
    """Plugin with other parameters.

    Raises
    ------
    NotApplicableError
        If it lacks one of them.
    InputError
        If it refuses one.
    """
    fields = {field.name for field in dataclasses.fields(plugin)}
    if missing := sorted(set(parameters) - fields):
        raise NotApplicableError(f"it has no parameter {missing[0]}")
    return dataclasses.replace(plugin, **parameters)


@dataclass(frozen=True)
class Case(ABC, Generic[Subject]):
    """A case of a family; subclasses add fields, their input and what is promised.

    Attributes
    ----------
    name : str
        Class attribute: name of the family.
    kind : {"estimator", "detector"}
        Class attribute: what it is meant for.
    fixed : tuple of dict
        Class attribute: fields of the members that the table holds, the
        defaults left out.

    Raises
    ------
    InputError
        If a field lies outside its space.
    """

    name: ClassVar[str]
    kind: ClassVar[PluginKind]
    fixed: ClassVar[tuple[Mapping[str, Any], ...]] = ({},)

    def __post_init__(self) -> None:
        for key, space in self.spaces().items():
            value = getattr(self, key)
            if value not in space:
                raise InputError(f"case {self.name}: {key} = {value!r}; allowed are {space}")

    @classmethod
    def spaces(cls) -> dict[str, Space]:
        """Space of every field."""
        return {field.name: field.metadata["space"] for field in dataclasses.fields(cls)}

    @classmethod
    def table(cls) -> list[Self]:
        """Members that the fixed table holds."""
        return [cls(**values) for values in cls.fixed]

    @classmethod
    def of(cls, spec: Spec) -> Self:
        """Member that a specification spells.

        Raises
        ------
        InputError
            If a parameter is unknown or its value outside its space.
        """
        spaces = cls.spaces()
        for key in spec.params:
            if key not in spaces:
                raise unknown_name(f"parameter of case {cls.name}", key, spaces)
        return cls(**spec.params)

    @property
    def spec(self) -> str:
        """Its spelling, all fields included; `isacbench stress --case` takes it."""
        fields = ",".join(f"{field.name}={getattr(self, field.name)}" for field in dataclasses.fields(self))
        return f"{self.name}[{fields}]" if fields else self.name

    @property
    def may_refuse(self) -> bool:
        """Whether an `InputError` is a proper answer."""
        return False

    @property
    @abstractmethod
    def promises(self) -> tuple[Promise[Subject], ...]:
        """What must hold; where the first is broken, the others are not looked at."""

    def parameters(self) -> Mapping[str, Any]:
        """Parameters that a plugin must have and take, none by default."""
        return {}

    @abstractmethod
    def subject(self, plugin: Any, seed: int) -> Subject:
        """Bring the plugin and the input together.

        Parameters
        ----------
        plugin : Estimator or Detector
        seed : int
            What is random in the input follows from it and from the case.

        Raises
        ------
        NotApplicableError
            If the case says nothing about this plugin.
        """
