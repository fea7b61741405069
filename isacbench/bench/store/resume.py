"""Going on with a run: which stored rows are those of its cells, and which have to be made again."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from isacbench.bench.cells.statuses import failed
from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.store.provenance import environment_id, environment_of
from isacbench.errors import InputError, unknown_name

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from numpy.typing import NDArray

    from isacbench.bench.plan.run_plan import Plan
    from isacbench.bench.store.rows import Rows

    Mask = NDArray[np.bool_]

Rerun = Literal["failed", "stale", "all"]

DIGITS, LONGEST = 12, 32
"""Digits that are shown of a digest, and what is longer than any version."""

RERUNS: tuple[Rerun, ...] = ("failed", "stale", "all")


def parse_reruns(names: Collection[str]) -> tuple[Rerun, ...]:
    """Check the names of what is made again.

    Raises
    ------
    InputError
        If there is no such one.
    """
    for name in names:
        if name not in RERUNS:
            raise unknown_name("cells to rerun", name, RERUNS)
    return tuple(name for name in RERUNS if name in names)


def keep(
    stored: Rows,
    plan: Plan,
    suite_name: str,
    seed: int,
    rerun: Collection[Rerun] = (),
    mix_versions: bool = False,
    part: Mask | None = None,
    timing: bool = False,
) -> Rows:
    """Choose the stored rows that a run goes on with.

    Parameters
    ----------
    stored : Rows
        What a folder holds, in any order; of rows of the same cell the last one counts.
    plan : Plan
        Of the run.
    suite_name : str
    seed : int
    rerun : collection of {"failed", "stale", "all"}
        Rows not to keep: of cells that failed, of cells whose scenario or
        versions have changed since, or all.
    mix_versions : bool
        Whether rows of other versions may stand beside new ones.
    part : ndarray of bool, optional
        Cells of the plan that this run makes, of which alone rows are made
        again; all by default.
    timing : bool
        Whether the run is timed, so that rows whose times do not count are made again.

    Returns
    -------
    Rows
        At most one row a cell, each of the same identity (content of the
        scenario, estimator, parameters, SNR, trial, seed) as the plan's cell.

    Raises
    ------
    InputError
        If there are rows of another suite, seed, or grid, which would be
        lost, or of other scenarios or versions, and nobody said what to do
        with them.
    """
    records = stored.records
    if records.empty:
        return stored
    positions = plan.positions(records)
    _refuse_others(records, positions, plan, suite_name, seed)
    stored = _with_environments(stored, plan)
    good: Mask = ~pd.Series(positions).duplicated(keep="last").to_numpy() & has_its_cloud(stored)
    ours = np.ones_like(good) if part is None else part[positions]
    other_content, other_versions = _other_content(records, plan), _other_versions(stored, plan)
    if timing:
        good &= ~(ours & ~records["timing"].to_numpy(dtype=np.bool_))
    if "all" in rerun:
        good &= ~ours
    if "failed" in rerun:
        good &= ~(ours & failed(records).to_numpy())
    if "stale" in rerun:
        good &= ~(ours & (other_content | (other_versions & (not mix_versions))))
    if part is not None and "stale" in rerun and (good & ~ours & (other_content | other_versions)).any():
        raise InputError(
            "it holds cells of other parts of the run, of other contents or versions; "
            "allowed are --rerun stale without --shard, --mix-versions, or a new folder"
        )
    _refuse_stale(stored, plan, good & other_content, good & other_versions, mix_versions)
    return stored.take(good)


def differing_versions(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Say in which versions two environments differ, such as ``numpy 2.0.0 instead of 2.1.0``."""
    before, after = _flat(old), _flat(new)
    names = dict.fromkeys([*before, *after])
    return [
        f"{name} {_short(before.get(name))} instead of {_short(after.get(name))}"
        for name in names
        if before.get(name) != after.get(name)
    ]


