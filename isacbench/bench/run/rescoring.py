"""Scoring a run again from the clouds that it keeps, without estimating: no plugin is needed for that."""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.cell import MeasuredImage, score_image
from isacbench.bench.cells.statuses import failed
from isacbench.bench.store.observed_scenes import ObservedScenes, rows_by_trial
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import open_folder
from isacbench.bench.store.run_store import (
    JOURNAL,
    Session,
    current_metric,
    read_manifest,
    read_results,
    save_manifest,
    write_results,
)
from isacbench.bench.studies.study import ImagedScene
from isacbench.bench.suites.suite_kinds import kind_of
from isacbench.errors import InputError
from isacbench.model.cloud import PointCloud

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from isacbench.bench.cells.record import Results


class Change(NamedTuple):
    """What became of a column.

    Attributes
    ----------
    column : str
    n_rows : int
        Rows whose value differs from the one before.
    largest : float
        Largest absolute difference; infinite where a value is none now.
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
    """What became of a run.

    Attributes
    ----------
    kind : str
        Of its suite.
    records : DataFrame
        All rows, as they are now.
    n_scored, n_changed : int
        Rows that were scored again, and those of them that differ.
    changes : list of Change
        Columns that differ.
    """

    kind: str
    records: pd.DataFrame
    n_scored: int
    n_changed: int
    changes: list[Change]


def rescore(folder: Path) -> Rescored:
    """Score every stored cloud of a run again, and put the new scores in place of the old ones.

    Scores of the metric ``paper``, and what the studies ``efficiency`` and
    ``resolution`` measure of a cloud, are computed anew. What takes more than
    the cloud stays: times, the cells that detectors tested, failed rows.

    Parameters
    ----------
    folder : Path
        Of a run, to which nobody writes.

    Returns
    -------
    Rescored

    Raises
    ------
    InputError
        If the folder holds no run, a damaged one, or not all of its clouds;
        nothing has changed then.
    """
    session, tick = Session(datetime.now().astimezone()), time.perf_counter()
    read_manifest(folder)  # a folder that holds no run stays as it is
    with open_folder(folder):
        manifest, results = read_manifest(folder), read_results(folder)
        scored, rows = _scored_again(folder, results)
        records = results.records.copy()
        for name in scored:
            records.loc[rows, name] = scored[name].astype(records[name].dtype)
        found = _compared(results.suite.kind, results.records, records, len(rows))
        write_results(dataclasses.replace(results, records=records), folder)
        entry = {**session.describe(time.perf_counter() - tick, False), "rescored": len(rows)}
        sessions = [*manifest.get("sessions", ()), entry]
        save_manifest(folder, {**manifest, "metric": current_metric(), "sessions": sessions})
        (folder / JOURNAL).unlink(missing_ok=True)
    return found


def _scored_again(folder: Path, results: Results) -> tuple[pd.DataFrame, list[int]]:
    """New scores, and the rows that they belong to."""
    observed = ObservedScenes(folder, results.suite, results.scenarios, results.draws, results.records)
    columns = kind_of(results.suite).columns
    records, rows = results.records, Rows.of_tables(results.records, results.clouds, results.environments)
    candidates = np.flatnonzero(~failed(records) & records["scenario"].isin(list(observed.scenes)))
    _require_clouds(folder, rows, candidates)
    scored: dict[int, Mapping[str, Any]] = {}
    for (name, trial), inside in rows_by_trial(records.iloc[candidates]).items():
        scene, chosen = observed.scenes[name], candidates[inside]
        scenario = observed.scenario(name, trial)
        for row, cloud in zip(chosen.tolist(), _clouds(rows.take(chosen)), strict=True):
            shot = MeasuredImage(scenario, None, None, records["snr_db"].iloc[row], cloud)
            scored[row] = {**score_image(scenario, cloud), **_measured(scene, shot, columns)}
    return pd.DataFrame(list(scored.values()), index=list(scored)), list(scored)


def _require_clouds(folder: Path, rows: Rows, candidates: NDArray[np.intp]) -> None:
    n_wanted = rows.records["n_estimated"].to_numpy()[candidates]
    incomplete = rows.n_points[candidates] != n_wanted
    if incomplete.any():
        raise InputError(
            f"{folder}: {incomplete.sum()} of {incomplete.size} clouds are missing or damaged; allowed is a "
            "run with all of them, and `isacbench run` into it makes these again"
        )


def _measured(scene: ImagedScene, shot: MeasuredImage, columns: Mapping[str, Any]) -> dict[str, Any]:
    """All columns that a scene measures of a cloud; none where that takes more than the cloud."""
    found = {} if scene.measure is None else scene.measure(shot)
    if not found:
        return {}
    known = {*scene.labels, "snr_gain_db"}
    return {name: found.get(name, default) for name, default in columns.items() if name not in known}


def _clouds(rows: Rows) -> Iterator[PointCloud]:
    for points in np.split(rows.points, np.cumsum(rows.n_points)[:-1]):
        yield PointCloud.from_array(points)


def _compared(kind: str, old: pd.DataFrame, new: pd.DataFrame, n_scored: int) -> Rescored:
    differs = (old != new) & ~(old.isna() & new.isna())
    changes = []
    for name in new.columns[differs.any().to_numpy()]:
        filled = differs[name] & old[name].isna()
        rows = differs[name] & ~filled
        largest = _largest(old.loc[rows, name], new.loc[rows, name])
        changes.append(Change(name, int(rows.sum()), largest, int(filled.sum())))
    return Rescored(kind, new, n_scored, int(differs.any(axis=1).sum()), changes)


def _largest(old: pd.Series[Any], new: pd.Series[Any]) -> float:
    difference = (new.astype(np.float64) - old.astype(np.float64)).abs()
    return math.inf if difference.isna().any() else float(difference.max() if difference.size else 0.0)
