"""What cases of estimators share: they observe a small scene."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from isacbench.stress.case import Case, NotApplicableError
from isacbench.stress.imaging import Imaging

if TYPE_CHECKING:
    from collections.abc import Mapping

    from isacbench.conformance.scenes import Shot
    from isacbench.entries import Kind
    from isacbench.registry import AnyEstimator

__all__ = ["EstimatorCase"]


@dataclass(frozen=True)
class EstimatorCase(Case[Imaging]):
    """A scene, and parameters that the estimator takes for it."""

    kind: ClassVar[Kind] = "estimator"

    @abstractmethod
    def shot(self, seed: int) -> Shot:
        """Observe the scene; noise and random places follow from the seed."""

    def parameters(self) -> Mapping[str, Any]:
        """Parameters that an estimator must have and take, none by default."""
        return {}

    def subject(self, plugin: AnyEstimator, seed: int) -> Imaging:
        """Let an estimator image the scene.

        Raises
        ------
        NotApplicableError
            If it lacks a parameter that the case sets.
        """
        parameters = self.parameters()
        fields = {field.name for field in dataclasses.fields(plugin)}  # type: ignore[arg-type]
        if missing := sorted(set(parameters) - fields):
            raise NotApplicableError(f"it has no parameter {missing[0]}")
        return Imaging(dataclasses.replace(plugin, **parameters), self.shot(seed))  # type: ignore[type-var]