def _short(version: str | None) -> str:
    """Version as people read it: of a digest the first digits."""
    return "none" if version is None else version[:DIGITS] if len(version) > LONGEST else version


def _refuse_others(
    records: pd.DataFrame, positions: NDArray[np.int64], plan: Plan, suite_name: str, seed: int
) -> None:
    for column, wanted in (("suite", suite_name), ("seed", seed)):
        others = records.loc[records[column] != wanted, column]
        if len(others):
            raise InputError(
                f"it holds cells of {column} {others.iloc[0]}, not {wanted}; "
                "allowed is the same one, or a new folder"
            )
    if (positions < 0).any():
        first = records[positions < 0].iloc[0]
        variant = first["estimator"], first["params"]
        labels = estimator_labels([variant, *((one.name, one.params) for one in plan.entries)])
        raise InputError(
            f"it holds {np.sum(positions < 0)} cells that this run does not have, the first one "
            f"{labels[variant]} on {first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}; "
            "allowed is a run that has them all and perhaps more, or a new folder"
        )


def has_its_cloud(stored: Rows) -> Mask:
    """Rows whose clouds are as large as they say; rows without scores have none."""
    scored = stored.records["deviation"].notna().to_numpy()
    whole: Mask = ~scored | (stored.n_points == stored.records["n_estimated"].to_numpy())
    return whole


def _other_content(records: pd.DataFrame, plan: Plan) -> Mask:
    """Rows of scenes that have changed since."""
    contents = {scene.name: scene.content for scene in plan.scenes}
    other: Mask = (records["scenario_content"] != records["scenario"].map(contents)).to_numpy()
    return other


def _other_versions(stored: Rows, plan: Plan) -> Mask:
    """Rows that other versions have made."""
    now = versions_now(plan)
    columns = ["environment", "estimator", "params"]
    groups = stored.records.groupby(columns, sort=False)
    other = [
        stored.environments.get(name, {}).get("versions") != now[estimator, params]
        for name, estimator, params in groups.size().index
    ]
    return np.array(other, dtype=np.bool_)[groups.ngroup().to_numpy()]


def _with_environments(stored: Rows, plan: Plan) -> Rows:
    """Rows with the descriptions that this process knows itself, should the stored ones be damaged."""
    known = [environment_of(one.plugin) for one in plan.entries]
    named = {environment_id(environment): environment for environment in known}
    used = set(stored.records["environment"])
    here = {name: environment for name, environment in named.items() if name in used}
    return dataclasses.replace(stored, environments={**stored.environments, **here})


def versions_now(plan: Plan) -> dict[tuple[str, str], Any]:
    """Versions that rows made by this process have, by name and parameters of the entry."""
    return {(one.name, one.params): environment_of(one.plugin)["versions"] for one in plan.entries}


def _refuse_stale(stored: Rows, plan: Plan, content: Mask, versions: Mask, mix_versions: bool) -> None:
    if content.any():
        raise InputError(
            f"{content.sum()} of its {content.size} cells are of another content of the scenario "
            f"{stored.records[content].iloc[0]['scenario']!r}; allowed are --rerun stale, "
            "which makes them again, or a new folder"
        )
    if versions.any() and not mix_versions:
        first = stored.records[versions].iloc[0]
        old = stored.environments.get(first["environment"], {}).get("versions", {})
        new = versions_now(plan)[first["estimator"], first["params"]]
        raise InputError(
            f"{versions.sum()} of its {versions.size} cells were made by other versions, the first one by "
            f"{', '.join(differing_versions(old, new)) or 'unknown ones'}; allowed are --rerun stale, which "
            "makes them again, --mix-versions, which keeps them beside new ones, or a new folder"
        )


def _flat(versions: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Versions by dotted names."""
    flat: dict[str, Any] = {}
    for name, value in versions.items():
        flat |= _flat(value, f"{above}{name} ") if isinstance(value, dict) else {f"{above}{name}": value}
    return flat
