"""The journal: rows and clouds on disk the moment they are made, whatever happens next.

A line is the checksum of what follows it, and JSON: the names of the columns,
the description of an environment, what many rows share, or a row with its
cloud. A line that a kill or a failing disk has torn does not match its
checksum, and is left out.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import os
import struct
import zlib
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pandas as pd

from isacbench.bench.cells.record import ADDED, COLUMNS, PROVENANCE, TYPES, with_added
from isacbench.bench.store.rows import Rows
from isacbench.bench.store.run_folder import cannot_be_written
from isacbench.files.checked_files import open_own, require_file, require_inside
from isacbench.model.cloud_files.point_files import POINT_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from isacbench.bench.store.provenance import Environment, Made

CHUNK_ROWS = 50_000
"""Rows that are held as Python objects at a time."""

LINE_BYTES = 2**30
"""Longest line that is read as one: a cloud of twenty million points."""

N_CRC = 8

SHARED = ["suite", "scenario", "estimator", "params", "seed", *PROVENANCE]
"""Columns in which many rows agree; long as they are, they are written once."""

NUMBERS = [name for name in COLUMNS if name not in {*SHARED, *ADDED} and TYPES[name] == "float"]
"""Columns that are written bit by bit, before the cloud: in a third of the time that digits take. They stand
in this order in every journal: columns that were added later are written by their names."""

PACKED = struct.Struct(f"<{len(NUMBERS)}d")

OWN = [name for name in COLUMNS if name not in SHARED and name not in NUMBERS]


class Journal:
    """A journal that is written to, each entry at once; a context manager.

    Parameters
    ----------
    path : Path
        Appended to, if it exists.
    columns : mapping of str to Any
        Columns of the study, each with its value where an outcome has none.

    Raises
    ------
    InputError
        Here and in every method that writes, if the system does not let it.
    """

    def __init__(self, path: Path, columns: Mapping[str, Any]) -> None:
        self._columns = columns
        self._known: set[str] = set()
        self._shared: dict[tuple[Any, ...], int] = {}
        self._path = path
        try:
            # Unbuffered: one system call a line, so that a kill leaves whole lines and at most one torn.
            self._file = os.fdopen(open_own(path, os.O_WRONLY | os.O_APPEND), "ab", buffering=0)
        except OSError as error:
            raise cannot_be_written(path, error) from error
        if self._file.tell():
            self._file.write(b"\n")  # the end of a line that a kill may have torn
        self._write({"columns": [*OWN, *columns]})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def append(self, made: Made) -> None:
        """Write a row and its cloud."""
        record, cloud, extras = made.outcome.record, made.outcome.cloud, made.outcome.extras
        if record.environment not in self._known:
            self._known.add(record.environment)
            self._write({"environment": record.environment, "is": made.environment})
        shared = _shared(record)
        if shared not in self._shared:
            self._shared[shared] = len(self._shared)
            self._write({"shared": self._shared[shared], "is": dict(zip(SHARED, shared, strict=True))})
        values = [*_own(record), *(extras.get(name, value) for name, value in self._columns.items())]
        bits = PACKED.pack(*_numbers(record)) + cloud.to_array().astype("<f8").tobytes()
        numbers = base64.b64encode(bits).decode("ascii")
        self._write({"row": values, "of": self._shared[shared], "numbers": numbers})

    def _write(self, entry: Mapping[str, Any]) -> None:
        text = _encode(entry).encode()
        rest = memoryview(b"%08x %s\n" % (zlib.crc32(text), text))
        try:
            while rest:  # a disk that gets full takes a part, and only then refuses
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise cannot_be_written(self._path, error) from error


def read_journal(path: Path) -> tuple[Rows, int]:
    """Read a journal.

    Returns
    -------
    rows : Rows
        In the order in which they were made.
    n_torn : int
        Lines that are damaged and were left out.
    """
    require_inside(path, path.parent)
    require_file(path)
    reader = _Reader()
    with path.open("rb") as file:
        while line := file.readline(LINE_BYTES):
            reader.read(line)
    reader.gather()
    rows = Rows.joined(reader.parts)
    return dataclasses.replace(rows, environments=reader.environments), reader.n_torn


class _Reader:
    """Entries of a journal, gathered into tables a chunk at a time."""

    def __init__(self) -> None:
        self.columns: list[str] = []
        self.shared: dict[int, dict[str, Any]] = {}
        self.values: list[list[Any]] = []
        self.of: list[int] = []
        self.numbers: list[NDArray[np.float64]] = []
        self.parts: list[Rows] = []
        self.environments: dict[str, Environment] = {}
        self.n_torn = 0

    def read(self, line: bytes) -> None:
        if line == b"\n":
            return
        text = line[N_CRC + 1 :].removesuffix(b"\n")  # which alone may be what a kill has torn off
        if line[:N_CRC] != b"%08x" % zlib.crc32(text):
            self.n_torn += 1
            return
        try:
            self._take(json.loads(text))
        except (ValueError, TypeError, LookupError, RecursionError):  # whole, but none of ours
            self.n_torn += 1

    def _take(self, entry: dict[str, Any]) -> None:
        if "columns" in entry:
            self.gather()
            self.columns, self.shared = entry["columns"], {}
        elif "environment" in entry:
            self.environments[entry["environment"]] = entry["is"]
        elif "shared" in entry:
            self.shared[entry["shared"]] = entry["is"]
        elif len(entry["row"]) == len(self.columns) and entry["of"] in self.shared:
            self.values.append(entry["row"])
            self.of.append(entry["of"])
            self.numbers.append(np.frombuffer(base64.b64decode(entry["numbers"]), dtype="<f8"))
            if len(self.values) == CHUNK_ROWS:
                self.gather()
        else:  # what it needs was on a damaged line
            self.n_torn += 1

    def gather(self) -> None:
        if not self.values:
            return
        of = pd.Index(list(self.shared)).get_indexer(pd.Index(self.of))
        shared = pd.DataFrame(list(self.shared.values())).iloc[of].reset_index(drop=True)
        own = pd.DataFrame(self.values, columns=self.columns)
        every, n = np.concatenate(self.numbers), len(NUMBERS)
        sizes = np.array([numbers.size for numbers in self.numbers])
        of_row = (np.cumsum(sizes) - sizes)[:, None] + np.arange(n)
        numbers = pd.DataFrame(every[of_row], columns=NUMBERS)
        points = np.delete(every, of_row).reshape(-1, len(POINT_COLUMNS))
        records = with_added(pd.concat([shared, own, numbers], axis=1))
        self.parts.append(Rows(records, (sizes - n) // len(POINT_COLUMNS), points, {}))
        self.values, self.of, self.numbers = [], [], []


def _builtin(value: Any) -> Any:
    """Plain value of a NumPy scalar."""
    return value.item()


_encode = json.JSONEncoder(separators=(",", ":"), default=_builtin).encode
_shared = attrgetter(*SHARED)
_own = attrgetter(*OWN)
_numbers = attrgetter(*NUMBERS)
