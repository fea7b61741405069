"""Verdicts on curves and points: tolerances, paired scores, their changes, tests of both families."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.record import REFERENCE_COLUMNS
from isacbench.bench.compare import significance
from isacbench.bench.compare.pairs import CURVE
from isacbench.bench.compare.scenes import pool_scenes
from isacbench.bench.statistics import student_band
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.errors import InputError, unknown_name
from isacbench.metrics.descriptions import Direction, ScoreColumn

Floats = NDArray[np.float64]

VERDICTS = ("regression", "improvement", "inconclusive", "same")
"""All verdicts, the worst first."""

FORM = re.compile(
    r"\s*(?P<metric>\w+)\s*=\s*(?P<number>([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?)\s*(?P<percent>%?)\s*",
    re.IGNORECASE,
)

NEITHER = "seed", "timing", "time_spread_s", *REFERENCE_COLUMNS
"""Columns of every run for which neither direction is better."""


@dataclass(frozen=True)
class Tolerance:
    """Limit to how much worse the mean of a score may get.

    Attributes
    ----------
    metric : str
        Column of the records.
    limit : float
        At least 0: a fraction of the base's mean, or in units of the score.
    is_relative : bool
        Whether it is a fraction.
    """

    metric: str
    limit: float
    is_relative: bool

    def __str__(self) -> str:
        """Spell it as the command line takes it."""
        return f"{self.metric}={100 * self.limit:g}%" if self.is_relative else f"{self.metric}={self.limit:g}"


DEFAULT_TOLERANCE = Tolerance("deviation", 0.05, is_relative=True)


def parse_tolerance(text: str) -> Tolerance:
    """Parse ``NAME=5%``, relative to the base's mean, or ``NAME=0.5``, in units of the score.

    Examples
    --------
    >>> parse_tolerance("deviation=5%")
    Tolerance(metric='deviation', limit=0.05, is_relative=True)
    """
    match = FORM.fullmatch(text)
    if match is None:
        raise InputError(
            f"tolerance {text!r}: allowed is NAME=NUMBER% of the base's mean or NAME=NUMBER in units of the "
            "score, a number of at least 0, such as deviation=5% or hausdorff_xy_m=0.5"
        )
    number, is_relative = float(match["number"]), bool(match["percent"])
    return Tolerance(match["metric"], number / 100 if is_relative else number, is_relative)


def merge_tolerances(given: Iterable[Tolerance]) -> tuple[Tolerance, ...]:
    """Add tolerances to the default one; the last one for a score counts.

    Examples
    --------
    >>> [str(one) for one in merge_tolerances([parse_tolerance("recall=0.1")])]
    ['deviation=5%', 'recall=0.1']
    """
    return tuple({one.metric: one for one in (DEFAULT_TOLERANCE, *given)}.values())


def direction(
    column: str, described: Mapping[str, ScoreColumn], columns: Collection[str]
) -> Literal["lower", "higher"]:
    """Better direction of a column: lower, where nothing else is known.

    Parameters
    ----------
    described : mapping of str to ScoreColumn
        Columns of the run's metrics, as `isacbench.bench.store.manifest.stored_columns` has them.
    columns : collection of str
        Numeric columns that the runs have.

    Returns
    -------
    {"lower", "higher"}

    Raises
    ------
    InputError
        If there is no such column, or neither direction is better.

    Examples
    --------
    >>> direction("recall", {"recall": ScoreColumn("recall", "", better="higher")}, ["deviation", "recall"])
    'higher'
    """
    known: dict[str, Direction] = dict.fromkeys(NEITHER, "neither")
    known |= {name: score.better for name, score in described.items()}
    for kind in KINDS.values():
        known |= kind.better
    scores = [name for name in columns if known.get(name, "lower") != "neither"]
    if column not in columns:
        raise unknown_name("score", column, scores)
    better = known.get(column, "lower")
    if better == "neither":
        raise InputError(f"{column} has no better direction; allowed are {', '.join(scores)}")
    return better


class PairedScores(NamedTuple):
    """Paired scores of one metric.

    Attributes
    ----------
    keys : DataFrame
        For each point or curve a row: metric, scenario, estimator, params,
        and the point's ``snr_db`` or the curve's number ``n_snr`` of them.
    base, new : ndarray of float64, shape (n_trials, n_keys)
        NaN at the same places in both where a pair is missing. Of a comparison over scenes, shape
        (n_scenes, n_keys).
    """

    keys: pd.DataFrame
    base: Floats
    new: Floats


def point_scores(
    rows: pd.DataFrame, metric: str, sides: tuple[str, str], groups: Mapping[str, Sequence[str]]
) -> tuple[PairedScores, list[str]]:
    """Collect the scores of every point, sorted by curve and SNR, without points that have none.

    `rows` are those of `isacbench.bench.compare.pairs.scored_pairs`, `sides` words for both sides in notes.
    Where scenes are the units, `groups` have them by the name of their group: groups then take the place of
    scenarios and scenes that of trials. The notes say of how many cells one side alone has a score.
    """
    rows = rows.copy()
    in_base, in_new = np.isfinite(rows["base"]), np.isfinite(rows["new"])
    rows.loc[~(in_base & in_new), ["base", "new"]] = np.nan
    rows = rows[in_base | in_new]
    if groups and len(rows):
        rows = pool_scenes(rows, groups)
    rows["curve"] = rows.groupby(CURVE, sort=False).ngroup()
    rows = rows.sort_values(["curve", "snr_db"], kind="stable")
    keys = rows[[*CURVE, "snr_db"]].drop_duplicates(ignore_index=True)
    keys.insert(0, "metric", metric)
    point = rows.groupby(["curve", "snr_db"]).ngroup()
    trial, trials = pd.factorize(rows["trial"])
    base, new = np.full((2, len(trials), len(keys)), np.nan)
    base[trial, point], new[trial, point] = rows["base"], rows["new"]
    notes = []
    if not len(rows):
        notes.append(f"{metric}: no cell of both sides has one, nothing compared")
    elif (in_base != in_new).any():
        notes.append(
            f"{metric}: {(in_base & ~in_new).sum()} cells that have one in {sides[0]} alone, and "
            f"{(~in_base & in_new).sum()} that have one in {sides[1]} alone, are left out"
        )
    return PairedScores(keys, base, significance.without_rounding(base, new)), notes


def curve_scores(points: PairedScores) -> PairedScores:
    """Score whole curves: average every trial over the SNRs at which it has a pair."""
    curves = points.keys.groupby(["metric", *CURVE], sort=False)
    keys = curves.size().rename("n_snr").reset_index()
    base, change = (
        pd.DataFrame(values.T).groupby(curves.ngroup()).mean().to_numpy().T
        for values in (points.base, points.new - points.base)
    )
    return PairedScores(keys, base, significance.without_rounding(base, base + change))


def measure(scores: PairedScores, tolerance: Tolerance, better: str, of_scenes: bool) -> pd.DataFrame:
    """Measure the changes of all points or curves, without correction for the number of tests.

    Returned is a row for each key, as `judge` takes it; of scores of scenes with ``win_probability``,
    ``win_low`` and ``win_high``, the probability that the new side is better on an unseen one.
    """
    table = scores.keys.copy()
    base, new = pd.DataFrame(scores.base), pd.DataFrame(scores.new)
    worsening = new - base if better == "lower" else base - new
    table["n_pairs"] = base.count()
    table["n_better"], table["n_equal"] = (worsening < 0).sum(), (worsening == 0).sum()
    for name, values in (("base", base), ("new", new)):
        table[f"{name}_mean"] = values.mean()
        table[f"{name}_band"] = student_band(values.std(), table["n_pairs"])
    table = table.join(significance.bootstrap_changes(scores.base, scores.new))
    tests = [significance.signed_rank_test(column[np.isfinite(column)]) for column in worsening.to_numpy().T]
    table[["raw_worse", "raw_better", "attainable"]] = np.reshape(tests, (-1, 3))
    table["worsening"], table["spread"] = worsening.mean(), worsening.std()
    table["limit"] = tolerance.limit * (table["base_mean"].abs() if tolerance.is_relative else 1.0)
    low, high = ("relative_low", "relative_high") if tolerance.is_relative else ("change_low", "change_high")
    table["is_within"] = (table[low] >= -tolerance.limit) & (table[high] <= tolerance.limit)
    if of_scenes:
        wins = significance.win_shares(scores.base, scores.new, better)
        table = table.join(wins[["probability", "low", "high"]].add_prefix("win_"))
    return table


def judge(curves: pd.DataFrame, points: pd.DataFrame, alpha: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Correct the p-values of both families and give verdicts at a level of all together in each direction.

    The tables of `measure` get the columns ``p_worse``, ``p_better``, ``smallest_effect``,
    ``trials_needed`` and ``verdict``, and lose those that only lead to them.
    """
    keys = ["metric", *CURVE]
    of_curve = curves[[*keys, "n_snr"]].assign(curve=curves.index)
    points = points.merge(of_curve, on=keys, how="left")
    # The point of a curve of one SNR is the same hypothesis, and tested once.
    is_curve = (points["n_snr"] == 1).to_numpy()
    curves_tested = (curves["attainable"] < 1).to_numpy()
    points_tested = (points["attainable"] < 1).to_numpy() & ~is_curve
    shares = share_level(
        curves["attainable"].to_numpy()[curves_tested], points["attainable"].to_numpy()[points_tested], alpha
    )
    corrected_curves = _correct(curves, curves_tested, shares[0], alpha)
    corrected_points = _correct(points, points_tested, shares[1], alpha)
    corrected_points[is_curve] = corrected_curves.loc[points.loc[is_curve, "curve"]].to_numpy()
    return (
        _conclude(curves, corrected_curves, alpha),
        _conclude(points.drop(columns="curve"), corrected_points, alpha),
    )


