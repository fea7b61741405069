"""Probability that a cell-averaging CFAR detects an echo: what a detector can find at an SNR."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from isacbench.checked_arrays import Floats, Integers, checked_array
from isacbench.dsp.cfar.factors import ca_factor, check_pfa, checked_count
from isacbench.errors import require

Swerling = Literal[0, 1, 2, 3, 4]

NEGLIGIBLE = 1e-17
MOST_SNR = 300.0
AT_ONCE = 256


def detection_rate(
    snr_db: ArrayLike, pfa: float, looks: int = 1, n_training: int | None = None, swerling: Swerling = 0
) -> Floats:
    """Probability of detection of an echo in white noise, for Swerling's models of its fluctuation.

    The power of a cell is the mean of M looks. The energy E of the echo over all looks is fixed (0), or
    gamma distributed: of shape 1 where an exponential power is common to all looks (1), of shape M where each
    look has its own (2), and of shape 2 or 2 M for a chi-square of four degrees of freedom (3, 4). Given E,
    the sum of looks is a gamma variable of shape M + k, with k Poisson of mean E. So k is Poisson or negative
    binomial, and the rate is a sum over k: of incomplete gamma functions where the noise is known, of
    incomplete beta functions where it is the mean of N training cells.

    Parameters
    ----------
    snr_db : array_like
        Mean power of the echo in a look over that of the noise, in dB; in a map after all gain.
    pfa : float
        Probability of false alarm per cell.
    looks : int
        Independent noise powers M that a cell averages.
    n_training : int or None
        Training cells N of `ca`; None for a known noise.
    swerling : {0, 1, 2, 3, 4}

    Returns
    -------
    ndarray of float64
        With the shape of `snr_db`.

    Raises
    ------
    InputError
        If a value is out of range.

    References
    ----------
    P. Swerling, "Probability of detection for fluctuating targets", IRE Trans. Inf. Theory 6 (1960). J. I.
    Marcum, "A statistical theory of target detection by pulsed radar", ibid.: the sum over k.
    """
    check_pfa(pfa)
    looks = checked_count("looks", looks)
    require(swerling in get_args(Swerling), "swerling", swerling, "a model from 0 to 4")
    given = checked_array("snr_db", snr_db)
    snr = 10 ** np.minimum(given.ravel() / 10, MOST_SNR)
    shape = {0: np.inf, 1: 1.0, 2: looks, 3: 2.0, 4: 2.0 * looks}[swerling]
    if n_training is None:
        threshold = float(special.gammainccinv(looks, pfa))
    else:
        n_training = checked_count("n_training", n_training)
        share = ca_factor(pfa, n_training, looks) / n_training
        threshold = share / (1 + share)
    missed, first = np.zeros(snr.size), 0
    while True:
        k = np.arange(first, first + AT_ONCE)
        below = (
            special.gammainc(looks + k, threshold)
            if n_training is None
            else special.betainc(looks + k, looks * n_training, threshold)
        )
        missed += np.exp(_log_weights(k, looks * snr[:, None], shape)) @ below
        if below[-1] < NEGLIGIBLE:  # it falls with k, whatever the echo is
            return np.clip(1 - missed, pfa, 1.0).reshape(given.shape)
        first += AT_ONCE


def _log_weights(k: Integers, energy: Floats, shape: float) -> Floats:
    """Logarithm of the probability of k: Poisson of a mean energy, or negative binomial of a shape."""
    if np.isinf(shape):
        return special.xlogy(k, energy) - energy - special.gammaln(k + 1)
    scale = energy / shape
    binomial = special.gammaln(k + shape) - special.gammaln(shape) - special.gammaln(k + 1)
    return binomial + special.xlogy(k, scale / (1 + scale)) - shape * np.log1p(scale)
