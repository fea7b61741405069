"""Ranking of the estimators of a run over its scenes: rank sets, win probabilities, differences."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.compare.estimator_pairs import find_variant
from isacbench.bench.compare.matching import code_version
from isacbench.bench.compare.ranks import RankSets, rank_sets
from isacbench.bench.compare.scene_scores import (
    SCENE_KINDS,
    VARIANT,
    average_alone,
    average_scenes,
    scene_families,
    scene_groups,
    with_ratios,
)
from isacbench.bench.compare.statistics import (
    CHANGES,
    MIN_INTERVAL_TRIALS,
    bootstrap_changes,
    win_shares,
)
from isacbench.bench.compare.tolerance import direction
from isacbench.bench.compare.verdicts import without_rounding
from isacbench.bench.compare.worst_scenes import worst_scenes
from isacbench.bench.plan.labels import estimator_labels, find_limits
from isacbench.bench.store.manifest import stored_columns
from isacbench.bench.store.run import Run
from isacbench.charts import variants_in
from isacbench.errors import InputError
from isacbench.files.escaping import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from isacbench.bench.compare.scene_scores import SceneScores
    from isacbench.charts import Variant

    Floats = NDArray[np.float64]

BESIDE = ("f_score", "velocity_error_mps", "objects_f_score")
"""Columns that stand beside every rank. Of the cheating estimators that were tried, none is better by the
ratio, and none is as good by ratio, F-score and velocity error together (the tests of games)."""


@dataclass(frozen=True, eq=False, repr=False)
class Ranking:
    """Ranks of the estimators of a run, the scene being the unit.

    `isacbench.rank` makes it. Groups are ``all scenes``, and each family of 20
    scenes or more, ``town scenes``. Tables name an estimator by ``estimator``
    and ``params`` (canonical JSON); `labels` has readable names.

    Attributes
    ----------
    run : str
        Folder of the run.
    version : str
        Of the code that made it.
    better : {"lower", "higher"}
        Better direction of the metric.
    labels : mapping of (str, str) to str
        Readable names by name and params.
    scores : DataFrame
        A row for each scene and a column for each ranked estimator: its score,
        averaged over the SNRs and trials at which all of them have one.
    ranks : DataFrame
        A row for each group and estimator, the best mean first, references
        last: ``group``, ``n_scenes``, ``estimator``, ``params``,
        ``is_reference``; ``mean`` of the metric, ``precision`` and ``recall``
        over the scenes; ``rank_low`` and ``rank_high``, the set of ranks,
        simultaneous over the estimators of a group with 95 % confidence;
        ``change`` of the mean from the best one's, with ``change_low`` and
        ``change_high``. References have no ranks.
    wins : DataFrame
        A row for each group and ordered pair of ranked estimators:
        ``probability`` that the first one, ``estimator`` and ``params``, is
        better than ``other`` and ``other_params`` on an unseen scene of this
        kind, ties counting half, with the limits ``low`` and ``high`` of its
        95 % interval; ``n_scenes``, ``n_ties``; ``change``, the first one's
        mean less the other's, with ``change_low`` and ``change_high``.
    worst : DataFrame
        Scenes in which each estimator is worst (`isacbench.bench.compare.worst_scenes.worst_scenes`).
    notes : tuple of str
        Cells that were left out, failures that were counted as worst scores, and the pair that decides how
        wide the sets are.
    is_descriptive : bool
        True of fewer than six scenes, of which nothing is said but the means and their differences.
    """

    run: str
    version: str
    metric: str
    better: str
    labels: Mapping[Variant, str]
    scores: pd.DataFrame
    ranks: pd.DataFrame
    wins: pd.DataFrame
    worst: pd.DataFrame
    notes: tuple[str, ...]
    is_descriptive: bool = False

    def __repr__(self) -> str:
        """Show the metric, the number of scenes, and the rank set of every estimator over all scenes."""
        first = self.ranks[(self.ranks["group"] == self.ranks["group"].iloc[0]) & ~self.ranks["is_reference"]]
        lines = [
            f" {self.labels[row['estimator'], row['params']]}: "
            + (f"{row['mean']:.4g}" if self.is_descriptive else rank_text(row["rank_low"], row["rank_high"]))
            for row in first.to_dict("records")
        ]
        return (
            "\n".join(
                [
                    f"<Ranking of {self.run!r} by {self.metric} over {counted(len(self.scores), 'scene')}",
                    *lines,
                ]
            )
            + ">"
        )


def rank_text(low: float, high: float) -> str:
    """Write a set of consecutive ranks.

    Examples
    --------
    >>> rank_text(1, 3), rank_text(2, 2)
    ('1 to 3', '2')
    """
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def rank(
    run: str | Path | Run, metric: str | None = None, estimators: str | Sequence[str] | None = None
) -> Ranking:
    """Rank the estimators of a run over its scenes, as ``isacbench rank`` does. Nothing is written.

    Estimators that see the truth are references: they are shown, not ranked.

    Parameters
    ----------
    run : str, Path or Run
        Folder of a run, merged ones included, or a run as `isacbench.load_run` reads it.
    metric : str, optional
        Column of the rows with a better direction, or
        ``ratio``, the Hausdorff sum over that of the oracle. By default the ratio; of a run without
        the oracle, or without any ratio, ``hausdorff_sum_m``.
    estimators : str or sequence of str, optional
        Those to rank, as ``name[param=value,...]``, chosen before looking: a set of ranks depends on who
        competes. By default all but references.

    Returns
    -------
    Ranking
        Descriptive of fewer than six scenes: without ranks and intervals.

    Raises
    ------
    InputError
        If the folder holds no run, its scenarios are no scenes, or it has
        not the metric, two estimators, or a scene in which all of them have a score.

    Examples
    --------
    One scene with one estimator cannot be ranked:

    >>> from tempfile import TemporaryDirectory
    >>> from isacbench import run
    >>> with TemporaryDirectory() as folder:  # doctest: +ELLIPSIS
    ...     _ = run("quick", estimators=["fft4d", "oracle"], snr_db=[10], trials=1, out=folder)
    ...     rank(folder)
    Traceback (most recent call last):
    isacbench.errors.InputError: ...: a ranking needs two estimators or more that are no references; ...
    """
    opened = run if isinstance(run, Run) else Run.open(Path(run))
    chosen = [estimators] if isinstance(estimators, str) else estimators
    return rank_table(opened.require_finished(), metric, chosen)


def default_metric(records: pd.DataFrame) -> str:
    """Score that a run is ranked by: the ratio, or ``hausdorff_sum_m`` without an oracle to form it with."""
    return "ratio" if records["ratio"].notna().any() else "hausdorff_sum_m"


def rank_table(run: Run, metric: str | None = None, estimators: Sequence[str] | None = None) -> Ranking:
    """Rank the estimators of a run that was read, as `rank` does."""
    if run.kind not in SCENE_KINDS:
        raise InputError(
            f"{run.label}: the scenarios of a suite of kind {run.kind!r} are no scenes to rank over; allowed "
            f"are runs of the kinds {', '.join(SCENE_KINDS)}"
        )
    records = with_ratios(run)
    if metric is None:
        metric = default_metric(records)
    numbers = records.select_dtypes(["number", "bool"]).columns.drop(["snr_db", "trial"])
    better = direction(metric, stored_columns(run.manifest), numbers)
    variants, limits = variants_in(records), find_limits(records)
    ranked = [variant for variant in variants if variant[0] not in limits]
    if estimators is not None:
        chosen = {find_variant(run, text) for text in estimators}
        if seeing := sorted({name for name, _ in chosen} & limits):
            raise InputError(f"{run.label}: {seeing[0]} is a reference and is not ranked; give others")
        ranked = [variant for variant in ranked if variant in chosen]
    references = [variant for variant in variants if variant[0] in limits]
    if len(ranked) < 2:
        raise InputError(
            f"{run.label}: a ranking needs two estimators or more that are no references; "
            f"{'the run has' if estimators is None else 'chosen:'} "
            f"{', '.join(name for name, _ in ranked) or 'none'}"
        )
    scored = average_scenes(records, metric, better, ranked)
    _require_scenes(run, scored, metric)
    groups = scene_groups(scored.scenes.index, scene_families(run.manifest))
    # Failed cells have none of these scores: they are means over the images that there are.
    shares = {
        name: pd.DataFrame(
            {variant: average_alone(records, name, variant, scored.cells) for variant in ranked}
        ).rename_axis(columns=VARIANT)
        for name in BESIDE
        if name in records and name != metric
    }
    beside = {
        variant: {name: average_alone(records, name, variant, scored.cells) for name in (metric, *shares)}
        for variant in references
    }
    labels = estimator_labels(variants)
    is_descriptive = len(scored.scenes) < MIN_INTERVAL_TRIALS
    ranks, wins, critical = [], [], []
    for group, scenes in groups.items():
        table = scored.scenes.loc[scenes]
        found = _win_rows(table, better).assign(group=group)
        means = {name: share.reindex(scenes).mean() for name, share in shares.items()}
        rows = _rank_rows(table, better, found, means)
        if not is_descriptive:
            sets = _rank_sets(table, better)
            rows = rows.merge(sets.ranks, on=VARIANT)
            critical.append(_told_critical(group, table, sets, labels))
        ranks += [rows, _reference_rows(beside, metric, scenes)]
        ranks[-2:] = [part.assign(group=group, n_scenes=len(scenes)) for part in ranks[-2:]]
        wins.append(found)
    first = ["group", "n_scenes"]
    rank_rows = pd.concat([part for part in ranks if len(part)], ignore_index=True)
    rank_rows = rank_rows.reindex(columns=[*rank_rows, *({"rank_low", "rank_high"} - {*rank_rows})])
    rank_rows = rank_rows.astype({"rank_low": "Int64", "rank_high": "Int64"})
    return Ranking(
        run=run.label,
        version=code_version(run.manifest),
        metric=metric,
        better=better,
        labels=labels,
        scores=scored.scenes,
        ranks=_in_front(rank_rows, first),
        wins=_in_front(pd.concat(wins, ignore_index=True), first),
        worst=worst_scenes(records, run.manifest, scored, better),
        notes=(*scored.notes, *critical),
        is_descriptive=is_descriptive,
    )


def _require_scenes(run: Run, scored: SceneScores, metric: str) -> None:
    n_scenes = len(scored.scenes)
    if not n_scenes:
        left_out = "".join(f"; {note}" for note in scored.notes)
        raise InputError(f"{run.label}: in no scene do all estimators have a {metric}{left_out}")


def _in_front(table: pd.DataFrame, columns: Sequence[str]) -> pd.DataFrame:
    return table[[*columns, *(name for name in table if name not in columns)]]


def _win_rows(table: pd.DataFrame, better: str) -> pd.DataFrame:
    """Win probability and mean difference of every ordered pair of columns."""
    pairs = list(permutations(range(table.shape[1]), 2))
    first, second = (table.to_numpy()[:, [pair[side] for pair in pairs]] for side in (0, 1))
    first = without_rounding(second, first)
    variants = list(table.columns)
    rows = pd.DataFrame(
        {
            "n_scenes": len(table),
            "estimator": [variants[pair[0]][0] for pair in pairs],
            "params": [variants[pair[0]][1] for pair in pairs],
            "other": [variants[pair[1]][0] for pair in pairs],
            "other_params": [variants[pair[1]][1] for pair in pairs],
        }
    )
    return rows.join(win_shares(second, first, better)).join(bootstrap_changes(second, first)[CHANGES[:3]])


def _rank_rows(
    table: pd.DataFrame, better: str, wins: pd.DataFrame, shares: Mapping[str, pd.Series[float]]
) -> pd.DataFrame:
    """Mean, further scores and difference from the best of every column, the best first."""
    sign = 1.0 if better == "lower" else -1.0
    means = table.mean()
    best = means.index[int(np.argmin(sign * means.to_numpy()))]
    from_best = wins[(wins["other"] == best[0]) & (wins["other_params"] == best[1])]
    changes = from_best.set_index(VARIANT)[CHANGES[:3]].reindex(means.index)
    changes.loc[best] = 0.0
    rows = pd.DataFrame({"is_reference": False, "mean": means})
    rows = rows.assign(**shares).join(changes)
    return rows.sort_values("mean", ascending=better == "lower", kind="stable").reset_index()


class _Sets(NamedTuple):
    """Ranks of the estimators, and the sets that they were taken from."""

    ranks: pd.DataFrame
    sets: RankSets


def _rank_sets(table: pd.DataFrame, better: str) -> _Sets:
    """Find the rank set of every column."""
    # Differences by rounding alone are made exact zeros: those of all columns from the first of equal ones.
    values = table.to_numpy(copy=True)
    for column in range(1, values.shape[1]):
        values[:, column] = _rounded_to(values[:, :column], values[:, column])
    sets = rank_sets(values if better == "lower" else -values)
    ranks = pd.DataFrame([*table.columns], columns=VARIANT).assign(rank_low=sets.low, rank_high=sets.high)
    return _Sets(ranks, sets)


def _told_critical(group: str, table: pd.DataFrame, found: _Sets, labels: Mapping[Variant, str]) -> str:
    """Say which pair decides how wide the sets are."""
    variants: list[Any] = table.columns.to_list()
    worse, other = (labels[variants[place]] for place in found.sets.critical)
    return (
        f"{group}: the width of the rank sets is set by {worse} against {other}, in "
        f"{100 * found.sets.critical_share:.0f} % of the resamples beyond the critical value; sets depend on "
        "who competes, -e ranks a subset that was chosen before looking"
    )


def _rounded_to(others: Floats, values: Floats) -> Floats:
    """Make values equal to those of another column where only rounding parts them."""
    for other in others.T:
        values = without_rounding(other, values)
    return values


def _reference_rows(
    beside: Mapping[Variant, Mapping[str, pd.Series[float]]], metric: str, scenes: list[str]
) -> pd.DataFrame:
    """Mean and shares of every reference."""
    return pd.DataFrame(
        [
            {
                "estimator": name,
                "params": params,
                "is_reference": True,
                **{
                    "mean" if column == metric else column: values.reindex(scenes).mean()
                    for column, values in averages.items()
                },
            }
            for (name, params), averages in beside.items()
        ]
    )
