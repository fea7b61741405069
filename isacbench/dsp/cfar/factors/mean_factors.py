"""Factors of detectors whose noise estimate is a mean: of all training cells, or of one of two halves."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy import special

from isacbench.dsp.cfar.factors.rate_roots import (
    check_pfa,
    checked_factor,
    checked_looks,
    checked_training,
    solve_factor,
)
from isacbench.errors import InputError


def paper_factor(pfa: float, n_training: int) -> float:
    """Factor as the paper prints it, T_f = P_fa^(-1/N) - 1.

    The paper multiplies it with a *mean*, for which the factor N is missing:
    at P_fa = 1e-3 the true rate is 0.90 for CA with N = 72 and 0.32 for OSCA
    with N = 9. It is kept to reproduce the paper; `ca_factor` and
    `osca_factor` are exact.

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell that the paper means to reach.
    n_training : int
        Number N of cells: all training cells for CA, the cells of one column for OSCA.

    Returns
    -------
    float
        The printed factor, without unit.

    Raises
    ------
    InputError
        If `pfa` or `n_training` is out of range, or the factor overflows.

    References
    ----------
    arXiv 2310.06401.
    """
    check_pfa(pfa)
    # NumPy's exponential overflows to infinity; that of the standard library raises.
    with np.errstate(over="ignore"):
        factor = float(np.expm1(-math.log(pfa) / checked_training(n_training)))
    return checked_factor(factor, pfa)


def ca_rate(factor: float, n_training: int, looks: int = 1) -> float:
    """False-alarm rate of a cell-averaging detector with a given factor.

    The ratio of the cell under test to the mean of the training cells is
    F-distributed with (2M, 2MN) degrees of freedom.

    Parameters
    ----------
    factor : float
        Factor α >= 0 on the mean of the training cells.
    n_training : int
        Number N of training cells.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        P(power > α · mean) in homogeneous noise.

    Raises
    ------
    InputError
        If `n_training` or `looks` is below 1.
    """
    n_training, looks = checked_training(n_training), checked_looks(looks)
    return float(special.betainc(looks * n_training, looks, n_training / (n_training + factor)))


@lru_cache(maxsize=4096)
def ca_factor(pfa: float, n_training: int, looks: int = 1) -> float:
    """Exact factor of a cell-averaging detector.

    For one look it is N (P_fa^(-1/N) - 1); in general a quantile of the F
    distribution with (2M, 2MN) degrees of freedom.

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell.
    n_training : int
        Number N of training cells whose mean is the noise estimate.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        Factor α on the mean of the training cells.

    Raises
    ------
    InputError
        If `pfa`, `n_training` or `looks` is out of range, or the factor overflows.

    References
    ----------
    H. M. Finn, R. S. Johnson, "Adaptive detection mode with threshold control
    as a function of spatially sampled clutter-level estimates", RCA Review 29,
    1968.
    """
    check_pfa(pfa)
    n_training, looks = checked_training(n_training), checked_looks(looks)
    # The share of the cell under test in the total power is beta distributed; it and its
    # complement are inverted separately, since one of them may be tiny.
    share = special.betainccinv(looks, looks * n_training, pfa)
    rest = special.betaincinv(looks * n_training, looks, pfa)
    with np.errstate(over="ignore"):
        factor = n_training * float(share / rest)
    return checked_factor(factor, pfa)


@lru_cache(maxsize=4096)
def goca_factor(pfa: float, halves: tuple[int, int], looks: int = 1) -> float:
    """Exact factor of a greatest-of cell-averaging detector: on the greater of the means of two halves.

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell, 1e-30 to 0.999999.
    halves : (int, int)
        Training cells of the leading and of the trailing half; one of them may be
        empty, which leaves cell averaging over the other.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        Factor α on the greater mean.

    Raises
    ------
    InputError
        If `pfa`, `halves` or `looks` is out of range.

    Notes
    -----
    The false-alarm rate P: a gamma power of integer shape M is the time of the M-th arrival of a
    Poisson process of rate M. Let A be the mean of n cells. The cell under
    test exceeds αA if fewer than M arrivals fall into the time αA. Their
    number is negative binomial; given j of them, A is gamma distributed with
    shape Mn + j and rate M(n + α). Hence

        P = Σ_{j<M} NB_j(n) P(A_j > B) + the same with the halves exchanged,

    where B is the mean of the other half and P(A_j > B) a regularised
    incomplete beta function. All terms are positive. The smallest-of detector
    takes P(A_j < B) instead.

    References
    ----------
    V. G. Hansen, J. H. Sawyers, "Detectability loss due to 'greatest of'
    selection in a cell-averaging CFAR", IEEE Trans. AES 16(1), 1980: one look,
    equal halves.
    """
    return _chosen_half_factor(pfa, halves, looks, greatest=True)


@lru_cache(maxsize=4096)
def soca_factor(pfa: float, halves: tuple[int, int], looks: int = 1) -> float:
    """Exact factor of a smallest-of cell-averaging detector: on the smaller of the means of two halves.

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell, 1e-30 to 0.999999.
    halves : (int, int)
        Training cells of the leading and of the trailing half; one of them may be
        empty, which leaves cell averaging over the other.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        Factor α on the smaller mean.

    Raises
    ------
    InputError
        If `pfa`, `halves` or `looks` is out of range.

    References
    ----------
    G. V. Trunk, "Range resolution of targets using automatic detectors",
    IEEE Trans. AES 14(5), 1978.
    """
    return _chosen_half_factor(pfa, halves, looks, greatest=False)


def _chosen_half_factor(pfa: float, halves: tuple[int, int], looks: int, greatest: bool) -> float:
    check_pfa(pfa)
    looks = checked_looks(looks)
    _check_halves(halves)
    if 0 in halves:
        return ca_factor(pfa, sum(halves), looks)
    return solve_factor(lambda factor: chosen_half_rate(factor, halves, looks, greatest), pfa)


def chosen_half_rate(factor: float, halves: tuple[int, int], looks: int, greatest: bool) -> float:
    """False-alarm rate of a detector that takes the greater, or the smaller, mean of two halves."""
    looks = checked_looks(looks)
    _check_halves(halves)
    if factor == 0:
        return 1.0
    if 0 in halves:
        return ca_rate(factor, sum(halves), looks)
    leading, trailing = halves
    rate = _rate_of_half(factor, leading, trailing, looks, greatest)
    rate += _rate_of_half(factor, trailing, leading, looks, greatest)
    return min(rate, 1.0)


def _rate_of_half(factor: float, n_own: int, n_other: int, looks: int, greatest: bool) -> float:
    """Probability that the cell exceeds its threshold and that this half sets the threshold.

    I(a, b) = P(A_j < B) falls with j by one term of the beta law at a time:
    I(a, b) - I(a + 1, b) = p^a (1 - p)^b / (a B(a, b)).
    """
    own, other = looks * n_own, looks * n_other
    arrivals = np.arange(looks)
    # Logarithm of the negative binomial law of the arrivals, see the notes of `goca_factor`.
    log_law = own * -math.log1p(factor / n_own) - arrivals * math.log1p(n_own / factor)
    log_law += special.gammaln(own + arrivals) - special.gammaln(own) - special.gammaln(arrivals + 1)
    total = n_own + n_other + factor
    below, above = (n_own + factor) / total, n_other / total
    shape = own + arrivals[:-1]
    step = np.exp(
        shape * math.log1p(-above) + other * math.log(above) - np.log(shape) - special.betaln(shape, other)
    )
    if greatest:
        first = special.betainc(other, own, above)
        chosen = first + np.concatenate(([0.0], np.cumsum(step)))
    else:
        last = special.betainc(own + looks - 1, other, below)
        chosen = last + np.concatenate((np.cumsum(step[::-1])[::-1], [0.0]))
    return float(np.exp(log_law) @ chosen)


def _check_halves(halves: tuple[int, ...]) -> None:
    if len(halves) != 2 or min(halves) < 0 or max(halves) < 1:
        raise InputError(f"halves = {halves}: numbers of leading and trailing training cells, not both 0")
