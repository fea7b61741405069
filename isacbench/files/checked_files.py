"""Files that users name: checked before they are opened, read up to a limit, written only in place.

A path may lead to something other than a file by mistake: a pipe without a
writer, an endless device, a link to a file elsewhere.
"""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING

from isacbench.errors import AccessError, InputError

if TYPE_CHECKING:
    from pathlib import Path

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


def require_file(path: Path, limit_bytes: int | None = None, missing: str = "does not exist") -> int:
    """Refuse a path that is not a regular file of at most the largest size.

    Parameters
    ----------
    path : Path
        Symbolic links are followed.
    limit_bytes : int, optional
        Largest size.
    missing : str
        Words for a file that does not exist.

    Returns
    -------
    int
        Size in bytes.

    Raises
    ------
    InputError
        If it does not exist, is not a regular file or is too large.
    """
    found = _looked_at(path)
    if found is None:
        raise InputError(f"{path}: {missing}")
    _require_regular(path, found)
    if limit_bytes is not None and found.st_size > limit_bytes:
        raise InputError(
            f"{path}: has {binary_size(found.st_size)}; allowed are at most {binary_size(limit_bytes)}"
        )
    return found.st_size


def require_utf8(path: Path) -> None:
    """Refuse a name that no table, page or file of text can hold.

    Parameters
    ----------
    path : Path

    Raises
    ------
    AccessError
        If it is not UTF-8.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise AccessError(f"{path}: its name is not UTF-8; rename it") from error


def is_there(path: Path) -> bool:
    """Tell if a path exists, also as a symbolic link whose target is missing.

    Parameters
    ----------
    path : Path

    Returns
    -------
    bool
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be accessed: {_reason(error)}") from error
    return True


def require_writable(path: Path) -> None:
    """Refuse to write to a path that is not a file, such as a pipe or a folder.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If it is a folder, a pipe or a device.
    """
    found = _looked_at(path)
    if found is not None:
        _require_regular(path, found, "cannot be written: ")


def require_picture(path: Path) -> None:
    """Refuse a picture without an extension of a format that can be drawn.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If it is not .png, .pdf or .svg.
    """
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"{path}: a picture takes the extension .png, .pdf or .svg")


def require_replaceable(path: Path) -> None:
    """Refuse a file that could not be written or replaced; call it before the work whose result it takes.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If its folder does not exist, or it is a symbolic link, a folder, a
        pipe or a device.
    """
    require_writable(path)
    if path.is_symlink():
        raise _elsewhere(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: there is no folder {path.parent}")


def require_new(path: Path) -> None:
    """Refuse to overwrite, and to write where no folder is.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If the path exists, or its folder does not.
    """
    if is_there(path):
        raise InputError(f"{path}: exists already and is not overwritten")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder {path.parent} does not exist")


def read_text(path: Path, limit_bytes: int, missing: str = "does not exist") -> str:
    """Read a file of UTF-8 text, with or without a byte order mark, up to a limit.

    Parameters
    ----------
    path : Path
    limit_bytes : int
        Largest size.
    missing : str
        Words for a file that does not exist.

    Returns
    -------
    str

    Raises
    ------
    InputError
        As `require_file` does; or if it cannot be read or is not UTF-8 text.
    """
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

    Parameters
    ----------
    path : Path
        Named or found path.
    *folders : Path
        Allowed folders, the first one for messages.

    Raises
    ------
    InputError
        If the path, or the target of its symbolic links, lies elsewhere.
    """
    try:
        target = path.resolve()
        inside = any(target.is_relative_to(folder.resolve()) for folder in folders)
    except (OSError, RuntimeError, ValueError) as error:  # a name that is too long, links in a circle, NUL
        raise InputError(f"{path}: cannot be accessed: {_reason(error)}") from error
    if not inside:
        raise InputError(
            f"{path}: leads out of the folder {folders[0]}; allowed is a file in it or in a folder below it, "
            "and no symbolic link to elsewhere"
        )


def open_own(path: Path, flags: int) -> int:
    """Open a file of isacbench for writing, never through a symbolic link.

    Parameters
    ----------
    path : Path
        Created, if it does not exist.
    flags : int
        As `os.open` takes them: how to write.

    Returns
    -------
    int
        File descriptor.

    Raises
    ------
    InputError
        If it is a symbolic link, a pipe or a device.
    OSError
        If the system refuses.
    """
    if path.is_symlink():
        raise _elsewhere(path)
    if not path.is_dir():  # the system reports a folder itself
        require_writable(path)
    return os.open(path, flags | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)


def make_own_folder(path: Path) -> None:
    """Make a folder if it does not exist, never through a symbolic link.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        If it is a symbolic link, or cannot be written.
    """
    if path.is_symlink():
        raise _elsewhere(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def binary_size(n_bytes: int) -> str:
    """Write a number of bytes in units of 1024.

    Parameters
    ----------
    n_bytes : int

    Returns
    -------
    str

    Examples
    --------
    >>> binary_size(2**20), binary_size(100), binary_size(3 * 2**29)
    ('1 MiB', '100 bytes', '1.5 GiB')
    """
    for unit, size in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if n_bytes >= size:
            return f"{n_bytes / size:.4g} {unit}"
    return f"{n_bytes} bytes"


def _looked_at(path: Path) -> os.stat_result | None:
    """Status of a path; None if it does not exist."""
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:  # too long, no permission, links in a circle, NUL
        raise AccessError(f"{path}: cannot be accessed: {_reason(error)}") from error


def _require_regular(path: Path, found: os.stat_result, prefix: str = "") -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a pipe or a device"
        raise InputError(f"{path}: {prefix}is {kind}, not a file")


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _elsewhere(path: Path) -> InputError:
    return InputError(f"{path}: is a symbolic link; give a file or folder that is not a link")
