"""Folder of a run: one run at a time writes into it; its files, replaced as a whole, and its journal.

In the journal each row and its cloud are on disk as soon as they are made. A line holds a checksum and an
entry in JSON: the columns, the description of an environment, or a row with its cloud. A line that a kill or
a failing disk has torn does not match its checksum, and is left out. Tables are parquet with a digest of what
they hold, and CSV that is safe in a spreadsheet.
"""

from __future__ import annotations

import base64
import fcntl
import hashlib
import json
import math
import os
import platform
import zlib
from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from isacbench.bench.cells.provenance import Environment
from isacbench.bench.cells.rows import CLOUD_KEYS, COLUMNS, Row
from isacbench.bench.suites.scenario_digest import digest
from isacbench.errors import AccessError, InputError
from isacbench.files.checked_files import open_own, require_file, require_inside, require_utf8, write_errors
from isacbench.model.cloud_files.tables import POINT_COLUMNS

RECORDS, RECORDS_CSV = "results.parquet", "results.csv"
CLOUDS, TRUTH, MANIFEST = "clouds.parquet", "truth.parquet", "manifest.json"
DRAWS, JOURNAL, LOCK = "draws.parquet", "journal.jsonl", ".lock"

RUN_TABLES = frozenset({RECORDS, RECORDS_CSV, CLOUDS, TRUTH, MANIFEST, DRAWS, JOURNAL})
"""Files of a run."""

RUN_FILES = frozenset({LOCK, MANIFEST, RECORDS, JOURNAL})
"""Names by which the folder of a run is known: it has at least one of these files."""

DAMAGE = (ValueError, TypeError, LookupError, OSError)
"""Exceptions that reading a damaged file raises."""

ROWS_KEPT = "; the rows so far are kept, and the same run into the same folder goes on with them"


def default_folder(suite_name: str) -> Path:
    """Name the folder of a run that starts now, ``results/<suite>-<time>``."""
    return Path("results") / f"{suite_name}-{datetime.now():%Y%m%d-%H%M%S}"


@contextmanager
def open_folder(
    folder: Path | None, files: AbstractSet[str] = RUN_FILES, what: str = "a run"
) -> Iterator[Path]:
    """Create the folder of a run or enter an existing one, and keep other runs out of it.

    None gives a temporary one. A new folder is removed in the end if it holds no file; an existing one that
    is not empty must hold one of `files`, as that of `what` does.
    """
    if folder is None:
        with TemporaryDirectory(prefix="isacbench-") as temporary:
            yield Path(temporary)
        return
    require_utf8(folder)
    try:
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        names = {path.name for path in folder.iterdir()}
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: cannot be created or read: {error}") from error
    if names and not names & files:
        raise InputError(
            f"{folder}: exists and is not the folder of {what}; allowed are a new folder, an empty one, "
            f"or the folder of {what} to resume; nothing was overwritten"
        )
    with _locked(folder):
        try:
            yield folder
        finally:
            if is_new and {path.name for path in folder.iterdir()} <= {LOCK}:
                (folder / LOCK).unlink()
                folder.rmdir()


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which the system releases however this process ends."""
    with ExitStack() as stack:
        try:
            descriptor = open_own(folder / LOCK, os.O_RDWR | os.O_APPEND)
            file = stack.enter_context(os.fdopen(descriptor, "a+", encoding="utf-8"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise InputError(
                f"{folder}: another run is writing into it ({file.read() or 'unknown'}); wait for its "
                "end, or use another folder"
            ) from error
        except OSError as error:
            raise InputError(
                f"{folder}: cannot be locked: {error.strerror or error}; use a folder that can be "
                "written into, on a file system with locks"
            ) from error
        file.truncate(0)
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        file.write(f"process {os.getpid()} on {platform.node()}, since {now}")
        file.flush()
        yield


def require_unlocked(folder: Path) -> None:
    """Refuse a folder that a run is writing into. Nothing is written to find out."""
    if not (folder / LOCK).exists():
        return
    try:
        with (folder / LOCK).open(encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(f"{folder}: a run writes into it") from error


@contextmanager
def atomic_write(path: Path, afterwards: str = ROWS_KEPT) -> Iterator[Path]:
    """Write a file under a temporary name, and rename it once it is complete and on the disk.

    `afterwards` ends the message if it cannot be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        with write_errors(path, afterwards):
            temporary.unlink(missing_ok=True)  # a symbolic link of that name must not be followed
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
    finally:
        with suppress(OSError):  # it may be impossible to create, and then there is nothing to remove
            temporary.unlink(missing_ok=True)


@contextmanager
def damage_named(folder: Path, part: str = "") -> Iterator[None]:
    """Turn errors in reading a damaged folder into an `InputError` that names it."""
    try:
        yield
    except AccessError:
        raise
    except DAMAGE as error:
        raise InputError(f"{folder}: damaged run: {part}{damage_text(error)}") from error


