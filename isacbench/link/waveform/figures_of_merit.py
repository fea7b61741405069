"""Bit rates of the waveform."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import xlogy

from isacbench.checked_arrays import Floats, checked_array
from isacbench.choices import Modulation
from isacbench.link.waveform.qam import bits_per_symbol
from isacbench.model.number_limits import require_all
from isacbench.model.numerology import System, prs_elements


@dataclass(frozen=True)
class FrameRates:
    """Bits that frames sent one after the other carry, free of errors.

    Attributes
    ----------
    n_data_bits : int
        Bits of the elements that the PRS leaves.
    bit_rate_bps : float
        Data bits over the time of all symbols with their prefixes; a suffix overlaps
        the next prefix.
    """

    n_data_bits: int
    bit_rate_bps: float

    def achievable_rate_bps(self, ber: ArrayLike) -> Floats:
        """Compute the rate up to which a code could make the decided bits free of errors.

        Parameters
        ----------
        ber : array_like, any shape
            Bit error rate of independent errors, from 0 to 1.
        """
        return self.bit_rate_bps * hard_decision_capacity(ber)


def frame_rates(system: System, modulation: Modulation) -> FrameRates:
    """Count the bits of a frame, and its bit rate.

    Examples
    --------
    >>> from isacbench.model.numerology import System
    >>> rates = frame_rates(System(), "256qam")
    >>> rates.n_data_bits, round(rates.bit_rate_bps / 1e9, 3)
    (3473408, 2.977)
    """
    n_data_bits = bits_per_symbol(modulation) * int((~prs_elements(system)).sum())
    return FrameRates(n_data_bits, n_data_bits / (system.n_symbols * system.symbol_time_s))


def hard_decision_capacity(ber: ArrayLike) -> Floats:
    """Capacity of the binary symmetric channel: the information in bits that a decided bit carries.

    An `InputError` where a bit error rate is not from 0 to 1.
    """
    rate = checked_array("ber", ber)
    require_all("ber", rate, (rate >= 0) & (rate <= 1), "numbers from 0 to 1")
    entropy = -(xlogy(rate, rate) + xlogy(1 - rate, 1 - rate)) / np.log(2)
    return 1 - entropy
