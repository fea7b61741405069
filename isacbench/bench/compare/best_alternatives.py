"""Alternatives that may be the best one, as far as paired trials can tell."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

MAX_ENUMERATED = 12
"""Trials up to which all flips of signs are gone through; of more trials, as many flips are drawn."""

ROUNDING = 1e-9
"""Statistics this near to each other are equal: the same sum in another order."""


def best_p_values(scores: ArrayLike, margin: float = 0.0, seed: int = 0) -> Floats:
    """P-value, for each alternative, of the hypothesis that its mean is the lowest, or within a margin of it.

    Those with a p-value above a level are a set that misses the best
    alternative with at most that probability. Their number needs no
    correction, nor does it matter that the data choose with which the best is
    compared: it is dropped only if its own test errs (Gupta's subset
    selection).

    An alternative's statistic is the greatest, over the others, of the sum of
    paired differences beyond the margin, over the root of the sum of their
    squares. If the hypothesis only just holds, it is as it would be with the
    signs of any trials flipped, of all differences of a trial at once. So no
    normal distribution is supposed, and what alternatives share in a trial
    they share in every flip.

    Parameters
    ----------
    scores : array_like, shape (n_trials, n_alternatives)
        Lower is better. Finite: every alternative has met every trial.
    margin : float
        By how much a mean may be above the lowest one, in units of the scores.
    seed : int
        Of the flips that are drawn for more than `MAX_ENUMERATED` trials; the same answer every time.

    Returns
    -------
    ndarray of float64, shape (n_alternatives,)
        1 for that of least mean; never below `smallest_p_value`.

    Raises
    ------
    ValueError
        If the scores are no finite table with a trial.

    References
    ----------
    Gupta, "On some multiple decision (selection and ranking) rules", Technometrics 7 (1965). Westfall and
    Young, "Resampling-Based Multiple Testing" (1993), on the greatest of dependent statistics.

    Examples
    --------
    The second is worse than the first in each of eight trials, of the third nobody knows:

    >>> trials = np.array([[1.0, 1.5, 1.0 + x] for x in (0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.1, 0.0)])
    >>> best_p_values(trials).round(3).tolist()
    [1.0, 0.004, 0.672]
    """
    table = np.asarray(scores, dtype=np.float64)
    if table.ndim != 2 or not len(table) or not np.isfinite(table).all():
        raise ValueError(f"scores of shape {table.shape}: allowed is a finite table of trials x alternatives")
    signs = _signs(len(table), seed)
    return np.array([_p_value(_excess(table, k, margin), signs) for k in range(table.shape[1])])


def smallest_p_value(n_trials: int) -> float:
    """Smallest p-value that so many trials can have in `best_p_values`.

    Examples
    --------
    >>> smallest_p_value(8)
    0.00390625
    """
    return float(2.0 ** -min(n_trials, MAX_ENUMERATED))


def _excess(table: Floats, k: int, margin: float) -> Floats:
    """Differences (n_trials, n) of an alternative from all, beyond the margin; from itself 0."""
    excess = table[:, [k]] - table - margin
    excess[:, k] = 0.0
    return excess


def _p_value(differences: Floats, signs: Floats) -> float:
    """Share of the flips whose greatest statistic is that of the differences (n_trials, n), or more."""
    # Flips keep the sum of squares; given it, the sum is as good as Student's t.
    size = np.sqrt(np.square(differences).sum(axis=0))
    greatest = (signs @ (differences / np.where(size > 0, size, 1.0))).max(axis=1)
    return float(np.mean(greatest >= greatest[0] - ROUNDING))


def _signs(n_trials: int, seed: int) -> Floats:
    """Rows of signs (n_flips, n_trials), the first one without a flip: all that there are, or many."""
    if n_trials <= MAX_ENUMERATED:
        bits = np.arange(2**n_trials)[:, None] >> np.arange(n_trials)
        return (1 - 2 * (bits & 1)).astype(np.float64)
    signs: Floats = np.random.default_rng(seed).choice([-1.0, 1.0], (2**MAX_ENUMERATED, n_trials))
    signs[0] = 1.0
    return signs
