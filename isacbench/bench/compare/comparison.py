"""Comparison of runs or estimators: curves that got worse, beyond chance and by more than is tolerated.

Scores are paired, their changes measured and tested, and verdicts given at one level for all tests.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
import pandas as pd

from isacbench.bench.cells.rows import REFERENCE_COLUMNS
from isacbench.bench.compare import pairs, scenes, verdicts
from isacbench.bench.compare.pairs import NotComparableError
from isacbench.bench.compare.verdicts import Tolerance, merge_tolerances, parse_tolerance, verdict_counts
from isacbench.bench.store.manifest import stored_columns
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import Variant, variants_in
from isacbench.errors import InputError, unknown_name
from isacbench.metrics.descriptions import Direction, ScoreColumn

NEITHER = "seed", "timing", "time_spread_s", *REFERENCE_COLUMNS
"""Columns of every run for which neither direction is better."""


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


DEFAULT_ALPHA = 0.01


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
        scores, unpaired = verdicts.point_scores(rows, metric, sides, groups)
        notes += unpaired if len(chosen) or not len(paired) else []
        for found, own in ((points, scores), (curves, verdicts.curve_scores(scores))):
            found.append(verdicts.measure(own, tolerance, better[metric], bool(groups)))
        if groups:
            changed.append(scenes.most_changed(rows, metric, new.manifest))
    curve_table, point_table = verdicts.add_verdicts(_joined(curves), _joined(points), alpha)
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
