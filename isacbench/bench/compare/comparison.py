"""Comparison of runs or estimators: curves that got worse, beyond chance and by more than is tolerated.

Scores are paired, their changes measured and tested, and verdicts given at one level for all tests.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.rows import REFERENCE_COLUMNS
from isacbench.bench.compare import pairs, scenes, significance
from isacbench.bench.compare.pairs import CURVE, NotComparableError
from isacbench.bench.statistics import student_band
from isacbench.bench.store.manifest import stored_columns
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Variant, variants_in
from isacbench.errors import InputError, unknown_name
from isacbench.metrics.descriptions import Direction, ScoreColumn

NEITHER = "seed", "timing", "time_spread_s", *REFERENCE_COLUMNS
"""Columns of every run for which neither direction is better."""


DEFAULT_ALPHA = 0.01

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


def direction(
    column: str, described: Mapping[str, ScoreColumn], columns: Collection[str]
) -> Literal["lower", "higher"]:
    """Better direction of a column: lower, where nothing else is known.

    `described` are the columns of the runs' metrics, as `isacbench.bench.store.manifest.stored_columns` has
    them, and `columns` the numeric columns of their rows. InputError if there is no such column, or neither
    direction is better.

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


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Changes from a base to a new run, or from one estimator of a run to another.

    `isacbench.compare` makes it. All tables name an estimator by ``estimator``
    and ``params`` (canonical JSON) of the base; ``new_estimator`` and
    ``new_params`` differ where a map paired it with another one.

    Attributes
    ----------
    base, new : str
        Folders of the runs.
    base_version, new_version : str
        Of the code that made them.
    between : tuple of (str, str), or None
        Name and params of both estimators, where two of one run are compared:
        the first one is the base.
    variants : tuple of (str, str)
        Name and params of every estimator in either run.
    alpha : float
        Largest probability that any regression is reported between runs that
        differ by chance alone; likewise any improvement.
    tolerances : tuple of Tolerance
        Scores that are compared, and by how much each may get worse.
    curves : DataFrame
        A row for each metric, scenario, estimator and params: ``n_snr``,
        ``n_pairs`` (trials), of which the new run is better in ``n_better``
        and equal in ``n_equal``; mean and half width of its 95 % confidence band
        (Student's t) of both runs, ``base_mean``, ``base_band``,
        ``new_mean``, ``new_band``; ``change`` and ``relative``, the change
        over the base's mean, each with the limits ``_low`` and ``_high`` of
        its 95 % bootstrap interval; ``p_worse`` and ``p_better``, corrected
        for all tests made; ``smallest_effect``, the change of the mean, in
        units of the score, that so many trials would have shown with 80 %
        power, and ``trials_needed`` to show any; ``limit``, the tolerance in
        units of the score; ``verdict``, one of `VERDICTS`; ``is_better``, whether the new mean is
        better, significant or not.
    points : DataFrame
        The same for each SNR ``snr_db``. A curve of a single SNR
        (``n_snr = 1``) is tested once: its point has the curve's p-values.
    n_paired : int
        Number of cells that both sides scored, with points or without.
    cells : DataFrame
        A row for each other cell, with status, reason and ``change``: ``"failed"`` in the new run alone,
        ``"repaired"``, which failed in the base alone, ``"failed_both"``; ``"missing"`` in the new run, or
        ``"added"`` by it. Status and reason of a repaired or missing cell are those of the base.
    n_lost_scores : int
        Scores that the base has and the new run has not, of cells that both
        delivered.
    notes : tuple of str
        Parts that were not compared, each with the reason.
    unit : {"trial", "scene"}
        What is paired, resampled and counted. With six scenes or more it is the
        scene: scores are averaged within it, ``scenario`` of `curves` and
        `points` is a group of scenes (all, or a family of 20 or more),
        ``n_pairs`` and ``trials_needed`` count scenes, and ``win_probability``,
        ``win_low`` and ``win_high`` are the probability that the new side is
        better on an unseen scene, ties counting half, and its 95 % interval.
    scenes : DataFrame
        Scenes that changed most, as
        `isacbench.bench.compare.scenes.most_changed` lists them; empty if
        the unit is the trial.
    """

    base: str
    new: str
    base_version: str
    new_version: str
    between: tuple[Variant, Variant] | None
    variants: tuple[Variant, ...]
    alpha: float
    tolerances: tuple[Tolerance, ...]
    curves: pd.DataFrame
    points: pd.DataFrame
    n_paired: int
    cells: pd.DataFrame
    n_lost_scores: int
    notes: tuple[str, ...]
    unit: Literal["trial", "scene"] = "trial"
    scenes: pd.DataFrame = field(default_factory=pd.DataFrame)

    @property
    def is_worse(self) -> bool:
        """Tell whether a curve or point got worse."""
        return self._has("regression")

    @property
    def is_better(self) -> bool:
        """Tell whether a curve or point got better."""
        return self._has("improvement")

    def _has(self, verdict: str) -> bool:
        return any((table["verdict"] == verdict).any() for table in (self.curves, self.points))

    @property
    def is_regression(self) -> bool:
        """Tell whether a curve or point got worse, or a cell or a score failed or went missing."""
        is_lost = self.cells["change"].isin(["failed", "missing"])
        return self.is_worse or self.n_lost_scores > 0 or bool(is_lost.any())

    def changed_cells(self, change: str) -> pd.DataFrame:
        """Select the rows of `cells` with one ``change``, and leave out that column."""
        return self.cells[self.cells["change"] == change].drop(columns="change")

    def __repr__(self) -> str:
        """Show what was compared, the verdict, and counts of curves, points and cells."""
        sides = f"{self.base!r} and {self.new!r}"
        if self.between is not None:
            sides = f"{' and '.join(pairs.spell_apart(self.between))} of {self.base!r}"
        curves, points = (verdict_counts(table) or "none" for table in (self.curves, self.points))
        return (
            f"<Comparison of {sides}: {'regression' if self.is_regression else 'no regression'}\n"
            f" curves: {curves}; points: {points}\n"
            f" cells: {self.n_paired} paired, {len(self.changed_cells('failed'))} failed anew, "
            f"{len(self.changed_cells('missing'))} missing>"
        )


def compare(
    base: str | Path | Run,
    new: str | Path | Run | None = None,
    *,
    map: str | Iterable[str] = (),
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
    base : str, Path or Run
        Run to compare with, or the only run: its folder, or as `isacbench.load_run` reads it.
    new : str, Path or Run, optional
        The run to judge. Without it, `between` is needed.
    map : str or iterable of str
        ``OLD[param=value,...]=NEW[param=value,...]``: an estimator in `base`
        and its partner in `new`, such as ``music2d=music2d`` where its defaults have changed; all others are
        paired by equal name and parameters.
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
                "only one run was given; give two runs (BASE and NEW), or one run and two of its estimators"
            )
        runs = _opened(base), _opened(new)
        partners = pairs.find_pairs(*runs, _as_list(map))
        return compare_tables(*runs, asked, alpha, partners)
    if new is not None or map:
        raise InputError("between needs exactly one run, and cannot be combined with map")
    run = _opened(base)
    first, second = (pairs.find_variant(run, text) for text in between)
    if first == second:
        raise InputError(
            f"{run.label}: {between[0]!r} and {between[1]!r} name the same estimator; give two different ones"
        )
    return compare_tables(run, run, asked, alpha, {first: second}, is_between=True)


def compare_tables(
    base: Run,
    new: Run,
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

    With six scenes or more, the scene takes the place of the trial: the scores
    of a scene are averaged over its trials, and tests and intervals are over
    scenes, all of them and each family of 20 or more.

    `tolerances` come in addition to 5 % of the deviation, or instead; `alpha` is the level of everything
    together, in each direction. With `is_between` the one pair of `partners` alone is compared.
    """
    if not 0 < alpha < 0.5:
        raise InputError(f"alpha = {alpha!r}: allowed is a number above 0 and below 0.5")
    if reasons := pairs.incomparable(base, new):
        raise NotComparableError(reasons)
    asked = merge_tolerances(tolerances)
    if any(tolerance.metric == "ratio" for tolerance in asked):
        base, new = (
            run.changed(rows=run.rows.assign(ratio=scenes.with_ratios(run)["ratio"])) for run in (base, new)
        )
    columns, others = (
        run.rows.select_dtypes(["number", "bool"]).columns.drop(["snr_db", "trial"]) for run in (base, new)
    )
    in_both = columns.intersection(others, sort=False)
    described = {**stored_columns(new.manifest), **stored_columns(base.manifest)}
    better = {one.metric: direction(one.metric, described, in_both) for one in asked}
    variants = tuple(dict.fromkeys([*variants_in(base.rows), *variants_in(new.rows)]))
    between, sides = None, ("the base", "the new run")
    if is_between:
        (between,), sides = partners.items(), ("A", "B")
        base, new = (run.take(pairs.is_of(run, [one])) for run, one in zip((base, new), between, strict=True))
    base, new, left_out = pairs.pair_variants(base, new, partners)
    paired, cells = pairs.pair_cells(base, new, partners)
    notes = pairs.version_differences(base, new, partners) + left_out + _other_parameters(cells)
    groups = scenes.compared_scenes(base.manifest, paired["scenario"])
    points: list[pd.DataFrame] = []
    curves: list[pd.DataFrame] = []
    changed: list[pd.DataFrame] = []
    n_lost = 0
    for tolerance in asked:
        metric, chosen = tolerance.metric, paired
        if metric.startswith("time_"):
            chosen, untimed = pairs.timed_alike(paired, metric, base, new)
            notes += untimed
        rows = pairs.scored_pairs(chosen, metric)
        n_lost += int((np.isfinite(rows["base"]) & ~np.isfinite(rows["new"])).sum())
        scores, unpaired = point_scores(rows, metric, sides, groups)
        notes += unpaired if len(chosen) or not len(paired) else []
        for tables, own in ((points, scores), (curves, curve_scores(scores))):
            tables.append(measure(own, tolerance, better[metric], bool(groups)))
        if groups:
            changed.append(scenes.most_changed(rows, metric, new.manifest))
    curve_table, point_table = add_verdicts(_joined(curves), _joined(points), alpha)
    return Comparison(
        base=base.label,
        new=new.label,
        base_version=pairs.code_version(base.manifest),
        new_version=pairs.code_version(new.manifest),
        between=between,
        variants=variants,
        alpha=alpha,
        tolerances=asked,
        curves=pairs.with_partners(curve_table, partners),
        points=pairs.with_partners(point_table, partners),
        n_paired=len(paired),
        cells=cells,
        n_lost_scores=n_lost,
        notes=tuple(notes),
        unit="scene" if groups else "trial",
        scenes=pairs.with_partners(_joined(changed), partners) if groups else pd.DataFrame(),
    )


def _opened(run: str | Path | Run) -> Run:
    return (run if isinstance(run, Run) else Run.open(Path(run))).require_finished()


def _as_list(texts: str | Iterable[str]) -> list[str]:
    """Texts, of which one alone is allowed in the place of many."""
    return [texts] if isinstance(texts, str) else list(texts)


def _other_parameters(cells: pd.DataFrame) -> list[str]:
    """Say which estimators are unpaired because they ran with other parameters."""
    gone, come = (set(variants_in(cells[cells["change"] == change])) for change in ("missing", "added"))
    return [
        f"{name} ran with other parameters: its cells are missing under the old ones and added under the "
        "new; --map pairs them"
        for name in sorted({name for name, _ in gone - come} & {name for name, _ in come - gone})
    ]


def _joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """All rows; of a score that no cell has there are none, and no types of columns to join."""
    return pd.concat([table for table in tables if len(table)] or [tables[0]], ignore_index=True)


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
    corrected = pd.DataFrame(1.0, index=table.index, columns=["p_worse", "p_better"])
    if share:
        for side in ("worse", "better"):
            p_values = significance.holm(table.loc[tested, f"raw_{side}"]) / share
            corrected.loc[tested, f"p_{side}"] = np.minimum(p_values, 1.0)
    n_tests = max(int(tested.sum()), 1)
    level = (share or 0.5) * alpha / n_tests
    # More trials may let the other family have its half.
    return corrected.assign(
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
