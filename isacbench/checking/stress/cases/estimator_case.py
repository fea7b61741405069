"""Base of the cases of estimators: they observe a small scene."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from isacbench.checking.stress.case import Case, adapted
from isacbench.checking.stress.promises.image_promises import Imaging

if TYPE_CHECKING:
    from isacbench.checking.contract.small_scenes import Shot
    from isacbench.plugins.contracts import Estimator
    from isacbench.plugins.discovery import PluginKind


@dataclass(frozen=True)
class EstimatorCase(Case[Imaging]):
    """A scene, and parameters that the estimator takes for it."""

    kind: ClassVar[PluginKind] = "estimator"

    @abstractmethod
    def shot(self, seed: int) -> Shot:
        """Observe the scene; noise and random places follow from the seed."""

    def subject(self, plugin: Estimator, seed: int) -> Imaging:
        """Let an estimator image the scene.

        Raises
        ------
        NotApplicableError
            If it lacks a parameter that the case sets.
        """
        return Imaging(adapted(plugin, self.parameters()), self.shot(seed))
