"""Prediction of bit error rates over a channel that is given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from isacbench.choices import Modulation
from isacbench.link.waveform.qam import awgn_ber, bits_per_symbol

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

MOST_SUMMED = 2**12
"""Elements up to which the closed form is summed for each; beyond, a table of it is interpolated."""

STEP_DB = 0.05
"""Of the table. Cubics through logarithms of error rates are off by less than 1e-7 of them."""

WEAKEST_DB, STRONGEST_DB = -120.0, 120.0
"""Ends of the table, where error rates have been even for long."""


def response_ber(
    modulation: Modulation, response: ArrayLike, snr_db: float, n_symbols: ArrayLike | None = None
) -> float:
    """Predict the bit error rate over a known channel: the mean over its elements, each in white noise.

    Parameters
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
    response : array_like of complex, any shape
        Of the elements that carry data.
    snr_db : float
        Of an element whose response is 1.
    n_symbols : array_like, shape of `response`, optional
        Data symbols that each element of the response stands for; the same
        for all unless given.

    Returns
    -------
    float

    Raises
    ------
    InputError
        If there is no such modulation.

    Examples
    --------
    >>> response_ber("qpsk", [1.0, 1.0], 9.59) == float(awgn_ber("qpsk", 9.59))
    True
    """
    with np.errstate(divide="ignore"):
        gain_db = 20 * np.log10(np.abs(np.asarray(response)))
    element_snr_db = snr_db + gain_db
    error_rates = awgn_ber if element_snr_db.size <= MOST_SUMMED else _interpolated_ber
    weights = None if n_symbols is None else np.asarray(n_symbols, dtype=np.float64)
    return float(np.average(error_rates(modulation, element_snr_db), weights=weights))


def _interpolated_ber(modulation: Modulation, snr_db: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate `isacbench.link.waveform.qam.awgn_ber` in a table, for many SNRs."""
    within_db = np.clip(snr_db, WEAKEST_DB, STRONGEST_DB)
    first, last = np.floor(within_db.min() / STEP_DB), np.ceil(within_db.max() / STEP_DB)
    table_db = STEP_DB * np.arange(first, last + 2)
    smallest = np.finfo(np.float64).tiny
    logarithm = CubicSpline(table_db, np.log(np.maximum(awgn_ber(modulation, table_db), smallest)))
    rates: NDArray[np.float64] = np.exp(logarithm(within_db))
    return rates


def effective_snr_db(modulation: Modulation, snr_db: float, noise_gain: float) -> float:
    """Compute the SNR at which a known channel gives the error rate of a noisy channel estimate.

    The estimate is off by e, of power σ² times the noise gain. Its part in phase
    with the channel scales symbols and noise alike, so that thresholds are off in
    proportion to their place: nothing in QPSK, whose only threshold is 0. Its part
    in quadrature turns symbols, which adds the other axis's amplitude to each
    and makes both smaller by the second order. Over all thresholds of L levels an
    axis the noise grows by

        noise_gain ((2L² - 2L - 1) / (2L² - 2) + σ²/2),

    half of the noise gain for QPSK, and nearly all of it for many levels.

    Parameters
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
    snr_db : float
    noise_gain : float
        Of the estimator, `isacbench.link.reception.channel_estimation.PrsEstimator.noise_gain`.

    Returns
    -------
    float
        To first order in the noise gain, which is small.

    Raises
    ------
    InputError
        If there is no such modulation.

    Examples
    --------
    >>> round(10.0 - effective_snr_db("qpsk", 10.0, 0.02), 3)
    0.048
    """
    n_levels = 2 ** (bits_per_symbol(modulation) // 2)
    share = (2 * n_levels**2 - 2 * n_levels - 1) / (2 * n_levels**2 - 2)
    noise_power = 10 ** (-snr_db / 10)
    return snr_db - 10 * float(np.log10(1 + noise_gain * (share + noise_power / 2)))
