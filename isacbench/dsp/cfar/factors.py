"""Exact threshold factors: α such that P(power > α · noise estimate) = P_fa.

The noise is homogeneous complex Gaussian of unknown power, so the power of a
cell, averaged over M looks, is gamma distributed with shape M (exponential for
one look). Every factor multiplies the detector's *own* noise estimate, a mean
or an order statistic, whatever bias that estimate has.

| noise estimate | factor | found by |
|---|---|---|
| mean | `ca_factor` | closed form: a quantile of the F distribution |
| greater, smaller of two means | `goca_factor`, `soca_factor` | root of a finite sum of beta functions |
| order statistics, averaged | `osca_factor` | root; one-dimensional quadrature |
| trimmed mean | `tm_factor` | root of a product; quadrature with many looks |
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Callable
from functools import cache, lru_cache
from numbers import Integral, Real

import numpy as np
from scipy import optimize, special

from isacbench.checked_arrays import Floats
from isacbench.errors import InputError, require

LEAST_PFA, MOST_PFA = 1e-30, 0.999999
"""Rates between which factors without a closed form are found."""

# Probability of an order statistic left out at either end of the quadrature, far below the least rate.
# With 512 nodes the relative error of the rate is below 1e-8 even at the least rate. With more looks the
# order statistics are narrower and smoother, and 160 nodes leave a smaller error.
_TAIL = 1e-60

_N_NODES_FEW_LOOKS, _N_NODES = 512, 160

_MANY_LOOKS = 8


def check_pfa(pfa: float) -> None:
    """Refuse a probability of false alarm that is not a number strictly between 0 and 1."""
    allowed = isinstance(pfa, Real) and 0 < pfa < 1
    require(allowed, "pfa", pfa, "a probability of false alarm, strictly between 0 and 1")


def checked_count(name: str, number: int) -> int:
    """Check a number of looks or of training cells, and convert it to int, whose products cannot overflow."""
    require(isinstance(number, Integral) and number >= 1, name, number, "a whole number, at least 1")
    return int(number)


def checked_factor(factor: float, pfa: float) -> float:
    """Refuse a factor that is not finite; `pfa` is for the message."""
    if not math.isfinite(factor):
        raise InputError(
            f"pfa = {pfa}: the factor overflows float64, take a larger rate or more training cells"
        )
    return factor


def solve_factor(rate: Callable[[float], float], pfa: float, near: float | None = None) -> float:
    """Find the factor of a false-alarm rate, in log-log coordinates, in which the rate is nearly straight.

    The rate is a decreasing function of the factor, and `pfa` from `LEAST_PFA` to `MOST_PFA`; others are an
    `InputError`. `near` is a guess of the factor, for rates that are slow to compute: few of them are
    computed then, and the factor is found to 1e-10 instead of 1e-13.
    """
    check_pfa(pfa)
    if not LEAST_PFA <= pfa <= MOST_PFA:
        raise InputError(
            f"pfa = {pfa}: pfa must be from {LEAST_PFA} to {MOST_PFA}, where the numerical threshold factor "
            "is exact"
        )

    @cache  # the root search begins with both ends of the bracket, which are already computed
    def excess(log_factor: float) -> float:
        # A rate that underflows to 0 still tells on which side the root lies.
        return math.log(max(rate(math.exp(log_factor)), sys.float_info.min) / pfa)

    middle, width = (0.0, 1.0) if near is None else (math.log(near), 0.02)
    lower = upper = width
    while excess(middle - lower) < 0:
        lower *= 2
    while excess(middle + upper) > 0:
        upper *= 2
    xtol = 1e-13 if near is None else 1e-10
    return math.exp(optimize.brentq(excess, middle - lower, middle + upper, xtol=xtol))


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
        factor = float(np.expm1(-math.log(pfa) / checked_count("n_training", n_training)))
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
    n_training, looks = checked_count("n_training", n_training), checked_count("looks", looks)
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
    n_training, looks = checked_count("n_training", n_training), checked_count("looks", looks)
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


def _chosen_half_factor(pfa: float, halves: tuple[int, ...], looks: int, greatest: bool) -> float:
    looks = checked_count("looks", looks)
    if len(halves) != 2 or min(halves) < 0 or max(halves) < 1:
        raise InputError(f"halves = {halves}: numbers of leading and trailing training cells, not both 0")
    if 0 in halves:
        return ca_factor(pfa, sum(halves), looks)
    return solve_factor(lambda factor: chosen_half_rate(factor, halves, looks, greatest), pfa)


def chosen_half_rate(factor: float, halves: tuple[int, ...], looks: int, greatest: bool) -> float:
    """False-alarm rate of a detector that takes the greater, or smaller, mean of two halves with cells."""
    if factor == 0:
        return 1.0
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


def osca_rate(factor: float, columns: tuple[tuple[int, int], ...], looks: int = 1) -> float:
    """False-alarm rate of an ordered-statistic cell-averaging detector.

    Its noise estimate is the mean over columns of an order statistic of each
    column; a single column is the plain order-statistic detector.

    Parameters
    ----------
    factor : float
        Factor α >= 0 on the mean of the order statistics.
    columns : tuple of (int, int)
        For each column the rank k (1 is the smallest) and the number n of
        independent training cells, *without* the cell under test. A column
        of n cells that holds the cell under test counts as (k, n - 1), see
        the notes.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        P(power > α · estimate) in homogeneous noise.

    Raises
    ------
    InputError
        If `columns` or `looks` is out of range.

    Notes
    -----
    A gamma power of integer shape M is the time of the M-th arrival of a
    Poisson process. P(power > s Σ_c X_c) is therefore the probability of fewer
    than M arrivals in Σ_c s X_c. The arrivals of the columns are independent,
    so their counts add. Every term is positive, so that small rates keep their
    digits. For one look the rate is the product over columns of
    M_{k:n}(s) = Π_{i<k} (n - i) / (n - i + s) with s = α / (number of columns).
    Time and memory grow with the looks; a factor takes about 6 ms for 256
    looks. Factors are cached.

    In the paper the cell under test lies inside its own column of n cells. A
    cell above its threshold is normally also above its column's order
    statistic, which then is the k-th of the *other* n - 1 cells. This leaves
    out cells above the threshold that exceed fewer than k other cells of their
    column, which takes α below the number of columns and several cells above
    the threshold at once. For the paper's 9 x 9 window the true rate is
    2 % higher (relative) at P_fa = 0.5, 0.1 to 0.2 % higher at 0.1, and not
    measurably higher from 0.01 down. With columns of three cells it is 3 %
    higher at 0.1, with a single column 40 % higher at 0.5.

    References
    ----------
    H. Rohling, "Radar CFAR thresholding in clutter and multiple target
    situations", IEEE Trans. AES 19(4), 1983: the one-look order statistic.
    """
    return _osca_law(columns, looks)(factor)


@lru_cache(maxsize=1024)
def osca_factor(pfa: float, columns: tuple[tuple[int, int], ...], looks: int = 1) -> float:
    """Exact factor of an ordered-statistic cell-averaging detector.

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell, 1e-30 to 0.999999.
    columns : tuple of (int, int)
        Rank and number of training cells of each column, as in `osca_rate`.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        Factor α on the mean over columns of the order statistics.

    Raises
    ------
    InputError
        If `pfa`, `columns` or `looks` is out of range.
    """
    return solve_factor(_osca_law(columns, looks), pfa)


def _osca_law(columns: tuple[tuple[int, int], ...], looks: int) -> Callable[[float], float]:
    """The false-alarm rate of one set of columns as a function of the factor."""
    looks = checked_count("looks", looks)
    if not columns or any(not 1 <= rank <= n_cells for rank, n_cells in columns):
        raise InputError(
            f"columns = {columns}: each column is (rank, number of training cells), 1 <= rank <= number"
        )
    quadratures = [
        (*_order_statistic(rank, n_cells, looks), count)
        for (rank, n_cells), count in Counter(columns).items()
    ]

    def rate(factor: float) -> float:
        """P(power > factor · mean of the order statistics)."""
        scale = looks * factor / len(columns)
        law = np.eye(1, looks)[0]
        for power, weight, count in quadratures:
            arrivals = _poisson(scale * power, looks) @ weight
            for _ in range(count):
                law = np.convolve(law, arrivals)[:looks]
        return min(float(law.sum()), 1.0)

    return rate


def _order_statistic(rank: int, n_cells: int, looks: int) -> tuple[Floats, Floats]:
    """Nodes and probabilities of the rank-th smallest of `n_cells` gamma powers of mean 1.

    Over the logarithm of the power the density is smooth and vanishes at both
    ends, so that the trapezoid rule converges exponentially.
    """
    n_nodes = _N_NODES if looks >= _MANY_LOOKS else _N_NODES_FEW_LOOKS
    log_power = np.linspace(*order_span(rank, n_cells, looks), n_nodes)
    power = np.exp(log_power)
    log_density = (
        looks * log_power
        - power
        + special.xlogy(rank - 1, special.gammainc(looks, power))
        + special.xlogy(n_cells - rank, special.gammaincc(looks, power))
    )
    weight = np.exp(log_density - log_density.max())
    return power / looks, weight / weight.sum()


def order_span(rank: int, n_cells: int, looks: int) -> tuple[float, float]:
    """Logarithms of the powers between which the rank-th smallest of `n_cells` gamma powers lies."""
    above = n_cells - rank
    lower = special.gammaincinv(looks, special.betaincinv(rank, above + 1, _TAIL))
    upper = special.gammainccinv(looks, special.betaincinv(above + 1, rank, _TAIL))
    return math.log(lower), math.log(upper)


def _poisson(mean: Floats, n_counts: int) -> Floats:
    """Poisson probabilities of the counts 0 to n_counts - 1, shape (n_counts, mean.size)."""
    counts = np.arange(n_counts)
    log_law = np.multiply.outer(counts, np.log(mean)) - mean
    log_law -= special.gammaln(counts + 1)[:, np.newaxis]
    return np.exp(log_law, out=log_law)
