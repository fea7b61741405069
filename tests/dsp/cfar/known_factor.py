"""Rates that the built-in detectors' factors keep: plain quadrature over the law of their noise estimate."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from isacbench.plugins.contracts import Detector
from tests.dsp.cfar.known_noise import column_rank, columns_of, halves_of, share, training_cells

Cell = tuple[int, ...]
Floats = NDArray[np.float64]

_TAIL = 1e-40
"""Probability of an estimate left out at either end: far below the least rate."""

_SETTLED = 1e-6
"""Relative difference of a rate and the one that every second node gives, up to which it is known.

Its own error is a third of that at most, and far less wherever the density vanishes smoothly."""

_N_LINE, _N_SUMMED, _N_PLANE = 4001, 1001, 161
"""Nodes for a density, for one that is convolved, and along each axis of a plane."""

_LEAST_ARRIVALS = 1e-100
"""Probability of no arrival in a kept cell below which a pair of limits adds nothing to any rate."""

_MOST_LOOKS_TRIMMED = 16
"""Of a trimmed mean: the time grows with their square."""


class UnknownRateError(Exception):
    """The law of an estimate is not known here, or not affordable."""


class _Column(NamedTuple):
    """The rank-th smallest of some cells; 1 is the smallest."""

    rank: int
    n_cells: int


def known_rate(detector: Detector, factor: float, shape: Cell, cell: Cell, looks: int = 1) -> float:
    """Rate at which noise in a cell exceeds a factor times its noise estimate.

    Shares no code with `isacbench.dsp`. For one look, estimates that are linear
    in the sorted cells have a closed form, the product over their spacings.
    Otherwise the exceedance of the cell under test is integrated over the
    density of the estimate: a gamma density for means, chosen of two for
    halves, that of order statistics, convolved over columns. For trimmed
    means see `_trimmed_rate`. Of an `osca` without guard cells the column of
    the cell under test counts as the same rank of its other cells, the
    approximation that its factor is documented to make.
    """
    places = training_cells(detector, shape, cell)
    n_cells = len(places)
    one: Any = detector
    match detector.name:
        case "ca":
            return _mean_rate(factor, n_cells, looks)
        case "goca" | "soca":
            n_halves = [len(half) for half in halves_of(detector, places, cell)]
            return _half_rate(factor, n_halves, looks, greatest=detector.name == "goca")
        case "os":
            return _columns_rate(factor, [_Column(max(1, share(one.rank_fraction, n_cells)), n_cells)], looks)
        case "osca":
            return _columns_rate(factor, _columns(one, places, cell), looks)
        case "tm":
            trimmed = share(one.trim_low, n_cells), share(one.trim_high, n_cells)
            return _trimmed_mean_rate(factor, n_cells, trimmed, looks)
    raise UnknownRateError("the law of what it estimates is not known here")


def _columns(detector: Any, places: Sequence[Cell], cell: Cell) -> list[_Column]:
    columns = []
    for column in columns_of(detector, places):
        n_others = len(column) - (cell in column)
        columns.append(_Column(column_rank(len(column)), n_others))
    return columns


def _mean_rate(factor: float, n_cells: int, looks: int) -> float:
    if looks == 1:
        return _one_look_rate(factor, [np.full(n_cells, 1 / n_cells)])
    return _half_rate(factor, [n_cells], looks, greatest=True)


def _one_look_rate(factor: float, weights_of_columns: Sequence[Floats]) -> float:
    """Rate for the sum over columns of weighted sorted cells, the smallest first.

    The i-th spacing of n sorted exponential powers is exponential of mean 1 / (n - i), and a part of every
    cell above it.
    """
    log_rate = 0.0
    for weights in weights_of_columns:
        contained = np.cumsum(weights[::-1])[::-1]
        log_rate -= np.log1p(factor * contained / np.arange(weights.size, 0, -1)).sum()
    return math.exp(log_rate)


def _half_rate(factor: float, n_halves: Sequence[int], looks: int, greatest: bool) -> float:
    """Rate for the greatest or the smallest of the means of so many cells, the empty left out."""
    shapes = [looks * n for n in n_halves if n]
    ends = (
        min(float(special.gammaincinv(shape, _TAIL)) / shape for shape in shapes),
        max(float(special.gammainccinv(shape, _TAIL)) / shape for shape in shapes),
    )
    log_mean = _log_nodes(ends, _N_LINE)
    mean = np.exp(log_mean)
    other_law = special.gammainc if greatest else special.gammaincc
    density = np.zeros(_N_LINE)
    for i, shape in enumerate(shapes):
        others = [other_law(other, other * mean) for other in shapes[:i] + shapes[i + 1 :]]
        density += np.exp(_log_gamma_density(log_mean, shape)) * math.prod(others)
    return _integral(density * _exceeds(factor * mean, looks), log_mean)


def _columns_rate(factor: float, columns: Sequence[_Column], looks: int) -> float:
    """Rate for the mean over columns of an order statistic of each."""
    if looks == 1:
        return _one_look_rate(factor, [_unit(one.rank - 1, one.n_cells) / len(columns) for one in columns])
    if len(columns) == 1:
        log_power = _log_nodes(_ends(columns, looks), _N_LINE)
        density = np.exp(_log_order_density(log_power, columns[0], looks))
        return _integral(density * _exceeds(factor * np.exp(log_power), looks), log_power)
    return _settled(*(_convolved_rate(factor, columns, looks, n) for n in (_N_SUMMED, _N_SUMMED // 2)))


def _convolved_rate(factor: float, columns: Sequence[_Column], looks: int, n_nodes: int) -> float:
    """Convolve densities over nodes; all terms are positive, so that small rates keep their digits."""
    power = np.linspace(*_ends(columns, looks), n_nodes)
    step = power[1] - power[0]
    law = np.ones(1)
    for column, count in Counter(columns).items():
        density = step * np.exp(_log_order_density(np.log(power), column, looks)) / power
        law = np.convolve(law, _self_convolved(density, count))
    mean = (len(columns) * power[0] + step * np.arange(law.size)) / len(columns)
    return float(law @ _exceeds(factor * mean, looks))


def _self_convolved(density: Floats, count: int) -> Floats:
    """Density of the sum of so many, by squaring."""
    if count == 1:
        return density
    half = _self_convolved(density, count // 2)
    doubled = np.convolve(half, half)
    return np.convolve(doubled, density) if count % 2 else doubled


def _trimmed_mean_rate(factor: float, n_cells: int, trimmed: tuple[int, int], looks: int) -> float:
    below, above = trimmed
    n_kept = n_cells - below - above
    if looks == 1:
        return _one_look_rate(factor, [np.repeat([0.0, 1 / n_kept, 0.0], [below, n_kept, above])])
    if below == above == 0:
        return _mean_rate(factor, n_cells, looks)
    if n_kept == 1:
        return _columns_rate(factor, [_Column(below + 1, n_cells)], looks)
    if 0 in trimmed:
        raise UnknownRateError("the law of a mean trimmed on one side alone is not known here")
    if looks > _MOST_LOOKS_TRIMMED:
        raise UnknownRateError(f"a trimmed mean of more than {_MOST_LOOKS_TRIMMED} looks takes too long")
    return _trimmed_rate(factor, n_cells, trimmed, looks)


def _trimmed_rate(factor: float, n_cells: int, trimmed: tuple[int, int], looks: int) -> float:
    """Rate for a mean trimmed on both sides.

    The cell under test, the M-th arrival of a Poisson process, exceeds its threshold where fewer than M
    arrive in the kept cells. Between the largest cell trimmed below and the smallest above these are
    independent, and the probabilities of their arrivals incomplete gamma functions. The sum over both limits
    is a plain one.
    """
    below, above = trimmed
    n_kept = n_cells - below - above
    ends = _ends([_Column(below, n_cells), _Column(n_cells - above + 1, n_cells)], looks)
    log_limit = _log_nodes(ends, _N_PLANE)
    limit = np.exp(log_limit)
    low, high = np.triu_indices(_N_PLANE, 1)
    log_density = _log_gamma_density(log_limit, looks)
    log_low = log_density + special.xlogy(below - 1, special.gammainc(looks, looks * limit))
    log_high = log_density + special.xlogy(above - 1, special.gammaincc(looks, looks * limit))
    log_ways = special.gammaln(n_cells + 1) - sum(
        special.gammaln(n + 1) for n in (below - 1, above - 1, n_kept)
    )
    arrivals = _arrivals(looks * factor / n_kept, looks, limit)
    counted = arrivals[0, high] - arrivals[0, low] > _LEAST_ARRIVALS
    low, high = low[counted], high[counted]
    none = arrivals[0, high] - arrivals[0, low]
    ratio = (arrivals[1:, high] - arrivals[1:, low]) / none
    integrand = np.zeros((_N_PLANE, _N_PLANE))
    integrand[low, high] = np.exp(log_ways + log_low[low] + log_high[high] + n_kept * np.log(none))
    integrand[low, high] *= _sum_of_power(ratio, n_kept)
    step = log_limit[1] - log_limit[0]
    return _settled(
        float(integrand.sum()) * step**2,
        float(integrand[::2, ::2].sum()) * (2 * step) ** 2,
    )


def _arrivals(rate: float, looks: int, limit: Floats) -> Floats:
    """Probabilities of 0 to looks - 1 arrivals in a cell that is below a limit, shape (looks, limits)."""
    count = np.arange(looks)[:, np.newaxis]
    log_law = special.gammaln(looks + count) - special.gammaln(looks) - special.gammaln(count + 1)
    log_law -= looks * math.log1p(rate / looks) + count * math.log1p(looks / rate)
    law: Floats = np.exp(log_law) * special.gammainc(looks + count, (looks + rate) * limit)
    return law


def _sum_of_power(coefficients: Floats, exponent: int) -> Floats:
    """Sum of the first coefficients of a power of the series 1 + c_1 z + c_2 z² + …: Euler's recurrence."""
    power = [np.ones(coefficients.shape[1])]
    for n in range(1, len(coefficients) + 1):
        terms = [(k * (exponent + 1) - n) * coefficients[k - 1] * power[n - k] for k in range(1, n + 1)]
        power.append(np.sum(terms, axis=0) / n)
    total: Floats = np.sum(power, axis=0)
    return total


