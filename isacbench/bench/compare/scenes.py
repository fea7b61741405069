"""Scores of whole scenes: averages over the SNRs and trials at which all estimators have a score."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.rows import failed
from isacbench.bench.compare.pairs import CURVE, spell_apart
from isacbench.bench.compare.significance import MIN_INTERVAL_TRIALS, ROUNDING
from isacbench.bench.kinds.scores import LONE_COUNTS, POINT_FAMILIES, hausdorff_ratios
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite_kinds import KINDS
from isacbench.charts import VARIANT, Variant, rows_of, variants_in
from isacbench.files.escaping import plural

MIN_FAMILY_SCENES = 20
"""Least number of scenes for which something is said of a family alone."""

SCENE_KINDS = tuple(name for name, kind in KINDS.items() if kind.has_scenes)
"""Kinds of suites whose scenarios are scenes."""

SCENE_CELL = ["scenario", "snr_db", "trial"]

N_WORST = 3
"""Number of scenes that are listed for each estimator."""

N_CHANGED = 5
"""Number of scenes that are listed for each score of a comparison."""


class SceneScores(NamedTuple):
    """Scores of scenes by one metric.

    Attributes
    ----------
    scenes : DataFrame
        A row for each scene, in the order of the run, and a column for each variant: the mean over the
        cells of `cells`.
    cells : DataFrame
        A row for each scenario, SNR and trial at which all ranked estimators have a score.
    notes : list of str
        Cells that were left out, and failed cells that count as the worst score.
    """

    scenes: pd.DataFrame
    cells: pd.DataFrame
    notes: list[str]


def with_ratios(run: Run) -> pd.DataFrame:
    """Add the column ``ratio``, that of `isacbench.bench.kinds.scores.hausdorff_ratios`.

    Counts of lone scatterers become NaN in scenes of other families.
    """
    records, families = run.rows, scene_families(run.manifest)
    if "n_resolvable" in records:
        # Measured where scatterers are lone; elsewhere 0 stands for nothing.
        is_lone = records["scenario"].astype(object).map(families).isin(POINT_FAMILIES)
        records = records.assign(**{name: records[name].where(is_lone) for name in LONE_COUNTS})
    without = [name for name, family in families.items() if family in POINT_FAMILIES]
    return records.assign(ratio=hausdorff_ratios(records, without))


def scene_families(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Look up the family of every scenario of a run, an empty text where none made it."""
    return {name: str(one.get("family", "")) for name, one in manifest["scenarios"].items()}


def scene_groups(scenes: Iterable[str], families: Mapping[str, str]) -> dict[str, list[str]]:
    """Group scenes: all of them, and every family of 20 scenes or more that is not all.

    Examples
    --------
    >>> names = [f"town[seed={seed}]" for seed in range(20)]
    >>> {name: len(part) for name, part in scene_groups([*names, "a"], dict.fromkeys(names, "town")).items()}
    {'all scenes': 21, 'town scenes': 20}
    """
    everything = list(dict.fromkeys(scenes))
    groups = {"all scenes": everything}
    for family in dict.fromkeys(families.get(scene, "") for scene in everything):
        part = [scene for scene in everything if families.get(scene, "") == family]
        if family and MIN_FAMILY_SCENES <= len(part) < len(everything):
            groups[f"{family} scenes"] = part
    return groups


def compared_scenes(manifest: Mapping[str, Any], scenes: Iterable[str]) -> dict[str, list[str]]:
    """Group the scenes of a comparison as `scene_groups` does, where it has enough of them to be the units.

    There is no group of fewer than six scenes, and of suites whose scenarios are no population: steps of a
    parameter, maps, users.
    """
    names = list(dict.fromkeys(scenes))
    if len(names) < MIN_INTERVAL_TRIALS or manifest["suite"].get("kind", "imaging") not in SCENE_KINDS:
        return {}
    return scene_groups(names, scene_families(manifest))


