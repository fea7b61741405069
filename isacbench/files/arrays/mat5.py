"""Layout of MATLAB's mat files of versions 5 to 7: what arrays there are, and where their numbers lie.

A file is a header of 128 bytes, then elements: a tag of type and length, then data. An array is an element
of elements: flags, dimensions, name, real part, imaginary part. From version 7 on it may be a zlib stream.

References
----------
MathWorks, "MAT-File Format", chapter 1: level 5.
"""

from __future__ import annotations

import struct
import zlib
from contextlib import closing
from math import prod
from typing import IO, TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.inflated import OUTPUT_BYTES, ZLIB, InflatedBytes
from isacbench.files.arrays.listing import Listed, too_large
from isacbench.files.arrays.mapped import Bytes, MappedBytes
from isacbench.files.arrays.raw_arrays import RawArray

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

ByteOrder = Literal["<", ">"]
Shape = tuple[int, int, int, int]

FILE_HEADER_BYTES = 128
BYTE_ORDERS: dict[bytes, ByteOrder] = {b"IM": "<", b"MI": ">"}
LEVEL_5 = 0x0100

HEAD_BYTES = 4096
"""Enough for flags, dimensions and name of any array."""

MATRIX, COMPRESSED = 14, 15
PART_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types that numbers are stored in; MATLAB stores whole numbers in the smallest that holds them."""

OPAQUE = 17
CLASSES = {
    4: "U1",
    6: "f8",
    7: "f4",
    8: "i1",
    9: "u1",
    10: "i2",
    11: "u2",
    12: "i4",
    13: "u4",
    14: "i8",
    15: "u8",
}
"""Types of arrays: characters and numbers; all others are cells, structures and the like."""

CLASS_BITS, COMPLEX_BIT = 0x00FF, 0x0800


class MatArray(NamedTuple):
    """An array of a mat file.

    Attributes
    ----------
    listed : Listed
        Shape and type.
    start, stop : int
        Where its element lies in the file: with its tag, or the stream that holds it.
    compressed : bool
        Whether that is a stream.
    parts : int
        Byte of the element at which the tag of the real part stands.
    end : int
        Byte behind the element, decompressed.
    byte_order : {"<", ">"}
    """

    listed: Listed
    start: int
    stop: int
    compressed: bool
    parts: int
    end: int
    byte_order: ByteOrder


class _Tag(NamedTuple):
    """Tag of an element: type of its data, where they begin, how many bytes they take, where the next is."""

    kind: int
    start: int
    size: int
    following: int


def list_arrays(path: Path) -> dict[str, MatArray]:
    """List the arrays of a mat file by name.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict of str to MatArray

    Raises
    ------
    InputError
        If the file is none of versions 5 to 7, or ends within an array.
    """
    with path.open("rb") as file:
        byte_order = _byte_order(path, file.read(FILE_HEADER_BYTES))
        return dict(_arrays(path, file, byte_order))


def require_at_most(path: Path, arrays: Mapping[str, MatArray], limit_bytes: int) -> None:
    """Refuse arrays that take more memory than is allowed, whatever the file says of their sizes.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to MatArray
    limit_bytes : int
        Most that all of them may take, decompressed.

    Raises
    ------
    InputError
        If they take more.
    """
    left_bytes = limit_bytes
    with path.open("rb") as file:
        for array in arrays.values():
            left_bytes -= _taken(file, array, left_bytes)
            if left_bytes < 0:
                raise too_large(path, limit_bytes)


def _taken(file: IO[bytes], array: MatArray, most: int) -> int:
    """Bytes of an element, decompressed as far as they are not more than so many."""
    if not array.compressed:
        return array.stop - array.start
    file.seek(array.start)
    decompressor, taken, data = zlib.decompressobj(), 0, b""
    while taken <= most and not decompressor.eof:
        if not data:
            data = file.read(min(HEAD_BYTES * 16, array.stop - file.tell()))
        if not data:
            break
        taken += len(decompressor.decompress(data, OUTPUT_BYTES))
        data = decompressor.unconsumed_tail
    return taken


def open_bytes(path: Path, array: MatArray) -> Bytes:
    """Bytes of the element of an array, decompressed."""
    if array.compressed:
        return InflatedBytes(path, array.start, array.stop, array.end, ZLIB)
    return MappedBytes(path, array.start)


def real_part(path: Path, source: Bytes, array: MatArray, shape: Shape) -> RawArray:
    """Real part of an array, as the numbers that stand in the file.

    Parameters
    ----------
    path : Path
    source : Bytes
        From `open_bytes`.
    array : MatArray
    shape : (int, int, int, int)
        The array's, with the trailing ones that MATLAB drops.

    Raises
    ------
    InputError
        If its length is not that of the array.
    """
    return _part(path, source, array, shape, array.parts)


def imaginary_part(path: Path, source: Bytes, array: MatArray, shape: Shape) -> RawArray:
    """Imaginary part of an array, see `real_part`; in a stream, finding it decompresses the real part."""
    real = _read_tag(source, array.parts, array.byte_order)
    return _part(path, source, array, shape, real.following)


def read_numbers(path: Path, array: MatArray) -> NDArray[Any]:
    """Read an array of numbers whole.

    Parameters
    ----------
    path : Path
    array : MatArray
        Of real or complex numbers, and not too large, see `require_at_most`.

    Returns
    -------
    ndarray
        Of the array's shape and type.

    Raises
    ------
    InputError
        If its parts are no such array.
    """
    shape, dtype = array.listed
    with closing(open_bytes(path, array)) as source:
        real = _read_tag(source, array.parts, array.byte_order)
        numbers = _numbers(path, source, array, real).astype(dtype, order="F")
        if dtype.kind == "c":
            numbers.imag = _numbers(path, source, array, _read_tag(source, real.following, array.byte_order))
    return numbers.reshape(shape)


def _numbers(path: Path, source: Bytes, array: MatArray, tag: _Tag) -> NDArray[Any]:
    """Numbers of a part, as they are stored."""
    shape = array.listed.shape
    dtype = _stored_type(path, array, shape, tag)
    if not tag.size:
        return np.empty(shape, dtype, order="F")
    return np.ndarray(shape, dtype, source.read(tag.start, tag.start + tag.size), order="F")


def _part(path: Path, source: Bytes, array: MatArray, shape: Shape, at: int) -> RawArray:
    """Part of an array whose tag stands at some byte of the element."""
    tag = _read_tag(source, at, array.byte_order)
    return RawArray(source, tag.start, shape, _stored_type(path, array, shape, tag), "F")


def _stored_type(path: Path, array: MatArray, shape: tuple[int, ...], tag: _Tag) -> np.dtype[Any]:
    """Type that a part is stored in, whose length has to be that of the array."""
    dtype = np.dtype(array.byte_order + PART_TYPES.get(tag.kind, "V1"))
    if (
        dtype.kind == "V"
        or min(shape) < 0
        or tag.size != prod(shape) * dtype.itemsize
        or tag.start + tag.size > array.end
    ):
        raise InputError(
            f"{path}: is damaged: {tag.size} bytes of type {tag.kind} are no part of an array {shape}"
        )
    return dtype


def _byte_order(path: Path, header: bytes) -> ByteOrder:
    """Byte order of a file by its header."""
    byte_order = BYTE_ORDERS.get(header[126:128])
    if byte_order is None or struct.unpack(f"{byte_order}H", header[124:126]) != (LEVEL_5,):
        raise InputError(f"{path}: is no mat file of MATLAB's save options -v6, -v7 or -v7.3")
    return byte_order


def _arrays(path: Path, file: IO[bytes], byte_order: ByteOrder) -> Iterator[tuple[str, MatArray]]:
    """Names and places of the arrays, one after another."""
    size = path.stat().st_size
    at = FILE_HEADER_BYTES
    while at < size:
        file.seek(at)
        eight = file.read(8)
        tag = _tag(eight.ljust(8, b"\0"), at, byte_order)
        stop = tag.start + tag.size
        if len(eight) < 8 or stop > size:
            raise InputError(f"{path}: is truncated: the array at byte {at} goes beyond its {size} bytes")
        start = tag.start if tag.kind == COMPRESSED else at
        file.seek(start)
        head = file.read(min(HEAD_BYTES, stop - start))
        if tag.kind == COMPRESSED:
            head = zlib.decompressobj().decompress(head, HEAD_BYTES)
        found = _array(head, byte_order)
        if found is not None:
            name, listed, parts, end = found
            yield name, MatArray(listed, start, stop, tag.kind == COMPRESSED, parts, end, byte_order)
        at = stop


def _array(head: bytes, byte_order: ByteOrder) -> tuple[str, Listed, int, int] | None:
    """Name of an array, what it is, where its parts begin and where it ends, from its first bytes.

    None for what has no name, such as the data behind MATLAB's objects.
    """

    def tag_at(at: int) -> _Tag:
        return _tag(head[at : at + 8], at, byte_order)

    matrix = tag_at(0)
    if matrix.kind != MATRIX:
        return None
    flags = tag_at(matrix.start)
    (word,) = struct.unpack_from(f"{byte_order}I", head, flags.start)
    if word & CLASS_BITS == OPAQUE:
        return None
    dimensions = tag_at(flags.following)
    shape = struct.unpack_from(f"{byte_order}{dimensions.size // 4}i", head, dimensions.start)
    name = tag_at(dimensions.following)
    text = head[name.start : name.start + name.size].decode("latin1")
    if not text:
        return None
    return text, Listed(shape, _dtype(word)), name.following, matrix.start + matrix.size


def _read_tag(source: Bytes, at: int, byte_order: ByteOrder) -> _Tag:
    """Tag at some byte of an element."""
    return _tag(source.read(at, at + 8).tobytes(), at, byte_order)


def _tag(eight: bytes, at: int, byte_order: ByteOrder) -> _Tag:
    """Tag in eight bytes that stand at some place; up to four bytes of data can stand in the tag itself."""
    kind, size = struct.unpack(f"{byte_order}II", eight)
    if kind >> 16:
        return _Tag(kind & 0xFFFF, at + 4, kind >> 16, at + 8)
    return _Tag(kind, at + 8, size, at + 8 + size + -size % 8)


def _dtype(flags: int) -> np.dtype[Any]:
    """NumPy's type for the flags of an array."""
    dtype = np.dtype(CLASSES.get(flags & CLASS_BITS, "O"))
    if flags & COMPLEX_BIT and dtype.kind == "f":
        return np.result_type(dtype, np.complex64)
    return dtype
