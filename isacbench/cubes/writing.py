"""Writing a cube to a file block by block, in bounded memory."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from isacbench.checked_arrays import unmasked_array
from isacbench.cubes.cube import CUBE_NAME, ComplexArray, require_cube
from isacbench.cubes.tiling import ELEMENTS, SUBCARRIERS, SYMBOLS, box_lengths
from isacbench.errors import InputError, import_extra
from isacbench.files.checked_files import require_new

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike, DTypeLike

Shape: TypeAlias = tuple[int, int, int, int]
Write: TypeAlias = Callable[[int, ComplexArray], None]
"""Writes a block, already of the right type, from a subcarrier on."""

CHUNK_BYTES = 2**19
CHUNK_ELEMENTS = 2
"""Elements of a chunk along either axis of the array."""

SPARE_BYTES = 2**20
"""Room asked for beyond the numbers themselves: headers, indices, folders."""


def write_cube(
    path: str | Path,
    shape: tuple[int, ...],
    blocks: Iterable[ArrayLike],
    dtype: DTypeLike = np.complex64,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a cube to a new file, block by block.

    The file is written in the same folder under a hidden name, and renamed
    when it is complete; otherwise it is removed.

    An npy file is written in C order. Zarr gets chunks of about half a
    MiB of 2 x 2 elements (64 subcarriers and all symbols at the paper's size):
    one row and one column of a 16 x 16 array are in 15 of 64 chunks, so that
    23 % of the file is read for them, where C order costs at least half of it
    and chunks of all elements cost it whole. Single elements would halve that
    again, at four times as many chunks, which a folder holds as files.
    Nothing is compressed: noise cannot be.

    Parameters
    ----------
    path : str or Path
        Suffix npy or zarr (a folder, in which the array is named ``cube``).
    shape : (int, int, int, int)
        Subcarriers N, symbols M, and elements P and Q.
    blocks : iterable of array_like of complex, shape (n, M, P, Q)
        Consecutive subcarriers, any number at a time.
    dtype : dtype
        complex64 or complex128.
    progress : callable, optional
        Called with the number of subcarriers written and of all.

    Raises
    ------
    InputError
        Before anything is written, if the suffix is another, the file exists,
        its folder does not, the shape or type is not a cube's, or the disk has
        too little room; later if a block does not fit, is masked or has numbers too
        large or too small for the precision, or if subcarriers are missing.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "cube.npy"
    >>> write_cube(path, (8, 4, 2, 2), (np.ones((4, 4, 2, 2), np.complex64) for _ in range(2)))
    >>> np.load(path).shape
    (8, 4, 2, 2)
    """
    path, dtype = Path(path), np.dtype(dtype).newbyteorder("=")
    if (suffix := path.suffix.lower()) not in _FORMATS:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(f"{path}: has {found}; a cube is written as {', '.join(_FORMATS)}")
    checked_shape = require_cube(str(path), shape, dtype)
    require_new(path)
    _require_room(path, checked_shape, dtype)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with _FORMATS[suffix](part, checked_shape, dtype) as write:
            first = 0
            for block in _whole_chunks(blocks, path, checked_shape, dtype):
                write(first, block)
                first += len(block)
                if progress is not None:
                    progress(first, shape[0])
        require_new(path)
        part.rename(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # a name that is too long
            shutil.rmtree(part) if part.is_dir() else part.unlink()


def chunk_lengths(shape: Shape, itemsize: int) -> Shape:
    """Lengths of a chunk: 2 x 2 elements, and along symbols and then subcarriers what makes half a MiB.

    Examples
    --------
    >>> chunk_lengths((2048, 224, 16, 16), 8)
    (64, 224, 2, 2)
    """
    n_p, n_q = (min(CHUNK_ELEMENTS, length) for length in shape[2:])
    nesting = (SUBCARRIERS, SYMBOLS, ELEMENTS)
    n_subcarriers, n_symbols, _ = box_lengths((*shape[:2], n_p * n_q), nesting, CHUNK_BYTES // itemsize)
    return n_subcarriers, n_symbols, n_p, n_q


def _whole_chunks(
    blocks: Iterable[ArrayLike], path: Path, shape: Shape, dtype: np.dtype[Any]
) -> Iterator[ComplexArray]:
    """Blocks of whole chunks: parts of them would be read and written again and again."""
    waiting: list[ComplexArray] = []
    n_chunk, n_given = chunk_lengths(shape, dtype.itemsize)[0], 0
    for block in blocks:
        waiting.append(_converted(block, path, shape, dtype))
        n_given += len(waiting[-1])
        if n_given > shape[0]:
            raise InputError(f"{path}: {n_given} subcarriers were given; the cube has {shape[0]}")
        if (n_waiting := sum(map(len, waiting))) >= n_chunk or n_given == shape[0]:
            held = np.concatenate(waiting)
            n_whole = n_waiting if n_given == shape[0] else n_waiting - n_waiting % n_chunk
            yield held[:n_whole]
            waiting = [held[n_whole:]]
    if n_given < shape[0]:
        raise InputError(f"{path}: only {n_given} of {shape[0]} subcarriers were given")


def _converted(block: ArrayLike, path: Path, shape: Shape, dtype: np.dtype[Any]) -> ComplexArray:
    """Convert a block to the precision of the cube."""
    given = unmasked_array(f"{path}: a block", block)
    if given.dtype.kind != "c" or given.shape[1:] != shape[1:]:
        raise InputError(
            f"{path}: a block takes complex numbers of shape "
            f"(n, {', '.join(map(str, shape[1:]))}), not {given.dtype} of shape {given.shape}"
        )
    try:
        with np.errstate(over="raise"):
            values = np.ascontiguousarray(given, dtype=dtype)
    except FloatingPointError:
        raise InputError(f"{path}: a block has numbers that are too large for {dtype}") from None
    if not values.any() and given.any():
        raise InputError(f"{path}: a block has numbers that are too small for {dtype}")
    return values


@contextmanager
def _create_npy(path: Path, shape: Shape, dtype: np.dtype[Any]) -> Iterator[Write]:
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)

        def write(_first_subcarrier: int, block: ComplexArray) -> None:
            file.write(block.data)

        yield write


@contextmanager
def _create_zarr(path: Path, shape: Shape, dtype: np.dtype[Any]) -> Iterator[Write]:
    zarr: Any = import_extra("zarr", "cubes", str(path))
    array = zarr.open_group(path, mode="w").create_array(
        CUBE_NAME,
        shape=shape,
        dtype=dtype,
        chunks=chunk_lengths(shape, dtype.itemsize),
        compressors=None,
        # A chunk of zeros would otherwise look like one that was not written.
        config={"write_empty_chunks": True},
    )

    def write(first_subcarrier: int, block: ComplexArray) -> None:
        array[first_subcarrier : first_subcarrier + len(block)] = block

    yield write


_FORMATS: dict[str, Callable[[Path, Shape, np.dtype[Any]], AbstractContextManager[Write]]] = {
    ".npy": _create_npy,
    ".zarr": _create_zarr,
}


def _require_room(path: Path, shape: Shape, dtype: np.dtype[Any]) -> None:
    """Refuse to begin what the disk cannot hold."""
    wanted = int(np.prod(shape, dtype=object)) * dtype.itemsize + SPARE_BYTES
    free = shutil.disk_usage(path.parent).free
    if free < wanted:
        raise InputError(f"{path}: takes {wanted / 1e9:.2f} GB, its disk has {free / 1e9:.2f} GB left")
