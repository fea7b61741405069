"""Bytes of a compressed stream: read on at the speed of decompression, read again from checkpoints."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from threading import Lock
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.mapped import Bytes

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

ZLIB, RAW_DEFLATE = zlib.MAX_WBITS, -zlib.MAX_WBITS
"""What surrounds the compressed data: zlib's header and checksum, or nothing."""

INPUT_BYTES = 2**15
OUTPUT_BYTES = 2**20
"""Most that is read and decompressed in one step."""

CHECKPOINT_BYTES = 16 * 2**20
"""Decompressed bytes between checkpoints of some 70 kB each: 4 MB for a cube of the paper's size."""


class _State(NamedTuple):
    """Decompression at some place of the stream, from where it can go on."""

    position: int
    next_input: int
    checksum: int
    decompressor: Any

    def kept(self) -> _State:
        """A copy that going on does not change."""
        return self._replace(decompressor=self.decompressor.copy())


class InflatedBytes(Bytes):
    """Decompressed bytes of a part of a file.

    Reading on costs what decompression costs, and skipping as much. Reading
    backwards goes on from the nearest checkpoint before.

    Parameters
    ----------
    path : Path
    start, stop : int
        Where in the file the compressed stream lies.
    size : int
        Bytes that it decompresses to, as far as they are used.
    wrapping : int
        `ZLIB` or `RAW_DEFLATE`.
    checksum : int or None
        CRC-32 of the decompressed bytes, where the file tells it.
    """

    sequential = True

    def __init__(
        self, path: Path, start: int, stop: int, size: int, wrapping: int, checksum: int | None = None
    ) -> None:
        self._path = path
        self._file: IO[bytes] = path.open("rb")
        self._stop = stop
        self._size = size
        self._checksum = checksum
        self._lock = Lock()
        self._now = _State(0, start, 0, zlib.decompressobj(wrapping))
        self._checkpoints = [self._now.kept()]

    def read(self, start: int, stop: int) -> NDArray[np.uint8]:
        """Decompress bytes from `start` to before `stop`.

        Raises
        ------
        InputError
            If the stream is damaged or ends early.
        """
        wanted = np.empty(stop - start, np.uint8)
        with self._lock:
            self._go_back(start)
            while self._now.position < start:
                self._inflate(start - self._now.position)
            while self._now.position < stop:
                at = self._now.position
                piece = self._inflate(stop - at)
                wanted[at - start : at - start + len(piece)] = np.frombuffer(piece, np.uint8)
        return wanted

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _go_back(self, start: int) -> None:
        """Resume from the nearest checkpoint where the place lies behind, or far ahead of, what was read."""
        places = [state.position for state in self._checkpoints]
        nearest = self._checkpoints[bisect_right(places, start) - 1]
        if self._now.position > start or self._now.position < nearest.position:
            self._keep()
            self._now = nearest.kept()

    def _keep(self) -> None:
        """Make the present place a checkpoint, unless it lies close behind one."""
        places = [state.position for state in self._checkpoints]
        place = bisect_right(places, self._now.position)
        if self._now.position - places[place - 1] >= CHECKPOINT_BYTES:
            self._checkpoints.insert(place, self._now.kept())

    def _inflate(self, most: int) -> bytes:
        """Decompress the next bytes, no more than so many."""
        position, next_input, checksum, decompressor = self._now
        data = decompressor.unconsumed_tail
        if not data:
            self._file.seek(next_input)
            data = self._file.read(min(INPUT_BYTES, self._stop - next_input))
            next_input += len(data)
        try:
            piece: bytes = decompressor.decompress(data, min(most, OUTPUT_BYTES))
        except zlib.error as error:
            raise self._damaged(str(error)) from error
        if not piece and not data:
            raise self._damaged(f"the compressed data end at {position} of {self._size} bytes")
        self._now = _State(position + len(piece), next_input, zlib.crc32(piece, checksum), decompressor)
        if self._now.position == self._size:
            self._compare_checksums()
        self._keep()
        return piece

    def _compare_checksums(self) -> None:
        """Compare the checksum of what was decompressed, all of it, with the one in the file."""
        if self._checksum is not None and self._now.checksum != self._checksum:
            raise self._damaged("the checksum differs")
        # zlib's own stands behind the data, and is compared by going there.
        self._file.seek(self._now.next_input)
        rest = self._file.read(min(INPUT_BYTES, self._stop - self._now.next_input))
        decompressor = self._now.decompressor.copy()
        try:
            decompressor.decompress(decompressor.unconsumed_tail + rest, OUTPUT_BYTES)
        except zlib.error as error:
            raise self._damaged(str(error)) from error

    def _damaged(self, reason: str) -> InputError:
        return InputError(f"{self._path}: is damaged: {reason}")
