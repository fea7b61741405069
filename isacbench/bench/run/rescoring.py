"""Rescoring of a run from its stored clouds; it needs no new estimates and no plugins.

Rows of references are the exception: their scores are means over realisations, which are made again.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.cell import MeasuredImage
from isacbench.bench.cells.record import N_STORED, stored_points
from isacbench.bench.cells.scored_images import image_reference
from isacbench.bench.cells.statuses import failed
from isacbench.bench.kinds.scenes import ImagedScene
from isacbench.bench.store import run_store
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import open_folder
from isacbench.bench.store.score_columns import SCORES, describe_scores, metrics_of
from isacbench.bench.store.stored_run import ObservedScenes, rows_by_trial
from isacbench.bench.suites.suite_kinds import kind_of, with_metrics
from isacbench.errors import InputError
from isacbench.metrics.geometry import CloudPair
from isacbench.model.cloud import PointCloud
from isacbench.plugins.contracts import is_reference
from isacbench.plugins.registry import get_estimator

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from isacbench.bench.cells.record import Results
    from isacbench.model.scene import Scenario
    from isacbench.plugins.contracts import ReferenceEstimator
    from isacbench.plugins.scoring import Metrics


class Change(NamedTuple):
    """Change of a column.

    Attributes
    ----------
    column : str
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


@dataclass(frozen=True, eq=False)
class Rescored:
    """Result of rescoring.

    Attributes
    ----------
    kind : str
        Kind of the suite.
    records : DataFrame
        All rows, as they are now.
    n_scored, n_changed : int
        Rows that were scored again, and rows whose values have changed.
    changes : list of Change
        Columns that have changed.
    """

    kind: str
    records: pd.DataFrame
    n_scored: int
    n_changed: int
    changes: list[Change]


def rescore(folder: Path, metrics: Iterable[str] = ()) -> Rescored:
    """Score every stored cloud of a run again, and replace the old scores.

    The realisations of references are made again from the stored scenario; the
    stored cloud stays. It computes anew the scores of all metrics of the run, those that its kind of suite
    has by now included, and the columns that the studies ``efficiency`` and ``resolution`` derive from a
    cloud. What needs more than the cloud stays as it is: times, and cells that detectors tested.
    Failed rows stay, too.

    Parameters
    ----------
    folder : Path
        Folder of a run that is not being written to.
    metrics : iterable of str
        Further metrics, as ``name[param=value,...]``; one that the run has already takes its place.

    Returns
    -------
    Rescored

    Raises
    ------
    InputError
        If the folder holds no run, a damaged one, or not all of its clouds, or
        if a reference is not installed. The folder is then unchanged.
    """
    started, tick = datetime.now().astimezone(), time.perf_counter()
    run_store.read_manifest(folder)  # before the lock: a folder without a run stays as it is
    with open_folder(folder):
        manifest, results = run_store.read_manifest(folder), run_store.read_results(folder)
        suite = with_metrics(results.suite, metrics)
        used = metrics_of(suite)
        scored = _scored_again(folder, results, used)
        scores = describe_scores(used, results.scenarios.values())
        before = results.records.assign(
            **{str(name): math.nan for name in scored if name not in results.records}
        )
        records = before.copy()
        for name in scored:
            records.loc[scored.index, name] = scored[name].astype(records[name].dtype)
        found = _compared(results.suite.kind, before, records, len(scored))
        run_store.write_results(dataclasses.replace(results, suite=suite, records=records), folder)
        entry = run_store.describe_session(
            started, time.perf_counter() - tick, False, {"rescored": len(scored)}
        )
        sessions = [*manifest.get("sessions", ()), entry]
        run_store.save_manifest(
            folder,
            {
                **manifest,
                "suite": {**manifest["suite"], "metrics": suite.metrics},
                SCORES: scores,
                "sessions": sessions,
            },
        )
        (folder / run_store.JOURNAL).unlink(missing_ok=True)
    return found


