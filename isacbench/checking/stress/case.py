"""Cases: hostile but finite input, written ``name[param=value,...]``, and the promises checked on it.

A case is a frozen dataclass. Its class is a family: every field has a space
(`isacbench.checking.stress.spaces`), ``fixed`` lists the members that the table holds,
and the random search draws from the same spaces. Members that the search finds
to fail are added to ``fixed``, so that they are always checked.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from isacbench.checking.promises.image_promises import Imaging
from isacbench.checking.promises.map_promises import TestedMap
from isacbench.checking.promises.promise import NotApplicableError, Promise
from isacbench.checking.promises.small_scenes import RESOLVED, Echo, Layout, Shot, observed
from isacbench.checking.stress.spaces import Space
from isacbench.errors import InputError, unknown_name
from isacbench.plugins.contracts import Detector, Estimator
from isacbench.plugins.discovery import PluginKind
from isacbench.specifications import Spec

Subject = TypeVar("Subject")
"""A plugin together with the input of a case; the promises are measured on it."""


def adapted(plugin: Any, parameters: Mapping[str, Any]) -> Any:
    """Copy of a plugin with some parameters replaced.

    Raises
    ------
    NotApplicableError
        If the plugin lacks one of them.
    InputError
        If the plugin refuses one.
    """
    fields = {field.name for field in dataclasses.fields(plugin)}
    if missing := sorted(set(parameters) - fields):
        raise NotApplicableError(f"it has no parameter {missing[0]}")
    return dataclasses.replace(plugin, **parameters)


@dataclass(frozen=True)
class Case(ABC, Generic[Subject]):
    """A case of a family; subclasses add fields, the input and the promises.

    Attributes
    ----------
    name : str
        Class attribute: name of the family.
    kind : {"estimator", "detector", "metric"}
        Class attribute: kind of plugin that the family is meant for.
    fixed : tuple of dict
        Class attribute: fields of the members in the table, without defaults.
    promised : tuple of Promise
        Class attribute: promises on every member, unless the family overrides
        `promises`.

    Raises
    ------
    InputError
        If a field lies outside its space.
    """

    name: ClassVar[str]
    kind: ClassVar[PluginKind]
    fixed: ClassVar[tuple[Mapping[str, Any], ...]] = ({},)
    promised: ClassVar[tuple[Promise[Any], ...]] = ()

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
        """Member that a specification describes.

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
        """Specification with all fields, as `isacbench stress --case` takes it."""
        fields = ",".join(f"{field.name}={getattr(self, field.name)}" for field in dataclasses.fields(self))
        return f"{self.name}[{fields}]" if fields else self.name

    @property
    def may_refuse(self) -> bool:
        """True if the plugin may answer with an `InputError`."""
        return False

    @property
    def promises(self) -> tuple[Promise[Subject], ...]:
        """Promises on this case; where the first is broken, the others are not measured."""
        return self.promised

    def parameters(self) -> Mapping[str, Any]:
        """Parameters to set on the plugin; none by default."""
        return {}

    @abstractmethod
    def subject(self, plugin: Any, seed: int) -> Subject:
        """Combine plugin and input into the subject of the promises.

        Parameters
        ----------
        seed : int
            Seed of the random parts of the input.

        Returns
        -------
        object
            Subject of the promises.

        Raises
        ------
        NotApplicableError
            If the plugin lacks a parameter that the case sets.
        """


class CaseScene(NamedTuple):
    """Echoes, their SNR in dB and the layout that observes them."""

    echoes: Sequence[Echo]
    snr_db: float = math.inf
    layout: Layout = Layout()


@dataclass(frozen=True)
class EstimatorCase(Case[Imaging]):
    """A scene, and parameters to set on the estimator for it."""

    kind: ClassVar[PluginKind] = "estimator"

    def scene(self) -> CaseScene:
        """Scene without random places: three resolved echoes without noise by default."""
        return CaseScene(RESOLVED)

    def shot(self, seed: int) -> Shot:
        """Observe the scene.

        Parameters
        ----------
        seed : int
            Seed of the noise, and of random places.
        """
        echoes, snr_db, layout = self.scene()
        return observed(echoes, snr_db, seed, layout)

    def subject(self, plugin: Estimator, seed: int) -> Imaging:
        """Let an estimator image the scene."""
        return Imaging(adapted(plugin, self.parameters()), self.shot(seed))


@dataclass(frozen=True)
class DetectorCase(Case[TestedMap]):
    """A power map, and parameters to set on the detector for it."""

    kind: ClassVar[PluginKind] = "detector"

    @abstractmethod
    def power(self, seed: int) -> NDArray[np.float64]:
        """Make the map.

        Parameters
        ----------
        seed : int
            Seed of the noise.
        """

    def n_looks(self) -> int:
        """Independent noise powers that each cell averages, one by default."""
        return 1

    def subject(self, plugin: Detector, seed: int) -> TestedMap:
        """Combine detector and map."""
        return TestedMap(adapted(plugin, self.parameters()), self.power(seed), self.n_looks())
