"""Peak-to-average power ratio of OFDM symbols: measured, and its distribution in theory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
from scipy.special import lambertw

from isacbench.errors import InputError, require
from isacbench.model.number_limits import require_count

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

MOST_CROSSINGS_AT = 0.5
"""Power over its mean at which an envelope of Gaussian samples crosses upwards most often."""


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
    grid = np.asarray(symbols, dtype=np.complex128)
    if grid.ndim != 2 or grid.size == 0:
        raise InputError(
            f"symbols of shape {grid.shape}: allowed are subcarriers by symbols, at least one each"
        )
    mean = float(np.mean(grid.real**2 + grid.imag**2))
    require(0 < mean < np.inf, "mean power of the symbols", mean, "a positive number")
    samples = scipy.fft.ifft(grid.T, oversampling * len(grid), axis=1, norm="forward")
    peak = (samples.real**2 + samples.imag**2).max(axis=1) / len(grid)
    papr_db: Floats = 10 * np.log10(peak / mean)
    return papr_db


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
    n_subcarriers : int
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
    power = 10 ** (np.asarray(papr_db, dtype=np.float64) / 10)
    if oversampled:
        power = np.maximum(power, MOST_CROSSINGS_AT)
        expected = n_subcarriers * np.sqrt(np.pi / 3 * power) * np.exp(-power)
    else:
        with np.errstate(divide="ignore"):
            expected = -n_subcarriers * np.log1p(-np.exp(-power))
    probability: Floats = -np.expm1(-expected)
    return probability


def exceeded_papr_db(probability: float, n_subcarriers: int) -> float:
    """Invert `papr_ccdf` of the continuous envelope: the ratio that a share of the symbols exceeds.

    Parameters
    ----------
    probability : float
        Between 0 and 1.
    n_subcarriers : int

    Returns
    -------
    float
        In dB.

    Raises
    ------
    InputError
        If there is no such ratio.

    Examples
    --------
    >>> round(exceeded_papr_db(1e-3, 2048), 2)
    12.02
    """
    require(0 < probability < 1, "probability", probability, "a number between 0 and 1")
    expected = -np.log1p(-probability) / n_subcarriers
    # γ exp(-2γ) is known, and γ at least 1/2: the lower branch of Lambert's function.
    known = 3 / np.pi * expected**2
    allowed = bool(2 * known <= np.exp(-1))
    require(allowed, "probability", probability, f"one that {n_subcarriers} subcarriers exceed at some level")
    return float(10 * np.log10(-lambertw(-2 * known, -1).real / 2))