def damage_text(error: Exception) -> str:
    """Message of an exception, preceded by its type unless it is an `InputError`."""
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"


TEXTS = ["scenario", "estimator", "params"]
"""Keys that a table of points holds as categories."""


Clouds = list[NDArray[np.float64]]
"""Points of each row, shape (n, 5): x, y, z, v, power."""

NO_POINTS = np.empty((0, len(POINT_COLUMNS)))


def clouds_of(rows: pd.DataFrame, table: pd.DataFrame) -> Clouds:
    """Find the clouds of rows in a table of points with their cells' keys; other cells are left out."""
    index, keys = (pd.MultiIndex.from_frame(one[CLOUD_KEYS]) for one in (rows, table))
    of_row = index.get_indexer(keys)
    order = np.argsort(of_row, kind="stable")  # points of other cells, -1, first
    points = table[POINT_COLUMNS].to_numpy(dtype=np.float64)[order]
    bounds = np.searchsorted(of_row[order], np.arange(len(rows) + 1))
    return [points[start:end] for start, end in pairwise(bounds.tolist())]


def cloud_table(rows: pd.DataFrame, clouds: Clouds) -> pd.DataFrame:
    """One row a point: the keys of its cell, then x, y, z in m, v in m/s, power."""
    keys = rows[CLOUD_KEYS].astype(dict.fromkeys(TEXTS, "category"))
    own = keys.iloc[np.repeat(np.arange(len(rows)), sizes(clouds))].reset_index(drop=True)
    points = np.concatenate([NO_POINTS, *clouds])
    return pd.concat([own, pd.DataFrame(points, columns=POINT_COLUMNS)], axis=1)


def sizes(clouds: Clouds) -> NDArray[np.int64]:
    """Number of points of each cloud."""
    return np.fromiter(map(len, clouds), dtype=np.int64)


DIGEST = "digest"
"""Attribute of a table's file that holds the digest of its content."""

FORMULA = r"^[=+\-@\t\r]"
"""First character of a text that a spreadsheet evaluates as a formula."""

GUARD = "'"
"""Mark by which spreadsheets know that a text follows."""


def read_table(path: Path) -> pd.DataFrame:
    """Read a table. ValueError if it is not as it was written, InputError if it is no file of its folder."""
    require_inside(path, path.parent)
    require_file(path)
    try:
        with path.open("rb") as file:
            table = pd.read_parquet(file, page_checksum_verification=True)
    except Exception as error:  # Arrow raises many types for a damaged file, without a number of the system
        if isinstance(error, MemoryError) or getattr(error, "errno", None) is not None:
            raise AccessError(f"{path}: cannot be read: {error}") from error
        raise ValueError(f"{path.name}: {type(error).__name__}: {error}") from error
    # The checksums of pages do not cover the description of the table.
    if DIGEST in table.attrs and table.attrs[DIGEST] != _table_digest(table):
        raise ValueError(f"{path.name}: its content does not match its digest")
    table.attrs = {}
    return table


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table with its digest, in place of an older one."""
    signed = table.copy(deep=False)
    signed.attrs = {DIGEST: _table_digest(table)}
    with atomic_write(path) as temporary:
        signed.to_parquet(temporary, index=False, write_page_checksum=True)


def write_csv_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV: text in quotes, missing values empty, numbers with all their digits.

    Each column has one type, else pyarrow raises ArrowInvalid or ArrowTypeError.
    """
    csv.write_csv(pa.Table.from_pandas(table, preserve_index=False), path)


def without_formulas(table: pd.DataFrame) -> pd.DataFrame:
    """Put an apostrophe before text that a spreadsheet would evaluate as a formula.

    Examples
    --------
    >>> without_formulas(pd.DataFrame({"scenario": ["street", "=1+1"]}))["scenario"].tolist()
    ['street', "'=1+1"]
    """
    guarded = {}
    for name in table.columns:
        if pd.api.types.infer_dtype(table[name], skipna=True) == "string":
            is_formula = table[name].str.match(FORMULA, na=False)
            guarded[name] = table[name].mask(is_formula, GUARD + table[name])
    return table.assign(**guarded)


def _table_digest(table: pd.DataFrame) -> str:
    """Digest of the names and values of a table."""
    rows = pd.util.hash_pandas_object(table, index=False).to_numpy()
    return digest([list(table.columns), len(table), hashlib.sha256(rows.tobytes()).hexdigest()])


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
        with write_errors(path, ROWS_KEPT):
            # Unbuffered: a line is on its way when it is written, so that a kill tears at most one.
            self._file = path.open("xb", buffering=0)
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
        with write_errors(self._path, ROWS_KEPT):
            while rest:  # a disk that is nearly full takes a part before it refuses
                rest = rest[self._file.write(rest) :]


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
