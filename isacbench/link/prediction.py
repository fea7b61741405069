"""What theory says of a reception: error rates and error vectors over a channel that is given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from isacbench.link.qam import Modulation, awgn_ber

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["effective_snr_db", "response_ber", "response_evm"]


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


def effective_snr_db(snr_db: float, noise_gain: float) -> float:
    """SNR that the channel estimate's error leaves.

    The estimate is off by the noise power times its noise gain. Data symbols
    are off by that times their power, which is 1 in the mean: it adds to the
    noise. To first order in the noise gain.

    Parameters
    ----------
    snr_db : float
    noise_gain : float
        Of the estimator, `isacbench.link.estimation.PrsEstimator.noise_gain`.

    Returns
    -------
    float

    Examples
    --------
    >>> round(effective_snr_db(10.0, 1.0), 2)
    6.99
    """
    return snr_db - 10 * float(np.log10(1 + noise_gain))
