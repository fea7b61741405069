"""Comparison of two runs: which curves got worse, shown beyond chance and by more than is tolerated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from isacbench.bench.paired import (
    CONFIDENCE,
    bootstrap_changes,
    holm,
    signed_rank_test,
    smallest_effect,
    trials_needed,
)
from isacbench.bench.pairing import (
    CURVE,
    CellChanges,
    NotComparableError,
    RunTable,
    code_version,
    incomparable,
    pair_cells,
    version_differences,
)
from isacbench.bench.scoretable import PairedScores, curve_scores, point_scores, timed_alike
from isacbench.bench.tolerance import Tolerance, direction, is_time, merge_tolerances
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["DEFAULT_ALPHA", "VERDICTS", "Comparison", "compare", "share_level"]

DEFAULT_ALPHA = 0.01

VERDICTS = ("regression", "improvement", "inconclusive", "same")


@dataclass(frozen=True, eq=False)
class Comparison:
    """What became of a run's curves.

    Attributes
    ----------
    base, new : str
        Labels of the runs.
    base_version, new_version : str
        Of the code that made them.
    alpha : float
        Probability that any regression at all is reported of runs between
        which nothing changed, at most; likewise any improvement.
    tolerances : tuple of Tolerance
    curves : DataFrame
        A row for each metric, scenario, estimator and params: ``n_snr``,
        ``n_pairs`` (trials); mean and half width of its 95 % confidence band
        (Student's t) of both runs, ``base_mean``, ``base_band``,
        ``new_mean``, ``new_band``; ``change`` and ``relative``, the change
        over the base's mean, each with the limits ``_low`` and ``_high`` of
        its 95 % bootstrap interval; ``p_worse`` and ``p_better``, corrected
        for all tests made; ``smallest_effect``, the change of the mean, in
        units of the score, that so many trials would have shown with 80 %
        power, and ``trials_needed`` to show any; ``limit``, the tolerance in
        units of the score; ``verdict``, one of `VERDICTS`.
    points : DataFrame
        The same for each SNR ``snr_db``. A curve of a single SNR
        (``n_snr = 1``) is tested once: its point has the curve's p-values.
    cells : CellChanges
    n_lost_scores : int
        Scores that the base has and the new run has not, of cells that both
        delivered.
    notes : tuple of str
        What was not compared, and why.
    """

    base: str
    new: str
    base_version: str
    new_version: str
    alpha: float
    tolerances: tuple[Tolerance, ...]
    curves: pd.DataFrame
    points: pd.DataFrame
    cells: CellChanges
    n_lost_scores: int
    notes: tuple[str, ...]

    @property
    def is_regression(self) -> bool:
        """Whether a curve or point got worse, or a cell or a score failed or went missing."""
        worse = any((table["verdict"] == "regression").any() for table in (self.curves, self.points))
        return bool(worse or self.n_lost_scores or len(self.cells.new_failures) or len(self.cells.missing))


def compare(
    base: RunTable, new: RunTable, tolerances: Iterable[Tolerance] = (), alpha: float = DEFAULT_ALPHA
) -> Comparison:
    """Compare a run with another of the same suite, cell by cell.

    Two families of hypotheses are tested by one-sided signed-rank tests of
    paired trials: every point of a curve, and every curve as a whole by the
    means of its trials over all SNRs, because trials alone are independent.
    Each family has half the level and is corrected by Holm's method; a family
    that could not pass at half the level whatever the signs of its
    differences leaves it to the other. What has no difference at all is not
    tested. Both are decided by the sizes of the differences alone, on which
    the tests are conditional.

    A regression is significant *and* larger than the tolerance. What has a
    95 % bootstrap interval within the tolerance on both sides is the same.
    Everything else is inconclusive.

    Parameters
    ----------
    base, new : RunTable
    tolerances : iterable of Tolerance
        In addition to 5 % of the deviation, or instead.
    alpha : float
        Level of everything together, in each direction.

    Returns
    -------
    Comparison

    Raises
    ------
    NotComparableError
        If the runs measured different things.
    InputError
        If a tolerance or the level cannot be.
    """
    if not 0 < alpha < 0.5:
        raise InputError(f"alpha = {alpha!r}: allowed is a number above 0 and below 0.5")
    reasons = incomparable(base, new)
    if reasons:
        raise NotComparableError(reasons)
    asked = merge_tolerances(tolerances)
    better = _directions(base, new, asked)
    pairs, cells = pair_cells(base, new)
    notes = version_differences(base, new) + _other_parameters(cells)
    points, curves, n_lost = [], [], 0
    for tolerance in asked:
        chosen = pairs
        if is_time(tolerance.metric):
            chosen, told = timed_alike(pairs, tolerance.metric, base, new)
            notes += told
        has = {run: np.isfinite(chosen[f"{tolerance.metric}_{run}"]) for run in ("base", "new")}
        n_lost += int((has["base"] & ~has["new"]).sum())
        scores, told = point_scores(chosen, tolerance.metric)
        notes += told if len(chosen) or not len(pairs) else []
        sign = 1 if better[tolerance.metric] == "lower" else -1
        points.append(_measure(scores, tolerance, sign))
        curves.append(_measure(curve_scores(scores), tolerance, sign))
    curve_table, point_table = _judge(_joined(curves), _joined(points), alpha)
    return Comparison(
        base=base.label,
        new=new.label,
        base_version=code_version(base),
        new_version=code_version(new),
        alpha=alpha,
        tolerances=asked,
        curves=curve_table,
        points=point_table,
        cells=cells,
        n_lost_scores=n_lost,
        notes=tuple(notes),
    )


def _directions(base: RunTable, new: RunTable, asked: Sequence[Tolerance]) -> dict[str, str]:
    """Better direction of every score asked for, which both runs must have."""
    columns, others = (
        run.records.select_dtypes(["number", "bool"]).columns.drop(["snr_db", "trial"]) for run in (base, new)
    )
    in_both = [name for name in columns if name in others]
    metric = base.manifest["metric"]["name"]
    return {tolerance.metric: direction(tolerance.metric, metric, in_both) for tolerance in asked}


def _other_parameters(cells: CellChanges) -> list[str]:
    """Say which estimators are unpaired because they ran with other parameters."""
    gone, come = (set(table["estimator"]) for table in (cells.missing, cells.added))
    return [
        f"{name} ran with other parameters: its cells are missing under the old ones and added under the new"
        for name in sorted(gone & come)
        if not set(cells.missing.loc[cells.missing["estimator"] == name, "params"])
        & set(cells.added.loc[cells.added["estimator"] == name, "params"])
    ]


def _joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """All rows; of a score that no cell has there are none, and no types of columns to join."""
    return pd.concat([table for table in tables if len(table)] or [tables[0]], ignore_index=True)


def _measure(scores: PairedScores, tolerance: Tolerance, sign: int) -> pd.DataFrame:
    """Changes of every column, its uncorrected p-values, and what its trials could have shown."""
    table = scores.keys.copy()
    n_pairs = np.isfinite(scores.base).sum(axis=0)
    table["n_pairs"] = n_pairs
    for name, values in (("base", scores.base), ("new", scores.new)):
        mean, spread = _mean_and_spread(values, n_pairs)
        table[f"{name}_mean"], table[f"{name}_band"] = mean, _band(spread, n_pairs)
    for name, values in bootstrap_changes(scores.base, scores.new)._asdict().items():
        table[name] = values
    differences = sign * (scores.new - scores.base)
    tests = [signed_rank_test(column[np.isfinite(column)]) for column in differences.T]
    table["raw_worse"] = [test.greater for test in tests]
    table["raw_better"] = [test.less for test in tests]
    table["attainable"] = [test.attainable for test in tests]
    _, table["spread"] = _mean_and_spread(differences, n_pairs)
    table["sign"] = sign
    table["limit"] = tolerance.limit * (table["base_mean"].abs() if tolerance.is_relative else 1.0)
    low, high = ("relative_low", "relative_high") if tolerance.is_relative else ("change_low", "change_high")
    table["is_within"] = (table[low] >= -tolerance.limit) & (table[high] <= tolerance.limit)
    return table


def _mean_and_spread(values: Floats, n: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Mean and standard deviation of each column, NaN as far as there are too few."""
    kept = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(kept, values, 0.0).sum(axis=0) / n
        squares = np.square(np.where(kept, values - mean, 0.0)).sum(axis=0)
        return mean, np.sqrt(np.where(n > 1, squares / (n - 1), np.nan))


def _band(spread: Floats, n: NDArray[np.int64]) -> Floats:
    """Half width of the confidence band of a mean by Student's t."""
    freedom = np.where(n > 1, n - 1, np.nan)
    band: Floats = spread * stdtrit(freedom, (1 + CONFIDENCE) / 2) / np.sqrt(freedom + 1)
    return band


def _judge(curves: pd.DataFrame, points: pd.DataFrame, alpha: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Correct the p-values of both families and give verdicts."""
    curve_keys = ["metric", *CURVE]
    points = points.merge(curves[[*curve_keys, "n_snr"]], on=curve_keys, how="left")
    is_curve = (points["n_snr"] == 1).to_numpy()
    tested_curves = (curves["attainable"] < 1).to_numpy()
    tested_points = (points["attainable"] < 1).to_numpy() & ~is_curve
    shares = share_level(
        curves["attainable"].to_numpy()[tested_curves], points["attainable"].to_numpy()[tested_points], alpha
    )
    corrected_curves = _correct(curves, tested_curves, shares[0], alpha)
    corrected_points = _correct(points, tested_points, shares[1], alpha)
    # What is one and the same hypothesis is tested once.
    of_curve = points[curve_keys].merge(
        pd.concat([curves[curve_keys], corrected_curves], axis=1), on=curve_keys, how="left"
    )
    corrected_points.loc[is_curve] = of_curve.loc[is_curve, corrected_points.columns]
    return _conclude(curves, corrected_curves, alpha), _conclude(points, corrected_points, alpha)


def share_level(curves: Floats, points: Floats, alpha: float) -> tuple[float, float]:
    """Share the level between curves and points, half each unless one of them cannot use its half.

    Parameters
    ----------
    curves, points : ndarray of float64
        Smallest attainable p-values of the hypotheses of each family.
    alpha : float

    Returns
    -------
    of_curves, of_points : float
        Fractions of the level, 1 together.

    Examples
    --------
    Ten trials can show something of four curves, but of none of 44 points:

    >>> share_level(np.full(4, 2.0**-10), np.full(44, 2.0**-10), alpha=0.01)
    (1.0, 0.0)
    """
    can_use = [family.size > 0 and family.min() * family.size <= alpha / 2 for family in (curves, points)]
    if all(can_use):
        return 0.5, 0.5
    return (0.0, 1.0) if can_use[1] else (1.0, 0.0)


def _correct(table: pd.DataFrame, tested: NDArray[np.bool_], share: float, alpha: float) -> pd.DataFrame:
    """P-values to be held against the whole level, and what the trials of a family could show."""
    found = {}
    for side in ("worse", "better"):
        p_values = np.ones(len(table))
        if share:
            p_values[tested] = np.minimum(holm(table[f"raw_{side}"].to_numpy()[tested]) / share, 1.0)
        found[f"p_{side}"] = p_values
    n_tests = max(int(tested.sum()), 1)
    level = (share or 0.5) * alpha / n_tests
    found["smallest_effect"] = smallest_effect(table["spread"], table["n_pairs"], level)
    # More trials may let the other family have its half.
    found["trials_needed"] = np.full(len(table), trials_needed(0.5 * alpha / n_tests))
    return pd.DataFrame(found, index=table.index)


def _conclude(table: pd.DataFrame, corrected: pd.DataFrame, alpha: float) -> pd.DataFrame:
    """Table with its verdicts, without what only led to them."""
    table = pd.concat([table, corrected], axis=1)
    worsening = table["sign"] * table["change"]
    is_unchanged = (table["n_pairs"] > 0) & (table["attainable"] == 1)
    conditions = [
        (table["p_worse"] <= alpha) & (worsening > table["limit"]),
        (table["p_better"] <= alpha) & (-worsening > table["limit"]),
        is_unchanged | table["is_within"],
    ]
    table["verdict"] = np.select(conditions, ["regression", "improvement", "same"], "inconclusive")
    return table.drop(columns=["raw_worse", "raw_better", "attainable", "spread", "sign", "is_within"])
