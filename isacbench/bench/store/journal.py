"""Journal of a run: each row and its cloud are on disk as soon as they are made.

A line holds a checksum and an entry in JSON: the columns, the description of
an environment, values that many rows share, or a row with its cloud. A line
that a kill or a failing disk has torn does not match its checksum. It is left
out.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import COLUMNS, PROVENANCE, TYPES
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import cannot_be_written
from isacbench.files.checked_files import require_file, require_inside
from isacbench.model.cloud_files.columns import POINT_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from isacbench.bench.store.provenance import Environment, Made

SHARED = ["suite", "scenario", "estimator", "params", "seed", *PROVENANCE]
"""Columns in which many rows agree: each combination is written once."""

NUMBERS = [name for name in COLUMNS if name not in SHARED and TYPES[name] == "float"]
"""Columns that are written as bits, before the cloud."""

OWN = [name for name in COLUMNS if name not in SHARED and name not in NUMBERS]
"""Columns that are written by name."""


class Journal:
    """Journal that is open for writing.

    Parameters
    ----------
    path : Path
        A new file.
    columns : mapping of str to Any
        Columns of the study, each with its value where an outcome has none.

    Raises
    ------
    InputError
        Here and in `append`, if the file cannot be written.
    """

    def __init__(self, path: Path, columns: Mapping[str, Any]) -> None:
        self._columns = columns
        self._environments: set[str] = set()
        self._shared: dict[tuple[Any, ...], int] = {}
        self._path = path
        try:
            # Unbuffered: a line is on its way when it is written, so that a kill tears at most one.
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        self._write({"columns": [*OWN, *columns]})

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def append(self, made: Made) -> None:
        """Write a row and its cloud.

        Parameters
        ----------
        made : Made
        """
        record, cloud, extras = made.outcome.record, made.outcome.cloud, made.outcome.extras
        if record.environment not in self._environments:
            self._environments.add(record.environment)
            self._write({"environment": record.environment, "is": made.environment})
        shared = attrgetter(*SHARED)(record)
        if shared not in self._shared:
            self._shared[shared] = len(self._shared)
            self._write({"shared": self._shared[shared], "is": dict(zip(SHARED, shared, strict=True))})
        values = [*attrgetter(*OWN)(record), *(extras.get(name, x) for name, x in self._columns.items())]
        numbers = np.concatenate([attrgetter(*NUMBERS)(record), cloud.to_array().ravel()]).astype("<f8")
        text = base64.b64encode(numbers.tobytes()).decode("ascii")
        self._write({"row": values, "of": self._shared[shared], "numbers": text})

    def _write(self, entry: Mapping[str, Any]) -> None:
        text = json.dumps(entry, separators=(",", ":"), default=np.generic.item).encode()
        rest = memoryview(b"%08x %s\n" % (zlib.crc32(text), text))
        try:
            while rest:  # a disk that is nearly full takes a part before it refuses
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise cannot_be_written(self._path, error) from error


def read_journal(path: Path) -> tuple[Rows, int]:
    """Read a journal.

    Parameters
    ----------
    path : Path

    Returns
    -------
    rows : Rows
        In the order in which they were made.
    n_torn : int
        Damaged lines, which were left out.
    """
    require_inside(path, path.parent)
    require_file(path)
    environments: dict[str, Environment] = {}
    calls = [_Call([])]
    n_torn = 0
    with path.open("rb") as file:
        for line in file:
            entry = _decoded(line)
            if "columns" in entry:
                calls.append(_Call(entry["columns"]))
            elif "environment" in entry:
                environments[entry["environment"]] = entry["is"]
            elif "shared" in entry:
                calls[-1].shared[entry["shared"]] = entry["is"]
            elif "row" in entry and calls[-1].has_context(entry):
                calls[-1].append(entry)
            elif line.strip():  # an older isacbench wrote an empty line before those of a further call
                n_torn += 1
    rows = Rows.joined([call.rows() for call in calls if call.of])
    return dataclasses.replace(rows, environments=environments), n_torn


class _Call:
    """Entries that one call of a run has written."""

    def __init__(self, columns: list[str]) -> None:
        self.columns = columns
        self.shared: dict[int, dict[str, Any]] = {}
        self.of: list[int] = []
        self.values: list[list[Any]] = []
        self.numbers: list[bytes] = []

    def has_context(self, row: dict[str, Any]) -> bool:
        """Tell whether the lines were whole that say what the values of a row are."""
        return len(row["row"]) == len(self.columns) and row["of"] in self.shared

    def append(self, row: dict[str, Any]) -> None:
        self.of.append(row["of"])
        self.values.append(row["row"])
        self.numbers.append(base64.b64decode(row["numbers"]))

    def rows(self) -> Rows:
        shared = pd.DataFrame.from_dict(self.shared, orient="index").loc[self.of].reset_index(drop=True)
        own = pd.DataFrame(self.values, columns=self.columns)
        every = np.frombuffer(b"".join(self.numbers), dtype="<f8")
        sizes = np.array([len(numbers) for numbers in self.numbers]) // every.itemsize
        of_record = (np.cumsum(sizes) - sizes)[:, None] + np.arange(len(NUMBERS))
        numbers = pd.DataFrame(every[of_record], columns=NUMBERS)
        points = np.delete(every, of_record).reshape(-1, len(POINT_COLUMNS))
        records = pd.concat([shared, own, numbers], axis=1)
        return Rows(records, (sizes - len(NUMBERS)) // len(POINT_COLUMNS), points, {})


def _decoded(line: bytes) -> dict[str, Any]:
    """Entry of a line, empty where the line is damaged."""
    checksum, _, text = line.rstrip(b"\n").partition(b" ")
    entry: dict[str, Any] = json.loads(text) if checksum == b"%08x" % zlib.crc32(text) else {}
    return entry
