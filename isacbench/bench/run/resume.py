"""Resuming: which stored rows a run into the same folder keeps, and which belong to another run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from isacbench.bench.cells.rows import failed
from isacbench.bench.labels import estimator_labels
from isacbench.bench.run.options import RunOptions
from isacbench.bench.run.plan import Job, Plan
from isacbench.bench.store.manifest import SCORES, require_same_scores
from isacbench.bench.store.provenance import differing_versions, environment_id
from isacbench.bench.store.run import Run
from isacbench.bench.suites.suite import Suite
from isacbench.charts import Variant
from isacbench.checked_arrays import Mask
from isacbench.errors import InputError


def rows_to_keep(stored: Run, job: Job, options: RunOptions, part: Mask) -> Run:
    """Select the stored rows that a resumed run keeps, at most one a cell; refuse to lose any others.

    Not kept are rows to be made again (of failed cells, of cells whose scenario or versions have changed
    since, or all) within `part`, the cells that this run computes, and of a timed run those that were not
    timed. Rows of another suite, seed or grid are refused, those scored by other metrics, and those of other
    scenarios or, unless they may be mixed, other versions that are neither kept nor computed again.
    """
    rows, plan = stored.rows, job.plan
    if rows.empty:
        return stored
    is_all_again = "all" in options.rerun and part.all()
    if SCORES in stored.manifest or not is_all_again:  # without them it is not known what scored the rows
        require_same_scores(stored.manifest, job.suite)
    positions = plan.positions(rows)
    _refuse_others(rows, positions, plan, job.suite)
    known = plan.environments.values()  # the manifest may be damaged
    environments = {**stored.environments, **{environment_id(one): one for one in known}}
    now = plan.versions()
    contents = {task.name: task.content for task in plan.tasks}
    other_content: Mask = (rows["scenario_content"] != rows["scenario"].map(contents)).to_numpy()
    other_versions = _other_versions(rows, environments, now) & (not options.mix_versions)
    again = np.full(len(rows), "all" in options.rerun)
    if options.timing:
        again |= ~rows["timing"].to_numpy(dtype=np.bool_)
    if "failed" in options.rerun:
        again |= failed(rows).to_numpy()
    if "stale" in options.rerun:
        again |= other_content | other_versions
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
        labels = estimator_labels([variant, *(one.key for one in plan.entries)])
        raise InputError(
            f"it holds {len(unknown)} cells that this run does not have, the first one "
            f"{labels[variant]} on {first['scenario']} at {first['snr_db']:g} dB, trial {first['trial']}; "
            "include them in this run, or use a new folder"
        )


def _other_versions(rows: pd.DataFrame, environments: Mapping[str, Any], now: Mapping[Variant, Any]) -> Mask:
    """Tell which rows were made by other versions than rows of this process would be."""
    groups = rows.groupby(["environment", "estimator", "params"], sort=False)
    other = [
        environments.get(name, {}).get("versions") != now[estimator, params]
        for name, estimator, params in groups.size().index
    ]
    return np.array(other, dtype=np.bool_)[groups.ngroup().to_numpy()]
