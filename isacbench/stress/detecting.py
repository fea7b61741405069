"""What cases of detectors share: they test a small power map."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from isacbench.stress.case import Case, NotApplicableError
from isacbench.stress.tested_maps import TestedMap

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from isacbench.contracts import Detector
    from isacbench.entries import Kind

__all__ = ["SHAPE", "DetectorCase", "white_noise"]

SHAPE = 13, 17
"""Of an ordinary map: primes, and larger than the windows by default."""


@dataclass(frozen=True)
class DetectorCase(Case[TestedMap]):
    """A power map, and parameters that the detector takes for it."""

    kind: ClassVar[Kind] = "detector"

    @abstractmethod
    def power(self, seed: int) -> NDArray[np.float64]:
        """Make the map; what is random follows from the seed."""

    def n_looks(self) -> int:
        """Independent noise powers that each cell averages, one by default."""
        return 1

    def parameters(self) -> Mapping[str, Any]:
        """Parameters that a detector must have and take, none by default."""
        return {}

    def subject(self, plugin: Detector, seed: int) -> TestedMap:
        """Bring detector and map together.

        Raises
        ------
        NotApplicableError
            If the detector lacks a parameter that the case sets.
        """
        parameters = self.parameters()
        fields = {field.name for field in dataclasses.fields(plugin)}  # type: ignore[arg-type]
        if missing := sorted(set(parameters) - fields):
            raise NotApplicableError(f"it has no parameter {missing[0]}")
        detector = dataclasses.replace(plugin, **parameters)  # type: ignore[type-var]
        return TestedMap(detector, self.power(seed), self.n_looks())


def white_noise(shape: tuple[int, ...], seed: int, looks: int = 1) -> NDArray[np.float64]:
    """Power of white noise of mean 1, averaged over looks.

    Parameters
    ----------
    shape : tuple of int
    seed : int
    looks : int, default 1

    Returns
    -------
    ndarray of float64
    """
    return np.random.default_rng([seed, looks]).standard_gamma(looks, shape) / looks
