"""Ranking of the estimators of a run over its scenes: rank sets, win probabilities, differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from pathlib import Path
from typing import Any

import pandas as pd

from isacbench.bench.compare import scenes, significance
from isacbench.bench.compare.comparison import direction
from isacbench.bench.compare.pairs import code_version, find_variant
from isacbench.bench.labels import estimator_labels, references_in
from isacbench.bench.store.manifest import stored_columns
from isacbench.bench.store.run import Run
from isacbench.charts import VARIANT, Variant, variants_in
from isacbench.errors import InputError
from isacbench.files.escaping import plural

BESIDE = ("f_score", "velocity_error_mps", "objects_f_score")
"""Columns that stand beside every rank. Of the cheating estimators that were tried, none is better by the
ratio, and none is as good by ratio, F-score and velocity error together (the tests of games)."""

CHANGE = significance.CHANGES[:3]
"""Change of a mean in units of the score, and its interval."""


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
        Scenes in which each estimator is worst (`isacbench.bench.compare.scenes.worst_scenes`).
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
        head = f"<Ranking of {self.run!r} by {self.metric} over {plural(len(self.scores), 'scene')}"
        return "\n".join([head, *lines]) + ">"


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
    if run.kind not in scenes.SCENE_KINDS:
        raise InputError(
            f"{run.label}: the scenarios of a suite of kind {run.kind!r} are no scenes to rank over; allowed "
            f"are runs of the kinds {', '.join(scenes.SCENE_KINDS)}"
        )
    records = scenes.with_ratios(run)
    if metric is None:
        metric = default_metric(records)
    numbers = records.select_dtypes(["number", "bool"]).columns.drop(["snr_db", "trial"])
    better = direction(metric, stored_columns(run.manifest), numbers)
    variants, limits = variants_in(records), references_in(records)
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
    scored = scenes.average_scenes(records, metric, better, ranked)
    if scored.scenes.empty:
        left_out = "".join(f"; {note}" for note in scored.notes)
        raise InputError(f"{run.label}: in no scene do all estimators have a {metric}{left_out}")
    # Failed cells have none of these scores: they are means over the images that there are.
    beside = {
        name: scenes.average_alone(records, name, [*ranked, *references], scored.cells)
        for name in (metric, *BESIDE)
        if name in records
    }
    labels = estimator_labels(variants)
    is_descriptive = len(scored.scenes) < significance.MIN_INTERVAL_TRIALS
    ranks, wins, critical = [], [], []
    for group, names in scenes.scene_groups(scored.scenes.index, scenes.scene_families(run.manifest)).items():
        table = scored.scenes.loc[names]
        wins.append(_win_rows(group, table, better))
        means = pd.DataFrame({name: own.reindex(names).mean() for name, own in beside.items()})
        rows = _rank_rows(table, better, wins[-1], means.rename(columns={metric: "mean"}))
        places = pd.DataFrame(index=table.columns, columns=["rank_low", "rank_high"])
        if not is_descriptive:
            sets = _rank_sets(table, better)
            places["rank_low"], places["rank_high"] = sets.low, sets.high
            critical.append(_critical_note(group, sets, [labels[one] for one in ranked]))
        ranks.append(rows.join(places.astype("Int64")).reset_index())
        ranks[-1].insert(0, "group", group)
        ranks[-1].insert(1, "n_scenes", len(names))
    return Ranking(
        run=run.label,
        version=code_version(run.manifest),
        metric=metric,
        better=better,
        labels=labels,
        scores=scored.scenes,
        ranks=pd.concat(ranks, ignore_index=True),
        wins=pd.concat(wins, ignore_index=True),
        worst=scenes.worst_scenes(records, run.manifest, scored, better),
        notes=(*scored.notes, *critical),
        is_descriptive=is_descriptive,
    )


def _win_rows(group: str, table: pd.DataFrame, better: str) -> pd.DataFrame:
    """Win probability and mean difference of every ordered pair of columns."""
    pairs = list(permutations(range(table.shape[1]), 2))
    first, second = (table.to_numpy()[:, list(side)] for side in zip(*pairs, strict=True))
    first = significance.without_rounding(second, first)
    names: list[Any] = list(table.columns)
    rows = pd.DataFrame(
        [(group, len(table), *names[one], *names[other]) for one, other in pairs],
        columns=["group", "n_scenes", *VARIANT, "other", "other_params"],
    )
    changes = significance.bootstrap_changes(second, first)[CHANGE]
    return rows.join(significance.win_shares(second, first, better)).join(changes)


def _rank_rows(table: pd.DataFrame, better: str, wins: pd.DataFrame, means: pd.DataFrame) -> pd.DataFrame:
    """Means and difference from the best of every estimator, the best first, references last."""
    own = table.mean().sort_values(ascending=better == "lower", kind="stable")
    best: Any = own.index[0]
    from_best = wins[(wins["other"] == best[0]) & (wins["other_params"] == best[1])]
    rows = means.loc[[*own.index, *means.index.difference(own.index, sort=False)]]
    rows.insert(0, "is_reference", ~rows.index.isin(own.index))
    rows["mean"] = own.reindex(rows.index).fillna(rows["mean"])
    rows = rows.join(from_best.set_index(VARIANT)[CHANGE])
    rows.loc[[best], CHANGE] = 0.0
    return rows


def _rank_sets(table: pd.DataFrame, better: str) -> significance.RankSets:
    """Find the rank set of every column."""
    # Differences by rounding alone are made exact zeros: those of all columns from the first of equal ones.
    columns = table.to_numpy(copy=True).T
    for earlier, later in combinations(columns, 2):
        later[:] = significance.without_rounding(earlier, later)
    return significance.rank_sets(columns.T if better == "lower" else -columns.T)


def _critical_note(group: str, sets: significance.RankSets, labels: Sequence[str]) -> str:
    """Say which pair decides how wide the sets are."""
    worse, other = (labels[place] for place in sets.critical)
    return (
        f"{group}: the width of the rank sets is set by {worse} against {other}, in "
        f"{100 * sets.critical_share:.0f} % of the resamples beyond the critical value; sets depend on "
        "who competes, -e ranks a subset that was chosen before looking"
    )
