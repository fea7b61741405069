"""The folder that a run writes into: its own, and nobody else's as long as the run goes on."""

from __future__ import annotations

import fcntl
import os
import platform
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TextIO

from isacbench.errors import InputError
from isacbench.files.checked_files import is_there, open_own, require_file, require_inside

if TYPE_CHECKING:
    from collections.abc import Iterator
    from collections.abc import Set as AbstractSet

LOCK = ".lock"
ROWS_KEPT = "; the rows so far are kept, and the same run into the same folder goes on with them"
RUN_FILES = frozenset({LOCK, "manifest.json", "results.parquet", "journal.jsonl"})
"""A folder with one of them is the folder of a run."""


def default_folder(suite_name: str) -> Path:
    """Return the folder ``results/<suite>-<time>`` of a run that starts now."""
    return Path("results") / f"{suite_name}-{datetime.now():%Y%m%d-%H%M%S}"


@contextmanager
def open_folder(
    folder: Path | None, files: AbstractSet[str] = RUN_FILES, what: str = "a run"
) -> Iterator[Path]:
    """Create the folder of a run or enter an existing one, and keep other runs out of it.

    Parameters
    ----------
    folder : Path or None
        None for a temporary one. A folder that is new and left without a
        file is taken away again.
    files : set of str
        Names of which an existing folder must have one.
    what : str
        Whose folder it then is, in words.

    Raises
    ------
    InputError
        If it cannot be created, holds something else, or another run writes
        into it.
    """
    if folder is None:
        with TemporaryDirectory(prefix="isacbench-") as temporary:
            yield Path(temporary)
        return
    is_new = _create(folder, files, what)
    with _locked(folder):
        try:
            yield folder
        finally:
            if is_new and {path.name for path in folder.iterdir()} <= {LOCK}:
                (folder / LOCK).unlink()
                folder.rmdir()


@contextmanager
def replacing(path: Path, afterwards: str = ROWS_KEPT) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` once it is written whole and on the disk.

    Parameters
    ----------
    path : Path
    afterwards : str
        Last words of the message where it cannot be written.

    Raises
    ------
    InputError
        If the system does not let it.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.unlink(missing_ok=True)  # somebody may have left a symbolic link of that name
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise cannot_be_written(path, error, afterwards) from error
    finally:
        with suppress(OSError):  # what could not be made cannot be in the way
            temporary.unlink(missing_ok=True)


def cannot_be_written(path: Path, error: OSError, afterwards: str = ROWS_KEPT) -> InputError:
    """Build the exception for a disk that is full, or a folder that is not ours."""
    return InputError(f"{path}: cannot be written: {error.strerror or error}{afterwards}")


def require_unlocked(folder: Path) -> None:
    """Refuse a folder that a run writes into at this moment; nothing is written to find out.

    Raises
    ------
    InputError
        If there is such a run, or the lock cannot be looked at.
    """
    lock = folder / LOCK
    if not is_there(lock):
        return
    require_inside(lock, folder)
    require_file(lock)
    try:
        with lock.open(encoding="utf-8", errors="replace") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(f"{folder}: a run writes into it") from error
    except OSError as error:
        raise InputError(f"{lock}: cannot be looked at: {error.strerror or error}") from error


def _create(folder: Path, files: AbstractSet[str], what: str) -> bool:
    """Create a folder unless it exists; whether it is new."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError as error:
        names = _names(folder)
        if names and not names & files:
            raise InputError(
                f"{folder}: exists and is not the folder of {what}; allowed are a new folder, an empty one, "
                f"or that of {what} to go on with; nothing was overwritten"
            ) from error
        return False
    except (OSError, ValueError) as error:
        raise InputError(
            f"{folder}: cannot be created: {getattr(error, 'strerror', None) or error}"
        ) from error
    return True


def _names(folder: Path) -> set[str]:
    """What is in a folder; of what is none, its own name."""
    try:
        return {path.name for path in folder.iterdir()} if folder.is_dir() else {folder.name}
    except OSError as error:
        raise InputError(f"{folder}: cannot be looked into: {error.strerror or error}") from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system lets go of whatever ends this process."""
    with _lock_file(folder) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            file.seek(0)
            raise InputError(
                f"{folder}: another run writes into it ({file.read() or 'unknown'}); allowed is to "
                "wait for its end, or another folder"
            ) from error
        except OSError as error:
            raise _cannot_be_locked(folder, error) from error
        file.truncate(0)
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        file.write(f"process {os.getpid()} on {platform.node()}, since {now}")
        file.flush()
        yield


def _lock_file(folder: Path) -> TextIO:
    try:
        return os.fdopen(open_own(folder / LOCK, os.O_RDWR | os.O_APPEND), "a+", encoding="utf-8")
    except OSError as error:
        raise _cannot_be_locked(folder, error) from error


def _cannot_be_locked(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"{folder}: cannot be locked: {error.strerror or error}; allowed is a folder that can be written "
        "into, on a file system with locks"
    )
