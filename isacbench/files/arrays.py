"""Arrays in npy, npz, mat, HDF5 and zarr files: listed by name, and read in boxes by the formats' libraries.

MATLAB's version 7.3 is HDF5: a variable is an object at the root, and numbers are a dataset with the axes in
reverse and the name of their class as an attribute.
"""

import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError, import_extra
from isacbench.files.checked_files import HELD_BYTES, require_file
from isacbench.files.escaping import shortened

Box = tuple[slice, ...]
Lengths = tuple[int, ...]

PAIRS = (("real", "imag"), ("r", "i"))
"""Names of the two fields by which files without complex numbers spell them."""

TEXTS = ("char", "string")
"""Kinds of what is no array and holds no numbers."""

NUMBER_CLASSES = {"double", "single", "logical", *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64))}
"""MATLAB's classes whose datasets hold their values; those of texts and cells hold other things."""

CELL_CONTENTS = ("#refs#", "#subsystem#")
"""Groups at the root in which MATLAB keeps what cells and objects refer to."""

HDF5_SIGNATURE, USER_BLOCK = b"\x89HDF\r\n\x1a\n", 512
"""First bytes of HDF5, and those before it that MATLAB fills with a header of its own."""

MOST_CHUNKS = 2**22
"""Of a zarr array, looked up one by one: more would hold few numbers each of a cube at the paper's size."""


@dataclass(frozen=True, eq=False)
class StoredArray:
    """Array in a file, of which nothing but the header was read.

    Its type is complex where the file holds pairs of real fields. `read` takes a box, one slice an axis, in
    any thread; () is all. Strides or chunks say how it lies in a file that can be read in parts.
    `drops_ones` tells that the program that wrote it drops trailing axes of length one. `require_filled`
    raises `InputError` if parts were never written, for which libraries give zeros.
    """

    shape: Lengths
    dtype: np.dtype[Any]
    read: Callable[[Any], NDArray[Any]]
    strides: Lengths | None = None
    chunks: Lengths | None = None
    drops_ones: bool = False
    require_filled: Callable[[], None] = lambda: None

    @property
    def n_bytes(self) -> int:
        """Memory that the whole array takes."""
        return prod(self.shape) * self.dtype.itemsize

    def whole(self) -> NDArray[Any]:
        """Read all of it."""
        self.require_filled()
        return self.read(())

    def with_dropped_ones(self, n_axes: int) -> "StoredArray":
        """Give it back the trailing axes of length one that its program drops."""
        n_held = len(self.shape)
        ones = (1,) * (n_axes - n_held)
        if not self.drops_ones or not ones:
            return self
        chunks, added = self.chunks and self.chunks + ones, (..., *(None for _ in ones))
        return replace(
            self, shape=self.shape + ones, chunks=chunks, read=lambda box: self.read(box[:n_held])[added]
        )

    def __getitem__(self, box: Box) -> NDArray[Any]:
        return self.read(box)

    def __str__(self) -> str:
        return f"{self.dtype.newbyteorder('=')} of shape {self.shape}"


Entries = dict[str, StoredArray | str]
"""All that a file holds by its path, ``group/name``; empty for the only array of a format without names. A
kind in words, such as ``"cell"``, stands for what is no array of numbers."""


@contextmanager
def open_arrays(path: Path) -> Iterator[tuple[Entries, ExitStack]]:
    """List the arrays of a file, and name the file in whatever its library raises meanwhile.

    The stack closes the file at the end of the ``with`` block, unless the block takes that over.
    """
    kind, list_arrays = FORMATS[path.suffix.lower()]
    try:
        with ExitStack() as opened:
            yield list_arrays(path, opened), opened
    except InputError:
        raise
    except Exception as error:  # Damaged files surface as anything that a parser can raise.
        raise InputError(f"{path}: cannot be read as {kind}: {shortened(str(error))}") from error


def names_of(entries: Entries) -> str:
    """Name entries of a file with their types and shapes, in the length of a message."""
    return shortened(", ".join(f"{name} ({entry})".strip() for name, entry in entries.items()))


