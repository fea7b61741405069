"""Scores of paired cells, laid out for statistics: trials over points, trials over whole curves."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.compare.compared_run import RunTable
from isacbench.bench.compare.matching import CURVE, machines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

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
        As `isacbench.bench.compare.matching.pair_cells` returns it.
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
        reasons.append(f"{(~timed).sum()} were not timed (alone, serially, one BLAS thread) on both sides")
    if (timed & ~alike).any():
        example = pairs.index[timed & ~alike][0]
        reasons.append(
            f"{(timed & ~alike).sum()} ran on other machines ({before[example]}, and {after[example]})"
        )
    if not reasons:
        return pairs[alike], []
    told = [f"{metric}: {alike.sum()} of {len(pairs)} paired cells compared; {', '.join(reasons)}"]
    return pairs[alike], told


def point_scores(
    pairs: pd.DataFrame, metric: str, sides: tuple[str, str] = ("the base", "the new run")
) -> tuple[PairedScores, list[str]]:
    """Scores of every point, sorted by curve and SNR; points without any score are left out.

    Parameters
    ----------
    pairs : DataFrame
        As `isacbench.bench.compare.matching.pair_cells` returns it.
    metric : str
    sides : (str, str)
        Words for both sides in notes.

    Returns
    -------
    scores : PairedScores
    notes : list of str
        What has a score in one of the runs only.
    """
    before, after = (pairs[f"{metric}_{run}"].to_numpy(dtype=np.float64) for run in ("base", "new"))
    lost, gained = np.isfinite(before) & ~np.isfinite(after), ~np.isfinite(before) & np.isfinite(after)
    scored, is_unpaired = np.isfinite(before) | np.isfinite(after), lost | gained
    rows = pairs.loc[scored, [*CURVE, "snr_db", "trial"]]
    keys, tables = _lay_out(
        rows, [np.where(is_unpaired, np.nan, values)[scored] for values in (before, after)]
    )
    keys.insert(0, "metric", metric)
    notes = []
    if not scored.any():
        notes.append(f"{metric}: no cell of both sides has one, nothing compared")
    elif lost.any() or gained.any():
        notes.append(
            f"{metric}: {lost.sum()} cells that have one in {sides[0]} alone, and {gained.sum()} that have "
            f"one in {sides[1]} alone, are left out"
        )
    return PairedScores(keys, tables[0], _without_rounding(*tables)), notes


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
    return PairedScores(keys, base, _without_rounding(base, base + change))


def _lay_out(rows: pd.DataFrame, columns: Sequence[Floats]) -> tuple[pd.DataFrame, list[Floats]]:
    """Keys of the points, curve by curve and by SNR, and each column as a table of trials over points."""
    rows = rows.reset_index(drop=True)
    curve = rows.groupby(CURVE, sort=False).ngroup()
    order = np.lexsort([rows["snr_db"], curve])
    rows = rows.iloc[order]
    keys = rows[[*CURVE, "snr_db"]].drop_duplicates().reset_index(drop=True)
    point = rows.groupby([*CURVE, "snr_db"], sort=False).ngroup().to_numpy()
    trial, trials = pd.factorize(rows["trial"])
    tables = [np.full((len(trials), len(keys)), np.nan) for _ in columns]
    for table, column in zip(tables, columns, strict=True):
        table[trial, point] = column[order]
    return keys, tables


def _without_rounding(base: Floats, new: Floats) -> Floats:
    """New scores, made equal to the base's where only rounding parts them: zeros and ties are to be exact."""
    is_rounding = np.abs(new - base) <= ROUNDING * (np.abs(base) + np.abs(new)) / 2
    return np.where(is_rounding, base, new)