def _ends(columns: Sequence[_Column], looks: int) -> tuple[float, float]:
    """Powers between which all of the order statistics lie, but for the least of tails."""
    lower = [special.betaincinv(rank, n - rank + 1, _TAIL) for rank, n in columns]
    upper = [special.betaincinv(n - rank + 1, rank, _TAIL) for rank, n in columns]
    least, most = special.gammaincinv(looks, min(lower)), special.gammainccinv(looks, min(upper))
    return float(least) / looks, float(most) / looks


def _log_nodes(ends: tuple[float, float], n_nodes: int) -> Floats:
    return np.linspace(math.log(ends[0]), math.log(ends[1]), n_nodes)


def _log_order_density(log_power: Floats, column: _Column, looks: int) -> Floats:
    """Log density of the logarithm of an order statistic of powers of mean 1."""
    rank, n_cells = column
    power = looks * np.exp(log_power)
    log_density = _log_gamma_density(log_power, looks)
    log_density += special.xlogy(rank - 1, special.gammainc(looks, power))
    log_density += special.xlogy(n_cells - rank, special.gammaincc(looks, power))
    return log_density - math.log(special.beta(rank, n_cells - rank + 1))


def _log_gamma_density(log_mean: Floats, shape: int) -> Floats:
    """Log density of the logarithm of a gamma variable of mean 1."""
    log_density: Floats = shape * (math.log(shape) + log_mean - np.exp(log_mean)) - special.gammaln(shape)
    return log_density


def _exceeds(threshold: Floats, looks: int) -> Floats:
    """Probability that noise of mean 1 exceeds a threshold."""
    above: Floats = special.gammaincc(looks, looks * threshold)
    return above


def _integral(values: Floats, nodes: Floats) -> float:
    step = float(nodes[1] - nodes[0])
    return _settled(float(values.sum()) * step, float(values[::2].sum()) * 2 * step)


def _settled(rate: float, coarse: float) -> float:
    if abs(rate - coarse) > _SETTLED * rate:
        raise UnknownRateError("the quadrature of its rate does not settle")
    return rate


def _unit(index: int, size: int) -> Floats:
    unit = np.zeros(size)
    unit[index] = 1
    return unit
