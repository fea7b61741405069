"""Factors of the trimmed-mean detector."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from numbers import Integral

import numpy as np
from scipy import optimize, special

from isacbench.checked_arrays import Floats
from isacbench.dsp.cfar.factors import (
    ca_factor,
    checked_count,
    order_span,
    osca_factor,
    solve_factor,
)
from isacbench.errors import InputError

_NEGLIGIBLE = -20.0
"""Logarithm of the ratio to the largest integrand below which values are neglected."""

_N_COARSE, _N_PLANE, _N_LINE = 24, 54, 128
"""Nodes along each limit: to find where the integrand lies, to integrate over two limits, and over one."""

_N_BETWEEN, _N_WHOLE = 14, 64
"""Nodes between the two limits; more where nothing is trimmed on one side."""

_MOST_ZOOMS = 12

_LARGEST_LOGIT = 40.0
"""Logit of a share that differs negligibly from 1."""

_ALIAS = 1e-9
"""Largest aliases of the contour sum, relative to the rate."""


@lru_cache(maxsize=1024)
def tm_factor(pfa: float, n_training: int, trimmed: tuple[int, int], looks: int = 1) -> float:
    """Exact factor of a trimmed-mean detector.

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

    Notes
    -----
    One look: the spacings of sorted exponential powers are independent and
    exponential. The Laplace transform of the trimmed sum, and with it the
    rate, is therefore a product. With nothing trimmed the detector is cell
    averaging, with one cell kept an order statistic.

    Many looks: a gamma power of integer shape M is the time of the M-th arrival
    of a Poisson process. Let S be the trimmed mean and L its Laplace transform.
    The cell under test exceeds αS if fewer than M arrivals fall into αS. Their
    number has the generating function L(αM(1 - z)), so that the rate is the
    coefficient of z^(M-1) in L(αM(1 - z)) / (1 - z). The trapezoid rule reads it
    on a circle near the saddle point, where no digits cancel however small the
    rate. L itself: given the largest of the cells trimmed below and the smallest
    of those trimmed above, the kept cells are independent and follow a truncated
    gamma law. L is a power of that law's transform, integrated over these two
    limits by the trapezoid rule in logarithms. The relative error of the rate is
    below 1e-6 from P_fa = 1e-15 up.

    References
    ----------
    P. P. Gandhi, S. A. Kassam, "Analysis of CFAR processors in nonhomogeneous
    background", IEEE Trans. AES 24(4), 1988: one look.
    """
    _check_trimmed(n_training, trimmed)
    n_training, looks = int(n_training), checked_count("looks", looks)
    below, above = trimmed
    if below == above == 0:
        return ca_factor(pfa, n_training, looks)
    if looks == 1:
        return solve_factor(lambda factor: _one_look_rate(factor, n_training, trimmed), pfa)
    if below + above == n_training - 1:
        return osca_factor(pfa, ((below + 1, n_training),), looks)
    near = ca_factor(pfa, n_training, looks) / _rough_mean(n_training, trimmed, looks)
    return solve_factor(lambda factor: many_looks_rate(factor, n_training, trimmed, looks), pfa, near)


def _one_look_rate(factor: float, n_training: int, trimmed: tuple[int, int]) -> float:
    """Multiply the Laplace transforms of the spacings that the kept cells contain."""
    below, above = trimmed
    n_kept = n_training - below - above
    spacing = np.arange(n_training - above)
    times_contained = np.minimum(n_kept, n_training - above - spacing)
    scale = factor / n_kept
    return math.exp(-np.log1p(scale * times_contained / (n_training - spacing)).sum())


def _check_trimmed(n_training: int, trimmed: tuple[int, ...]) -> None:
    checked_count("n_training", n_training)
    if (
        len(trimmed) != 2
        or not all(isinstance(n, Integral) and n >= 0 for n in trimmed)
        or sum(trimmed) >= n_training
    ):
        raise InputError(
            f"trimmed = {trimmed}: numbers >= 0 of smallest and largest cells, fewer than all {n_training}"
        )


def _rough_mean(n_training: int, trimmed: tuple[int, int], looks: int) -> float:
    """Rough trimmed mean of cells of mean 1: the mean of their law between the two trimming quantiles."""
    lower, upper = (trimmed[0] / n_training, 1 - trimmed[1] / n_training)
    limits = special.gammaincinv(looks, [lower, upper])
    return float(np.diff(special.gammainc(looks + 1, limits))[0] / (upper - lower))


def many_looks_rate(factor: float, n_training: int, trimmed: tuple[int, int], looks: int) -> float:
    """Read the coefficient of the generating function on a circle; powers have the mean `looks` here."""
    n_kept = n_training - sum(trimmed)
    scale = factor / n_kept
    radius = _saddle_point(factor, n_training, trimmed, looks)
    tilt = scale * (1 - radius)
    lower, upper, log_weight = _limits(n_training, trimmed, looks, 1 + tilt)
    node, node_weight = special.roots_legendre(_N_WHOLE if 0 in trimmed else _N_BETWEEN)
    middle, half = (np.log(upper) + np.log(lower)) / 2, np.log(upper / lower) / 2
    log_power = middle[:, np.newaxis] + np.multiply.outer(half, node)
    power, least = np.exp(log_power), lower[:, np.newaxis]
    density = np.exp(_log_density(log_power, looks) + tilt * (least - power))
    density *= np.multiply.outer(half, node_weight)
    kept = density.sum(axis=1)
    log_weight = log_weight + n_kept * (np.log(kept) - tilt * lower)
    largest = log_weight.max()
    counted = log_weight > largest + _NEGLIGIBLE
    weight, power = np.exp(log_weight[counted] - largest), power[counted]
    density = density[counted] / kept[counted, np.newaxis]

    first = float(weight.sum()) / (1 - radius)
    log_first = math.log(first) + largest - (looks - 1) * math.log(radius)
    # The rate is not far below the integrand's peak; aliases are at most radius^n.
    n_nodes = looks + math.ceil((math.log(_ALIAS) + min(log_first - 5, 0)) / math.log(radius))
    total = first
    for k in range(1, n_nodes // 2 + 1):
        turn = np.exp(2j * math.pi * k / n_nodes)
        transform = (np.exp((turn - 1) * scale * radius * power) * density).sum(axis=1) ** n_kept
        term = weight @ transform * turn ** (1 - looks) / (1 - radius * turn)
        total += (1 if 2 * k == n_nodes else 2) * float(term.real)
        if abs(term) < _ALIAS * first:
            break
    return min(float(math.exp(log_first) * total / (first * n_nodes)), 1.0)


def _saddle_point(factor: float, n_training: int, trimmed: tuple[int, int], looks: int) -> float:
    """Saddle point of the integrand on the real axis, for a trimmed mean that is gamma distributed."""
    shape = looks * n_training
    slope = looks * factor * _rough_mean(n_training, trimmed, looks) / shape

    def derivative(z: float) -> float:
        return shape * slope / (1 + slope * (1 - z)) - (looks - 1) / z + 1 / (1 - z)

    return float(optimize.brentq(derivative, 1e-12, 1 - 1e-12))


def _limits(
    n_training: int, trimmed: tuple[int, int], looks: int, tilted: float
) -> tuple[Floats, Floats, Floats]:
    """Pairs of powers between which the kept cells lie, and the logarithm of their weights.

    With n kept cells, the transform of their sum is the sum over the pairs of
    weight times the n-th power of the transform of a truncated power. The pairs
    cover the region that matters for gamma powers of rate `tilted`, in
    coordinates in which the integrand vanishes smoothly and exponentially. Where
    nothing is trimmed on a side, the power beyond that limit is negligible.
    """
    below, above = trimmed
    n_kept = n_training - below - above
    log_ways = special.gammaln(n_training + 1) - special.gammaln(n_kept + 1)

    def pair(log_lower: Floats, logit: Floats) -> tuple[Floats, Floats, Floats]:
        """Limits, and the logarithm of their weight without the steps of the grid."""
        # The logit gives the upper limit as a share of the law above the lower one: without tilt the two
        # are independent.
        lower = np.exp(log_lower)
        left = special.gammaincc(looks, lower)
        passed = special.gammainc(looks, lower) + special.expit(logit) * left
        remaining = special.expit(-logit) * left
        upper = np.where(
            passed < 0.5, special.gammaincinv(looks, passed), special.gammainccinv(looks, remaining)
        )
        log_weight = np.full(upper.shape, log_ways)
        if below:
            log_weight += _log_density(log_lower, looks) - special.gammaln(below)
            log_weight += special.xlogy(below - 1, special.gammainc(looks, lower))
        if above:
            log_weight += above * (np.log(left) + special.log_expit(-logit)) - special.gammaln(above)
            log_weight += special.log_expit(logit)
        return lower, upper, log_weight

    def log_size(log_lower: Floats, logit: Floats) -> Floats:
        lower, upper, log_weight = pair(log_lower, logit)
        low, high = tilted * lower, tilted * upper
        # Of the two equal differences, take the one of smaller numbers: it cancels fewer digits.
        share = np.where(
            low < looks,
            special.gammainc(looks, high) - special.gammainc(looks, low),
            special.gammaincc(looks, low) - special.gammaincc(looks, high),
        )
        return log_weight + special.xlogy(n_kept, np.maximum(share, 0))

    least = math.log(special.gammaincinv(looks, math.exp(-_LARGEST_LOGIT)) / tilted)
    spans = [
        order_span(below, n_training, looks) if below else (least, least),
        (-70.0, _LARGEST_LOGIT) if above else (_LARGEST_LOGIT, _LARGEST_LOGIT),
    ]
    axes = _zoomed(log_size, spans)
    log_step = sum(math.log(axis[1] - axis[0]) for axis in axes if axis.size > 1)
    lower, upper, log_weight = pair(*(part.ravel() for part in np.meshgrid(*axes)))
    apart = upper > lower
    return lower[apart], upper[apart], log_weight[apart] + log_step


def _log_density(log_power: Floats, looks: int) -> Floats:
    """Logarithm of the density of the logarithm of a gamma power."""
    return looks * log_power - np.exp(log_power) - special.gammaln(looks)


def _zoomed(log_size: Callable[..., Floats], spans: list[tuple[float, float]]) -> list[Floats]:
    """Equidistant nodes along each axis where a function with one peak is not negligible."""

    def grids(n_nodes: int) -> list[Floats]:
        return [np.linspace(*span, n_nodes if span[0] < span[1] else 1) for span in spans]

    for _ in range(_MOST_ZOOMS):
        coarse = grids(_N_COARSE)
        size = log_size(*np.meshgrid(*coarse, indexing="ij"))
        matters = np.nonzero(size > size.max() + _NEGLIGIBLE)
        closer = [
            (float(grid[max(index.min() - 1, 0)]), float(grid[min(index.max() + 1, grid.size - 1)]))
            for grid, index in zip(coarse, matters, strict=True)
        ]
        small = all(
            new[1] - new[0] >= 0.7 * (old[1] - old[0]) for new, old in zip(closer, spans, strict=True)
        )
        spans = closer
        if small:
            break
    return grids(_N_LINE if any(first == last for first, last in spans) else _N_PLANE)
