"""Arrays in npy and npz files: what headers claim is held against the file before room is made for it."""

from __future__ import annotations

import zipfile
from functools import partial
from math import prod
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.stored_arrays import ArrayFile, StoredArray

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SUFFIX = ".npy"
"""Of arrays in an npz file."""

HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""By version of the format; version 3 differs in names of fields, which arrays of numbers lack."""


def list_npy(path: Path) -> ArrayFile:
    """List the array of an npy file, which is mapped when it is read.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ArrayFile

    Raises
    ------
    InputError
        If the file is shorter than its header says.
    ValueError
        If it is no npy file.
    """
    with path.open("rb") as file:
        array = _listed(file, str(path), path.stat().st_size, partial(np.load, path, mmap_mode="r"), True)
    return ArrayFile({"": array})


def list_npz(path: Path) -> ArrayFile:
    """List the members of an npz file; arrays are read whole.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ArrayFile

    Raises
    ------
    InputError
        If an array is shorter than its header says, or two have one name.
    ValueError, zipfile.BadZipFile
        If it is no npz file.
    """
    arrays: dict[str, StoredArray | str] = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix(SUFFIX)
            if name in arrays:
                raise InputError(f"{path}: holds {name} twice")
            arrays[name] = "no array"
            if member.filename.endswith(SUFFIX):
                with archive.open(member) as file:
                    read = partial(_read_member, path, name)
                    arrays[name] = _listed(file, f"{path}: {name}", member.file_size, read)
    return ArrayFile(arrays)


def _read_member(path: Path, name: str) -> NDArray[Any]:
    with np.load(path) as archive:
        values: NDArray[Any] = archive[name]
    return values


def _listed(
    file: IO[bytes], name: str, held_bytes: int, read: Any, is_mapped: bool = False
) -> StoredArray | str:
    """Describe the array whose npy header begins at the position of a file."""
    version = np.lib.format.read_magic(file)
    if version not in HEADER_READERS:
        raise ValueError(f"version {version} of the format; arrays of numbers have 1.0 or 2.0")
    shape, _, dtype = HEADER_READERS[version](file)
    if dtype.hasobject:
        return "Python objects, which are never unpickled"
    if min(shape, default=0) < 0:
        raise ValueError(f"shape {shape}; no length is negative")
    array = StoredArray(shape, dtype, read, is_mapped)
    wanted_bytes = file.tell() + prod(shape) * dtype.itemsize
    if held_bytes < wanted_bytes:
        raise InputError(
            f"{name}: is truncated: {array} takes {wanted_bytes} bytes, the file has {held_bytes}"
        )
    return array
