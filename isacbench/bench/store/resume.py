"""Resuming a run: which stored rows to keep, and which cells to compute again."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.record import failed
from isacbench.bench.plan.labels import estimator_labels
from isacbench.bench.plan.run_plan import Plan
from isacbench.bench.store.provenance import environment_id, environment_of
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.errors import InputError, unknown_name

Mask = NDArray[np.bool_]

Rerun = Literal["failed", "stale", "all"]
RERUNS: tuple[Rerun, ...] = ("failed", "stale", "all")

DIGITS, LONGEST_VERSION = 12, 32
"""Digits that are shown of a digest, and the length that no version exceeds."""


def parse_reruns(names: Collection[str]) -> tuple[Rerun, ...]:
    """Check the names of the groups of cells to compute again."""
    for name in names:
        if name not in RERUNS:
            raise unknown_name("cells to rerun", name, RERUNS)
    return tuple(name for name in RERUNS if name in names)


def rows_to_keep(
    stored: Run,
    plan: Plan,
    suite: Suite,
    rerun: Collection[Rerun] = (),
    mix_versions: bool = False,
    part: Mask | None = None,
    timing: bool = False,
) -> Run:
    """Select the stored rows that a resumed run keeps, at most one a cell; refuse to lose any others.

    Not kept are rows of `rerun` (of failed cells, of cells whose scenario or versions have changed since, or
    all) within `part`, the cells that this run computes, and with `timing` those that were not timed. Rows of
    another suite, seed or grid are refused, and those of other scenarios or, unless `mix_versions`, other
    versions that are neither kept nor computed again.
    """
    rows = stored.rows
    if rows.empty:
        return stored
    positions = plan.positions(rows)
    _refuse_others(rows, positions, plan, suite)
    known = [environment_of(one.plugin) for one in plan.entries]  # the manifest may be damaged
    environments = {**stored.environments, **{environment_id(one): one for one in known}}
    now = versions_now(plan)
    contents = {scene.name: scene.content for scene in plan.scenes}
    other_content: Mask = (rows["scenario_content"] != rows["scenario"].map(contents)).to_numpy()
    other_versions = _other_versions(rows, environments, now) & (not mix_versions)
    again = np.full(len(rows), "all" in rerun)
    if timing:
        again |= ~rows["timing"].to_numpy(dtype=np.bool_)
    if "failed" in rerun:
        again |= failed(rows).to_numpy()
    if "stale" in rerun:
        again |= other_content | other_versions
    if part is not None:
        again &= part[positions]
    is_last = ~pd.Series(positions).duplicated(keep="last").to_numpy()
    has_cloud = rows["deviation"].isna().to_numpy() | stored.is_whole()
    good: Mask = is_last & has_cloud & ~again
    if (stale := good & other_content).any():
        raise InputError(
            f"{stale.sum()} of its {stale.size} cells were made with different content of scenario "
            f"{rows[stale].iloc[0]['scenario']!r}: use --rerun stale (without --shard), or a new folder"
        )
    if (stale := good & other_versions).any():
        first = rows[stale].iloc[0]
        old = environments.get(first["environment"], {}).get("versions", {})
        new = now[first["estimator"], first["params"]]
        raise InputError(
            f"{stale.sum()} of its {stale.size} cells were made by other versions, the first one by "
            f"{', '.join(differing_versions(old, new))}; use --rerun stale (without --shard) to "
            "recompute them, --mix-versions to keep them, or a new folder"
        )
    return stored.changed(manifest={**stored.manifest, "environments": environments}).take(good)


def differing_versions(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """List what differs in the ``versions`` of two environments, such as ``numpy 2.0.0 instead of 2.1.0``."""
    before, after = _flat(old), _flat(new)
    return [
        f"{name} {_short(before.get(name))} instead of {_short(after.get(name))}"
        for name in dict.fromkeys([*before, *after])
        if before.get(name) != after.get(name)
    ]


def versions_now(plan: Plan) -> dict[tuple[str, str], Any]:
    """Versions that rows made by this process would have, by name and parameters of the entry."""
    return {(one.name, one.params): environment_of(one.plugin)["versions"] for one in plan.entries}


def _refuse_others(rows: pd.DataFrame, positions: NDArray[np.int64], plan: Plan, suite: Suite) -> None:
    """Refuse rows of cells that are not in the plan."""
    for column, wanted in (("suite", suite.name), ("seed", suite.seed)):
        others = rows.loc[rows[column] != wanted, column]
        if len(others):
            raise InputError(
                f"it holds cells of {column} {others.iloc[0]}, not {wanted}; "
                f"use the same {column}, or a new folder"
            )
    unknown = rows[positions < 0]
    if len(unknown):
        first = unknown.iloc[0]
        variant = first["estimator"], first["params"]
        labels = estimator_labels([variant, *((one.name, one.params) for one in plan.entries)])
        raise InputError(
            f"it holds {len(unknown)} cells that this run does not have, the first one "
            f"{labels[variant]} on {first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}; "
            "include them in this run, or use a new folder"
        )


def _other_versions(
    rows: pd.DataFrame, environments: Mapping[str, Any], now: Mapping[tuple[str, str], Any]
) -> Mask:
    """Tell which rows were made by other versions than rows of this process would be."""
    groups = rows.groupby(["environment", "estimator", "params"], sort=False)
    other = [
        environments.get(name, {}).get("versions") != now[estimator, params]
        for name, estimator, params in groups.size().index
    ]
    return np.array(other, dtype=np.bool_)[groups.ngroup().to_numpy()]


def _flat(versions: Mapping[str, Any]) -> dict[Any, Any]:
    """Versions by flat names: nested keys joined by spaces."""
    # pandas 2 makes no row of an empty dictionary.
    return pd.json_normalize(dict(versions), sep=" ").to_dict("records")[0] if versions else {}


def _short(version: str | None) -> str:
    """Version, or the first digits of a digest."""
    text = version or "none"
    return text if len(text) <= LONGEST_VERSION else text[:DIGITS]