def _scored_again(folder: Path, results: Results, metrics: Metrics) -> pd.DataFrame:
    """New scores, indexed by the position of their row."""
    observed = ObservedScenes(folder, results.suite, results.scenarios, results.draws, results.records)
    records, rows = results.records, Rows.of_tables(results.records, results.clouds, results.environments)
    candidates = np.flatnonzero(~failed(records) & records["scenario"].isin(list(observed.scenes)))
    is_incomplete = (rows.n_points != stored_points(records).to_numpy())[candidates]
    if is_incomplete.any():
        raise InputError(
            f"{folder}: {is_incomplete.sum()} of {len(candidates)} clouds are missing or damaged; "
            "`isacbench run` into the folder makes them again"
        )
    references = _references(folder, records.iloc[candidates], candidates)
    ends = np.cumsum(rows.n_points)
    scored: dict[int, Mapping[str, Any]] = {}
    for (name, trial), inside in rows_by_trial(records.iloc[candidates]).items():
        scenario = observed.scenario(name, trial)
        for row in candidates[inside].tolist():
            cloud = PointCloud.from_array(rows.points[ends[row] - rows.n_points[row] : ends[row]])
            shot = MeasuredImage(scenario, None, None, records["snr_db"].iloc[row], cloud)
            measured = _measured(observed.scenes[name], shot, kind_of(results.suite).columns)
            reference = references.get(row)
            pair = CloudPair.of(scenario, cloud)
            scores = metrics.score(pair) if reference is None else _means(reference, scenario, metrics)
            scored[row] = {**scores, **measured}
    # What only some scenes measure, or only some kinds of objects have, stays as it is in the other rows.
    names = dict.fromkeys(name for found in scored.values() for name in found)
    before = records.reindex(columns=list(names)).iloc[list(scored)]
    kept = before.to_dict("records")
    found = [{**old, **new} for old, new in zip(kept, scored.values(), strict=True)]
    return pd.DataFrame(found, index=list(scored), columns=list(names))


def _references(
    folder: Path, records: pd.DataFrame, positions: NDArray[np.intp]
) -> dict[int, ReferenceEstimator]:
    """References by the position of their rows, which have spreads."""
    if N_STORED not in records:
        return {}
    variants: dict[tuple[str, str], ReferenceEstimator] = {}
    found = {}
    for row, (_, record) in zip(positions.tolist(), records.iterrows(), strict=True):
        if pd.isna(record[N_STORED]):
            continue
        name, params = record["estimator"], record["params"]
        if (name, params) not in variants:
            variants[name, params] = _reference(folder, name, params)
        found[row] = variants[name, params]
    return found


def _reference(folder: Path, name: str, params: str) -> ReferenceEstimator:
    """Build the reference of a row."""
    what = f"{folder}: the scores of {name!r} are means over its realisations, which have to be made again"
    try:
        plugin = get_estimator(name, **json.loads(params))
    except InputError as error:
        raise InputError(f"{what}; {error}") from error
    if not is_reference(plugin):
        raise InputError(f"{what}, but the installed estimator has no realisations")
    return plugin


def _means(reference: ReferenceEstimator, scenario: Scenario, metrics: Metrics) -> dict[str, Any]:
    """Scores of a reference with their spreads."""
    image = image_reference(reference, scenario, metrics)
    return {**image.scores, **image.spread_columns()}


def _measured(scene: ImagedScene, shot: MeasuredImage, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Columns that a scene derives from a cloud; none if it needs more than the cloud."""
    found = {} if scene.measure is None else scene.measure(shot)
    if not found:
        return {}
    known = {*scene.labels, "snr_gain_db"}
    return {name: found.get(name, default) for name, default in columns.items() if name not in known}


def _compared(kind: str, old: pd.DataFrame, new: pd.DataFrame, n_scored: int) -> Rescored:
    """Compare old and new rows column by column."""
    differs = (old != new) & ~(old.isna() & new.isna())
    changes = []
    for name in new.columns[differs.any().to_numpy()]:
        is_filled = differs[name] & old[name].isna()
        is_moved = differs[name] & ~is_filled
        distances = (new.loc[is_moved, name].astype(np.float64) - old.loc[is_moved, name]).abs()
        largest = distances.fillna(math.inf).max() if is_moved.any() else 0.0
        changes.append(Change(name, int(is_moved.sum()), float(largest), int(is_filled.sum())))
    return Rescored(kind, new, n_scored, int(differs.any(axis=1).sum()), changes)
