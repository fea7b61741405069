"""Factors of the trimmed-mean detector."""

from __future__ import annotations

import math
from functools import lru_cache
from numbers import Integral
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import optimize, special

from isacbench.dsp.cfar.factors.mean_factors import ca_factor, ca_rate
from isacbench.dsp.cfar.factors.order_factors import osca_factor, osca_rate
from isacbench.dsp.cfar.factors.rate_roots import check_pfa, checked_looks, checked_training, solve_factor
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Probability of an order statistic left out at either end, before the quadrature looks closer.
_TAIL = 1e-60
# Logarithm of what is negligible beside the largest integrand, and beside a part of an integral.
_NEGLIGIBLE = -27.0
# Of a pair of powers, relative to the largest.
_LEAST_WEIGHT = 1e-11
_N_COARSE, _N_LINE = 24, 96
_MOST_ZOOMS = 12
_LOGIT_SPAN = -70.0, 40.0
_MOST_MOVES, _SMALL_MOVE = 12, 0.2
_N_WHOLE = 64
# Where so few cells are trimmed on a side, their law vanishes slowly, and many nodes are needed.
_FEW_TRIMMED = 2
# Aliases of the contour sum, relative to the rate, and terms at which it ends.
_ALIAS, _LAST_TERM = 1e-9, 1e-9
# Change of the factor, in its logarithm, up to which a law stays accurate.
_REACH = 0.05


def tm_rate(factor: float, n_training: int, trimmed: tuple[int, int], looks: int = 1) -> float:
    """Give the false-alarm rate of a trimmed-mean detector with a given factor.

    Its noise estimate is the mean of the sorted training cells without the
    smallest and the largest.

    Parameters
    ----------
    factor : float
        Factor α >= 0 on the trimmed mean.
    n_training : int
        Number N of training cells.
    trimmed : (int, int)
        How many of the smallest, and of the largest, are left out.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        P(power > α · trimmed mean) in homogeneous noise.

    Raises
    ------
    InputError
        If `n_training`, `trimmed` or `looks` is out of range.

    Notes
    -----
    One look: the spacings of sorted exponential powers are independent and
    exponential, so that the Laplace transform of the trimmed sum, and with it
    the rate, is a product. Nothing trimmed is cell averaging, one cell kept an
    order statistic.

    Otherwise, with many looks: a gamma power of integer shape M is the M-th
    arrival of a Poisson process. The cell under test exceeds αS, S the trimmed
    mean, with fewer than M arrivals in αS, whose number has the generating
    function L(αM(1 - z)), L the Laplace transform of S. The rate is therefore
    the coefficient of z^(M-1) in L(αM(1 - z)) / (1 - z), read by the trapezoid
    rule on a circle near the saddle point, where no digits cancel however small
    the rate. For L itself: given the largest of the cells trimmed below and the
    smallest of those trimmed above, the cells kept are independent and follow
    a truncated gamma law. L is a power of that law's transform, integrated over
    the two by the trapezoid rule in logarithms. The relative error of the rate
    is below 3e-7, and below 1e-8 where at least three cells are trimmed on
    either side, from P_fa = 1e-15 up.
    A factor takes about 20 ms with two looks and 60 ms with 256, more above
    P_fa = 0.1, and three times as much where one or two cells are trimmed on a
    side and some on the other; factors are cached.

    References
    ----------
    P. P. Gandhi, S. A. Kassam, "Analysis of CFAR processors in nonhomogeneous
    background", IEEE Trans. AES 24(4), 1988: one look.

    Examples
    --------
    >>> f"{tm_rate(9.946539, 72, (18, 18)):.6f}"
    '0.001000'
    """
    _check_trimmed(n_training, trimmed)
    n_training, looks = int(n_training), checked_looks(looks)
    below, above = trimmed
    if factor == 0:
        return 1.0
    if below == above == 0:
        return ca_rate(factor, n_training, looks)
    if looks == 1:
        return _one_look_rate(factor, n_training, trimmed)
    if below + above == n_training - 1:
        return osca_rate(factor, ((below + 1, n_training),), looks)
    return _TrimmedLaw(factor, n_training, trimmed, looks, _nodes(trimmed)).rate(factor)


