"""Comparison of runs or estimators: curves that got worse, beyond chance and by more than is tolerated."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from isacbench.bench.compare.compared_run import RunTable, read_run
from isacbench.bench.compare.comparison import Comparison
from isacbench.bench.compare.estimator_pairs import (
    find_pairs,
    find_variant,
    pair_variants,
    restrict,
    variants_of,
    with_partners,
)
from isacbench.bench.compare.matching import (
    CURVE,
    CellChanges,
    NotComparableError,
    code_version,
    incomparable,
    pair_cells,
    version_differences,
)
from isacbench.bench.compare.score_table import PairedScores, curve_scores, point_scores, timed_alike
from isacbench.bench.compare.statistics import (
    bootstrap_changes,
    holm,
    signed_rank_test,
    smallest_effect,
    trials_needed,
)
from isacbench.bench.compare.tolerance import Tolerance, direction, is_time, merge_tolerances, parse_tolerance
from isacbench.bench.studies.intervals import CONFIDENCE
from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from isacbench.bench.plan.labels import Variant

    Floats = NDArray[np.float64]

DEFAULT_ALPHA = 0.01


def compare(
    base: str | Path,
    new: str | Path | None = None,
    *,
    map: str | Iterable[str] = (),
    match: str | Iterable[str] = (),
    between: tuple[str, str] | None = None,
    tolerances: str | Iterable[str] = (),
    alpha: float = DEFAULT_ALPHA,
) -> Comparison:
    """Compare two runs of a suite, or two estimators of one run, as ``isacbench compare`` does.

    Nothing is written. An estimator is named by a specification,
    ``name[param=value,...]``, that fits one stored variant; parameters that are
    not given may have any value, and its plugin need not be installed.

    Parameters
    ----------
    base : str or Path
        Folder of the run to compare with, or of the only run.
    new : str or Path, optional
        Folder of the run to judge. Without it, `between` is needed.
    map : str or iterable of str
        ``OLD[param=value,...]=NEW[param=value,...]``: an estimator in `base`
        and its partner in `new`; all others are paired by equal name and
        parameters.
    match : str or iterable of str
        Names of estimators whose one variant in `base` is paired with the one
        in `new`, whatever their parameters.
    between : (str, str), optional
        Two estimators of the run `base`; the second one is judged by the first.
    tolerances : str or iterable of str
        ``NAME=5%`` of the base's mean or ``NAME=0.5`` in units of the score, in
        addition to ``deviation=5%`` or instead.
    alpha : float
        Largest probability of any false regression.

    Returns
    -------
    Comparison
        Curves, points and cells as tables; `Comparison.is_regression` is the
        verdict.

    Raises
    ------
    NotComparableError
        If the runs measured different things.
    InputError
        If a folder holds no run, or an argument is not allowed.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from isacbench import run
    >>> with TemporaryDirectory() as folder:
    ...     _ = run("quick", estimators=["oracle", "fft4d"], snr_db=[10], trials=1, out=folder)
    ...     found = compare(folder, between=("oracle", "fft4d"))
    >>> found.is_regression, found.curves["verdict"].tolist()
    (False, ['inconclusive'])
    """
    asked = [parse_tolerance(text) for text in _as_list(tolerances)]
    if between is None:
        if new is None:
            raise InputError(
                "one run alone: allowed are two runs, BASE and NEW, or one and two of its estimators, "
                "between A and B"
            )
        runs = read_run(Path(base)), read_run(Path(new))
        partners = find_pairs(*runs, _as_list(map), _as_list(match))
        return compare_tables(*runs, asked, alpha, partners)
    if new is not None or map or match:
        raise InputError("between A and B: allowed with one run, and without map and match")
    run = read_run(Path(base))
    first, second = (find_variant(run, text) for text in between)
    if first == second:
        raise InputError(f"{run.label}: {between[0]!r} and {between[1]!r} are one estimator; allowed are two")
    return compare_tables(run, run, asked, alpha, {first: second}, is_between=True)


def compare_tables(
    base: RunTable,
    new: RunTable,
    tolerances: Iterable[Tolerance] = (),
    alpha: float = DEFAULT_ALPHA,
    partners: Mapping[Variant, Variant] = MappingProxyType({}),
    is_between: bool = False,
) -> Comparison:
    """Compare two runs of a suite cell by cell.

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
    partners : mapping of (str, str) to (str, str)
        Variant of the new run for variants of the base; all others are
        partners of their equals.
    is_between : bool
        Whether the one pair of partners alone is compared.

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
    variants = tuple(dict.fromkeys([*variants_of(base), *variants_of(new)]))
    between, sides = None, ("the base", "the new run")
    if is_between:
        (between,), sides = partners.items(), ("A", "B")
        base, new = restrict(base, between[0]), restrict(new, between[1])
    base, new, left_out = pair_variants(base, new, partners)
    pairs, cells = pair_cells(base, new, partners)
    notes = version_differences(base, new, partners) + left_out + _other_parameters(cells)
    points, curves, n_lost = [], [], 0
    for tolerance in asked:
        chosen = pairs
        if is_time(tolerance.metric):
            chosen, told = timed_alike(pairs, tolerance.metric, base, new)
            notes += told
        n_lost += _count_lost(chosen, tolerance.metric)
        scores, told = point_scores(chosen, tolerance.metric, sides)
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
        between=between,
        variants=variants,
        alpha=alpha,
        tolerances=asked,
        curves=with_partners(curve_table, partners),
        points=with_partners(point_table, partners),
        cells=cells,
        n_lost_scores=n_lost,
        notes=tuple(notes),
    )


def _as_list(texts: str | Iterable[str]) -> list[str]:
    """Texts, of which one alone is allowed in the place of many."""
    return [texts] if isinstance(texts, str) else list(texts)


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
    keys = ["estimator", "params", "new_estimator", "new_params"]
    gone, come = (
        set(table[keys].itertuples(index=False, name=None)) for table in (cells.missing, cells.added)
    )
    unpaired = {variant[0] for variant in gone} & {variant[2] for variant in come}
    return [
        f"{name} ran with other parameters: its cells are missing under the old ones and added under the "
        "new; --match or --map pairs them"
        for name in sorted(unpaired - {variant[0] for variant in gone & come})
    ]


def _count_lost(pairs: pd.DataFrame, metric: str) -> int:
    """Count the pairs of which the base alone has a score."""
    return int((np.isfinite(pairs[f"{metric}_base"]) & ~np.isfinite(pairs[f"{metric}_new"])).sum())


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
