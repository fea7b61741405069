"""Arrays in npy, npz, mat, HDF5 and zarr files: listed by name, and read in boxes by the formats' libraries.

MATLAB's version 7.3 is HDF5: a variable is an object at the root. Numbers are a dataset with the axes in
reverse and the name of their class as an attribute; an array without elements is a dataset of its
dimensions. Characters and objects are datasets of codes, cells datasets of references, structures groups of
variables, and sparse matrices groups of their parts.
"""

from __future__ import annotations

import re
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import prod
from operator import itemgetter
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError, import_extra
from isacbench.files.checked_files import HELD_BYTES, require_file
from isacbench.files.escaping import shortened

Box = tuple[slice, ...]
Lengths = tuple[int, ...]

PAIRS = (("real", "imag"), ("r", "i"))
"""Names of the two fields by which files without complex numbers spell them."""

SPARSE, TEXTS = "sparse matrix", ("char", "string", "attribute")
"""Kinds of what is no array: one that could be, and those that hold no numbers or few."""

MATLAB_KINDS = {"U": "char", "O": "cell", "V": "struct"}
"""Classes of MATLAB by the kind of the NumPy type that SciPy reads them as."""

NUMBER_CLASSES = {"double", "single", "logical", *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64))}
"""MATLAB's classes whose datasets hold their values; those of texts and tables hold other things."""

CELL_CONTENTS = ("#refs#", "#subsystem#")
"""Groups at the root in which MATLAB keeps what cells and objects refer to."""

HDF5_SIGNATURE, USER_BLOCK = b"\x89HDF\r\n\x1a\n", 512
"""First bytes of HDF5, and those before it that MATLAB fills with a header of its own."""

NPY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
"""By version of the format; version 3 differs in names of fields, which arrays of numbers lack."""

MOST_CHUNKS = 2**22
"""Of a zarr array, looked up one by one: more would hold few numbers each of a cube at the paper's size."""


@dataclass(frozen=True, eq=False)
class StoredArray:
    """Array in a file, of which nothing but the header was read.

    Attributes
    ----------
    shape : tuple of int
    dtype : dtype
        Complex where the file holds pairs of real fields.
    read : callable
        Reads a box, given as one slice an axis, in any thread; () is all.
    strides, chunks : tuple of int, optional
        How it lies in a file that can be read in parts.
    drops_ones : bool
        True if the program that wrote the file drops trailing axes of length one.
    require_filled : callable
        Raises `InputError` if parts were never written; libraries give zeros for them.
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

    def with_dropped_ones(self, n_axes: int) -> StoredArray:
        """Give it back the trailing axes of length one that its program drops."""
        n_held, n_ones = len(self.shape), n_axes - len(self.shape)
        if not self.drops_ones or n_ones < 1:
            return self
        ones, added = (1,) * n_ones, (..., *[None] * n_ones)
        chunks = self.chunks and self.chunks + ones
        return replace(
            self, shape=self.shape + ones, chunks=chunks, read=lambda box: self.read(box[:n_held])[added]
        )

    def __getitem__(self, box: Box) -> NDArray[Any]:
        return self.read(box)

    def __str__(self) -> str:
        return f"{self.dtype.newbyteorder('=')} of shape {self.shape}"


Entries = dict[str, StoredArray | str]
"""All that a file holds by its path, ``group/name`` or ``group/name@attribute``; empty for the only array of
a format without names. A kind in words, such as ``"cell"``, stands for what is no array of numbers."""


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
    if "MATLAB_empty" in dataset.attrs:
        return _in_memory(np.broadcast_to(0.0, dataset[()].ravel().tolist()))
    is_reversed = "MATLAB_class" in dataset.attrs
    order = slice(None, None, -1 if is_reversed else 1)
    chunks = dataset.chunks or (*(1 for _ in dataset.shape[:-2]), *dataset.shape[-2:])

    def require_filled() -> None:
        if dataset.is_virtual or dataset.external:
            raise InputError(
                f"{name}: keeps its numbers in other files; allowed is a file that holds them itself"
            )
        present, wanted = int(dataset.id.get_storage_size() > 0), int(dataset.size > 0)
        if dataset.chunks is not None:
            present = dataset.id.get_num_chunks()
            wanted = prod(-(-n // part) for n, part in zip(dataset.shape, dataset.chunks, strict=True))
        if present < wanted:
            raise InputError(f"{name}: is not complete: {present} of {wanted} chunks were written")

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

    with path.open("rb") as file:
        entry = _from_header(file, str(path), path.stat().st_size, read)
    return {"": entry if isinstance(entry, str) else replace(entry, strides=read(()).strides)}


def _list_npz(path: Path, _opened: ExitStack) -> Entries:
    def read(name: str, box: Box) -> NDArray[Any]:
        with np.load(path, allow_pickle=False) as archive:
            values: NDArray[Any] = archive[name][box]
        return values

    entries: Entries = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            entries[name] = "no array"
            if name != member.filename:
                with archive.open(member) as file:
                    entries[name] = _from_header(
                        file, f"{path}: {name}", member.file_size, partial(read, name)
                    )
    return entries


def _from_header(
    file: IO[bytes], name: str, held_bytes: int, read: Callable[[Any], NDArray[Any]]
) -> StoredArray | str:
    """Describe the array whose npy header begins at the position of a file, before room is made for it."""
    version = np.lib.format.read_magic(file)
    if version not in NPY_HEADERS:
        raise ValueError(f"version {version} of the format; arrays of numbers have 1.0 or 2.0")
    shape, _, dtype = NPY_HEADERS[version](file)
    if dtype.hasobject:
        return "Python objects, which are never unpickled"
    if min(shape, default=0) < 0:
        raise ValueError(f"shape {shape}; no length is negative")
    array = StoredArray(shape, dtype, read)
    wanted_bytes = file.tell() + array.n_bytes
    if held_bytes < wanted_bytes:
        raise InputError(
            f"{name}: is truncated: {array} takes {wanted_bytes} bytes, the file has {held_bytes}"
        )
    return array


def _list_mat(path: Path, opened: ExitStack) -> Entries:
    """List a file of MATLAB; those of versions before 7.3 are read at once."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque

    with path.open("rb") as file:
        head = file.read(USER_BLOCK + len(HDF5_SIGNATURE))
    if HDF5_SIGNATURE in (head[: len(HDF5_SIGNATURE)], head[USER_BLOCK:]):
        return _list_hdf5(path, opened)
    require_file(path, HELD_BYTES)
    load = partial(loadmat, path, appendmat=False)
    entries: Entries = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        variables = load()
        if isinstance(variables.get("None"), MatlabOpaque):
            del variables["None"]
            while (name := _last_object(load, 1 + len(entries))) not in entries:
                entries[name] = "object"
    for name, value in variables.items():
        if not name.startswith("__"):
            entries.update(_matlab_entries(name, value))
    return entries