def hdf5_array(dataset: Any, name: str) -> StoredArray:
    """Describe a dataset of h5py, with the axes in MATLAB's order if MATLAB wrote it.

    A dataset without chunks counts as one of planes of its last two axes.
    """
    is_reversed = "MATLAB_class" in dataset.attrs
    order = slice(None, None, -1 if is_reversed else 1)
    chunks = dataset.chunks or (*(1 for _ in dataset.shape[:-2]), *dataset.shape[-2:])

    def require_filled() -> None:
        if dataset.chunks:
            present = dataset.id.get_num_chunks()
            wanted = prod(-(-n // part) for n, part in zip(dataset.shape, dataset.chunks, strict=True))
        else:  # what lies in other files, HDF5 would read as zeros if these are missing
            present = int(dataset.id.get_storage_size() > 0 and not dataset.external)
            wanted = int(dataset.size > 0)
        if present < wanted:
            raise InputError(f"{name}: is not complete: the file has {present} of {wanted} chunks")

    def read(box: Box) -> NDArray[Any]:
        values = _as_complex(dataset[box[order]])
        return values.T if is_reversed else values

    return StoredArray(
        dataset.shape[order],
        _complex_type(dataset.dtype),
        read,
        chunks=chunks[order],
        drops_ones=is_reversed,
        require_filled=require_filled,
    )


def zarr_array(array: Any, name: str) -> StoredArray:
    """Describe an open zarr array."""

    def require_filled() -> None:
        if array.nchunks > MOST_CHUNKS:
            raise InputError(f"{name}: has {array.nchunks} chunks; allowed are at most {MOST_CHUNKS}")
        if (lacks := array.nchunks - array.nchunks_initialized) > 0:  # of shards all chunks count
            raise InputError(
                f"{name}: lacks {lacks} of {array.nchunks} chunks; if they hold zeros, "
                "write them with the zarr setting write_empty_chunks"
            )

    def read(box: Box) -> NDArray[Any]:
        return _as_complex(np.asarray(array[box]))

    return StoredArray(
        array.shape, _complex_type(array.dtype), read, chunks=array.chunks, require_filled=require_filled
    )


def _list_npy(path: Path, _opened: ExitStack) -> Entries:
    def read(box: Box) -> NDArray[Any]:
        # Mapped anew: the pages that a box touches are released with it.
        return np.lib.format.open_memmap(path, mode="r")[box]

    mapped = read(())
    return {"": StoredArray(mapped.shape, mapped.dtype, read, mapped.strides)}


def _list_npz(path: Path, _opened: ExitStack) -> Entries:
    """List the arrays of an archive by their headers, before room is made for their numbers."""

    def read(name: str, box: Box) -> NDArray[Any]:
        with np.load(path, allow_pickle=False) as archive:
            values: NDArray[Any] = archive[name][box]
        return values

    entries: Entries = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if not member.filename.endswith(".npy"):
                continue
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as file:
                is_first = np.lib.format.read_magic(file) == (1, 0)
                formats = np.lib.format
                read_header = formats.read_array_header_1_0 if is_first else formats.read_array_header_2_0
                shape, _, dtype = read_header(file)
                entry = StoredArray(shape, dtype, partial(read, name))
                if not dtype.hasobject and file.tell() + entry.n_bytes > member.file_size:
                    raise InputError(f"{path}: {name}: is truncated: has less than {entry}")
            entries[name] = entry
    return entries


def _list_mat(path: Path, opened: ExitStack) -> Entries:
    """List a file of MATLAB; those of versions before 7.3 are read at once."""
    from scipy.io import loadmat

    with path.open("rb") as file:
        head = file.read(USER_BLOCK + len(HDF5_SIGNATURE))
    if HDF5_SIGNATURE in (head[: len(HDF5_SIGNATURE)], head[USER_BLOCK:]):
        return _list_hdf5(path, opened)
    require_file(path, HELD_BYTES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        variables = loadmat(path, appendmat=False)
    named = [(name, value) for name, value in variables.items() if not name.startswith("__")]
    return dict(entry for name, value in named for entry in _matlab_entries(name, value))


def _matlab_entries(name: str, value: Any) -> Iterator[tuple[str, StoredArray | str]]:
    """Entries of a variable that SciPy read; the fields of a structure are named after it."""
    if not isinstance(value, np.ndarray):
        yield name, "sparse matrix"
    elif value.dtype.kind in "biufc":
        yield name, replace(_in_memory(value), drops_ones=True)
    elif value.dtype.names and value.size == 1 and type(value) is np.ndarray:
        for field in value.dtype.names:
            yield from _matlab_entries(f"{name}/{field}", value.flat[0][field])
    else:
        yield name, {"U": "char", "O": "cell"}.get(value.dtype.kind, "struct or object")


def _list_hdf5(path: Path, opened: ExitStack) -> Entries:
    """List the datasets of an HDF5 file; soft and external links are not followed."""
    h5py: Any = import_extra("h5py", "cubes", str(path))
    file = opened.enter_context(h5py.File(path, "r"))
    entries: Entries = {}

    def add(name: str, link: Any) -> None:
        if name.startswith(CELL_CONTENTS):
            return
        item = file[name] if isinstance(link, h5py.HardLink) else None
        if item is None:
            entries[name] = "link"
        elif isinstance(item, h5py.Dataset):
            kind = item.attrs.get("MATLAB_class")
            if isinstance(kind, bytes):
                kind = kind.decode("latin1")
            is_empty = "MATLAB_empty" in item.attrs or item.shape is None
            if h5py.check_string_dtype(item.dtype):
                entries[name] = "string"
            elif is_empty or kind not in (None, *NUMBER_CLASSES):
                entries[name] = "empty" if is_empty else shortened(str(kind))
            else:
                entries[name] = hdf5_array(item, f"{path}: {name}")

    file.visititems_links(add)
    return entries


def _list_zarr(path: Path, opened: ExitStack) -> Entries:
    """List the arrays of a zarr store of version 2 or 3, in a folder or a zip file."""
    zarr: Any = import_extra("zarr", "cubes", str(path))
    if path.is_dir():
        store = zarr.storage.LocalStore(path, read_only=True)
    else:
        zipfile.ZipFile(path).close()  # The store cannot be closed if this fails.
        store = zarr.storage.ZipStore(path, mode="r")
        opened.callback(store.close)
    # Consolidated metadata lack what was added later.
    root = zarr.open(store, mode="r", use_consolidated=False)
    members = [("", root), *(root.members(max_depth=None) if isinstance(root, zarr.Group) else ())]
    return {
        name: zarr_array(member, f"{path}: {name}" if name else str(path))
        for name, member in sorted(members, key=lambda member: member[0])
        if isinstance(member, zarr.Array)
    }


def _in_memory(values: NDArray[Any]) -> StoredArray:
    return StoredArray(values.shape, values.dtype, values.__getitem__)


def _complex_type(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Complex type of two real fields in native byte order; other types as they are."""
    if dtype.names in PAIRS:
        parts = {str(dtype[field].newbyteorder("=")) for field in dtype.names}
        if parts in ({"float32"}, {"float64"}):
            return np.result_type(parts.pop(), np.complex64)
    return dtype


def _as_complex(values: NDArray[Any]) -> NDArray[Any]:
    """Complex numbers of an array of two real fields; other arrays as they are."""
    wanted, names = _complex_type(values.dtype), values.dtype.names
    if wanted == values.dtype or names is None:
        return values
    part = np.empty(0, wanted).real.dtype
    return values.astype([(name, part) for name in names], copy=False).view(wanted)


FORMATS: dict[str, tuple[str, Callable[[Path, ExitStack], Entries]]] = {
    ".npy": ("npy", _list_npy),
    ".npz": ("npz", _list_npz),
    ".mat": ("mat", _list_mat),
    ".h5": ("HDF5", _list_hdf5),
    ".hdf5": ("HDF5", _list_hdf5),
    ".zarr": ("zarr", _list_zarr),
    ".zip": ("zarr", _list_zarr),
}
"""Name of the format and function that lists the arrays, by suffix."""
