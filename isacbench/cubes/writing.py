"""Writing a cube to a file block by block, in bounded memory."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from isacbench.checked_arrays import unmasked_array
from isacbench.cubes.cube import CUBE_NAME, ComplexArray, require_cube
from isacbench.cubes.tiling import ELEMENTS, SUBCARRIERS, SYMBOLS, box_lengths
from isacbench.errors import InputError, import_extra
from isacbench.files.checked_files import require_new

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, DTypeLike

Shape: TypeAlias = tuple[int, int, int, int]
Write: TypeAlias = Callable[[int, ComplexArray], None]
"""Writes a block, already of the right type, from a subcarrier on."""

CHUNK_BYTES = 2**19
CHUNK_ELEMENTS = 2
"""Elements of a chunk along either axis of the array."""

SPARE_BYTES = 2**20
"""Room asked for beyond the numbers themselves: headers, indices, folders."""


class CubeWriter:
    """A cube that is being written, from `create_cube`.

    Attributes
    ----------
    path : Path
    shape : (int, int, int, int)
    dtype : dtype
    is_written : ndarray of bool, shape (N,)
        Subcarriers that were written.
    block_subcarriers : int
        Blocks of so many subcarriers, or a multiple, that begin at a multiple
        of it, are whole chunks: they are written fastest.
    """

    def __init__(self, path: Path, shape: Shape, dtype: np.dtype[Any], write: Write) -> None:
        self.path = path
        self.shape = shape
        self.dtype = dtype
        self.block_subcarriers = chunk_lengths(shape, dtype.itemsize)[0]
        self._write = write
        self.is_written = np.zeros(shape[0], dtype=bool)

    def write(self, first_subcarrier: int, block: ArrayLike) -> None:
        """Write consecutive subcarriers (n, M, P, Q) in the cube's precision, also where some were written.

        Refused are numbers that are not complex, masked, or too large or too small for that precision.
        """
        given = unmasked_array(f"{self.path}: a block", block)
        if given.dtype.kind != "c" or given.shape[1:] != self.shape[1:]:
            raise InputError(
                f"{self.path}: a block takes complex numbers of shape "
                f"(n, {', '.join(map(str, self.shape[1:]))}), not {given.dtype} of shape {given.shape}"
            )
        stop = first_subcarrier + len(given)
        if not 0 <= first_subcarrier < stop <= self.shape[0]:
            raise InputError(
                f"{self.path}: a block of {len(given)} subcarriers from {first_subcarrier} on does not lie "
                f"in the cube's {self.shape[0]}"
            )
        try:
            with np.errstate(over="raise"):
                values = np.ascontiguousarray(given, dtype=self.dtype)
        except FloatingPointError:
            raise InputError(
                f"{self.path}: a block has numbers that are too large for {self.dtype}"
            ) from None
        if not values.any() and given.any():
            raise InputError(f"{self.path}: a block has numbers that are too small for {self.dtype}")
        with _writing(self.path):
            self._write(first_subcarrier, values)
        self.is_written[first_subcarrier:stop] = True


@contextmanager
def create_cube(
    path: str | Path, shape: tuple[int, ...], dtype: DTypeLike = np.complex64
) -> Iterator[CubeWriter]:
    """Create a file for a cube, and fill it block by block.

    The file is written in the same folder under a hidden name, and renamed
    when the ``with`` block ends with all subcarriers written; otherwise it is
    removed.

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
        File to create, of suffix npy or zarr (a folder, in which the array is
        named ``cube``).
    shape : (int, int, int, int)
        Subcarriers N, symbols M, and elements P and Q.
    dtype : dtype
        complex64 or complex128.

    Yields
    ------
    CubeWriter

    Raises
    ------
    InputError
        Before anything is written, if the suffix is another, the file exists,
        its folder does not, the shape or type is not a cube's, or the disk has
        too little room; at the end, if subcarriers are missing.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "cube.npy"
    >>> with create_cube(path, (8, 4, 2, 2)) as writer:
    ...     for first in range(0, 8, 4):
    ...         writer.write(first, np.ones((4, 4, 2, 2), np.complex64))
    >>> np.load(path).shape
    (8, 4, 2, 2)
    """
    path = Path(path)
    create = _format_of(path)
    dtype = np.dtype(dtype).newbyteorder("=")
    checked_shape = require_cube(str(path), shape, dtype)
    require_new(path)
    _require_room(path, checked_shape, dtype)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with ExitStack() as file:
            with _writing(path):
                write = file.enter_context(create(part, checked_shape, dtype))
            writer = CubeWriter(path, checked_shape, dtype, write)
            yield writer
            missing = np.flatnonzero(~writer.is_written)
            if len(missing):
                raise InputError(
                    f"{path}: {len(missing)} of {len(writer.is_written)} subcarriers were not written, "
                    f"subcarrier {missing[0]} first"
                )
            with _writing(path):
                file.close()
                require_new(path)
                part.rename(path)
    except BaseException:
        _remove(part)
        raise


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


@contextmanager
def _create_npy(path: Path, shape: Shape, dtype: np.dtype[Any]) -> Iterator[Write]:
    header = {
        "descr": np.lib.format.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": shape,
    }
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        offset = file.tell()

        def write(first_subcarrier: int, block: ComplexArray) -> None:
            file.seek(offset + first_subcarrier * block[0].nbytes)
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


def _format_of(path: Path) -> Callable[[Path, Shape, np.dtype[Any]], AbstractContextManager[Write]]:
    """Function that creates files of a path's suffix, upper or lower case."""
    try:
        return _FORMATS[path.suffix.lower()]
    except KeyError:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise InputError(f"{path}: has {found}; a cube is written as {', '.join(_FORMATS)}") from None


def _require_room(path: Path, shape: Shape, dtype: np.dtype[Any]) -> None:
    """Refuse to begin what the disk cannot hold."""
    wanted = int(np.prod(shape, dtype=object)) * dtype.itemsize + SPARE_BYTES
    free = shutil.disk_usage(path.parent).free
    if free < wanted:
        raise InputError(f"{path}: takes {wanted / 1e9:.2f} GB, its disk has {free / 1e9:.2f} GB left")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Name the file where the system refuses to write."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def _remove(path: Path) -> None:
    """Remove a file or folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