def share_level(curves: Floats, points: Floats, alpha: float) -> tuple[float, float]:
    """Share the level between curves and points, half each unless one of them cannot use its half.

    Parameters
    ----------
    curves, points : ndarray of float64
        Smallest attainable p-values of the hypotheses of each family.

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
            p_values[tested] = np.minimum(
                significance.holm(table[f"raw_{side}"].to_numpy()[tested]) / share, 1.0
            )
        found[f"p_{side}"] = p_values
    n_tests = max(int(tested.sum()), 1)
    found["smallest_effect"] = significance.smallest_effect(
        table["spread"], table["n_pairs"], (share or 0.5) * alpha / n_tests
    )
    # More trials may let the other family have its half.
    found["trials_needed"] = np.full(len(table), significance.trials_needed(0.5 * alpha / n_tests))
    return pd.DataFrame(found, index=table.index)


def _conclude(table: pd.DataFrame, corrected: pd.DataFrame, alpha: float) -> pd.DataFrame:
    """Table with its verdicts, without what only led to them."""
    table = table.join(corrected)
    is_unchanged = (table["n_pairs"] > 0) & (table["attainable"] == 1)
    conditions = [
        (table["p_worse"] <= alpha) & (table["worsening"] > table["limit"]),
        (table["p_better"] <= alpha) & (-table["worsening"] > table["limit"]),
        is_unchanged | table["is_within"],
    ]
    table["verdict"] = np.select(conditions, ["regression", "improvement", "same"], "inconclusive")
    table["is_better"] = table["worsening"] < 0
    return table.drop(columns=["raw_worse", "raw_better", "attainable", "worsening", "spread", "is_within"])
