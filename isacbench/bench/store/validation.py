"""Validation of a run's folder: kinds and limits of what it holds, whoever has written it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any, get_args

import numpy as np
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from isacbench.bench.cells.record import COLUMNS, TYPES, CellStatus
from isacbench.errors import InputError
from isacbench.files.escaping import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd


KEYS = ("suite", "scenario", "estimator", "params", "status")
"""Columns of text that every row has."""

FREE_ROWS = 1_000_000
"""Rows that any table may have; of a table with more, every row takes a byte of its file at least."""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)


class _Git(_Part):
    commit: str | None = None
    dirty: bool | None = None


class _Metric(_Part):
    name: str | None = None
    version: int | None = None


class _Estimator(_Part):
    name: str
    params: dict[str, Any]


class _Scenario(_Part):
    content: str = ""


class _Scene(_Part):
    name: str
    content: str
    snr_db: list[Finite]
    contestants: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)]


class _Machine(_Part):
    processor: str | None = None
    cores: int | None = None


Version = str | None


class _Environment(_Part):
    versions: dict[str, Version | dict[str, Version | dict[str, Version]]] = {}
    machine: _Machine = _Machine()


class _Session(_Part):
    started: str


class Manifest(_Part):
    """What is read of a manifest, as far as it is there: who reads a part says which parts must be."""

    isacbench: str = ""
    git: _Git | None = None
    started: str = ""
    wall_time_s: Finite = 0.0
    interrupted: bool = False
    seed: int = 0
    suite: dict[str, Any] = {}
    metric: _Metric = _Metric()
    estimators: list[_Estimator] = []
    scenarios: dict[str, _Scenario] = {}
    scenes: list[_Scene] = []
    environments: dict[str, _Environment] = {}
    sessions: list[_Session] = []

    @field_validator("scenes")
    @classmethod
    def _require_estimators(cls, scenes: list[_Scene], info: ValidationInfo) -> list[_Scene]:
        """Refuse scenes whose entries are not among the estimators."""
        n_estimators = len(info.data.get("estimators", ()))
        for scene in scenes:
            if max(scene.contestants) >= n_estimators:
                raise ValueError(
                    f"contestant {max(scene.contestants)} of {scene.name!r}; allowed are indices of the "
                    f"{n_estimators} estimators"
                )
        return scenes


def require_sound_records(records: pd.DataFrame) -> None:
    """Refuse records whose columns are not what every reader takes them for.

    Parameters
    ----------
    records : DataFrame
        Of `isacbench.bench.cells.record.COLUMNS` as many as there are.

    Raises
    ------
    ValueError
        Naming the column.
    """
    for name in COLUMNS:
        if name in records:
            _require_kind(name, records[name])
    if "snr_db" in records and not np.isfinite(records["snr_db"].to_numpy(dtype=np.float64)).all():
        raise ValueError("column snr_db: allowed are finite numbers")
    if "status" in records:
        unknown = set(records["status"].unique()) - set(get_args(CellStatus))
        if unknown:
            raise ValueError(
                f"column status: {quoted(unknown.pop())}; allowed are {', '.join(get_args(CellStatus))}"
            )
    if "params" in records:
        for text in records["params"].unique():
            _require_params(text)


def require_described_scenarios(records: pd.DataFrame, manifest: Mapping[str, Any]) -> None:
    """Refuse records of scenarios that the manifest does not describe.

    Parameters
    ----------
    records : DataFrame
    manifest : mapping of str to Any
        With ``suite`` and ``scenarios``.

    Raises
    ------
    InputError
        Naming the scenarios.
    """
    # A study that makes scenes of a scenario names it in a column of its own; rows of a user have none.
    names = records["template" if "template" in records else "scenario"].dropna().unique()
    maps = manifest["suite"].get("maps")
    others = map(str, maps) if isinstance(maps, list) else ()
    missing = set(map(str, names)) - {""} - set(manifest["scenarios"]) - set(others)
    if missing:
        described = quoted(sorted(manifest["scenarios"])) if manifest["scenarios"] else "none"
        raise InputError(
            f"its rows name the scenarios {quoted(sorted(missing))}, which its manifest does not describe; "
            f"allowed are those that it does, {described}"
        )


def require_rows_that_fit(path: Path) -> None:
    """Refuse a table that says it has far more rows than its file can hold: a bomb.

    Raises
    ------
    ValueError
        If it does.
    """
    n_rows, n_bytes = pq.read_metadata(path).num_rows, path.stat().st_size
    if n_rows > max(FREE_ROWS, n_bytes):
        raise ValueError(f"{n_rows} rows in {n_bytes} bytes; allowed is a byte a row at least")


def _require_kind(name: str, column: pd.Series[Any]) -> None:
    kind = TYPES[name]
    if kind in ("int", "float", "bool"):
        allowed = {"int": "iu", "float": "fiu", "bool": "b"}[kind]
        if column.dtype.kind not in allowed:
            raise ValueError(f"column {name} holds {column.dtype}, where {kind} is wanted")
    elif name in KEYS and column.isna().any():
        raise ValueError(f"column {name} has gaps, where text is wanted")
    elif not all(isinstance(text, str) for text in column.dropna().unique()):
        raise ValueError(f"column {name} holds {column.dtype}, where text is wanted")


def _require_params(text: object) -> None:
    try:
        params = json.loads(str(text))
    except (ValueError, RecursionError):
        params = None
    if not isinstance(params, dict):
        raise ValueError(f"column params: {quoted(text)}; allowed are parameters as JSON")
