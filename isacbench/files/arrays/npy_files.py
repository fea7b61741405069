"""Arrays as npy files hold them: headers are held against files before room is made for numbers."""

from __future__ import annotations

import io
from math import prod
from typing import IO, TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np

from isacbench.errors import InputError
from isacbench.files.checked_files import binary_size

if TYPE_CHECKING:
    import zipfile
    from pathlib import Path

    from numpy.typing import NDArray

Order = Literal["C", "F"]

SUFFIX = ".npy"
"""Of arrays in an npz file."""

MAGIC_BYTES = 8
LENGTH_BYTES = {(1, 0): 2, (2, 0): 4}
"""Bytes of the header's length, by version; 3 differs in names of fields, which arrays of numbers lack."""

HEADER_BYTES = 1024
"""More than a header of numbers ever takes, and few enough to be parsed in no time."""


class Header(NamedTuple):
    """What an npy header says of the array behind it.

    Attributes
    ----------
    shape : tuple of int
    order : {"C", "F"}
    dtype : dtype
    offset : int
        Byte at which the numbers begin.
    """

    shape: tuple[int, ...]
    order: Order
    dtype: np.dtype[Any]
    offset: int

    @property
    def n_bytes(self) -> int:
        """Bytes of the numbers."""
        return prod(self.shape) * self.dtype.itemsize

    @property
    def end(self) -> int:
        """Byte behind the last number."""
        return self.offset + self.n_bytes


def read_header(file: IO[bytes]) -> Header:
    """Read the header of an npy file from where it begins.

    Raises
    ------
    ValueError
        If it is none, or a longer one than numbers take; nothing is ever unpickled.
    """
    start = file.read(MAGIC_BYTES)
    version = np.lib.format.read_magic(io.BytesIO(start))
    if version not in LENGTH_BYTES:
        raise ValueError(f"version {version} of the format, where arrays of numbers have 1.0 or 2.0")
    length = file.read(LENGTH_BYTES[version])
    n_bytes = int.from_bytes(length, "little")
    if n_bytes > HEADER_BYTES:
        raise ValueError(f"a header of {n_bytes} bytes, where arrays of numbers have {HEADER_BYTES} at most")
    header = io.BytesIO(length + file.read(n_bytes))
    parse = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, fortran_order, dtype = parse(header)
    if min(shape, default=0) < 0:
        raise ValueError(f"shape {shape}, where no length is negative")
    return Header(shape, "F" if fortran_order else "C", dtype, MAGIC_BYTES + len(length) + n_bytes)


def read_array(file: IO[bytes], held_bytes: int, limit_bytes: int) -> NDArray[Any]:
    """Read an array from where its npy file begins.

    Parameters
    ----------
    file : binary file
    held_bytes : int
        What the file holds, as far as is known: a directory may lie.
    limit_bytes : int
        Most that the array may take.

    Returns
    -------
    ndarray
        Read-only, in the file's byte and memory order.

    Raises
    ------
    ValueError
        If it is damaged, shorter than its header says or larger than
        allowed, or holds Python objects, which are never unpickled.
    """
    header = read_header(file)
    if header.dtype.hasobject:
        raise ValueError("Object arrays cannot be loaded when allow_pickle=False")
    if header.n_bytes > limit_bytes:
        raise ValueError(
            f"an array of {header.dtype} of shape {header.shape} takes {binary_size(header.n_bytes)}; "
            f"allowed are at most {binary_size(limit_bytes)}"
        )
    if header.end > held_bytes:
        raise ValueError(
            f"truncated: {header.dtype} of shape {header.shape} takes {header.end} bytes, it has {held_bytes}"
        )
    return np.ndarray(header.shape, header.dtype, _read(file, header.n_bytes), order=header.order)


def _read(file: IO[bytes], n_bytes: int) -> NDArray[np.uint8]:
    """So many bytes of a file, straight to where they stay."""
    data = np.empty(n_bytes, np.uint8)
    n_read, rest = 0, data.data
    while n_read < n_bytes and (n_more := cast("io.BufferedIOBase", file).readinto(rest[n_read:])):
        n_read += n_more
    if n_read < n_bytes:
        raise ValueError(f"truncated: {n_read} of {n_bytes} bytes of numbers")
    data.setflags(write=False)
    return data


def read_members(archive: zipfile.ZipFile, path: Path, limit_bytes: int) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz file by name.

    Parameters
    ----------
    archive : ZipFile
    path : Path
        For messages.
    limit_bytes : int
        Most that all of them may take, decompressed.

    Raises
    ------
    InputError
        If they take more.
    ValueError
        As `read_array` does.
    """
    arrays: dict[str, NDArray[Any]] = {}
    left_bytes = limit_bytes
    for member in archive.infolist():
        if member.filename.endswith(SUFFIX):
            if member.file_size > left_bytes + HEADER_BYTES:
                raise InputError(
                    f"{path}: {member.filename} takes {binary_size(member.file_size)} decompressed; "
                    f"allowed are at most {binary_size(limit_bytes)} for all arrays together"
                )
            with archive.open(member) as file:
                array = read_array(file, member.file_size, left_bytes)
            arrays[member.filename.removesuffix(SUFFIX)] = array
            left_bytes -= array.nbytes
    return arrays
