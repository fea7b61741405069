"""What theory says of a reception: error rates and error vectors over a channel that is given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.link.qam import Modulation, awgn_ber, bits_per_symbol

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["effective_snr_db", "estimated_evm", "response_ber", "response_evm"]


def response_ber(modulation: Modulation, response: ArrayLike, snr_db: float) -> float:
    """Bit error rate over a channel that the user knows: the mean over its elements, each in white noise.

    Parameters
    ----------
    modulation : {"qpsk", "16qam", "64qam", "256qam"}
    response : array_like of complex, any shape
        Of the elements that carry data.
    snr_db : float
        Of an element whose response is 1.

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
    return float(np.mean(awgn_ber(modulation, snr_db + gain_db)))


def response_evm(response: ArrayLike, snr_db: float) -> float:
    """Error vector magnitude behind division by a channel that the user knows.

    Noise is divided with it: the root mean square is that of σ/|H|, and weak
    elements make most of it.

    Parameters
    ----------
    response : array_like of complex, any shape
        Of the elements that carry data; none is 0.
    snr_db : float
        Of an element whose response is 1.

    Returns
    -------
    float
        Over the root mean square of data symbols, 1.

    Examples
    --------
    >>> response_evm([1.0], 20.0)
    0.1
    """
    power = np.abs(np.asarray(response)) ** 2
    return float(np.sqrt(10 ** (-snr_db / 10) * np.mean(1 / power)))


def effective_snr_db(modulation: Modulation, snr_db: float, noise_gain: float) -> float:
    """SNR in which the receiver with a noisy channel estimate is as good as one that knows the channel.

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
        Of the estimator, `isacbench.link.estimation.PrsEstimator.noise_gain`.

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


def estimated_evm(snr_db: float, noise_gain: float) -> float:
    """Error vector magnitude in white noise behind division by a noisy channel estimate.

    All of the estimate's error counts here, in phase or not.

    Parameters
    ----------
    snr_db : float
    noise_gain : float

    Returns
    -------
    float
        To first order in the noise gain.

    Examples
    --------
    >>> round(estimated_evm(20.0, 0.02), 4)
    0.101
    """
    return float(np.sqrt(10 ** (-snr_db / 10) * (1 + noise_gain)))
