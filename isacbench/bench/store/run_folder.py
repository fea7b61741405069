"""Folder of a run: names of its files, one run writes into it at a time, each file is replaced as a whole."""

from __future__ import annotations

import fcntl
import os
import platform
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from isacbench.errors import AccessError, InputError
from isacbench.files.checked_files import open_own, require_utf8, write_errors

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
def replacing(path: Path, afterwards: str = ROWS_KEPT) -> Iterator[Path]:
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