@lru_cache(maxsize=1024)
def tm_factor(pfa: float, n_training: int, trimmed: tuple[int, int], looks: int = 1) -> float:
    """Give the exact factor of a trimmed-mean detector.

    Parameters
    ----------
    pfa : float
        Probability of false alarm per cell, 1e-30 to 0.999999.
    n_training : int
        Number N of training cells.
    trimmed : (int, int)
        How many of the smallest, and of the largest, are left out.
    looks : int, default 1
        Independent noise powers M that each cell averages.

    Returns
    -------
    float
        Factor α on the trimmed mean.

    Raises
    ------
    InputError
        If `pfa`, `n_training`, `trimmed` or `looks` is out of range.

    Examples
    --------
    >>> round(tm_factor(1e-3, 72, (18, 18)), 6)
    9.946539
    """
    check_pfa(pfa)
    _check_trimmed(n_training, trimmed)
    n_training, looks = int(n_training), checked_looks(looks)
    below, above = trimmed
    if below == above == 0:
        return ca_factor(pfa, n_training, looks)
    if looks == 1:
        return solve_factor(lambda factor: _one_look_rate(factor, n_training, trimmed), pfa)
    if below + above == n_training - 1:
        return osca_factor(pfa, ((below + 1, n_training),), looks)
    # A law is accurate around the factor that it was made for.
    found = ca_factor(pfa, n_training, looks) / _rough_mean(n_training, trimmed, looks)
    for _ in range(_MOST_MOVES):
        near = found
        found = solve_factor(_TrimmedLaw(near, n_training, trimmed, looks, _COARSE).rate, pfa, near)
        if abs(math.log(found / near)) < _REACH:
            break
    nodes = _nodes(trimmed)
    if nodes == _COARSE:
        return found
    return solve_factor(_TrimmedLaw(found, n_training, trimmed, looks, nodes).rate, pfa, found)


def _one_look_rate(factor: float, n_training: int, trimmed: tuple[int, int]) -> float:
    """Multiply the Laplace transforms of the spacings that the kept cells contain."""
    below, above = trimmed
    n_kept = n_training - below - above
    spacing = np.arange(n_training - above)
    times_contained = np.minimum(n_kept, n_training - above - spacing)
    scale = factor / n_kept
    return math.exp(-np.log1p(scale * times_contained / (n_training - spacing)).sum())


def _check_trimmed(n_training: int, trimmed: tuple[int, ...]) -> None:
    checked_training(n_training)
    if (
        len(trimmed) != 2
        or not all(isinstance(n, Integral) and n >= 0 for n in trimmed)
        or sum(trimmed) >= n_training
    ):
        raise InputError(
            f"trimmed = {trimmed}: numbers >= 0 of smallest and largest cells, fewer than all {n_training}"
        )


def _rough_mean(n_training: int, trimmed: tuple[int, int], looks: int) -> float:
    """Give roughly the trimmed mean of cells of mean 1, from the quantiles between which its cells lie."""
    lower, upper = (trimmed[0] / n_training, 1 - trimmed[1] / n_training)
    limits = special.gammaincinv(looks, [lower, upper])
    return float(np.diff(special.gammainc(looks + 1, limits))[0] / (upper - lower))


def _guessed_saddle(factor: float, n_training: int, trimmed: tuple[int, int], looks: int) -> float:
    """Give the logit of the radius at the saddle point if the trimmed mean is roughly gamma distributed."""
    logit = np.linspace(-80, 20, 1001)
    shape, mean = looks * n_training, _rough_mean(n_training, trimmed, looks)
    log_size = -shape * np.log1p(looks * factor * special.expit(-logit) * mean / shape)
    log_size -= (looks - 1) * special.log_expit(logit) + special.log_expit(-logit)
    return float(logit[log_size.argmin()])


class _Nodes(NamedTuple):
    """Nodes an axis of the plane of two limits, and of the powers between two limits.

    The plane ends where the integrand is `negligible`, a logarithm, beside its
    largest value: nodes lie the closer, the sooner it ends.
    """

    plane: int
    between: int
    negligible: float = _NEGLIGIBLE


_COARSE, _FINE = _Nodes(36, 12), _Nodes(52, 15, -20.0)


def _nodes(trimmed: tuple[int, int]) -> _Nodes:
    """Give the nodes for a rate that is exact to 1e-6 of itself."""
    return _FINE if 0 < min(trimmed) <= _FEW_TRIMMED else _COARSE


