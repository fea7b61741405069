"""Runs of the same scenes as one table: estimators of several runs side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import DRAW_COLUMNS
from isacbench.bench.compare.matching import RunTable, incomparable
from isacbench.bench.compare.scene_scores import with_ratios
from isacbench.bench.plan.labels import estimator_labels, find_limits
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_store import CLOUDS, TRUTH, read_manifest, read_scenes, read_sound_rows
from isacbench.bench.store.stored_run import MOST_NAMED, ObservedScenes
from isacbench.bench.suites.suite_kinds import restore_suite
from isacbench.charts import variants_in
from isacbench.errors import InputError
from isacbench.files.checked_files import is_there
from isacbench.files.escaping import counted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from isacbench.bench.kinds.scenes import ImagedScene
    from isacbench.charts import Variant

RUN = "run"
"""Column of joined rows with the number of their run."""

KEY = ["scenario", "snr_db", "trial"]
SAME = ["deviation", "gospa_m", "n_estimated"]
"""Scores by which two runs of an estimator are recognised as equal."""


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
    notes : tuple of str
        Estimators and rows that were left out.
    """

    runs: tuple[ReadRun, ...]
    table: RunTable
    rows: Rows
    labels: Mapping[Variant, str]
    specs: Mapping[Variant, str]
    notes: tuple[str, ...]


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


def join_runs(runs: Sequence[ReadRun], rename_all: bool = False, only_common: bool = False) -> JoinedRuns:
    """Put the rows of runs of the same scenes into one table.

    An estimator that an earlier run has with the same scores is left out, and so are references of later
    runs, which see the truth.

    Parameters
    ----------
    runs : sequence of ReadRun
        At least one.
    rename_all : bool
        Whether to keep and name after its run every estimator of several runs that is no reference.
    only_common : bool
        Whether to refuse runs with other scenes, and to leave out SNRs and trials that not all runs have, so
        that means are over the same cells.

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
        if only_common and not reasons:
            reasons = _other_scenes(tables[0], table)
        if reasons:
            raise InputError(f"{tables[0].label} and {table.label} have no common page: {'; '.join(reasons)}")
    common = _common_cells(tables) if only_common else None
    notes = []
    own = [estimator_labels(variants_in(table.records)) for table in tables]
    kept: list[Rows] = []
    labels: dict[Variant, str] = {}
    specs: dict[Variant, str] = {}
    seen: dict[Variant, pd.DataFrame] = {}
    for number, run in enumerate(runs):
        rows = run.rows
        if common is not None:
            is_common = np.array([cell in common for cell in _cells(rows.records)], dtype=np.bool_)
            if not is_common.all():
                n_other = counted(int((~is_common).sum()), "row")
                notes.append(f"{n_other} of {run.name} left out: not all runs have their SNR and trial")
            rows = rows.take(is_common)
        records, limits = rows.records.assign(**{RUN: number}), find_limits(rows.records)
        dropped = np.zeros(len(records), dtype=np.bool_)
        for variant in variants_in(records):
            label = own[number][variant]
            of_variant = _is_of(records, variant)
            is_shared = sum(variant in other for other in own) > 1 and variant[0] not in limits
            if variant in seen and not (
                is_shared and (rename_all or not _scores_equal(seen[variant], records[of_variant]))
            ):
                dropped |= of_variant
                first = runs[int(seen[variant][RUN].iloc[0])].name
                if variant[0] not in limits:
                    notes.append(f"{label} of {run.name} has the same scores as that of {first}")
                continue
            name, spec = variant[0], label
            if is_shared and (rename_all or variant in seen):
                name, label = f"{name} ({run.name})", f"{label} ({run.name})"
            seen.setdefault(variant, records[of_variant])
            records.loc[of_variant, "estimator"] = name
            if label in labels.values():  # parameters of estimators that are not installed
                label = f"{label} ({run.name})"
            labels[name, variant[1]], specs[name, variant[1]] = label, spec
        kept.append(replace(rows, records=records).take(~dropped))
    joined = Rows.joined(kept)
    if not len(joined):
        raise InputError("the runs have no common page: no SNR and trial is in all of them")
    united = RunTable(" and ".join(table.label for table in tables), joined.records, _united(runs))
    scored = replace(united, records=with_ratios(united))
    return JoinedRuns(
        tuple(runs), scored, replace(joined, records=scored.records), labels, specs, tuple(notes)
    )


def _is_of(records: pd.DataFrame, variant: Variant) -> NDArray[np.bool_]:
    return np.asarray((records["estimator"] == variant[0]) & (records["params"] == variant[1]))


def _other_scenes(one: RunTable, other: RunTable) -> tuple[str, ...]:
    """Name the scenes that only one of two runs has."""
    apart = sorted(set(one.records["scenario"]) ^ set(other.records["scenario"]))
    more = f" and {len(apart) - MOST_NAMED} more" if len(apart) > MOST_NAMED else ""
    return (f"only one of them has the scenes {', '.join(apart[:MOST_NAMED])}{more}",) if apart else ()


def _cells(records: pd.DataFrame) -> list[tuple[Any, ...]]:
    return list(zip(*(records[name] for name in KEY), strict=True))


def _common_cells(tables: Sequence[RunTable]) -> set[tuple[Any, ...]]:
    """Scenes, SNRs and trials that all runs have."""
    return set.intersection(*(set(_cells(table.records)) for table in tables))


def _scores_equal(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Tell whether an estimator has the same cells and scores in two runs."""
    first, second = (table.astype({"scenario": object}).set_index(KEY)[SAME] for table in (one, other))
    return first.index.sort_values().equals(second.index.sort_values()) and np.allclose(
        first, second.reindex(first.index), rtol=1e-9, equal_nan=True
    )


def _united(runs: Sequence[ReadRun]) -> dict[str, Any]:
    """Manifest of the first run with the scenarios of all."""
    scenarios = {name: told for run in reversed(runs) for name, told in run.manifest["scenarios"].items()}
    first = runs[0].manifest
    return {**first, "scenarios": {name: scenarios[name] for name in [*first["scenarios"], *scenarios]}}
