"""Statistics of paired trials: tests of a change, its size, the least change that could be shown; rank sets.

The rank sets of estimators are simultaneous confidence sets, the scene being the unit.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri, stdtrit

from isacbench.bench.statistics import CONFIDENCE, exact_interval

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_EXACT = 100
"""Largest number of differences with an exact null distribution; for more, its normal limit is taken."""

TEST_POWER = 0.8

MIN_INTERVAL_TRIALS = 6
"""Least number of trials for an interval. Resamples of n trials stay within their range, which misses the
middle of a symmetric distribution with probability 2^(1 - n): with fewer trials in more than 5 % of cases."""

N_RESAMPLES = 4000
COLUMNS_AT_ONCE = 512

SIGNED_RANK_EFFICIENCY = 3 / math.pi
"""Efficiency of the signed-rank test in trials, relative to the t test of normal differences."""


LEAST_VARIANCE = 0.1
"""Least variance of a pair's differences in a resample, as a fraction of that of all scenes. Without it,
one pair that differs in few scenes has infinite statistics in the resamples that lack them, and no pair could
be told apart."""

ROUNDING = 1e-9
"""Largest relative difference of scores that counts as none: rounding by another processor or library."""


class SignedRank(NamedTuple):
    """One-sided p-values of a signed-rank test.

    `greater` and `less` are the probabilities that differences without an effect lie at least as far above,
    or below, zero. `attainable` is the smallest p-value that differences of these sizes can have, reached if
    all signs are equal: 2^-n for n differences that are not zero.
    """

    greater: float
    less: float
    attainable: float


CHANGES = ["change", "change_low", "change_high", "relative", "relative_low", "relative_high"]


def without_rounding(base: Floats, new: Floats) -> Floats:
    """Make scores equal to others where only rounding parts them: zeros and ties are to be exact."""
    is_rounding = np.abs(new - base) <= ROUNDING * (np.abs(base) + np.abs(new)) / 2
    return np.where(is_rounding, base, new)


def signed_rank_test(differences: ArrayLike) -> SignedRank:
    """Wilcoxon's signed-rank test of paired, finite differences, with ties and zeros.

    The p-values are conditional on the sizes of the differences. Under the null hypothesis (differences
    symmetric about zero) each sign is a fair coin. The distribution of the rank sum over all signs is
    computed by dynamic programming over doubled midranks, which is exact with ties as well. For more than 100
    differences its normal limit is taken, with the variance of the midranks and continuity correction. Zeros
    are ranked and then left out (Pratt): if they were dropped first, differences that lean further to one
    side could become less significant. Without any difference that is not zero, all p-values are 1.

    Wilcoxon, "Individual comparisons by ranking methods", Biometrics Bulletin 1 (1945). Pratt, "Remarks on
    zeros and ties in the Wilcoxon signed rank procedures", J. Am. Stat. Assoc. 54 (1959).

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
    # The distribution is symmetric: the sum of negative ranks has the tail of the positive ones.
    sums = np.array([positive, kept.sum() - positive])
    if kept.size <= MAX_EXACT:
        greater, less = _tails(tuple(sorted(kept.tolist())))[sums]
    else:
        # Continuity correction: half a rank towards the middle is 1 in doubled ranks.
        greater, less = ndtr((kept.sum() / 2 + 1 - sums) / math.sqrt(np.square(kept).sum() / 4))
    return SignedRank(float(greater), float(less), 2.0**-kept.size)


