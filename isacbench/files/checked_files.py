"""Files that users name: checked before they are opened, read up to a limit, never overwritten by mistake."""

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from isacbench.errors import AccessError, InputError

TOML_BYTES = 2**20
"""Largest scenario or suite: ten thousand objects."""

SOURCE_BYTES = 2**24
"""Largest source of a plugin."""

CLOUD_BYTES = 2**28
"""Largest point cloud, in its file and as an array: 6.7 million points of five doubles."""

GRID_BYTES = 2**28
"""Largest transmitted grid as complex128: 16.8 million resource elements, 36 times the paper's."""

HELD_BYTES = 2**32
"""Largest array or file of a format that is read as a whole: a cube four times the paper's."""

MANIFEST_BYTES = 2**28
"""Largest manifest of a run: some hundred thousand scenes."""

PICTURES = ".png", ".pdf", ".svg"


def known_suffix(path: Path, allowed: Iterable[str], takes: str) -> str:
    """Return the suffix of a path in small letters; refuse one that is not among those allowed."""
    suffix = path.suffix.lower()
    if suffix not in allowed:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(f"{path}: has {found}; {takes} {', '.join(allowed)}")
    return suffix


def require_file(path: Path, limit_bytes: int | None = None, missing: str = "does not exist") -> int:
    """Refuse a path that is not a regular file of at most the largest size; return its size.

    `missing` are the words for a file that does not exist.
    """
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: {missing}") from None
    except OSError as error:
        raise AccessError(f"{path}: cannot be accessed: {error.strerror}") from error
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: is not a file")
    if limit_bytes is not None and found.st_size > limit_bytes:
        raise InputError(
            f"{path}: has {binary_size(found.st_size)}; allowed are at most {binary_size(limit_bytes)}"
        )
    return found.st_size


def require_utf8(path: Path) -> None:
    """Refuse a name that no table, page or file of text can hold."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise AccessError(f"{path}: its name is not UTF-8; rename it") from error


def path_exists(path: Path) -> bool:
    """Tell if a path exists, also as a symbolic link whose target is missing."""
    return os.path.lexists(path)


def require_picture(path: Path) -> None:
    """Refuse a picture without an extension of a format that can be drawn."""
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: a picture takes the extension .png, .pdf or .svg")


def require_replaceable(path: Path) -> None:
    """Refuse a file that could not be written or replaced; call it before the work whose result it takes."""
    with write_errors(path):
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: cannot be written: is not a file")
        if not path.parent.is_dir():
            raise InputError(f"{path}: cannot be written: there is no folder {path.parent}")


@contextmanager
def write_errors(path: Path, afterwards: str = "") -> Iterator[None]:
    """Name the file in an error of the system while it is written; `afterwards` ends the message."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}{afterwards}") from error


def require_new(path: Path) -> None:
    """Refuse to overwrite, and to write where no folder is."""
    if path_exists(path):
        raise InputError(f"{path}: exists already and is not overwritten")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder {path.parent} does not exist")


def read_text(path: Path, limit_bytes: int, missing: str = "does not exist") -> str:
    """Read a file of UTF-8 text, with or without a byte order mark, of at most the largest size."""
    require_file(path, limit_bytes, missing)
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start})") from error
    except OSError as error:
        raise AccessError(f"{path}: cannot be read: {error.strerror}") from error


def require_inside(path: Path, *folders: Path) -> None:
    """Refuse a path outside some folders, where another person's file or folder names it.

    A file from somebody else must not make a user's program read files of the
    user elsewhere, and quote them in messages.
    """
    if not any(path.resolve().is_relative_to(folder.resolve()) for folder in folders):
        raise InputError(
            f"{path}: leads out of the folder {folders[0]}; allowed is a file in it or in a folder below it, "
            "and no symbolic link to elsewhere"
        )


def open_own(path: Path, flags: int) -> int:
    """Open or create a file of isacbench for writing, never through a symbolic link."""
    return os.open(path, flags | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)


def make_own_folder(path: Path) -> None:
    """Make a folder if it does not exist."""
    with write_errors(path):
        path.mkdir(parents=True, exist_ok=True)


def binary_size(n_bytes: int) -> str:
    """Write a number of bytes in units of 1024.

    Examples
    --------
    >>> binary_size(2**20), binary_size(100), binary_size(3 * 2**29)
    ('1 MiB', '100 bytes', '1.5 GiB')
    """
    for unit, size in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if n_bytes >= size:
            return f"{n_bytes / size:.4g} {unit}"
    return f"{n_bytes} bytes"
