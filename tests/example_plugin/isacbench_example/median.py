"""The median of the whole map as its noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from isacbench.dsp.cfar import checked_power
from isacbench.dsp.cfar.factors import check_pfa
from isacbench.plugins.contracts import Detection

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MedianCfar"]


@dataclass(frozen=True)
class MedianCfar:
    """Median of the whole map as its noise: for maps that are mostly empty.

    Attributes
    ----------
    pfa : float
        Probability of false alarm per cell in homogeneous noise; exact for
        large maps.

    Raises
    ------
    InputError
        If `pfa` is out of range.
    """

    name: ClassVar[str] = "median"

    pfa: float = 1e-3

    def __post_init__(self) -> None:
        check_pfa(self.pfa)

    def detect(self, power: NDArray[np.floating], looks: int = 1) -> Detection:
        """Test every cell of a power map.

        Power averaged over M looks is gamma-distributed with shape M.
        """
        power = checked_power(power, looks)
        median_of_unit_noise = gammaincinv(looks, 0.5) / looks
        noise = np.full(power.shape, np.median(power) / median_of_unit_noise)
        threshold = noise * gammainccinv(looks, self.pfa) / looks
        return Detection(power > threshold, threshold, noise)
