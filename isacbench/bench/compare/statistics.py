"""Statistics of paired trials: whether a change is real, its size, and the least that could be shown."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from isacbench.bench.studies.intervals import CONFIDENCE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

MAX_EXACT = 100
"""Differences up to which the null distribution is exact; beyond, its normal limit is."""

TEST_POWER = 0.8

MIN_INTERVAL_TRIALS = 6
"""Fewest trials with an interval: no resampling of n trials leaves their range, which misses the middle of a
symmetric distribution with probability 2^(1 - n), more than 5 % of fewer."""

N_RESAMPLES = 4000
COLUMNS_AT_ONCE = 512

SIGNED_RANK_EFFICIENCY = 3 / math.pi
"""Of the signed-rank test, in trials, relative to the t test of normal differences."""


class SignedRank(NamedTuple):
    """One-sided p-values of a signed-rank test.

    Attributes
    ----------
    greater, less : float
        That differences of no effect lie as far above, or below, zero.
    attainable : float
        Smallest p-value that differences of these sizes could have had, were
        all their signs equal: 2^-n for n that are not zero.
    """

    greater: float
    less: float
    attainable: float


class Changes(NamedTuple):
    """Mean changes with their confidence intervals, arrays of shape (n_points,).

    Attributes
    ----------
    change, change_low, change_high : ndarray of float64
        Of the mean, in units of the score.
    relative, relative_low, relative_high : ndarray of float64
        The same over the size of the base's mean; infinite where that is zero
        and the change is not.
    """

    change: Floats
    change_low: Floats
    change_high: Floats
    relative: Floats
    relative_low: Floats
    relative_high: Floats


def signed_rank_test(differences: ArrayLike) -> SignedRank:
    """Wilcoxon's signed-rank test of paired differences, with ties and zeros.

    The p-values are conditional on the sizes of the differences: under the
    null hypothesis, differences symmetric about zero, each sign is a fair
    coin. The distribution of the rank sum over all signs is computed by
    dynamic programming over doubled midranks, exactly whatever the ties; for
    more than 100 differences its normal limit is taken, with
    the variance of the midranks and continuity correction. Zeros are ranked
    and then left out (Pratt): dropping them first can make differences that
    lean further to one side less significant.

    Parameters
    ----------
    differences : array_like, shape (n,)
        Finite.

    Returns
    -------
    SignedRank
        All 1 where every difference is zero, and of none at all.

    References
    ----------
    Wilcoxon, "Individual comparisons by ranking methods", Biometrics
    Bulletin 1 (1945). Pratt, "Remarks on zeros and ties in the Wilcoxon
    signed rank procedures", J. Am. Stat. Assoc. 54 (1959).

    Examples
    --------
    >>> signed_rank_test([0.3, 0.1, 0.2, 0.4])
    SignedRank(greater=0.0625, less=1.0, attainable=0.0625)
    """
    values = np.asarray(differences, dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError("differences must be finite")
    ranks = _doubled_midranks(np.abs(values))
    is_positive, is_zero = values > 0, values == 0
    positive, kept = int(ranks[is_positive].sum()), ranks[~is_zero]
    if not kept.size:
        return SignedRank(1.0, 1.0, 1.0)
    negative = int(kept.sum()) - positive
    tail = _exact_tail if kept.size <= MAX_EXACT else _normal_tail
    key = tuple(sorted(kept.tolist()))
    # The distribution is symmetric: the sum of negative ranks has the tail of the positive ones.
    return SignedRank(tail(key, positive), tail(key, negative), 2.0**-kept.size)


def holm(p_values: ArrayLike) -> Floats:
    """Adjust p-values of a family by Holm's step-down method.

    Rejecting what has an adjusted p-value of at most a level keeps the
    probability of any false rejection below that level, however the tests
    depend on each other.

    Parameters
    ----------
    p_values : array_like, shape (n,)

    Returns
    -------
    ndarray of float64, shape (n,)

    References
    ----------
    Holm, "A simple sequentially rejective multiple test procedure", Scand.
    J. Stat. 6 (1979).

    Examples
    --------
    >>> holm([0.01, 0.04, 0.03]).tolist()
    [0.03, 0.06, 0.06]
    """
    values = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(values, kind="stable")
    remaining = np.arange(values.size, 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(remaining * values[order]), 1.0)
    return adjusted


def bootstrap_changes(base: Floats, new: Floats, seed: int = 0) -> Changes:
    """Mean changes of paired trials with 95 % bootstrap intervals.

    Trials are resampled jointly, with their pairs and for all points at once:
    what the points of one trial share, they share in every resample. The
    intervals are percentiles, at levels expanded so that on normal
    differences they are as wide as those of Student's t (Hesterberg); plain
    percentiles are too narrow for few trials.

    Parameters
    ----------
    base, new : ndarray of float64, shape (n_trials, n_points)
        Scores, NaN at the same places in both where a pair is missing.
    seed : int
        Of the resampling; the same answer every time.

    Returns
    -------
    Changes
        Means are NaN without pairs, intervals with fewer than six, unless
        all differences are zero.

    References
    ----------
    Hesterberg, "What teachers should know about the bootstrap", Am. Stat. 69
    (2015), section 4.

    Examples
    --------
    >>> base = np.full((10, 1), 8.0)
    >>> found = bootstrap_changes(base, base + 2)
    >>> found.relative_low, found.relative_high
    (array([0.25]), array([0.25]))
    """
    n_trials, n_points = base.shape
    if not base.size:
        return Changes(*np.full((6, n_points), np.nan))
    weights = np.random.default_rng(seed).multinomial(n_trials, np.full(n_trials, 1 / n_trials), N_RESAMPLES)
    found = np.full((6, n_points), np.nan)
    for start in range(0, n_points, COLUMNS_AT_ONCE):
        part = slice(start, start + COLUMNS_AT_ONCE)
        found[:, part] = _changes(base[:, part], new[:, part], weights.astype(np.float64))
    return Changes(*found)


def smallest_effect(spread: ArrayLike, n_trials: ArrayLike, level: float) -> Floats:
    """Smallest mean change that a one-sided signed-rank test would show with 80 % power.

    For n normal differences of standard deviation s that is (z + z_0.8) s /
    sqrt(3n/pi - z^2/2) with z = z_(1-level): the sample size of the t test
    (Guenther) at the signed-rank test's asymptotic relative efficiency of
    3/pi. Where n are so few that all signs must be equal, it is the mean
    with which they are so in 80 % of all cases; where even that, p = 2^-n,
    would not do, it is infinite. Simulated power is 0.73 to 0.81.

    Parameters
    ----------
    spread : array_like
        Standard deviations s.
    n_trials : array_like
        Numbers of differences n.
    level : float
        Of the test, what corrects it for others included.

    Returns
    -------
    ndarray of float64
        In units of the spread.

    References
    ----------
    Guenther, "Sample size formulas for normal theory t tests", Am. Stat. 35
    (1981). Lehmann, "Nonparametrics: Statistical Methods Based on Ranks"
    (1975), on the efficiency.

    Examples
    --------
    >>> smallest_effect(1.0, [6, 20], level=0.01).round(2).tolist()
    [inf, 0.78]
    """
    trials, deviation = np.asarray(n_trials, dtype=np.float64), np.asarray(spread, dtype=np.float64)
    quantile = float(ndtri(1 - level))
    attainable = np.exp2(-trials)
    # Wherever the level is attainable at all, what is under the root is positive.
    freedom = np.where(attainable > level, np.nan, SIGNED_RANK_EFFICIENCY * trials - quantile**2 / 2)
    effect = (quantile + float(ndtri(TEST_POWER))) / np.sqrt(freedom)
    equal_signs = ndtri(np.power(TEST_POWER, 1 / np.maximum(trials, 1)))
    effect = np.where(2 * attainable > level, np.maximum(effect, equal_signs), effect)
    return np.where(attainable > level, np.inf, effect * deviation)


def trials_needed(level: float) -> int:
    """Fewest trials of which a signed-rank test can be significant at all: 2^-n is at most the level.

    Examples
    --------
    >>> trials_needed(0.01), trials_needed(0.01 / 66)
    (7, 13)
    """
    return math.ceil(-math.log2(level))


def _doubled_midranks(sizes: Floats) -> Integers:
    """Twice the ranks from 1 on, equal ones sharing their mean: whole numbers."""
    _, inverse, counts = np.unique(sizes, return_inverse=True, return_counts=True)
    doubled: Integers = (2 * np.cumsum(counts) - counts + 1)[inverse]
    return doubled


def _exact_tail(ranks: tuple[int, ...], observed: int) -> float:
    """Probability of a rank sum of at least the observed one."""
    return float(_tails(ranks)[observed])


@lru_cache(maxsize=256)
def _tails(ranks: tuple[int, ...]) -> Floats:
    """Probabilities that the sum of the ranks with a positive sign is at least 0, 1, ..., all ranks."""
    mass = np.zeros(sum(ranks) + 1)
    mass[0] = 1.0
    for rank in ranks:
        positive = mass[:-rank].copy()
        mass[rank:] += positive
        mass /= 2
    # Summed from the far end, where the smallest are.
    tails: Floats = np.cumsum(mass[::-1])[::-1]
    tails.flags.writeable = False
    return tails


def _normal_tail(ranks: tuple[int, ...], observed: int) -> float:
    """Probability of a rank sum of at least the observed one, in the limit of many."""
    doubled = np.array(ranks, dtype=np.float64)
    # Half a rank towards the middle is 1 in doubled ranks.
    excess = observed - doubled.sum() / 2 - 1
    return float(ndtr(-excess / math.sqrt(np.square(doubled).sum() / 4)))


def _changes(base: Floats, new: Floats, weights: Floats) -> Floats:
    """The six rows of `Changes`."""
    paired = np.isfinite(base) & np.isfinite(new)
    n_pairs = paired.sum(axis=0)
    differences, levels = np.where(paired, new - base, 0.0), np.where(paired, base, 0.0)
    every_trial = np.ones((1, len(base)))
    change, relative = _mean_changes(differences, levels, paired, every_trial)
    unchanged = (n_pairs > 0) & ~differences.any(axis=0)
    has_interval = (n_pairs >= MIN_INTERVAL_TRIALS) | unchanged
    intervals = [
        np.where(has_interval, _percentiles(resampled, n_pairs), np.nan)
        for resampled in _mean_changes(differences, levels, paired, weights)
    ]
    return np.stack([change[0], *intervals[0], relative[0], *intervals[1]])


def _mean_changes(
    differences: Floats, levels: Floats, paired: NDArray[np.bool_], weights: Floats
) -> tuple[Floats, Floats]:
    """Absolute and relative changes of the weighted mean, shape (n_weightings, n_points)."""
    total = weights @ differences
    with np.errstate(divide="ignore", invalid="ignore"):
        absolute = total / (weights @ paired)
        relative = np.where(total == 0, absolute, total / np.abs(weights @ levels))
    return absolute, relative


def _percentiles(resampled: Floats, n_pairs: Integers) -> Floats:
    """Interval of each column, shape (2, n_points), of the resamples that hold a pair at all."""
    ordered = np.sort(resampled, axis=0)  # NaN last
    last = (~np.isnan(resampled)).sum(axis=0) - 1
    freedom = np.maximum(n_pairs - 1, 1)
    quantile = stdtrit(freedom, (1 + CONFIDENCE) / 2) * np.sqrt((freedom + 1) / freedom)
    # The next resample outwards.
    low = np.floor(ndtr(-quantile) * last).astype(np.int64)
    columns = np.arange(resampled.shape[1])
    return np.stack([ordered[low, columns], ordered[last - low, columns]])
