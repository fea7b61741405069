"""Matching of two runs: their rows, reasons why they cannot be compared, and pairs of cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.cells.record import CLOUD_KEYS, SCORED
from isacbench.bench.store.manifest import spell_metric, stored_metrics
from isacbench.bench.store.resume import differing_versions
from isacbench.errors import InputError

if TYPE_CHECKING:
    from isacbench.bench.store.run import Run
    from isacbench.charts import Variant

CURVE = ["scenario", "estimator", "params"]
CELL = CLOUD_KEYS
MEASURED = {
    "the suite": ("suite", "name"),
    "the kind of suite": ("suite", "kind"),
    "the seed": ("seed", ""),
}
"""Parts of the manifest (section and key) that must be equal for two runs to be comparable."""


class NotComparableError(ValueError):
    """The two runs measured different things.

    Attributes
    ----------
    reasons : tuple of str
        All reasons, in words.
    """

    def __init__(self, reasons: tuple[str, ...]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = reasons


@dataclass(frozen=True, eq=False)
class CellChanges:
    """Cells of two runs, sorted by whether each run has and scored them.

    Tables have the columns of `CELL`, status and reason, and ``new_estimator``
    and ``new_params``, which differ where an estimator was paired with another.

    Attributes
    ----------
    n_paired : int
        Number of cells that both runs scored, with points or without.
    n_failed_both : int
        Number of cells that failed in both runs; they are left out.
    new_failures : DataFrame
        Scored by the base only; status and reason are those of the new run.
    missing : DataFrame
        In the base only.
    repaired : DataFrame
        Scored by the new run only; status and reason are those of the base.
    added : DataFrame
        In the new run only.
    """

    n_paired: int
    n_failed_both: int
    new_failures: pd.DataFrame
    missing: pd.DataFrame
    repaired: pd.DataFrame
    added: pd.DataFrame


def code_version(manifest: Mapping[str, Any]) -> str:
    """Version of the code that made a run, with its commit where it is known."""
    version, git = str(manifest.get("isacbench", "unknown version")), manifest.get("git")
    if not git or not git.get("commit"):
        return version
    return f"{version} ({git['commit'][:10]}{', changed' if git.get('dirty') else ''})"


def incomparable(base: Run, new: Run) -> tuple[str, ...]:
    """Find every reason why two runs cannot be compared, in words; different code is not a reason."""
    reasons = []
    for what, (section, key) in MEASURED.items():
        old, other = (run.manifest[section].get(key) if key else run.manifest[section] for run in (base, new))
        if old != other:
            reasons.append(f"{what} differs: {old} in {base.label}, {other} in {new.label}")
    before, after = stored_metrics(base.manifest), stored_metrics(new.manifest)
    reasons += [
        f"the metric {name} differs: {spell_metric(before[name])} in {base.label}, "
        f"{spell_metric(after[name])} in {new.label}"
        for name in before
        if name in after and before[name] != after[name]
    ]
    contents, others = _contents(base), _contents(new)
    changed = [name for name in contents if name in others and contents[name] != others[name]]
    reasons += [f"scenario {name} has another content" for name in changed]
    return tuple(reasons)


def pair_cells(base: Run, new: Run, partners: Mapping[Variant, Variant]) -> tuple[pd.DataFrame, CellChanges]:
    """Pair the cells of two runs by scenario, estimator, parameters, SNR and trial.

    `partners` are variants of the base, each with the variant of the new run that
    `isacbench.bench.compare.estimator_pairs.pair_variants` has renamed to it. The pairs have a row for each
    cell that both runs scored: the columns of `CELL`, and all others twice, ending in ``_base`` and ``_new``.
    """
    # Categorical columns of two runs have different categories: merge them as text.
    text = dict.fromkeys([*CURVE, "status", "reason", "environment"], object)
    before, after = (run.rows.astype(text).copy() for run in (base, new))  # each in one piece
    cells = pd.merge(
        before,
        after,
        on=CELL,
        how="outer",
        suffixes=("_base", "_new"),
        indicator=True,
        sort=False,
    )
    in_both = cells["_merge"] == "both"
    base_scored, new_scored = (cells[f"status_{end}"].isin(SCORED) for end in ("base", "new"))
    pairs = cells[in_both & base_scored & new_scored]
    changes = CellChanges(
        n_paired=len(pairs),
        n_failed_both=int((in_both & ~base_scored & ~new_scored).sum()),
        new_failures=_told(cells[in_both & base_scored & ~new_scored], "new", partners),
        missing=_told(cells[cells["_merge"] == "left_only"], "base", partners),
        repaired=_told(cells[in_both & ~base_scored & new_scored], "base", partners),
        added=_told(cells[cells["_merge"] == "right_only"], "new", partners),
    )
    return pairs.drop(columns="_merge"), changes


def with_partners(table: pd.DataFrame, partners: Mapping[Variant, Variant]) -> pd.DataFrame:
    """Append the columns ``new_estimator`` and ``new_params``, which differ where a variant has a partner."""
    variants = zip(table["estimator"], table["params"], strict=True)
    named = [partners.get(variant, variant) for variant in variants]
    return table.assign(new_estimator=[name for name, _ in named], new_params=[params for _, params in named])


def version_differences(base: Run, new: Run, partners: Mapping[Variant, Variant]) -> list[str]:
    """Say in one line, if at all, how the versions of the code differ for estimators that both runs have.

    Paired estimators with different names have different code in any case: its versions are left out.
    """
    before, after = _versions(base), _versions(new)
    told: set[str] = set()
    for variant in [variant for variant in before if variant in after]:
        old, now = before[variant], after[variant]
        if partners.get(variant, variant)[0] != variant[0]:
            old, now = (_without_own_code(versions) for versions in (old, now))
        told.update(differing_versions(now, old))
    return [f"made by other versions: {'; '.join(sorted(told))}"] if told else []


def _without_own_code(versions: Mapping[str, Any]) -> dict[str, Any]:
    """Versions without those of the plugin, and without the digest of what it imports of isacbench."""
    release = {"version": versions.get("isacbench", {}).get("version")}
    return {**versions, "plugins": {}, "isacbench": release}


def _versions(run: Run) -> dict[tuple[str, str], dict[str, Any]]:
    """Versions that made the first cell of each estimator, by name and parameters."""
    first = run.rows.drop_duplicates(["estimator", "params"])
    return {
        (estimator, params): run.manifest["environments"][name].get("versions", {})
        for estimator, params, name in zip(
            first["estimator"], first["params"], first["environment"], strict=True
        )
    }


def timed_alike(pairs: pd.DataFrame, metric: str, base: Run, new: Run) -> tuple[pd.DataFrame, list[str]]:
    """Select the pairs whose times can be compared, timed alone on equal machines; say what is left out."""
    timed = pairs["timing_base"].astype(bool) & pairs["timing_new"].astype(bool)
    before = pairs["environment_base"].map(_machines(base))
    after = pairs["environment_new"].map(_machines(new))
    other = timed & (before != after)
    reasons = []
    if not timed.all():
        reasons.append(f"{(~timed).sum()} were not timed (alone, serially, one BLAS thread) on both sides")
    if other.any():
        reasons.append(
            f"{other.sum()} ran on other machines ({before[other].iloc[0]}, and {after[other].iloc[0]})"
        )
    alike = pairs[timed & ~other]
    told = f"{metric}: {len(alike)} of {len(pairs)} paired cells compared; {', '.join(reasons)}"
    return alike, [told] if reasons else []


def _machines(run: Run) -> dict[str, str]:
    """Processor and number of cores of each environment, in words."""
    try:
        found = {name: one["machine"] for name, one in run.manifest["environments"].items()}
        return {name: f"{one['processor']}, {one['cores']} cores" for name, one in found.items()}
    except KeyError as error:
        raise InputError(
            f"{run.label}: an environment of the manifest lacks {error}; times can be compared only "
            "between runs whose manifests describe their machines"
        ) from error


def _contents(run: Run) -> dict[str, set[str]]:
    """Digests of each scenario's content, from the manifest and from the rows."""
    found = {name: {described.get("content")} for name, described in run.manifest["scenarios"].items()}
    rows = run.rows[["scenario", "scenario_content"]].drop_duplicates().dropna()
    for name, content in zip(rows["scenario"], rows["scenario_content"], strict=True):
        found.setdefault(name, set()).add(content)
    return found


def _told(cells: pd.DataFrame, end: str, partners: Mapping[Variant, Variant]) -> pd.DataFrame:
    """Cells with the status and the reason that one of the runs has."""
    told = cells[[*CELL, f"status_{end}", f"reason_{end}"]]
    told = told.set_axis([*CELL, "status", "reason"], axis=1).reset_index(drop=True)
    return with_partners(told, partners)
