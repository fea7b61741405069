"""Arrays in HDF5 files, MATLAB's mat files of version 7.3 among them.

MATLAB writes a variable as an object at the root. Numbers are a dataset with the axes in reverse and the
name of their class as an attribute; an array without elements is a dataset of its dimensions. Characters
and objects are datasets of codes, cells datasets of references, structures groups of variables, and sparse
matrices groups of their parts.
"""

from __future__ import annotations

from functools import partial
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.stored_arrays import (
    SPARSE,
    ArrayFile,
    ChunkedArray,
    StoredArray,
    as_complex,
    complex_dtype,
    listed_attribute,
)
from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    from pathlib import Path

    import h5py
    from numpy.typing import NDArray

    from isacbench.files.arrays.stored_arrays import Box

CLASS_ATTRIBUTE, EMPTY_ATTRIBUTE, SPARSE_ATTRIBUTE = "MATLAB_class", "MATLAB_empty", "MATLAB_sparse"
"""Attributes that MATLAB gives a variable, an array without elements and a sparse matrix."""

CELL_CONTENTS = ("#refs#", "#subsystem#")
"""Groups at the root in which MATLAB keeps what cells and objects refer to."""

INTEGER_CLASSES = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
NUMBER_CLASSES = {"double", "single", "logical", *INTEGER_CLASSES}
"""Classes whose datasets hold their values; those of texts and tables are numbers of another meaning."""


def list_hdf5(path: Path) -> ArrayFile:
    """List everything in an HDF5 file by its path; soft and external links are not followed.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ArrayFile
        An array that has several names is listed with each of them.

    Raises
    ------
    OSError
        If the file is damaged.
    """
    import h5py

    file = h5py.File(path, "r")
    entries = _attributes("", file)
    first_names = {file["/"].id: ""}

    def add(name: str, link: Any) -> None:
        if name.partition("/")[0] in CELL_CONTENTS or isinstance(entries.get(name.rpartition("/")[0]), str):
            return  # contents of cells, or parts of a sparse matrix
        if not isinstance(link, h5py.HardLink):
            entries[name] = "link"
            return
        item = file[name]
        entries.update(_attributes(name, item))
        first, kind = first_names.setdefault(item.id, name), _class_name(item)
        has_members = isinstance(item, h5py.Group) and len(item) and kind in (None, "struct")
        if first in entries:
            entries[name] = entries[first]
        elif isinstance(item, h5py.Dataset) and h5py.check_string_dtype(item.dtype):
            entries[name] = "string"
        elif isinstance(item, h5py.Dataset) and item.shape is not None and kind in (None, *NUMBER_CLASSES):
            entries[name] = dataset_array(item, f"{path}: {name}")
        elif not has_members or first != name:
            entries[name] = kind or type(item).__name__.lower()

    file.visititems_links(add)
    return ArrayFile(entries, file.close)


def dataset_array(dataset: h5py.Dataset, name: str) -> StoredArray:
    """Describe a dataset, with the axes in MATLAB's order if MATLAB wrote it.

    Parameters
    ----------
    dataset : h5py.Dataset
    name : str
        Name in messages.

    Returns
    -------
    StoredArray
        Chunked, unless it is an array without elements from MATLAB. A dataset
        without chunks counts as one of planes of its last two axes.
    """
    if EMPTY_ATTRIBUTE in dataset.attrs:
        dimensions = tuple(dataset[()].ravel().tolist())
        return StoredArray(dimensions, np.dtype(np.float64), partial(np.zeros, dimensions))
    is_reversed = CLASS_ATTRIBUTE in dataset.attrs
    order = slice(None, None, -1 if is_reversed else 1)
    chunks = dataset.chunks or (*(1 for _ in dataset.shape[:-2]), *dataset.shape[-2:])

    def read_box(box: Box) -> NDArray[Any]:
        values = as_complex(dataset[box[order]])
        return values.T if is_reversed else values

    def read() -> NDArray[Any]:
        _require_filled(name, dataset)
        return read_box((slice(None),) * dataset.ndim)

    return ChunkedArray(
        shape=dataset.shape[order],
        dtype=complex_dtype(dataset.dtype),
        read=read,
        drops_ones=is_reversed,
        chunks=chunks[order],
        read_box=read_box,
        require_filled=partial(_require_filled, name, dataset),
    )


def _attributes(name: str, item: h5py.HLObject) -> dict[str, StoredArray | str]:
    """Attributes of an object that MATLAB did not write, by their names."""
    keys = [key for key in item.attrs if not key.startswith("MATLAB_")]
    return {f"{name}@{key}": listed_attribute(item.attrs[key]) for key in keys}


def _class_name(item: h5py.HLObject) -> str | None:
    """MATLAB's class of a variable, None where another program wrote it."""
    if SPARSE_ATTRIBUTE in item.attrs:
        return SPARSE
    value = item.attrs.get(CLASS_ATTRIBUTE)
    if value is None:
        return None
    return shortened(value.decode("latin1") if isinstance(value, bytes) else str(value))


def _require_filled(name: str, dataset: h5py.Dataset) -> None:
    """Refuse numbers that were never written or lie in other files, for which HDF5 can give zeros."""
    if dataset.is_virtual or dataset.external:
        raise InputError(
            f"{name}: keeps its numbers in other files; allowed is a file that holds them itself"
        )
    if dataset.chunks is None:
        present, wanted = int(dataset.id.get_storage_size() > 0), int(dataset.size > 0)
    else:
        present = dataset.id.get_num_chunks()
        wanted = prod(-(-length // part) for length, part in zip(dataset.shape, dataset.chunks, strict=True))
    if present < wanted:
        raise InputError(f"{name}: is not complete: {present} of {wanted} chunks were written")
