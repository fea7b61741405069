"""Figures of merit of the waveform: bit rates and peaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike
from scipy.special import xlogy

from isacbench.checked_arrays import Floats, checked_array
from isacbench.choices import Modulation
from isacbench.errors import InputError, require
from isacbench.link.waveform.qam import bits_per_symbol
from isacbench.model.number_limits import require_all, require_count
from isacbench.model.numerology import System, prs_elements

MOST_CROSSINGS_AT = 0.5
"""Power over its mean at which an envelope of Gaussian samples crosses upwards most often."""


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

        Returns
        -------
        ndarray of float64, same shape

        Raises
        ------
        InputError
            If a rate is not from 0 to 1.
        """
        return self.bit_rate_bps * hard_decision_capacity(ber)


def frame_rates(system: System, modulation: Modulation) -> FrameRates:
    """Count the bits of a frame, and its bit rate.

    Parameters
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}

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
    return FrameRates(n_data_bits, n_data_bits / (system.n_symbols * system.symbol_time_s))


def hard_decision_capacity(ber: ArrayLike) -> Floats:
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
    """
    rate = checked_array("ber", ber)
    require_all("ber", rate, (rate >= 0) & (rate <= 1), "numbers from 0 to 1")
    entropy = -(xlogy(rate, rate) + xlogy(1 - rate, 1 - rate)) / np.log(2)
    return 1 - entropy


def symbol_papr_db(symbols: ArrayLike, oversampling: int = 4) -> Floats:
    """Measure the peak-to-average power ratio of every OFDM symbol.

    Parameters
    ----------
    symbols : array_like, shape (n_subcarriers, n_symbols)
        Resource grid. It is fastest where the subcarriers of a symbol lie side
        by side in memory.
    oversampling : int
        Samples over the critical number: at 1 peaks between them are missed,
        at 4 about 0.05 dB of their height is.

    Returns
    -------
    ndarray of float64, shape (n_symbols,)
        Largest power of the useful part, in dB over the mean power of all
        symbols. The prefix repeats samples of it.

    Raises
    ------
    InputError
        If the grid has no two axes, is empty or not finite, or carries no
        power.

    Examples
    --------
    >>> symbol_papr_db(np.ones((16, 1))).round(2).tolist()
    [12.04]
    """
    require_count("oversampling", oversampling)
    grid = checked_array("symbols", symbols, np.complex128)
    if grid.ndim != 2 or grid.size == 0:
        raise InputError(
            f"symbols of shape {grid.shape}: allowed are subcarriers by symbols, at least one each"
        )
    mean = float(np.mean(grid.real**2 + grid.imag**2))
    require(0 < mean < np.inf, "mean power of the symbols", mean, "a positive number")
    samples = scipy.fft.ifft(grid.T, oversampling * len(grid), axis=1, norm="forward")
    peak = (samples.real**2 + samples.imag**2).max(axis=1) / len(grid)
    return 10 * np.log10(peak / mean)


def papr_ccdf(papr_db: ArrayLike, n_subcarriers: int, *, oversampled: bool = True) -> Floats:
    """Probability that the peak-to-average power ratio of a symbol is exceeded, for Gaussian samples.

    Symbols of many subcarriers have samples that are nearly Gaussian, whatever
    the constellation. At the critical rate the samples are independent, and
    one of N exceeds γ with the probability 1 - (1 - exp(-γ))^N. Of the
    continuous envelope N √(πγ/3) exp(-γ) upward crossings of a high level γ
    are expected, of a process with a flat spectrum; rare crossings are
    Poisson.

    Parameters
    ----------
    papr_db : array_like, any shape
    oversampled : bool
        Of the continuous envelope, not of samples at the critical rate. It
        is meant for rare peaks, and is taken constant below -3 dB, the level
        of most crossings.

    Returns
    -------
    ndarray of float64, same shape

    References
    ----------
    Ochiai and Imai, "On the distribution of the peak-to-average power ratio in
    OFDM signals", IEEE Trans. Commun. 49 (2001); crossings by Rice, "Statistical
    properties of a sine wave plus random noise", Bell Syst. Tech. J. 27 (1948).

    Examples
    --------
    >>> papr_ccdf([10.0, 12.0], 2048, oversampled=False).round(6).tolist()
    [0.088789, 0.000268]
    """
    power = 10 ** (checked_array("papr_db", papr_db) / 10)
    if oversampled:
        power = np.maximum(power, MOST_CROSSINGS_AT)
        expected = n_subcarriers * np.sqrt(np.pi / 3 * power) * np.exp(-power)
    else:
        with np.errstate(divide="ignore"):
            expected = -n_subcarriers * np.log1p(-np.exp(-power))
    return -np.expm1(-expected)
