"""Bit rates of a frame: free of errors, and achievable at a bit error rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import xlogy

from isacbench.choices import Modulation
from isacbench.link.waveform.qam import bits_per_symbol
from isacbench.model.number_limits import require_all
from isacbench.model.prs import prs_elements

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from isacbench.model.numerology import System


@dataclass(frozen=True)
class FrameRates:
    """Bits that frames sent one after the other carry, free of errors.

    Attributes
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
    n_data_bits : int
        Bits of the elements that the PRS leaves.
    bit_rate_bps : float
        Data bits over the time of all symbols with their prefixes; a suffix overlaps
        the next prefix.
    """

    modulation: Modulation
    n_data_bits: int
    bit_rate_bps: float

    def achievable_rate_bps(self, ber: ArrayLike) -> NDArray[np.float64]:
        """Compute the rate up to which a code could make the decided bits free of errors.

        Parameters
        ----------
        ber : array_like, any shape
            Bit error rate of independent errors, from 0 to 1.

        Returns
        -------
        ndarray of float64, same shape

        Raises
        ------
        InputError
            If a rate is not from 0 to 1.
        """
        rate: NDArray[np.float64] = self.bit_rate_bps * hard_decision_capacity(ber)
        return rate


def frame_rates(system: System, modulation: Modulation) -> FrameRates:
    """Count the bits of a frame, and its bit rate.

    Parameters
    ----------
    system : System
    modulation : {"qpsk", "16qam", "64qam", "256qam"}

    Returns
    -------
    FrameRates

    Raises
    ------
    InputError
        If there is no such modulation.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> rates = frame_rates(System(), "256qam")
    >>> rates.n_data_bits, round(rates.bit_rate_bps / 1e9, 3)
    (3473408, 2.977)
    """
    n_data_bits = bits_per_symbol(modulation) * int((~prs_elements(system)).sum())
    return FrameRates(modulation, n_data_bits, n_data_bits / (system.n_symbols * system.symbol_time_s))


def hard_decision_capacity(ber: ArrayLike) -> NDArray[np.float64]:
    """Compute the information that a decided bit carries: the capacity of the binary symmetric channel.

    Parameters
    ----------
    ber : array_like, any shape
        Bit error rate, from 0 to 1.

    Returns
    -------
    ndarray of float64, same shape
        In bits, from 0 to 1.

    Raises
    ------
    InputError
        If a rate is not from 0 to 1.

    Examples
    --------
    >>> hard_decision_capacity([0.0, 0.5, 0.11]).round(3).tolist()
    [1.0, 0.0, 0.5]
    """
    rate = np.asarray(ber, dtype=np.float64)
    require_all("ber", rate, (rate >= 0) & (rate <= 1), "numbers from 0 to 1")
    entropy = -(xlogy(rate, rate) + xlogy(1 - rate, 1 - rate)) / np.log(2)
    capacity: NDArray[np.float64] = 1 - entropy
    return capacity