def pool_scenes(rows: pd.DataFrame, groups: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """Put groups in the place of scenarios, and scenes in the place of trials.

    `rows` have ``scenario``, ``estimator``, ``params``, ``snr_db``, ``trial``, ``base`` and ``new``, scores
    that are NaN in both or in none; `groups` are scenes by the name of their group. Returned is a row for
    each group, estimator, SNR and scene: the means over the scene's trials.
    """
    means = rows.groupby([*CURVE, "snr_db"], sort=False)[["base", "new"]].mean().reset_index()
    parts = [
        means[means["scenario"].isin(scenes)].assign(trial=lambda part: part["scenario"], scenario=group)
        for group, scenes in groups.items()
    ]
    return pd.concat(parts, ignore_index=True)


def average_scenes(records: pd.DataFrame, metric: str, better: str, ranked: Sequence[Variant]) -> SceneScores:
    """Average a score within every scene, over the SNRs and trials at which all ranked estimators have one.

    A cell that failed gets the worst score that any of the estimators has in
    the run. Left out it would make its estimator look better than one that
    tried and delivered a bad image.
    """
    # Merged and stored rows may have categories, which would be grouped whether they occur or not.
    rows = records[[*SCENE_CELL, *VARIANT]].astype(dict.fromkeys(CURVE, object))
    rows = rows.assign(score=_scores(records, metric), failed=failed(records))
    columns = pd.MultiIndex.from_tuples(ranked, names=VARIANT)
    scores, is_failed = (
        rows.pivot(index=SCENE_CELL, columns=VARIANT, values=name).reindex(columns=columns)
        for name in ("score", "failed")
    )
    is_failed = is_failed.eq(True)  # a missing row has not failed
    # Where no estimator has a score, the metric is not defined or all failed.
    is_failed &= scores.notna().any(axis=1).to_numpy()[:, None]
    worst = float(scores.max().max() if better == "lower" else scores.min().min())
    scores = scores.mask(is_failed, worst)
    cells = scores.dropna()
    scenes = cells.groupby("scenario").mean()
    scenes = scenes.reindex([name for name in rows["scenario"].unique() if name in scenes.index])
    n_failed = is_failed.loc[cells.index].sum().tolist()
    notes = [
        f"failed cells of {name}: {number}, each counted as the worst {metric} of the run, {worst:.4g}"
        for name, number in zip(spell_apart(ranked), n_failed, strict=True)
        if number
    ]
    if len(cells) < len(scores):
        n_gone = scores.index.get_level_values("scenario").nunique() - len(scenes)
        notes.append(
            f"{metric}: {len(scores) - len(cells)} of {len(scores)} combinations of scene, SNR and trial are "
            f"left out, {plural(n_gone, 'scene')} altogether: not all estimators have a score there"
        )
    return SceneScores(scenes, cells, notes)


def average_alone(
    records: pd.DataFrame, metric: str, variants: Sequence[Variant], cells: pd.DataFrame
) -> pd.DataFrame:
    """Average a score of each estimator within every scene, as far as it has one at the compared cells."""
    rows = records[[*SCENE_CELL, *VARIANT]].astype(dict.fromkeys(CURVE, object))
    scores = rows.assign(score=_scores(records, metric)).pivot(
        index=SCENE_CELL, columns=VARIANT, values="score"
    )
    columns = pd.MultiIndex.from_tuples(variants, names=VARIANT)
    return scores.reindex(index=cells.index, columns=columns).groupby("scenario").mean()


def _scores(records: pd.DataFrame, metric: str) -> pd.Series[float]:
    """Scores of rows, NaN where a cell failed or its score is not finite."""
    values: pd.Series[float] = records[metric].astype(float)
    return values.where(~failed(records) & np.isfinite(values))


def worst_scenes(
    records: pd.DataFrame, manifest: Mapping[str, Any], scored: SceneScores, better: str
) -> pd.DataFrame:
    """List the three scenes in which each estimator has its worst scores.

    The columns are ``estimator``, ``params``, ``scenario``, ``family``, ``score`` of the scene; of its worst
    cell ``snr_db``, ``trial``, ``cell_score`` and ``status``.
    """
    tables = []
    for variant in variants_in(scored.scenes.columns.to_frame()):
        own = rows_of(records, variant).astype({"scenario": object}).set_index(SCENE_CELL)
        cells = own[["status"]].join(scored.cells[variant].rename("cell_score"), how="inner").reset_index()
        cells = cells.sort_values("cell_score", ascending=better == "higher", kind="stable")
        scores = scored.scenes[variant].sort_values(ascending=better == "higher", kind="stable")
        worst = scores[:N_WORST].rename("score").reset_index()
        worst = worst.merge(cells.drop_duplicates("scenario"), on="scenario", how="left")
        tables.append(worst.assign(estimator=variant[0], params=variant[1]))
    table = pd.concat(tables, ignore_index=True)
    table["family"] = table["scenario"].map(scene_families(manifest)).fillna("")
    return table[[*VARIANT, "scenario", "family", "score", "snr_db", "trial", "cell_score", "status"]]


def most_changed(rows: pd.DataFrame, metric: str, manifest: Mapping[str, Any]) -> pd.DataFrame:
    """List the scenes in which a score changed most, the largest mean change of a scene first.

    `rows` are those of `isacbench.bench.compare.pairs.scored_pairs`, the manifest is that of the new run. Of
    at most five rows the columns are ``metric``, ``scenario``, ``family``, ``estimator``, ``params``, the
    means ``base`` and ``new``, ``change``; of the cell that changed most ``snr_db`` and ``trial``.
    """
    rows = rows.assign(change=rows["new"] - rows["base"])
    rows = rows[np.isfinite(rows["change"])]
    means = rows.groupby(CURVE, sort=False)[["base", "new", "change"]].mean().reset_index()
    means = means[means["change"].abs() > ROUNDING * (means["base"].abs() + means["new"].abs())]
    most, cells = (
        one.sort_values("change", key=abs, ascending=False, kind="stable") for one in (means, rows)
    )
    cells = cells.drop_duplicates(CURVE)[[*CURVE, "snr_db", "trial"]]
    table: pd.DataFrame = most[:N_CHANGED].merge(cells, on=CURVE, how="left")
    table = table.assign(metric=metric, family=table["scenario"].map(scene_families(manifest)).fillna(""))
    first = ["metric", "scenario", "family", *VARIANT]
    return table[[*first, "base", "new", "change", "snr_db", "trial"]]
