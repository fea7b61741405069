"""Bit rates of a frame: what its data could carry, and what the PRS, the prefix and errors take of it."""

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
    frame_time_s : float
        All symbols with their prefixes; suffixes overlap the next prefix.
    n_data_bits : int
        Bits of the elements that the PRS leaves.
    bit_rate_bps : float
        Data bits over the frame's time.
    without_prs_bps : float
        What it would be if the PRS carried data as well.
    without_prefix_bps : float
        What it would be if there were neither PRS nor prefix.
    """

    modulation: Modulation
    frame_time_s: float
    n_data_bits: int
    bit_rate_bps: float
    without_prs_bps: float
    without_prefix_bps: float

    @property
    def prs_share(self) -> float:
        """Share of the bits that the PRS costs."""
        return 1 - self.bit_rate_bps / self.without_prs_bps

    @property
    def prefix_share(self) -> float:
        """Share of the time that the cyclic prefix costs."""
        return 1 - self.without_prs_bps / self.without_prefix_bps

    def achievable_rate_bps(self, ber: ArrayLike) -> NDArray[np.float64]:
        """Rate up to which a code could make the decided bits free of errors.

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
    """Bit rates of a frame.

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
    >>> round(rates.bit_rate_bps / 1e9, 3), round(rates.prs_share, 4), round(rates.prefix_share, 4)
    (2.977, 0.0536, 0.2)
    """
    n_bits = bits_per_symbol(modulation)
    is_prs = prs_elements(system)
    n_data_bits = n_bits * (is_prs.size - int(is_prs.sum()))
    frame_time_s = system.n_symbols * system.symbol_time_s
    return FrameRates(
        modulation=modulation,
        frame_time_s=frame_time_s,
        n_data_bits=n_data_bits,
        bit_rate_bps=n_data_bits / frame_time_s,
        without_prs_bps=n_bits * is_prs.size / frame_time_s,
        without_prefix_bps=n_bits * system.bandwidth_hz,
    )


def hard_decision_capacity(ber: ArrayLike) -> NDArray[np.float64]:
    """Information that a decided bit carries: the capacity of the binary symmetric channel, in bits.

    Parameters
    ----------
    ber : array_like, any shape
        Bit error rate, from 0 to 1.

    Returns
    -------
    ndarray of float64, same shape
        From 0 to 1.

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
