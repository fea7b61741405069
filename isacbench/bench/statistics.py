"""Summaries of rows: medians of times, confidence intervals, and words for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import bdtr, betaincinv, chdtri, ndtri, stdtrit

from isacbench.bench.cells.rows import failed
from isacbench.files.escaping import plural

Floats = NDArray[np.float64]

TIME = "time_estimate_s"
CONFIDENCE = 0.95

MIN_TRIALS = 5
"""Least number of trials for a confidence band of means, errors and shares: fewer hardly show the spread."""


def student_band(deviation: ArrayLike, n: ArrayLike) -> Floats:
    """Half width of the 95 % confidence interval of means (Student's t), NaN for fewer than five values.

    `deviation` are the standard deviations of the `n` values behind each mean.

    Examples
    --------
    >>> student_band([1.0, 1.0], [5, 4]).round(3).tolist()
    [1.242, nan]
    """
    counts = np.asarray(n, dtype=np.float64)
    freedom = np.where(counts >= MIN_TRIALS, counts - 1, np.nan)
    band: Floats = np.asarray(deviation) * stdtrit(freedom, (1 + CONFIDENCE) / 2) / np.sqrt(freedom + 1)
    return band


def deviation_columns(rows: pd.DataFrame) -> dict[str, float]:
    """Mean of the imaging deviation, ``deviation_mean``, and its ``deviation_band`` (`student_band`)."""
    deviation = rows["deviation"].dropna()
    band = student_band(deviation.std(), len(deviation))
    return {"deviation_mean": float(deviation.mean()), "deviation_band": float(band)}


def means_and_bands(groups: Any, names: Sequence[str]) -> pd.DataFrame:
    """Mean of each column in groups of a table, ``<name>_mean``, and its ``<name>_band`` (`student_band`)."""
    mean, deviation, count = (getattr(groups[[*names]], what)() for what in ("mean", "std", "count"))
    bands = student_band(deviation, count)
    columns: dict[str, Any] = {}
    for place, name in enumerate(names):
        columns |= {f"{name}_mean": mean[name], f"{name}_band": bands[:, place]}
    return pd.DataFrame(columns, index=mean.index)


def median_interval(values: Floats) -> tuple[float, float, float]:
    """Median and the limits of its 95 % confidence interval, for any distribution.

    The ends of the interval are two of the values, as far inside as the binomial distribution of the number
    of values below the median allows. So it is valid with the long tail that run times have. There is none
    (NaN) for fewer than six values, whose whole range misses the median in more than 5 % of all cases.
    David and Nagaraja, "Order Statistics", 3rd edition (2003), section 7.1.

    Examples
    --------
    >>> median_interval(np.arange(1.0, 10.0))
    (5.0, 2.0, 8.0)
    """
    if not values.size:
        return math.nan, math.nan, math.nan
    return float(np.median(values)), *quantile_interval(values, 0.5)


def quantile_interval(values: Floats, share: float) -> tuple[float, float]:
    """Limits of the 95 % confidence interval of a quantile, for any distribution, as `median_interval` does.

    NaN where even the range of all values misses the quantile in more than 5 % of all cases.

    Examples
    --------
    >>> quantile_interval(np.arange(1.0, 101.0), 0.9)
    (84.0, 96.0)
    """
    n, tail = values.size, (1 - CONFIDENCE) / 2
    ordered = np.sort(values)
    # Values that may lie below the quantile at least, and above it.
    below, above = (int((bdtr(np.arange(n), n, part) <= tail).sum()) for part in (share, 1 - share))
    if not below or not above:
        return math.nan, math.nan
    return float(ordered[below - 1]), float(ordered[n - above])


def rms_interval(values: Floats) -> tuple[float, float, float]:
    """Root mean square and the limits of its 95 % confidence interval, also where tails are heavy.

    The mean square is taken as a scaled chi-square. Its degrees of freedom follow from the spread of the
    squares (Satterthwaite); they are at most the number of values, which is exact for normal values. There is
    no interval (NaN) for fewer than five values.

    Examples
    --------
    >>> rms_interval(np.array([3.0, -4.0, 3.0, -4.0]))[0]
    3.5355339059327378
    """
    n = values.size
    if not n:
        return math.nan, math.nan, math.nan
    squares = np.square(values)
    mean = float(squares.mean())
    if n < MIN_TRIALS or not mean:
        return math.sqrt(mean), math.nan, math.nan
    spread = float(squares.var(ddof=1))
    freedom = min(float(n), 2 * n * mean**2 / spread) if spread else float(n)
    tail = (1 - CONFIDENCE) / 2
    low, high = (math.sqrt(mean * freedom / float(chdtri(freedom, p))) for p in (tail, 1 - tail))
    return math.sqrt(mean), low, high


def wilson_interval(n_successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % confidence interval of a probability, NaN without trials.

    Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 22
    (1927).

    Examples
    --------
    >>> [round(limit, 4) for limit in wilson_interval(9, 10)]
    [0.5958, 0.9821]
    """
    if not n:
        return math.nan, math.nan
    quantile = float(ndtri((1 + CONFIDENCE) / 2))
    share, shrink = n_successes / n, 1 + quantile**2 / n
    middle = (share + quantile**2 / (2 * n)) / shrink
    half = quantile * math.sqrt(share * (1 - share) / n + quantile**2 / (4 * n**2)) / shrink
    # Rounding must not move an end away from 0 or 1.
    return (middle - half if n_successes else 0.0), (middle + half if n_successes < n else 1.0)


def exact_interval(n_successes: float, n: int) -> tuple[float, float]:
    """Clopper and Pearson's 95 % confidence interval of a probability; half a success counts half.

    It holds the probability in at least 95 % of all cases, also near 0 and 1, where Wilson's interval may
    hold it in 84 %. With half successes, such as ties, the counts spread less than the binomial ones, and the
    interval is the wider. NaN without trials. Clopper and Pearson, "The use of confidence or fiducial limits
    illustrated in the case of the binomial", Biometrika 26 (1934).

    Examples
    --------
    >>> [round(limit, 4) for limit in exact_interval(9, 10)]
    [0.555, 0.9975]
    """
    if not n:
        return math.nan, math.nan
    tail, n_failures = (1 - CONFIDENCE) / 2, n - n_successes
    low = float(betaincinv(n_successes, n_failures + 1, tail)) if n_successes else 0.0
    high = float(betaincinv(n_successes + 1, n_failures, 1 - tail)) if n_failures else 1.0
    return low, high


def share_columns(name: str, n_successes: int, n: int, n_trials: int) -> dict[str, float]:
    """Share counted in trials, ``<name>``, and Wilson's interval of it, ``<name>_low`` to ``<name>_high``.

    NaN of nothing, and an interval of fewer than five trials: one trial can have many of the `n` (bits of a
    frame, cells of a map), which are then only one draw.

    Examples
    --------
    >>> {name: round(value, 4) for name, value in share_columns("p", 9, 10, n_trials=10).items()}
    {'p': 0.9, 'p_low': 0.5958, 'p_high': 0.9821}
    """
    low, high = wilson_interval(n_successes, n) if n_trials >= MIN_TRIALS else (math.nan, math.nan)
    return {name: n_successes / n if n else math.nan, f"{name}_low": low, f"{name}_high": high}


def time_words(rows: pd.DataFrame) -> str:
    """Say what the times of a run are: those of cells that ran beside others mislead."""
    is_alone = rows["timing"].astype(bool)[~failed(rows)].all()
    return "median processor time" + ("" if is_alone else " (not measured alone)")


def median_times(rows: pd.DataFrame, by: Sequence[str], columns: Sequence[str] = (TIME,)) -> pd.DataFrame:
    """Take the median over the cells of each group that did not fail, whatever their SNR and trial.

    Where any cell of a group was timed (`isacbench run --timing`), the timed cells of the group count alone.
    Indexed by group, without groups that have no such cell; the columns are ``<column>_median``.

    Examples
    --------
    >>> rows = pd.DataFrame({"estimator": "a", "status": "ok", "timing": False, TIME: [1, 2, 9]})
    >>> median_times(rows, ["estimator"])["time_estimate_s_median"].to_dict()
    {'a': 2.0}
    """
    scored = rows[~failed(rows)].astype({"timing": bool})
    any_timed = scored.groupby(list(by), sort=False, dropna=False)["timing"].transform("any")
    counting = scored[scored["timing"] | ~any_timed].groupby(list(by), sort=False, dropna=False)
    return counting[list(columns)].median().add_suffix("_median")


def summarise(
    rows: pd.DataFrame, by: Sequence[str], numbers: Callable[[pd.DataFrame], Mapping[str, Any]]
) -> pd.DataFrame:
    """Summarise rows, one row a group: the columns `by`, its numbers, and ``time_estimate_s_median``.

    Examples
    --------
    >>> rows = pd.DataFrame({"estimator": ["a", "a"], "status": "ok", "timing": False, TIME: [1, 3]})
    >>> summarise(rows, ["estimator"], lambda part: {"n_cells": len(part)}).to_dict("records")
    [{'estimator': 'a', 'n_cells': 2, 'time_estimate_s_median': 2.0}]
    """
    groups = rows.groupby(list(by), sort=False)
    records = [{**dict(zip(by, key, strict=True)), **numbers(part)} for key, part in groups]
    return pd.DataFrame(records).join(median_times(rows, by), on=list(by))


def trials_and_band(n: int, unit: str = "trial") -> str:
    """Say how many trials, or others, there were, and whether they have a confidence band.

    Examples
    --------
    >>> trials_and_band(12), trials_and_band(1, "scene")
    ('12 trials, 95 % confidence band', '1 scene, no confidence band below 5')
    """
    band = "95 % confidence band" if n >= MIN_TRIALS else f"no confidence band below {MIN_TRIALS}"
    return f"{plural(n, unit)}, {band}"
