"""Journal of a run: each row and its cloud are on disk as soon as they are made.

A line holds a checksum and an entry in JSON: the columns, the description of
an environment, or a row with its cloud. A line that a kill or a failing disk
has torn does not match its checksum. It is left out.
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import COLUMNS, Row
from isacbench.bench.store.provenance import Environment
from isacbench.bench.store.run_folder import cannot_be_written
from isacbench.bench.store.tables import Clouds
from isacbench.files.checked_files import require_file, require_inside
from isacbench.model.cloud_files.columns import POINT_COLUMNS

MOST_ROWS = 10_000
"""Rows that are read before they become a table, which takes less memory."""


class Journal:
    """Journal that is open for writing into a new file.

    `columns` are those of the study, each with its value where a row has none. What cannot be written is
    an `InputError`.
    """

    def __init__(self, path: Path, columns: Mapping[str, Any]) -> None:
        self._columns = {**dict.fromkeys(COLUMNS, math.nan), **columns}
        self._environments: set[str] = set()
        self._path = path
        try:
            # Unbuffered: a line is on its way when it is written, so that a kill tears at most one.
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        self._write({"columns": [*self._columns]})

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def append(self, row: Row) -> None:
        """Write a row and its cloud."""
        values = row.values
        if (name := values["environment"]) not in self._environments:
            self._environments.add(name)
            self._write({"environment": name, "is": row.environment})
        points = base64.b64encode(row.cloud.to_array().astype("<f8").tobytes()).decode("ascii")
        self._write({"row": [values.get(*one) for one in self._columns.items()], "cloud": points})

    def _write(self, entry: Mapping[str, Any]) -> None:
        text = json.dumps(entry, separators=(",", ":"), default=np.generic.item).encode()
        rest = memoryview(b"%08x %s\n" % (zlib.crc32(text), text))
        try:
            while rest:  # a disk that is nearly full takes a part before it refuses
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise cannot_be_written(self._path, error) from error


class JournalContent(NamedTuple):
    """Rows of a journal in the order in which they were made, and the number of damaged lines."""

    rows: pd.DataFrame
    clouds: Clouds
    environments: dict[str, Environment]
    n_torn: int


def read_journal(path: Path) -> JournalContent:
    """Read a journal; damaged lines are left out."""
    require_inside(path, path.parent)
    require_file(path)
    columns: list[str] = []
    environments: dict[str, Environment] = {}
    tables: list[pd.DataFrame] = []
    values: list[list[Any]] = []
    clouds: Clouds = []
    n_torn = 0
    with path.open("rb") as file:
        for line in file:
            entry = _decoded(line)
            if "columns" in entry:
                columns = entry["columns"]
            elif "environment" in entry:
                environments[entry["environment"]] = entry["is"]
            elif "row" in entry and columns:
                values.append(entry["row"])
                points = np.frombuffer(base64.b64decode(entry["cloud"]), dtype="<f8")
                clouds.append(points.reshape(-1, len(POINT_COLUMNS)))
            else:
                n_torn += 1
            if len(values) == MOST_ROWS:
                tables.append(pd.DataFrame(values, columns=columns))
                values = []
    if values or not tables:
        tables.append(pd.DataFrame(values, columns=columns))
    return JournalContent(pd.concat(tables, ignore_index=True), clouds, environments, n_torn)


def _decoded(line: bytes) -> dict[str, Any]:
    """Entry of a line, empty where the line is damaged."""
    checksum, _, text = line.rstrip(b"\n").partition(b" ")
    entry: dict[str, Any] = json.loads(text) if checksum == b"%08x" % zlib.crc32(text) else {}
    return entry