def holm(p_values: ArrayLike) -> Floats:
    """Adjust p-values of a family by Holm's step-down method.

    If hypotheses with an adjusted p-value of at most a level are rejected, the probability of any false
    rejection is at most that level, however the tests depend on each other. Holm, "A simple sequentially
    rejective multiple test procedure", Scand. J. Stat. 6 (1979).

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


def bootstrap_changes(base: Floats, new: Floats) -> pd.DataFrame:
    """Compute mean changes of paired trials with 95 % bootstrap intervals.

    Trials are resampled with their pairs and for all points at once, so that dependence between the points of
    a trial is kept in every resample. The intervals are percentiles, at levels expanded so that on normal
    differences they are as wide as those of Student's t; plain percentiles are too narrow for few trials
    (Hesterberg, "What teachers should know about the bootstrap", Am. Stat. 69 (2015), section 4).

    `base` and `new` have the shape (n_trials, n_points), NaN at the same places where a pair is missing.
    Returned is a row for each point: the change of the mean in units of the score, with the limits of its
    interval, ``change``, ``change_low`` and ``change_high``; and the same over the absolute mean of the base,
    ``relative``, infinite where that is zero and the change is not. Means are NaN without pairs, intervals
    with fewer than six, unless all differences are zero.

    Examples
    --------
    >>> base = np.full((10, 1), 8.0)
    >>> found = bootstrap_changes(base, base + 2)
    >>> found[["relative_low", "relative_high"]].to_numpy()
    array([[0.25, 0.25]])
    """
    n_trials, n_points = base.shape
    changes = np.full((6, n_points), np.nan)
    if base.size:
        rng = np.random.default_rng(0)
        weights = rng.multinomial(n_trials, np.full(n_trials, 1 / n_trials), N_RESAMPLES).astype(np.float64)
        for start in range(0, n_points, COLUMNS_AT_ONCE):
            part = slice(start, start + COLUMNS_AT_ONCE)
            changes[:, part] = _changes(base[:, part], new[:, part], weights)
    return pd.DataFrame(changes.T, columns=CHANGES)


def win_shares(base: Floats, new: Floats, better: str) -> pd.DataFrame:
    """Estimate the probability that the new score of a pair is better, with its 95 % interval.

    `base` and `new` have the shape (n_pairs, n_points), NaN at the same places where a pair is missing.
    Returned is a row for each point: ``probability``, the share of pairs in which the new score is better,
    ties counting half; the limits ``low`` and ``high`` of `isacbench.bench.statistics.exact_interval`; and
    the number of ties, ``n_ties``. NaN without pairs.

    Examples
    --------
    >>> win_shares(np.array([[2.0], [2.0], [2.0]]), np.array([[1.0], [2.0], [3.0]]), "lower")["probability"]
    0    0.5
    Name: probability, dtype: float64
    """
    n_pairs = np.isfinite(new - base).sum(axis=0)
    n_ties = (new == base).sum(axis=0)
    n_wins = (new < base if better == "lower" else new > base).sum(axis=0) + n_ties / 2
    limits = [exact_interval(float(wins), int(n)) for wins, n in zip(n_wins, n_pairs, strict=True)]
    with np.errstate(invalid="ignore"):
        shares = pd.DataFrame({"probability": n_wins / n_pairs})
    shares[["low", "high"]] = np.reshape(limits, (-1, 2))
    return shares.assign(n_ties=n_ties)


def smallest_effect(spread: ArrayLike, n_trials: ArrayLike, level: float) -> Floats:
    """Smallest mean change that a one-sided signed-rank test would show with 80 % power.

    For n normal differences of standard deviation s that is (z + z_0.8) s / sqrt(3n/pi - z^2/2) with
    z = z_(1-level): the sample size of the t test (Guenther) at the signed-rank test's asymptotic relative
    efficiency of 3/pi. Where n is so small that all signs must be equal, it is the mean with which they are
    equal in 80 % of all cases. Where even equal signs, p = 2^-n, are not significant, it is infinite.
    Simulated power is 0.73 to 0.81. The level is that of the test, corrections for other tests included.

    Guenther, "Sample size formulas for normal theory t tests", Am. Stat. 35 (1981). Lehmann, "Nonparametrics:
    Statistical Methods Based on Ranks" (1975), on the efficiency.

    Examples
    --------
    >>> smallest_effect(1.0, [6, 20], level=0.01).round(2).tolist()
    [inf, 0.78]
    """
    trials, deviation = np.asarray(n_trials, dtype=np.float64), np.asarray(spread, dtype=np.float64)
    quantile = float(ndtri(1 - level))
    attainable = np.exp2(-trials)
    # Where the level is attainable at all, the value under the root is positive.
    freedom = np.where(attainable > level, np.nan, SIGNED_RANK_EFFICIENCY * trials - quantile**2 / 2)
    effect = (quantile + float(ndtri(TEST_POWER))) / np.sqrt(freedom)
    equal_signs = ndtri(np.power(TEST_POWER, 1 / np.maximum(trials, 1)))
    effect = np.where(2 * attainable > level, np.maximum(effect, equal_signs), effect)
    return np.where(attainable > level, np.inf, effect * deviation)


def trials_needed(level: float) -> int:
    """Least number of trials with which a signed-rank test can be significant: 2^-n is at most the level.

    Examples
    --------
    >>> trials_needed(0.01), trials_needed(0.01 / 66)
    (7, 13)
    """
    return math.ceil(-math.log2(level))


def _doubled_midranks(sizes: Floats) -> Integers:
    """Twice the ranks from 1 on, as whole numbers; equal values share the mean of their ranks."""
    _, inverse, counts = np.unique(sizes, return_inverse=True, return_counts=True)
    doubled: Integers = (2 * np.cumsum(counts) - counts + 1)[inverse]
    return doubled


@lru_cache(maxsize=256)
def _tails(ranks: tuple[int, ...]) -> Floats:
    """Probabilities that the sum of the ranks with a positive sign is at least 0, 1, ..., all ranks."""
    mass = np.zeros(sum(ranks) + 1)
    mass[0] = 1.0
    for rank in ranks:
        positive = mass[:-rank].copy()
        mass[rank:] += positive
        mass /= 2
    # Summed from the far end, where the probabilities are smallest.
    tails: Floats = np.cumsum(mass[::-1])[::-1]
    return tails


def _changes(base: Floats, new: Floats, weights: Floats) -> Floats:
    """Six rows, as `CHANGES` names them."""
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
    """Interval of each column, shape (2, n_points), from the resamples that hold at least one pair."""
    ordered = np.sort(resampled, axis=0)  # NaN last
    last = (~np.isnan(resampled)).sum(axis=0) - 1
    freedom = np.maximum(n_pairs - 1, 1)
    quantile = stdtrit(freedom, (1 + CONFIDENCE) / 2) * np.sqrt((freedom + 1) / freedom)
    # Rounded outwards to the next resample.
    low = np.floor(ndtr(-quantile) * last).astype(np.int64)
    columns = np.arange(resampled.shape[1])
    return np.stack([ordered[low, columns], ordered[last - low, columns]])


class RankSets(NamedTuple):
    """First and last ranks of sets of consecutive ranks; rank 1 is the lowest mean.

    `critical` is the pair of estimators, the first one above the second, whose statistic is most often the
    one beyond the last critical value, and `critical_share` the share of the resamples beyond it in which it
    is. A pair with rare, large differences widens the sets of all.
    """

    low: Integers
    high: Integers
    critical: tuple[int, int]
    critical_share: float


def rank_sets(scores: ArrayLike) -> RankSets:
    """Find sets of ranks that hold the true ranks of all estimators at once with 95 % confidence.

    For every ordered pair of estimators j and k, the hypothesis is tested that the mean of j is at most that
    of k. All tests together reject a true hypothesis with a probability of at most 5 %. The set of j starts
    at 1 plus the number of estimators that it was found to be above, and ends at the number of all less those
    that were found to be above it. Where no true hypothesis is rejected, every rank is in its set, whichever
    rank equal means are given. This is the method of Mogstad, Romano, Shaikh and Wilhelm, with their
    one-sided tests of both directions and stepdown improvement.

    The statistic of a pair is Student's t of its differences within scenes. The critical value is the 95 %
    quantile of the largest statistic over the pairs that are not yet rejected, from a bootstrap over scenes:
    the pairs of a scene are drawn together, and each resample is divided by its own standard error, because
    with 20 scenes that of all scenes is too small in the tails. The critical value is computed again without
    the rejected hypotheses until no further one is rejected.

    `scores` have the shape (n_scenes, n_estimators), lower is better; a ValueError if they are not a finite
    table with at least two scenes. Equal scores give equal sets.

    Mogstad, Romano, Shaikh and Wilhelm, "Inference for ranks with applications to mobility across
    neighbourhoods and academic achievement across countries", Rev. Econ. Stud. 91 (2024), section 3.
    Romano and Wolf, "Exact and approximate stepdown methods for multiple hypothesis testing",
    J. Am. Stat. Assoc. 100 (2005).

    Examples
    --------
    The first two cannot be told apart: each is lower in half of the scenes. The third is above both:

    >>> scenes = np.arange(8.0)[:, None] + np.array([[0.0, 0.1, 5.0], [0.1, 0.0, 6.0]] * 4)
    >>> sets = rank_sets(scenes)
    >>> sets.low.tolist(), sets.high.tolist()
    ([1, 1, 3], [2, 2, 3])
    """
    table = np.asarray(scores, dtype=np.float64)
    if table.ndim != 2 or len(table) < 2 or not np.isfinite(table).all():
        raise ValueError(f"scores of shape {table.shape}: allowed is a finite table of two scenes or more")
    n_estimators = table.shape[1]
    first, second = np.nonzero(~np.eye(n_estimators, dtype=bool))
    is_above, pair, share = _stepdown(*_statistics(table[:, first] - table[:, second]))
    n_below = np.bincount(first[is_above], minlength=n_estimators)
    n_above = np.bincount(second[is_above], minlength=n_estimators)
    return RankSets(1 + n_below, n_estimators - n_above, (int(first[pair]), int(second[pair])), share)


def _statistics(differences: Floats) -> tuple[Floats, Floats]:
    """Student's t of each column, and in resamples (n_resamples, n_columns) of the centred columns."""
    n_scenes = len(differences)
    change = differences.mean(axis=0)
    centred = differences - change
    variance = np.square(centred).mean(axis=0)
    varies = variance > np.square(np.finfo(np.float64).eps * np.abs(change))
    centred[:, ~varies] = 0.0
    rng = np.random.default_rng(0)
    weights = rng.multinomial(n_scenes, np.full(n_scenes, 1 / n_scenes), N_RESAMPLES) / n_scenes
    resampled = weights @ centred
    spread = np.maximum(weights @ np.square(centred) - np.square(resampled), LEAST_VARIANCE * variance)
    # The means of estimators with equal differences in all scenes are known to differ, or are equal.
    certain = np.where(change == 0, 0.0, np.copysign(np.inf, change))
    scale = np.sqrt((n_scenes - 1) / np.where(varies, variance, 1.0))
    observed = np.where(varies, change * scale, certain)
    return observed, np.sqrt(n_scenes - 1) * resampled / np.sqrt(np.where(varies, spread, 1.0))


def _stepdown(observed: Floats, resampled: Floats) -> tuple[NDArray[np.bool_], int, float]:
    """Mark the rejected hypotheses; find the one that most of what is beyond the critical value is of."""
    is_left = np.ones(observed.size, dtype=bool)
    n_beyond = np.zeros(observed.size, dtype=np.intp)
    while is_left.any():
        place = np.flatnonzero(is_left)[resampled[:, is_left].argmax(axis=1)]
        largest = resampled[np.arange(len(resampled)), place]
        critical = np.quantile(largest, CONFIDENCE, method="higher")
        n_beyond = np.bincount(place[largest >= critical], minlength=observed.size)
        is_new = is_left & (observed > critical)
        if not is_new.any():
            break
        is_left &= ~is_new
    return ~is_left, int(n_beyond.argmax()), float(n_beyond.max() / n_beyond.sum())
