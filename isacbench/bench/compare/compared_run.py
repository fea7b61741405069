"""One side of a comparison: the rows and the manifest of a run, checked as far as a comparison needs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from isacbench.bench.cells.record import CLOUD_KEYS, require_sound_records, with_added
from isacbench.bench.store.run_store import (
    JOURNAL,
    MANIFEST,
    RECORDS,
    read_manifest,
    read_table,
    require_described_scenarios,
)
from isacbench.errors import InputError
from isacbench.files.checked_files import is_there

if TYPE_CHECKING:
    from pathlib import Path

COLUMNS = [*CLOUD_KEYS, "status", "reason", "environment", "scenario_content", "timing"]


SECTIONS = ["suite", "seed", "metric", "scenarios", "environments"]


@dataclass(frozen=True, eq=False)
class RunTable:
    """What a comparison needs to know of a run.

    Attributes
    ----------
    label : str
        How messages call it: its folder.
    records : DataFrame
        One row a cell.
    manifest : mapping of str to Any
        As JSON has it.
    """

    label: str
    records: pd.DataFrame
    manifest: Mapping[str, Any]


def read_run(folder: Path) -> RunTable:
    """Read what a comparison needs from the folder of a run: ``results.parquet`` and ``manifest.json``.

    Raises
    ------
    InputError
        If the folder does not hold them, or they lack what tells runs apart.
    """
    manifest = read_manifest(folder)
    if is_there(folder / JOURNAL):
        raise InputError(
            f"{folder}: the run has not come to its end; allowed is one that has, and the same "
            "isacbench run into the folder goes on"
        )
    if not is_there(folder / RECORDS):
        raise InputError(
            f"{folder}: not the folder of a run, {RECORDS} missing; allowed is one that isacbench run wrote"
        )
    try:
        records = with_added(read_table(folder / RECORDS))
        require_sound_records(records)
    except ValueError as error:
        raise InputError(f"{folder}: damaged run: {error}") from error
    _require(folder / MANIFEST, SECTIONS, manifest)
    _require(folder / RECORDS, COLUMNS, records.columns)
    _require(folder / MANIFEST, records["environment"].unique(), manifest["environments"])
    try:
        require_described_scenarios(records, manifest)
    except ValueError as error:
        raise InputError(f"{folder}: damaged run: {error}") from error
    for name, described in manifest["scenarios"].items():
        _require(
            folder / MANIFEST, [f"scenarios.{name}.content"], {f"scenarios.{name}.{key}" for key in described}
        )
    repeated = records.duplicated(CLOUD_KEYS)
    if repeated.any():
        raise InputError(
            f"{folder / RECORDS}: {repeated.sum()} cells have more than one row; allowed is one a cell"
        )
    return RunTable(str(folder), records, manifest)


def _require(where: Path, wanted: Any, present: Any) -> None:
    missing = [str(name) for name in wanted if name not in present]
    if missing:
        raise InputError(
            f"{where}: {', '.join(missing)} missing; allowed is a run of this version: run it again"
        )
