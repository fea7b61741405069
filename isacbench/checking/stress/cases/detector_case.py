"""Base of the cases of detectors: they test a small power map."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from isacbench.checking.stress.case import Case, adapted
from isacbench.checking.stress.promises.map_promises import TestedMap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from isacbench.plugins.contracts import Detector
    from isacbench.plugins.discovery import PluginKind

SHAPE = 13, 17
"""Of an ordinary map: primes, and larger than the windows by default."""


@dataclass(frozen=True)
class DetectorCase(Case[TestedMap]):
    """A power map, and parameters that the detector takes for it."""

    kind: ClassVar[PluginKind] = "detector"

    @abstractmethod
    def power(self, seed: int) -> NDArray[np.float64]:
        """Make the map; what is random follows from the seed."""

    def n_looks(self) -> int:
        """Independent noise powers that each cell averages, one by default."""
        return 1

    def subject(self, plugin: Detector, seed: int) -> TestedMap:
        """Bring detector and map together.

        Raises
        ------
        NotApplicableError
            If the detector lacks a parameter that the case sets.
        """
        return TestedMap(adapted(plugin, self.parameters()), self.power(seed), self.n_looks())


def white_noise_map(shape: tuple[int, ...], seed: int, looks: int = 1) -> NDArray[np.float64]:
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
