"""The folder that a run writes into: its own, and nobody else's as long as the run goes on."""

from __future__ import annotations

import fcntl
import os
import platform
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from isacbench.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["default_folder", "open_folder", "replacing"]

LOCK = ".lock"
RUN_FILES = {LOCK, "manifest.json", "results.parquet", "journal.jsonl"}
"""A folder with one of them is the folder of a run."""


def default_folder(suite_name: str) -> Path:
    """Return the folder ``results/<suite>-<time>`` of a run that starts now."""
    return Path("results") / f"{suite_name}-{datetime.now():%Y%m%d-%H%M%S}"


@contextmanager
def open_folder(folder: Path | None) -> Iterator[Path]:
    """Create the folder of a run or enter an existing one, and keep other runs out of it.

    Parameters
    ----------
    folder : Path or None
        None for a temporary one. A folder that is new and left without a
        file is taken away again.

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
    is_new = _create(folder)
    try:
        with _locked(folder):
            yield folder
    finally:
        if is_new and {path.name for path in folder.iterdir()} <= {LOCK}:
            (folder / LOCK).unlink(missing_ok=True)
            folder.rmdir()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path that takes the place of `path` once it is written whole and on the disk."""
    temporary = path.with_name(f".{path.name}.part")
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _create(folder: Path) -> bool:
    """Create a folder unless it exists; whether it is new."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError as error:
        names = {path.name for path in folder.iterdir()} if folder.is_dir() else {folder.name}
        if names and not names & RUN_FILES:
            raise InputError(
                f"{folder}: exists and is not the folder of a run; allowed are a new folder, an empty one, "
                "or that of a run to go on with; nothing was overwritten"
            ) from error
        return False
    except OSError as error:
        raise InputError(f"{folder}: cannot be created: {error.strerror}") from error
    return True


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system lets go of whatever ends this process."""
    with (folder / LOCK).open("a+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            file.seek(0)
            raise InputError(
                f"{folder}: another run writes into it ({file.read() or 'unknown'}); allowed is to "
                "wait for its end, or another folder"
            ) from error
        file.truncate(0)
        now = datetime.now().astimezone().isoformat(timespec="seconds")
        file.write(f"process {os.getpid()} on {platform.node()}, since {now}")
        file.flush()
        yield
