"""Verdicts on paired scores: changes are measured, tested, and judged at one level of all tests."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.compare import scenes, significance
from isacbench.bench.compare.pairs import CURVE
from isacbench.bench.statistics import student_band
from isacbench.errors import InputError

Floats = NDArray[np.float64]

POINT = [*CURVE, "snr_db"]

VERDICTS = ("regression", "improvement", "inconclusive", "same")
"""All verdicts, the worst first."""

FORM = re.compile(
    r"\s*(?P<metric>\w+)\s*=\s*(?P<number>([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?)\s*(?P<percent>%?)\s*",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Tolerance:
    """Limit to how much worse the mean of a score may get: a fraction of the base's mean, or in its units."""

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


def verdict_counts(table: pd.DataFrame, name: Callable[[str], str] = str) -> str:
    """Count the verdicts of curves or points by the names that `name` gives them, the worst first.

    Examples
    --------
    >>> verdict_counts(pd.DataFrame({"verdict": ["same", "regression", "same"]}))
    '1 regression, 2 same'
    """
    counts = table["verdict"].value_counts()
    return ", ".join(f"{counts[verdict]} {name(verdict)}" for verdict in VERDICTS if verdict in counts)


class PairedScores(NamedTuple):
    """Scores of both sides: a row a trial or scene, a column a point or curve; NaN in both without a pair."""

    base: pd.DataFrame
    new: pd.DataFrame


def point_scores(
    rows: pd.DataFrame, metric: str, sides: tuple[str, str], groups: Mapping[str, Sequence[str]]
) -> tuple[PairedScores, list[str]]:
    """Collect the scores of every point, sorted by curve and SNR, without points that have none.

    `rows` are those of `isacbench.bench.compare.pairs.scored_pairs`, `sides` words for both sides in notes.
    Where scenes are the units, `groups` have them by the name of their group: groups then take the place of
    scenarios and scenes that of trials. The notes say of how many cells one side alone has a score.
    """
    in_base, in_new = np.isfinite(rows["base"]), np.isfinite(rows["new"])
    rows = rows.assign(base=rows["base"].where(in_base & in_new), new=rows["new"].where(in_base & in_new))
    rows = rows[in_base | in_new]
    if groups and len(rows):
        rows = scenes.pool_scenes(rows, groups)
    order = rows.groupby(CURVE, sort=False).ngroup(), rows["snr_db"]
    rows = rows.iloc[np.lexsort(order[::-1])]
    points, trials = pd.MultiIndex.from_frame(rows[POINT].drop_duplicates()), rows["trial"].unique()
    base, new = (
        rows.pivot(index="trial", columns=POINT, values=side).reindex(index=trials, columns=points)
        for side in ("base", "new")
    )
    notes = []
    if not len(rows):
        notes.append(f"{metric}: no cell of both sides has one, nothing compared")
    elif (in_base != in_new).any():
        notes.append(
            f"{metric}: {(in_base & ~in_new).sum()} cells that have one in {sides[0]} alone, and "
            f"{(~in_base & in_new).sum()} that have one in {sides[1]} alone, are left out"
        )
    return _without_rounding(base, new), notes


def curve_scores(points: PairedScores) -> PairedScores:
    """Score whole curves: average every trial over the SNRs at which it has a pair."""
    base, change = (
        values.T.groupby(level=CURVE, sort=False).mean().T
        for values in (points.base, points.new - points.base)
    )
    return _without_rounding(base, base + change)


def _without_rounding(base: pd.DataFrame, new: pd.DataFrame) -> PairedScores:
    # Of one layout in memory: sums of equal scores are equal to the last digit.
    first, second = (np.ascontiguousarray(one) for one in (base, new))
    sides = first, significance.without_rounding(first, second)
    return PairedScores(*(pd.DataFrame(values, base.index, base.columns) for values in sides))


