"""Ranks of estimators with simultaneous confidence sets, the scene being the unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from isacbench.bench.compare.statistics import N_RESAMPLES
from isacbench.bench.statistics import CONFIDENCE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

LEAST_VARIANCE = 0.1
"""Least variance of a pair's differences in a resample, as a fraction of that of all scenes. Without it,
one pair that differs in few scenes has infinite statistics in the resamples that lack them, and no pair could
be told apart."""


class RankSets(NamedTuple):
    """Sets of consecutive ranks; rank 1 is the lowest mean.

    Attributes
    ----------
    low, high : ndarray of int64, shape (n_estimators,)
        First and last rank of each set.
    critical : (int, int)
        Pair of estimators, the first one above the second, whose statistic is most often the one beyond the
        last critical value. A pair with rare, large differences widens the sets of all.
    critical_share : float
        Share of the resamples beyond the critical value in which it is.
    """

    low: Integers
    high: Integers
    critical: tuple[int, int]
    critical_share: float


def rank_sets(scores: ArrayLike, seed: int = 0) -> RankSets:
    """Find sets of ranks that hold the true ranks of all estimators at once with 95 % confidence.

    For every ordered pair of estimators j and k, the hypothesis is tested that
    the mean of j is at most that of k. All tests together reject a true
    hypothesis with a probability of at most 5 %. The set of j starts at 1 plus
    the number of estimators that it was found to be above, and ends at the
    number of all less those that were found to be above it. Where no true
    hypothesis is rejected, every rank is in its set, whichever rank equal means
    are given. This is the method of Mogstad, Romano, Shaikh and Wilhelm, with
    their one-sided tests of both directions and stepdown improvement.

    The statistic of a pair is Student's t of its differences within scenes. The
    critical value is the 95 % quantile of the largest statistic over the pairs
    that are not yet rejected, from a bootstrap over scenes: the pairs of a scene
    are drawn together, and each resample is divided by its own standard error,
    because with 20 scenes that of all scenes is too small in the tails. The
    critical value is computed again without the rejected hypotheses until no
    further one is rejected.

    Parameters
    ----------
    scores : array_like, shape (n_scenes, n_estimators)
        Lower is better; finite.
    seed : int
        Seed of the resampling; equal seeds give equal sets.

    Raises
    ------
    ValueError
        If the scores are not a finite table with at least two scenes.

    References
    ----------
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
    is_above, pair, share = _stepdown(*_statistics(table[:, first] - table[:, second], seed))
    n_below = np.bincount(first[is_above], minlength=n_estimators)
    n_above = np.bincount(second[is_above], minlength=n_estimators)
    return RankSets(1 + n_below, n_estimators - n_above, (int(first[pair]), int(second[pair])), share)


def _statistics(differences: Floats, seed: int) -> tuple[Floats, Floats]:
    """Student's t of each column, and in resamples (n_resamples, n_columns) of the centred columns."""
    n_scenes = len(differences)
    change = differences.mean(axis=0)
    centred = differences - change
    variance = np.square(centred).mean(axis=0)
    varies = variance > np.square(np.finfo(np.float64).eps * np.abs(change))
    centred[:, ~varies] = 0.0
    rng = np.random.default_rng(seed)
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
