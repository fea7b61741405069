"""Scores of paired cells, laid out for statistics: trials over points, trials over whole curves."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.pairing import CURVE, RunTable, machines

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["PairedScores", "curve_scores", "point_scores", "timed_alike"]

ROUNDING = 1e-9
"""Differences of this fraction of the scores or less are rounding, of another processor or library: they
count as none."""


class PairedScores(NamedTuple):
    """Paired scores of one metric.

    Attributes
    ----------
    keys : DataFrame
        For each point or curve a row: metric, scenario, estimator, params,
        and the point's ``snr_db`` or the curve's number ``n_snr`` of them.
    base, new : ndarray of float64, shape (n_trials, n_keys)
        NaN at the same places in both where a pair is missing.
    """

    keys: pd.DataFrame
    base: Floats
    new: Floats


def timed_alike(
    pairs: pd.DataFrame, metric: str, base: RunTable, new: RunTable
) -> tuple[pd.DataFrame, list[str]]:
    """Pairs whose run times can be compared: both measured alone, on equal machines.

    Parameters
    ----------
    pairs : DataFrame
        As `isacbench.bench.pairing.pair_cells` returns it.
    metric : str
        Column of the run times.
    base, new : RunTable

    Returns
    -------
    alike : DataFrame
        Those rows.
    notes : list of str
        Why the others are not, nothing where there are none.
    """
    timed = pairs["timing_base"].astype(bool) & pairs["timing_new"].astype(bool)
    before, after = pairs["environment_base"].map(machines(base)), pairs["environment_new"].map(machines(new))
    alike = timed & (before == after)
    reasons = []
    if not timed.all():
        reasons.append(f"{(~timed).sum()} were not timed (alone, serially, one BLAS thread) in both runs")
    if (timed & ~alike).any():
        example = pairs.index[timed & ~alike][0]
        reasons.append(
            f"{(timed & ~alike).sum()} ran on other machines ({before[example]}; now {after[example]})"
        )
    if not reasons:
        return pairs[alike], []
    told = [f"{metric}: {alike.sum()} of {len(pairs)} paired cells compared; {', '.join(reasons)}"]
    return pairs[alike], told


def point_scores(pairs: pd.DataFrame, metric: str) -> tuple[PairedScores, list[str]]:
    """Scores of every point, sorted by curve and SNR; points without any score are left out.

    Parameters
    ----------
    pairs : DataFrame
        As `isacbench.bench.pairing.pair_cells` returns it.
    metric : str

    Returns
    -------
    scores : PairedScores
    notes : list of str
        What has a score in one of the runs only.
    """
    before = pairs[f"{metric}_base"].to_numpy(dtype=np.float64)
    after = pairs[f"{metric}_new"].to_numpy(dtype=np.float64)
    scored = np.isfinite(before) | np.isfinite(after)
    is_pair = np.isfinite(before) & np.isfinite(after)
    told = []
    if not scored.any():
        told.append(f"{metric}: no cell of both runs has one, nothing compared")
    elif (scored & ~is_pair).any():
        lost, gained = (scored & ~np.isfinite(after)).sum(), (scored & ~np.isfinite(before)).sum()
        told.append(
            f"{metric}: {lost} cells that have one in the base alone, and {gained} that have one in the new "
            "run alone, are left out"
        )
    rows = pairs.loc[scored, [*CURVE, "snr_db", "trial"]].reset_index(drop=True)
    number = rows.groupby(CURVE, sort=False).ngroup()
    order = np.lexsort([rows["snr_db"], number])
    keys = rows[[*CURVE, "snr_db"]].iloc[order].drop_duplicates().reset_index(drop=True)
    keys.insert(0, "metric", metric)
    column = rows.iloc[order].groupby([*CURVE, "snr_db"], sort=False).ngroup().to_numpy()
    trial, _ = pd.factorize(rows["trial"].iloc[order], sort=True)
    shape = (int(trial.max(initial=-1)) + 1, len(keys))
    found = []
    for values in (before, after):
        table = np.full(shape, np.nan)
        table[trial, column] = np.where(is_pair, values, np.nan)[scored][order]
        found.append(table)
    # Ties and zeros are exact below: rounding must not pass for a difference.
    negligible = np.abs(found[1] - found[0]) <= ROUNDING * (np.abs(found[0]) + np.abs(found[1])) / 2
    return PairedScores(keys, found[0], np.where(negligible, found[0], found[1])), told


def curve_scores(points: PairedScores) -> PairedScores:
    """Mean of every trial over the SNRs at which it has a pair."""
    keys = points.keys.groupby(["metric", *CURVE], sort=False).size().rename("n_snr").reset_index()
    paired = np.isfinite(points.base)
    if not paired.size:
        return PairedScores(keys, points.base, points.new)
    starts = np.concatenate([[0], np.cumsum(keys["n_snr"].to_numpy())[:-1]])
    n_pairs, base, change = (
        np.add.reduceat(np.where(paired, values, 0.0), starts, axis=1)
        for values in (1.0, points.base, points.new - points.base)
    )
    with np.errstate(invalid="ignore"):
        base, change = base / n_pairs, change / n_pairs
    return PairedScores(keys, base, base + change)