def measure(scores: PairedScores, tolerance: Tolerance, better: str, of_scenes: bool) -> pd.DataFrame:
    """Measure the changes of all points or curves, without correction for the number of tests.

    Returned is a row for each of them, as `add_verdicts` takes it; of scores of scenes with
    ``win_probability``, ``win_low`` and ``win_high``, the probability that the new side is better on an
    unseen one.
    """
    keys = scores.base.columns.to_frame(index=False)
    keys.insert(0, "metric", tolerance.metric)
    base, new = (one.set_axis(keys.index, axis=1) for one in scores)
    worsening = new - base if better == "lower" else base - new
    table = keys.assign(n_pairs=base.count(), n_better=(worsening < 0).sum(), n_equal=(worsening == 0).sum())
    for name, values in (("base", base), ("new", new)):
        table[f"{name}_mean"] = values.mean()
        table[f"{name}_band"] = student_band(values.std(), table["n_pairs"])
    table = table.join(significance.bootstrap_changes(base.to_numpy(), new.to_numpy()))
    tests = [significance.signed_rank_test(values.dropna()) for _, values in worsening.items()]
    table[["raw_worse", "raw_better", "attainable"]] = np.reshape(tests, (-1, 3))
    table["worsening"], table["spread"] = worsening.mean(), worsening.std()
    table["limit"] = tolerance.limit * (table["base_mean"].abs() if tolerance.is_relative else 1.0)
    low, high = ("relative_low", "relative_high") if tolerance.is_relative else ("change_low", "change_high")
    table["is_within"] = (table[low] >= -tolerance.limit) & (table[high] <= tolerance.limit)
    if of_scenes:
        wins = significance.win_shares(base.to_numpy(), new.to_numpy(), better)
        table = table.join(wins[["probability", "low", "high"]].add_prefix("win_"))
    return table


def add_verdicts(
    curves: pd.DataFrame, points: pd.DataFrame, alpha: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Correct the p-values of both families and give verdicts at a level of all together in each direction.

    The tables of `measure` get the columns ``n_snr``, ``p_worse``, ``p_better``, ``smallest_effect``,
    ``trials_needed``, ``verdict`` and ``is_better``, and lose those that only lead to them.
    """
    keys = ["metric", *CURVE]
    curves = curves.set_index(keys)
    curves.insert(0, "n_snr", points.groupby(keys)["snr_db"].count())
    curves = curves.reset_index()
    points = points.merge(curves[[*keys, "n_snr"]].assign(curve=curves.index), on=keys, how="left")
    # The point of a curve of one SNR is the same hypothesis, and tested once.
    is_curve = (points["n_snr"] == 1).to_numpy()
    families = (curves, curves["attainable"] < 1), (points, (points["attainable"] < 1) & ~is_curve)
    of_curves, of_points = (table.loc[tested, "attainable"].to_numpy() for table, tested in families)
    shares = share_level(of_curves, of_points, alpha)
    corrected_curves, corrected_points = (
        _correct(*family, share, alpha) for family, share in zip(families, shares, strict=True)
    )
    corrected_points[is_curve] = corrected_curves.loc[points.loc[is_curve, "curve"]].to_numpy()
    points = points.drop(columns="curve").join(corrected_points)
    return _with_verdicts(curves.join(corrected_curves), alpha), _with_verdicts(points, alpha)


def share_level(curves: Floats, points: Floats, alpha: float) -> tuple[float, float]:
    """Share the level between curves and points, half each unless one of them cannot use its half.

    `curves` and `points` are the smallest attainable p-values of the hypotheses of each family. Returned are
    their fractions of the level, 1 together.

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


def _correct(table: pd.DataFrame, tested: pd.Series[bool], share: float, alpha: float) -> pd.DataFrame:
    """P-values to be held against the whole level, and what the trials of a family could show."""
    found = pd.DataFrame(1.0, index=table.index, columns=["p_worse", "p_better"])
    if share:
        for side in ("worse", "better"):
            p_values = significance.holm(table.loc[tested, f"raw_{side}"]) / share
            found.loc[tested, f"p_{side}"] = np.minimum(p_values, 1.0)
    n_tests = max(int(tested.sum()), 1)
    level = (share or 0.5) * alpha / n_tests
    # More trials may let the other family have its half.
    return found.assign(
        smallest_effect=significance.smallest_effect(table["spread"], table["n_pairs"], level),
        trials_needed=significance.trials_needed(0.5 * alpha / n_tests),
    )


def _with_verdicts(table: pd.DataFrame, alpha: float) -> pd.DataFrame:
    is_unchanged = (table["n_pairs"] > 0) & (table["attainable"] == 1)
    conditions = [
        (table["p_worse"] <= alpha) & (table["worsening"] > table["limit"]),
        (table["p_better"] <= alpha) & (-table["worsening"] > table["limit"]),
        is_unchanged | table["is_within"],
    ]
    verdicts = np.select(conditions, ["regression", "improvement", "same"], "inconclusive")
    table = table.assign(verdict=verdicts, is_better=table["worsening"] < 0)
    return table.drop(columns=["raw_worse", "raw_better", "attainable", "worsening", "spread", "is_within"])