def _last_object(load: Callable[..., dict[str, Any]], n: int) -> str:
    """Name of the last of the first n objects of MATLAB: of as many as are wanted, SciPy gives that."""
    name: str = load(variable_names=["None"] * n)["None"]["s0"].item().decode("latin1")
    return name


def _matlab_entries(name: str, value: Any) -> Iterator[tuple[str, StoredArray | str]]:
    """Entries of a variable that SciPy read; the fields of a structure are named after it."""
    if not isinstance(value, np.ndarray):
        yield name, "unreadable" if isinstance(value, str) else SPARSE
    elif type(value) is not np.ndarray:
        yield name, "object"
    elif value.dtype.kind in "biufc":
        yield name, replace(_in_memory(value), drops_ones=True)
    elif value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _matlab_entries(f"{name}/{field}", value.flat[0][field])
    else:
        yield name, MATLAB_KINDS.get(value.dtype.kind, "object")


def _list_hdf5(path: Path, opened: ExitStack) -> Entries:
    """List everything in an HDF5 file with each of its names; soft and external links are not followed."""
    h5py: Any = import_extra("h5py", "cubes", str(path))
    file = opened.enter_context(h5py.File(path, "r"))
    entries = _attributes("", file.attrs)
    first_names = {file["/"].id: ""}

    def add(name: str, link: Any) -> None:
        if name.partition("/")[0] in CELL_CONTENTS or isinstance(entries.get(name.rpartition("/")[0]), str):
            return  # contents of cells, or parts of a sparse matrix
        if not isinstance(link, h5py.HardLink):
            entries[name] = "link"
            return
        item = file[name]
        entries.update(_attributes(name, item.attrs))
        first, kind = first_names.setdefault(item.id, name), _matlab_class(item.attrs)
        is_dataset, has_members = isinstance(item, h5py.Dataset), isinstance(item, h5py.Group) and len(item)
        if first in entries:
            entries[name] = entries[first]
        elif is_dataset and h5py.check_string_dtype(item.dtype):
            entries[name] = "string"
        elif is_dataset and item.shape is not None and kind in (None, *NUMBER_CLASSES):
            entries[name] = hdf5_array(item, f"{path}: {name}")
        elif not has_members or kind not in (None, "struct") or first != name:
            entries[name] = kind or type(item).__name__.lower()

    file.visititems_links(add)
    return entries


def _matlab_class(attributes: Any) -> str | None:
    """MATLAB's class of a variable, None where another program wrote it."""
    if "MATLAB_sparse" in attributes:
        return SPARSE
    value = attributes.get("MATLAB_class")
    text = value.decode("latin1") if isinstance(value, bytes) else str(value)
    return None if value is None else shortened(text)


def _list_zarr(path: Path, opened: ExitStack) -> Entries:
    """List everything in a zarr store of version 2 or 3, in a folder or a zip file."""
    zarr: Any = import_extra("zarr", "cubes", str(path))
    if path.is_dir():
        store = zarr.storage.LocalStore(path, read_only=True)
    else:
        zipfile.ZipFile(path).close()  # The store cannot be closed if this fails.
        store = zarr.storage.ZipStore(path, mode="r")
        opened.callback(store.close)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # Consolidated metadata lack what was added later.
        root = zarr.open(store, mode="r", use_consolidated=False)
        members = [("", root), *(root.members(max_depth=None) if isinstance(root, zarr.Group) else ())]
    text = "\n".join(str(warning.message) for warning in caught)
    entries: Entries = dict.fromkeys(re.findall(r"Object at (.+) is not recognized", text), "no zarr array")
    for name, member in sorted(members, key=itemgetter(0)):
        entries.update(_attributes(name, member.attrs))
        if isinstance(member, zarr.Array):
            entries[name] = zarr_array(member, f"{path}: {name}" if name else str(path))
        elif name and not member.nmembers():
            entries[name] = "empty group"
    return entries


def _attributes(name: str, attributes: Any) -> Entries:
    """Attributes but those of MATLAB, by their names: arrays if they have an axis of numbers."""
    entries: Entries = {}
    for key in attributes:
        if not key.startswith("MATLAB_"):
            try:
                values = _as_complex(np.asarray(attributes[key]))
            except ValueError:  # a ragged list
                values = np.array("")
            is_array = values.ndim > 0 and values.dtype.kind in "biufc"
            entries[f"{name}@{key}"] = _in_memory(values) if is_array else "attribute"
    return entries


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
