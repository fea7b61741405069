"""Rescoring of a run from its stored clouds; it needs no new estimates and no plugins.

Rows of references are the exception: their scores are means over realisations, which are made again.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.images import Image, image_reference
from isacbench.bench.cells.rows import N_STORED, failed
from isacbench.bench.store.manifest import SCORES, describe_scores, describe_session, read_manifest
from isacbench.bench.store.run import Run
from isacbench.bench.store.run_folder import open_folder
from isacbench.bench.suites.suite_kinds import kind_of, with_metrics
from isacbench.errors import InputError
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.model.scene import Scenario
from isacbench.plugins.contracts import ReferenceEstimator, is_reference
from isacbench.plugins.registry import get_estimator
from isacbench.plugins.scoring import Metrics


class Change(NamedTuple):
    """Change of a column.

    Attributes
    ----------
    n_rows : int
        Rows whose value has changed.
    largest : float
        Largest absolute difference; infinite if a row has lost its value.
    n_filled : int
        Rows that had no value before.
    """

    column: str
    n_rows: int
    largest: float
    n_filled: int = 0

    def __str__(self) -> str:
        filled = [f"{self.n_filled} rows filled in"] if self.n_filled else []
        moved = [f"{self.n_rows} rows, by at most {self.largest:.6g}"] if self.n_rows else []
        return f"{self.column}: {'; '.join([*filled, *moved])}"


class Rescored(NamedTuple):
    """The run as it is now, how many rows were scored again and how many differ, and the columns that do."""

    run: Run
    n_scored: int
    n_changed: int
    changes: list[Change]


def rescore(folder: Path, metrics: Iterable[str] = ()) -> Rescored:
    """Score every stored cloud of a run again, and replace the old scores.

    The realisations of references are made again from the stored scenario; the stored cloud stays. New are
    the scores of all metrics of the run and of `metrics`, ``name[param=value,...]``, those that its kind of
    suite has by now included, and the columns that the studies ``efficiency`` and ``resolution`` derive from
    a cloud. What needs more than the cloud stays: times, failed rows, and cells that detectors tested.
    InputError if clouds are missing or a reference is not installed; the folder is then unchanged.
    """
    started, tick = datetime.now().astimezone(), time.perf_counter()
    read_manifest(folder)  # before the lock: a folder without a run stays as it is
    with open_folder(folder):
        run = Run.open(folder)
        suite = with_metrics(run.suite, metrics)
        used = kind_of(suite).metrics_of(suite)
        scored = _score(run, used)
        before = run.rows.assign(**{str(name): math.nan for name in scored if name not in run.rows})
        rows = before.copy()
        for name in scored:
            rows.loc[scored.index, name] = scored[name].astype(rows[name].dtype)
        session = describe_session(started, time.perf_counter() - tick, False, {"rescored": len(scored)})
        manifest = {
            **run.manifest,
            "suite": {**run.manifest["suite"], "metrics": suite.metrics},
            SCORES: describe_scores(used, run.scenarios.values()),
            "sessions": [*run.manifest.get("sessions", ()), session],
        }
        run = run.changed(rows=rows, manifest=manifest)
        run.save(folder)
    differs = (before != rows) & ~(before.isna() & rows.isna())
    names = rows.columns[differs.any().to_numpy()]
    changes = [_change(name, *(table.loc[differs[name], name] for table in (before, rows))) for name in names]
    return Rescored(run, len(scored), int(differs.any(axis=1).sum()), changes)


def _score(run: Run, metrics: Metrics) -> pd.DataFrame:
    """New scores, indexed by the position of their row."""
    rows, scored = run.rows, {}
    chosen = np.flatnonzero(~failed(rows) & rows["scenario"].isin(list(run.imaged_scenes)))
    run.require_clouds()
    observed = lru_cache(maxsize=64)(run.observed)  # rows of a trial stand close together
    for place in chosen.tolist():
        row, cloud = rows.iloc[place], PointCloud.from_array(run.points[place])
        scenario = observed(row["scenario"], row["trial"])
        if pd.isna(row.get(N_STORED, math.nan)):
            scores = metrics.score(CloudPair.of(scenario, cloud))
        else:  # means over realisations, with their spreads
            reference = _reference(run.label, row["estimator"], row["params"])
            scores = image_reference(reference, scenario, metrics).columns()
        scored[place] = {**scores, **_own_columns(run, scenario, row, cloud)}
    # What only some scenes measure, or only some kinds of objects have, stays as it is in the other rows.
    names = list(dict.fromkeys(name for found in scored.values() for name in found))
    before = rows.reindex(columns=names).iloc[list(scored)].to_dict("records")
    found = [{**old, **new} for old, new in zip(before, scored.values(), strict=True)]
    return pd.DataFrame(found, index=list(scored), columns=names)


def _reference(label: str, name: str, params: str) -> ReferenceEstimator:
    """Build the reference of a row."""
    what = f"{label}: the scores of {name!r} are means over its realisations, which have to be made again"
    try:
        plugin = get_estimator(name, **json.loads(params))
    except InputError as error:
        raise InputError(f"{what}; {error}") from error
    if not is_reference(plugin):
        raise InputError(f"{what}, but the installed estimator has no realisations")
    return plugin


def _own_columns(run: Run, scenario: Scenario, row: pd.Series[Any], cloud: PointCloud) -> dict[str, Any]:
    """Columns that a scene derives from a cloud; none if it needs more than the cloud."""
    scene = run.imaged_scenes[row["scenario"]]
    image = Image(scenario, None, None, row["snr_db"], cloud)
    if scene.measure is None or not (found := scene.measure(image)):
        return {}
    known = {*scene.labels, "snr_gain_db"}
    columns = kind_of(run.suite).columns
    return {name: found.get(name, default) for name, default in columns.items() if name not in known}


def _change(column: str, old: pd.Series[Any], new: pd.Series[Any]) -> Change:
    """Change of a column from the values that differ."""
    is_moved = old.notna()
    distances = (new[is_moved].astype(np.float64) - old[is_moved]).abs().fillna(math.inf)
    return Change(
        column, int(is_moved.sum()), float(distances.max()) if is_moved.any() else 0.0, int((~is_moved).sum())
    )
