"""Arrays of numbers in MATLAB's mat files of version 7.3, which are HDF5 files.

A variable is an object at the root. Numbers are a dataset with the axes in reverse and the name of
their class as an attribute; an array without elements is a dataset of its dimensions. Characters and
objects are datasets of codes, cells datasets of references, structures and sparse matrices groups.
"""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.hdf5_datasets import MATLAB_ATTRIBUTE, require_filled, require_own
from isacbench.files.arrays.listing import Listed, complex_dtype, too_large
from isacbench.files.escaping import quoted, shortened

if TYPE_CHECKING:
    from pathlib import Path

    import h5py
    from numpy.typing import NDArray

EMPTY_ATTRIBUTE = "MATLAB_empty"
"""MATLAB writes it beside an array without elements, whose dataset holds the dimensions."""

NUMBER_CLASSES = {
    "double",
    "single",
    "logical",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}
"""Classes whose datasets hold their values; those of texts and tables are numbers of another meaning."""

LONGEST_CLASS = 63
"""Characters of a name in MATLAB."""


def read_arrays(path: Path, limit_bytes: int) -> dict[str, NDArray[Any] | Listed | str]:
    """Read the arrays of real numbers of a mat file of version 7.3.

    Parameters
    ----------
    path : Path
    limit_bytes : int
        Most memory that all of them may take together.

    Returns
    -------
    dict of str to ndarray, Listed or str
        By the name of the variable: real numbers, with the axes in MATLAB's order;
        shape and type of an array of others; the class of a variable that is neither.

    Raises
    ------
    InputError
        If a variable is a link, keeps its numbers in another file or was not
        filled, or if the arrays take more than `limit_bytes`.
    OSError
        If the file is damaged, or compressed by a filter that the HDF5 library lacks.
    """
    import h5py

    found: dict[str, NDArray[Any] | Listed | str] = {}
    left_bytes = limit_bytes
    with h5py.File(path, "r") as file:
        for name in file:
            if name.startswith("#"):  # what cells and objects refer to
                continue
            variable = _variable(path, file, name)
            found[name] = listed = _describe(variable)
            if isinstance(listed, Listed) and listed.dtype.kind in "fiu":
                left_bytes -= _taken_bytes(variable)
                if left_bytes < 0:
                    raise too_large(path, limit_bytes)
                found[name] = _numbers(f"{path}: {name}", variable)
    return found


def _variable(path: Path, file: h5py.File, name: str) -> h5py.HLObject:
    """Object of a name at the root of a file, which is no link to elsewhere."""
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        raise InputError(f"{path}: {quoted(name)} is a link; allowed are arrays that the file holds itself")
    return file[name]


def _describe(variable: h5py.HLObject) -> Listed | str:
    """Shape and type of an array of numbers; the class of another variable."""
    import h5py

    class_name = _class_name(variable)
    if not isinstance(variable, h5py.Dataset) or variable.shape is None:
        return "sparse matrix" if "MATLAB_sparse" in variable.attrs else class_name or "no array"
    if class_name is not None and class_name not in NUMBER_CLASSES:
        return class_name
    shape = variable.shape if class_name is None else variable.shape[::-1]
    return Listed(shape, complex_dtype(variable.dtype))


def _class_name(variable: h5py.HLObject) -> str | None:
    """MATLAB's class of a variable, None where another program wrote it."""
    value = variable.attrs.get(MATLAB_ATTRIBUTE)
    text = value.decode("latin1") if isinstance(value, bytes) else str(value)
    return None if value is None else shortened(text, LONGEST_CLASS)


def _taken_bytes(dataset: h5py.Dataset) -> int:
    """Memory that reading a dataset takes: one chunk at least, which is decompressed as a whole."""
    n_values: int = max(prod(dataset.shape), prod(dataset.chunks or ()))
    return n_values * int(dataset.dtype.itemsize)


def _numbers(name: str, dataset: h5py.Dataset) -> NDArray[Any]:
    """Read a dataset of numbers, in MATLAB's order of axes if MATLAB wrote it."""
    require_own(name, dataset)
    require_filled(name, dataset)
    values: NDArray[Any] = dataset[()]
    if EMPTY_ATTRIBUTE in dataset.attrs:
        return _empty(name, values)
    return values.T if MATLAB_ATTRIBUTE in dataset.attrs else values


def _empty(name: str, dimensions: NDArray[Any]) -> NDArray[Any]:
    """Build an array without elements from its dimensions."""
    shape = tuple(dimensions.ravel().tolist())
    if 0 not in shape:
        raise InputError(
            f"{name}: is damaged: an array without elements has the dimensions {quoted(list(shape))}"
        )
    return np.empty(shape)
