"""Resuming a run: which stored rows to keep, and which cells to compute again."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import stored_points
from isacbench.bench.cells.statuses import failed
from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.store.provenance import environment_id, environment_of
from isacbench.errors import InputError, unknown_name

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from numpy.typing import NDArray

    from isacbench.bench.plan.run_plan import Plan
    from isacbench.bench.store.rows import Rows
    from isacbench.bench.suites.suite import Suite

    Mask = NDArray[np.bool_]

Rerun = Literal["failed", "stale", "all"]

DIGITS, LONGEST_VERSION = 12, 32
"""Digits that are shown of a digest, and the length that no version exceeds."""

RERUNS: tuple[Rerun, ...] = ("failed", "stale", "all")


def parse_reruns(names: Collection[str]) -> tuple[Rerun, ...]:
    """Check the names of the groups of cells to compute again.

    Parameters
    ----------
    names : collection of str

    Returns
    -------
    tuple of {"failed", "stale", "all"}

    Raises
    ------
    InputError
        If a name is unknown.
    """
    for name in names:
        if name not in RERUNS:
            raise unknown_name("cells to rerun", name, RERUNS)
    return tuple(name for name in RERUNS if name in names)


def keep(
    stored: Rows,
    plan: Plan,
    suite: Suite,
    rerun: Collection[Rerun] = (),
    mix_versions: bool = False,
    part: Mask | None = None,
    timing: bool = False,
) -> Rows:
    """Select the stored rows that a resumed run keeps.

    Parameters
    ----------
    stored : Rows
        Content of a folder, in any order. If a cell has several rows, the last one counts.
    plan : Plan
        Plan of the run.
    suite : Suite
    rerun : collection of {"failed", "stale", "all"}
        Rows not to keep: those of failed cells, those of cells whose scenario
        or versions have changed since, or all.
    mix_versions : bool
        True to keep rows of other versions.
    part : ndarray of bool, optional
        Cells that this run computes; rows of other cells stay. Default: all.
    timing : bool
        True to compute rows again that were not timed.

    Returns
    -------
    Rows
        At most one row for each cell, with the same identity (content of the
        scenario, estimator, parameters, SNR, trial, seed) as in the plan.

    Raises
    ------
    InputError
        If rows of another suite, seed or grid would be lost, or if rows of
        other scenarios or versions are neither kept nor computed again.
    """
    records = stored.records
    if records.empty:
        return stored
    positions = plan.positions(records)
    _refuse_others(records, positions, plan, suite)
    known = [environment_of(one.plugin) for one in plan.entries]  # the manifest may be damaged
    environments = {environment_id(environment): environment for environment in known}
    stored = dataclasses.replace(stored, environments={**stored.environments, **environments})
    other_content = _other_content(records, plan)
    other_versions = _other_versions(stored, plan) & (not mix_versions)
    again = np.full(len(records), "all" in rerun)
    if timing:
        again |= ~records["timing"].to_numpy(dtype=np.bool_)
    if "failed" in rerun:
        again |= failed(records).to_numpy()
    if "stale" in rerun:
        again |= other_content | other_versions
    if part is not None:
        again &= part[positions]
    is_last = ~pd.Series(positions).duplicated(keep="last").to_numpy()
    good: Mask = is_last & has_its_cloud(stored) & ~again
    _refuse_stale(stored, plan, good & other_content, good & other_versions)
    return stored.take(good)


def differing_versions(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """List the versions in which two environments differ.

    Parameters
    ----------
    old, new : mapping of str to Any
        ``versions`` of an environment, nested.

    Returns
    -------
    list of str
        Such as ``numpy 2.0.0 instead of 2.1.0``.
    """
    before, after = _flat(old), _flat(new)
    return [
        f"{name} {_told(before.get(name))} instead of {_told(after.get(name))}"
        for name in dict.fromkeys([*before, *after])
        if before.get(name) != after.get(name)
    ]


def has_its_cloud(stored: Rows) -> Mask:
    """Tell which rows have all points of their cloud.

    Parameters
    ----------
    stored : Rows

    Returns
    -------
    ndarray of bool, shape (n,)
        True also for rows without scores, which have no cloud.
    """
    scored = stored.records["deviation"].notna().to_numpy()
    whole: Mask = ~scored | (stored.n_points == stored_points(stored.records).to_numpy())
    return whole


def versions_now(plan: Plan) -> dict[tuple[str, str], Any]:
    """Versions that rows made by this process would have.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    dict of (str, str) to dict
        ``versions`` of the environment by name and parameters of the entry.
    """
    return {(one.name, one.params): environment_of(one.plugin)["versions"] for one in plan.entries}


def _refuse_others(records: pd.DataFrame, positions: NDArray[np.int64], plan: Plan, suite: Suite) -> None:
    """Refuse rows of cells that are not in the plan."""
    for column, wanted in (("suite", suite.name), ("seed", suite.seed)):
        others = records.loc[records[column] != wanted, column]
        if len(others):
            raise InputError(
                f"it holds cells of {column} {others.iloc[0]}, not {wanted}; "
                f"use the same {column}, or a new folder"
            )
    unknown = records[positions < 0]
    if len(unknown):
        first = unknown.iloc[0]
        variant = first["estimator"], first["params"]
        labels = estimator_labels([variant, *((one.name, one.params) for one in plan.entries)])
        raise InputError(
            f"it holds {len(unknown)} cells that this run does not have, the first one "
            f"{labels[variant]} on {first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}; "
            "include them in this run, or use a new folder"
        )


def _refuse_stale(stored: Rows, plan: Plan, content: Mask, versions: Mask) -> None:
    """Refuse rows whose scenario has changed since, or that other versions made."""
    if content.any():
        raise InputError(
            f"{content.sum()} of its {content.size} cells were made with different content of scenario "
            f"{stored.records[content].iloc[0]['scenario']!r}: use --rerun stale (without --shard), or a new "
            "folder"
        )
    if versions.any():
        first = stored.records[versions].iloc[0]
        old = stored.environments.get(first["environment"], {}).get("versions", {})
        new = versions_now(plan)[first["estimator"], first["params"]]
        raise InputError(
            f"{versions.sum()} of its {versions.size} cells were made by other versions, the first one by "
            f"{', '.join(differing_versions(old, new))}; use --rerun stale (without --shard) to "
            "recompute them, --mix-versions to keep them, or a new folder"
        )


def _other_content(records: pd.DataFrame, plan: Plan) -> Mask:
    """Tell which rows are of scenes whose content has changed since."""
    contents = {scene.name: scene.content for scene in plan.scenes}
    other: Mask = (records["scenario_content"] != records["scenario"].map(contents)).to_numpy()
    return other


def _other_versions(stored: Rows, plan: Plan) -> Mask:
    """Tell which rows were made by other versions."""
    now = versions_now(plan)
    groups = stored.records.groupby(["environment", "estimator", "params"], sort=False)
    other = [
        stored.environments.get(name, {}).get("versions") != now[estimator, params]
        for name, estimator, params in groups.size().index
    ]
    return np.array(other, dtype=np.bool_)[groups.ngroup().to_numpy()]


def _flat(versions: Mapping[str, Any]) -> dict[Any, Any]:
    """Versions by flat names: nested keys joined by spaces."""
    # pandas 2 makes no row of an empty dictionary.
    return pd.json_normalize(dict(versions), sep=" ").to_dict("records")[0] if versions else {}


def _told(version: str | None) -> str:
    """Version, or the first digits of a digest."""
    told = version or "none"
    return told if len(told) <= LONGEST_VERSION else told[:DIGITS]