class _TrimmedLaw:
    """The false-alarm rate of a trimmed mean as a function of the factor, accurate around one factor.

    Powers are gamma distributed with mean `looks` here.
    """

    def __init__(
        self, factor: float, n_training: int, trimmed: tuple[int, int], looks: int, nodes: _Nodes
    ) -> None:
        self._looks = looks
        self._nodes = nodes
        self._n_kept = n_training - sum(trimmed)
        logit = _guessed_saddle(factor, n_training, trimmed, looks)
        # The nodes depend on the saddle point, and the saddle point, barely, on the nodes.
        for _ in range(_MOST_MOVES):
            self._place_nodes(factor * special.expit(-logit), n_training, trimmed)
            near = (logit - 1, logit + 1)
            moved = optimize.minimize_scalar(
                self._log_size, bounds=near, args=(factor,), method="bounded", options={"xatol": 0.03}
            )
            logit, before = float(moved.x), logit
            if abs(logit - before) < _SMALL_MOVE:
                break
        self._radius = float(special.expit(logit))

    def _place_nodes(self, tilted_factor: float, n_training: int, trimmed: tuple[int, int]) -> None:
        looks = self._looks
        tilt = tilted_factor / self._n_kept
        lower, upper, self._log_weight = _limits(n_training, trimmed, looks, tilt, self._nodes)
        node, weight = special.roots_legendre(_N_WHOLE if 0 in trimmed else self._nodes.between)
        middle, half = (np.log(upper) + np.log(lower)) / 2, np.log(upper / lower) / 2
        log_power = middle[:, np.newaxis] + np.multiply.outer(half, node)
        self._power = np.exp(log_power)
        self._density = np.exp(_log_density(log_power, looks)) * np.multiply.outer(half, weight)

    def _log_size(self, logit: float, factor: float) -> float:
        """Give the logarithm of the contour integrand where it crosses the real axis."""
        _, _, log_weight = self._tilted(factor / self._n_kept * special.expit(-logit))
        log_transform = special.logsumexp(log_weight)
        return float(log_transform - (self._looks - 1) * special.log_expit(logit) - special.log_expit(-logit))

    def _tilted(self, tilt: float) -> tuple[Floats, Floats, Floats]:
        """Give the tilted density of a kept power, its sum, and the logarithm of the tilted weights.

        The tilt of the least power counts in the weights alone: it may be smaller than any float64.
        """
        least = self._power[:, :1]
        density = self._density * np.exp(tilt * (least - self._power))
        kept = density.sum(axis=1)
        log_weight = self._log_weight + self._n_kept * (np.log(kept) - tilt * least[:, 0])
        return density, kept, log_weight

    def rate(self, factor: float) -> float:
        """Give P(power > factor · trimmed mean)."""
        scale, radius = factor / self._n_kept, self._radius
        density, kept, log_weight = self._tilted(scale * (1 - radius))
        largest = log_weight.max()
        weight = np.exp(log_weight - largest)
        counted = weight > _LEAST_WEIGHT
        density = density[counted] / kept[counted, np.newaxis]
        power, weight = scale * radius * self._power[counted], weight[counted]

        first = float(weight.sum()) / (1 - radius)
        log_first = math.log(first) + largest - (self._looks - 1) * math.log(radius)
        # The rate is not far below the integrand's peak; aliases are at most radius^n.
        n_nodes = self._looks + math.ceil((math.log(_ALIAS) + min(log_first - 5, 0)) / math.log(radius))
        total = first
        for k in range(1, n_nodes // 2 + 1):
            turn = np.exp(2j * math.pi * k / n_nodes)
            transform = (np.exp((turn - 1) * power) * density).sum(axis=1) ** self._n_kept
            term = weight @ transform * turn ** (1 - self._looks) / (1 - radius * turn)
            total += (1 if 2 * k == n_nodes else 2) * float(term.real)
            if abs(term) < _LAST_TERM * first:
                break
        return min(float(math.exp(log_first) * total / (first * n_nodes)), 1.0)


def _limits(
    n_training: int, trimmed: tuple[int, int], looks: int, tilt: float, nodes: _Nodes
) -> tuple[Floats, Floats, Floats]:
    """Give pairs of powers between which the kept cells lie, and the logarithm of their weights.

    Summed over the pairs, weight times the n-th power of the transform of a
    truncated power, n the number of kept cells, is the transform of their sum.
    The pairs span where that matters at the real argument `tilt`, in coordinates
    in which everything vanishes exponentially and smoothly at both ends.
    """
    log_ways = special.gammaln(n_training + 1) - special.gammaln(n_training - sum(trimmed) + 1)
    if 0 in trimmed:
        lower, upper, log_weight = _one_limit(n_training, trimmed, looks, 1 + tilt)
    else:
        lower, upper, log_weight = _two_limits(n_training, trimmed, looks, 1 + tilt, nodes)
    return lower, upper, log_weight + log_ways


def _one_limit(
    n_training: int, trimmed: tuple[int, int], looks: int, tilted: float
) -> tuple[Floats, Floats, Floats]:
    """Find the pairs where cells are trimmed on one side; the other limit is where the rest is negligible."""
    below, above = trimmed
    kept_share, kept_limit, trimmed_share = (
        (special.gammaincc, special.gammainccinv, special.gammainc)
        if below
        else (special.gammainc, special.gammaincinv, special.gammaincc)
    )
    span = _order_span(below or n_training - above + 1, n_training, looks)

    def log_size(log_limit: Floats) -> Floats:
        share = kept_share(looks, tilted * np.exp(log_limit))
        log_law = _log_edge(log_limit, looks, below + above, trimmed_share)
        return log_law + special.xlogy(n_training - below - above, share)

    log_limit = _zoomed(log_size, [span], _N_LINE, _NEGLIGIBLE)[0]
    log_weight = _log_edge(log_limit, looks, below + above, trimmed_share)
    log_weight += math.log(log_limit[1] - log_limit[0])
    limit = np.exp(log_limit)
    far = kept_limit(looks, kept_share(looks, tilted * limit) * math.exp(_NEGLIGIBLE)) / tilted
    return (limit, far, log_weight) if below else (far, limit, log_weight)


def _two_limits(
    n_training: int, trimmed: tuple[int, int], looks: int, tilted: float, nodes: _Nodes
) -> tuple[Floats, Floats, Floats]:
    """Find the pairs where cells are trimmed on both sides."""
    below, above = trimmed

    def pair(log_lower: Floats, logit: Floats) -> tuple[Floats, Floats]:
        """Give the upper power, and the logarithm of the weight without the steps."""
        # The coordinate beside the lower power: of the law above it, the share that lies below the upper one.
        # Without tilt the two are independent.
        lower = np.exp(log_lower)
        left = special.gammaincc(looks, lower)
        passed = special.gammainc(looks, lower) + special.expit(logit) * left
        remaining = special.expit(-logit) * left
        upper = np.where(
            passed < 0.5, special.gammaincinv(looks, passed), special.gammainccinv(looks, remaining)
        )
        log_weight = _log_edge(log_lower, looks, below, special.gammainc) - special.gammaln(above)
        log_weight += above * np.log(left)
        return upper, log_weight + above * special.log_expit(-logit) + special.log_expit(logit)

    def log_size(log_lower: Floats, logit: Floats) -> Floats:
        upper, log_weight = pair(log_lower, logit)
        low, high = tilted * np.exp(log_lower), tilted * upper
        # Of the two differences, the one of the smaller numbers.
        share = np.where(
            low < looks,
            special.gammainc(looks, high) - special.gammainc(looks, low),
            special.gammaincc(looks, low) - special.gammaincc(looks, high),
        )
        return log_weight + special.xlogy(n_training - below - above, np.maximum(share, 0))

    spans = [_order_span(below, n_training, looks), _LOGIT_SPAN]
    log_lower, logit = _zoomed(log_size, spans, nodes.plane, nodes.negligible)
    log_step = math.log((log_lower[1] - log_lower[0]) * (logit[1] - logit[0]))
    log_lower, logit = (part.ravel() for part in np.meshgrid(log_lower, logit))
    upper, log_weight = pair(log_lower, logit)
    apart = upper > np.exp(log_lower)
    return np.exp(log_lower[apart]), upper[apart], log_weight[apart] + log_step


def _log_edge(log_power: Floats, looks: int, n_beyond: int, share: Callable[..., Floats]) -> Floats:
    """Logarithm of the law of the innermost cell trimmed on one side, without the ways to choose the kept."""
    law: Floats = _log_density(log_power, looks) - special.gammaln(n_beyond)
    return law + special.xlogy(n_beyond - 1, share(looks, np.exp(log_power)))


def _log_density(log_power: Floats, looks: int) -> Floats:
    """Logarithm of the density of the logarithm of a gamma power."""
    law: Floats = looks * log_power - np.exp(log_power) - special.gammaln(looks)
    return law


def _order_span(rank: int, n_cells: int, looks: int) -> tuple[float, float]:
    """Give the logarithms between which the rank-th smallest of `n_cells` gamma powers lies."""
    above = n_cells - rank
    lower = special.gammaincinv(looks, special.betaincinv(rank, above + 1, _TAIL))
    upper = special.gammainccinv(looks, special.betaincinv(above + 1, rank, _TAIL))
    return math.log(lower), math.log(upper)


def _zoomed(
    log_size: Callable[..., Floats], spans: list[tuple[float, float]], n_nodes: int, negligible: float
) -> list[Floats]:
    """Give equidistant nodes along each axis where a function with one peak is not negligible."""
    for _ in range(_MOST_ZOOMS):
        grids = [np.linspace(*span, _N_COARSE) for span in spans]
        size = log_size(*np.meshgrid(*grids, indexing="ij"))
        matters = np.nonzero(size > size.max() + negligible)
        closer = [
            (float(grid[max(index.min() - 1, 0)]), float(grid[min(index.max() + 1, _N_COARSE - 1)]))
            for grid, index in zip(grids, matters, strict=True)
        ]
        small = all(new[1] - new[0] > 0.7 * (old[1] - old[0]) for new, old in zip(closer, spans, strict=True))
        spans = closer
        if small:
            break
    return [np.linspace(*span, n_nodes) for span in spans]
