"""Runs of the same scenes as one table: estimators of several runs side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import DRAW_COLUMNS
from isacbench.bench.compare.matching import RunTable, incomparable
from isacbench.bench.compare.scene_scores import with_sums_and_ratios
from isacbench.bench.plan.labels import estimator_labels, find_limits, variants_in
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_store import CLOUDS, TRUTH, read_manifest, read_scenes, read_sound_rows
from isacbench.bench.store.stored_run import ObservedScenes
from isacbench.bench.suites.suite_kinds import restore_suite
from isacbench.errors import InputError
from isacbench.files.checked_files import is_there

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from isacbench.bench.plan.labels import Variant
    from isacbench.bench.studies.study import ImagedScene

RUN = "run"
"""Column of joined rows with the number of their run."""

KEY = ["scenario", "snr_db", "trial"]


@dataclass(frozen=True, eq=False)
class ReadRun:
    """Run in its folder, with its clouds and scenes.

    Attributes
    ----------
    name : str
        Name in a page.
    manifest : mapping of str to Any
    rows : Rows
    observed : ObservedScenes
    """

    name: str
    manifest: Mapping[str, Any]
    rows: Rows
    observed: ObservedScenes

    @property
    def scenes(self) -> Mapping[str, ImagedScene]:
        """Scenes that were imaged, by name; none where the run has rows alone."""
        return self.observed.scenes if self.observed.scenarios else {}


@dataclass(frozen=True, eq=False)
class JoinedRuns:
    """Rows of one run, or of several.

    Attributes
    ----------
    runs : tuple of ReadRun
    table : RunTable
        Rows of all runs with the column ``run``, the ratios to the oracle and the sums of Hausdorff
        distances. An estimator that several runs have is named after its run, too.
    rows : Rows
        The same with their clouds.
    labels : mapping of (str, str) to str
        Readable names of the estimators of the table.
    specs : mapping of (str, str) to str
        The same without the names of runs: specifications.
    """

    runs: tuple[ReadRun, ...]
    table: RunTable
    rows: Rows
    labels: Mapping[Variant, str]
    specs: Mapping[Variant, str]


def read_for_page(folder: Path, name: str | None = None) -> ReadRun:
    """Read a run, also one that was killed, is not finished, or has rows but no clouds.

    Parameters
    ----------
    folder : Path
    name : str, optional
        By default that of the folder.

    Returns
    -------
    ReadRun

    Raises
    ------
    InputError
        If the folder does not hold a run, or a damaged one.
    """
    manifest = read_manifest(folder)
    rows = read_sound_rows(folder, manifest, with_clouds=is_there(folder / CLOUDS))
    if is_there(folder / TRUTH):
        suite, scenarios, draws = read_scenes(folder, manifest)
    else:  # a reference: rows alone
        suite, scenarios, draws = restore_suite(manifest["suite"]), {}, pd.DataFrame(columns=DRAW_COLUMNS)
    observed = ObservedScenes(folder, suite, scenarios, draws, rows.records)
    return ReadRun(name or folder.resolve().name, manifest, rows, observed)


def join_runs(runs: Sequence[ReadRun], rename_all: bool = False) -> JoinedRuns:
    """Put the rows of runs of the same scenes into one table.

    An estimator that an earlier run has with the same scores is left out, and so are references of later
    runs, which see the truth.

    Parameters
    ----------
    runs : sequence of ReadRun
        At least one.
    rename_all : bool
        Whether to keep and name after its run every estimator of several runs that is no reference.

    Returns
    -------
    JoinedRuns

    Raises
    ------
    InputError
        If the runs measured different things.
    """
    tables = [RunTable(run.name, run.rows.records, run.manifest) for run in runs]
    for table in tables[1:]:
        reasons = incomparable(tables[0], table)
        if reasons:
            raise InputError(f"{tables[0].label} and {table.label} have no common page: {'; '.join(reasons)}")
    own = [estimator_labels(variants_in(table.records)) for table in tables]
    kept: list[Rows] = []
    labels: dict[Variant, str] = {}
    specs: dict[Variant, str] = {}
    seen: dict[Variant, pd.DataFrame] = {}
    for number, run in enumerate(runs):
        records, limits = run.rows.records.assign(**{RUN: number}), find_limits(run.rows.records)
        dropped = np.zeros(len(records), dtype=np.bool_)
        for variant, label in own[number].items():
            of_variant = _is_of(records, variant)
            is_shared = sum(variant in other for other in own) > 1 and variant[0] not in limits
            if variant in seen and not (
                is_shared and (rename_all or not _scores_equal(seen[variant], records[of_variant]))
            ):
                dropped |= of_variant
                continue
            name, spec = variant[0], label
            if is_shared and (rename_all or variant in seen):
                name, label = f"{name} ({run.name})", f"{label} ({run.name})"
            seen.setdefault(variant, records[of_variant])
            records.loc[of_variant, "estimator"] = name
            labels[name, variant[1]], specs[name, variant[1]] = label, spec
        kept.append(replace(run.rows, records=records).take(~dropped))
    joined = Rows.joined(kept)
    united = RunTable(" and ".join(table.label for table in tables), joined.records, _united(runs))
    scored = replace(united, records=with_sums_and_ratios(united))
    return JoinedRuns(tuple(runs), scored, replace(joined, records=scored.records), labels, specs)


def _is_of(records: pd.DataFrame, variant: Variant) -> NDArray[np.bool_]:
    return np.asarray((records["estimator"] == variant[0]) & (records["params"] == variant[1]))


def _scores_equal(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Tell whether an estimator has the same cells and deviations in two runs."""
    first, second = (table.astype({"scenario": object}).set_index(KEY)["deviation"] for table in (one, other))
    return first.index.sort_values().equals(second.index.sort_values()) and np.allclose(
        first, second.reindex(first.index), rtol=1e-9, equal_nan=True
    )


def _united(runs: Sequence[ReadRun]) -> dict[str, Any]:
    """Manifest of the first run with the scenarios of all."""
    scenarios = {name: told for run in reversed(runs) for name, told in run.manifest["scenarios"].items()}
    first = runs[0].manifest
    return {**first, "scenarios": {name: scenarios[name] for name in [*first["scenarios"], *scenarios]}}
