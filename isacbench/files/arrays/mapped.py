"""Bytes of a file, mapped into memory piece by piece."""

from __future__ import annotations

import mmap
import os
from pathlib import Path
from typing import IO, TYPE_CHECKING, Protocol

import numpy as np

from isacbench.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Bytes(Protocol):
    """Bytes that arrays are read from, by any thread.

    Attributes
    ----------
    sequential : bool
        Whether reading backwards costs more than reading on.
    """

    sequential: bool

    def read(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Bytes from `start` to before `stop`, which lies behind it and inside; not to be written to."""

    def close(self) -> None:
        """Close the file."""


class MappedBytes(Bytes):
    """Bytes of a file as they stand there.

    Every read maps just its own pages, and they are released with the array
    that it returned: one map of the whole file would keep all pages resident
    that were ever looked at.

    Parameters
    ----------
    path : Path
    offset : int
        Where in the file the bytes begin.
    """

    sequential = False

    def __init__(self, path: Path, offset: int = 0) -> None:
        self._file: IO[bytes] = path.open("rb")
        self._offset = offset

    def read(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Map bytes from `start` to before `stop`.

        Raises
        ------
        InputError
            If the file ends before.
        """
        first = self._offset + start
        size = os.fstat(self._file.fileno()).st_size
        if self._offset + stop > size:
            raise InputError(
                f"{self._file.name}: is truncated: byte {self._offset + stop} is wanted, it has {size}"
            )
        page = first - first % mmap.ALLOCATIONGRANULARITY
        length = self._offset + stop - page
        mapped = mmap.mmap(self._file.fileno(), length, access=mmap.ACCESS_READ, offset=page)
        return np.frombuffer(mapped, dtype=np.uint8, offset=first - page)

    def close(self) -> None:
        """Close the file; pieces that are still mapped stay so."""
        self._file.close()
