"""Arrays as files list them: shape, type, and functions that read the numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Box = tuple[slice, ...]
Lengths = tuple[int, ...]

PAIRS = (("real", "imag"), ("r", "i"))
"""Names of the two fields by which files without complex numbers spell them."""

SPARSE, TEXTS = "sparse matrix", ("char", "string", "attribute")
"""Kinds of what is no array: one that could be, and those that hold no numbers or few."""


@dataclass(frozen=True, eq=False)
class StoredArray:
    """Array in a file, of which nothing but the header was read.

    Attributes
    ----------
    shape : tuple of int
    dtype : dtype
        Complex where the file holds pairs of real fields.
    read : callable
        Returns the whole array.
    is_mapped : bool
        True if that is a map of the file, of which nothing is read before it is used.
    drops_ones : bool
        True if the program that wrote the file drops trailing axes of length one.
    """

    shape: Lengths
    dtype: np.dtype[Any]
    read: Callable[[], NDArray[Any]]
    is_mapped: bool = False
    drops_ones: bool = False

    @property
    def n_bytes(self) -> int:
        """Memory that the whole array takes."""
        return prod(self.shape) * self.dtype.itemsize

    @property
    def dropped_ones(self) -> Lengths:
        """Lengths of the axes that a cube lacks because its program drops trailing ones."""
        return (1,) * (4 - len(self.shape)) if self.drops_ones else ()

    def __str__(self) -> str:
        return f"{self.dtype.newbyteorder('=')} of shape {self.shape}"


@dataclass(frozen=True, eq=False, kw_only=True)
class ChunkedArray(StoredArray):
    """Array in a file of chunks.

    Attributes
    ----------
    chunks : tuple of int
        Lengths of a chunk.
    read_box : callable
        Reads a box, given as one slice an axis, in any thread.
    require_filled : callable
        Raises `InputError` if chunks were never written; libraries give zeros for them.
    """

    chunks: Lengths
    read_box: Callable[[Box], NDArray[Any]]
    require_filled: Callable[[], None]


class ArrayFile(NamedTuple):
    """Open file of arrays.

    Attributes
    ----------
    arrays : dict of str to StoredArray or str
        All that the file holds by its path, ``group/name`` or ``group/name@attribute``;
        empty for the only array of a format without names. The kind in words,
        such as ``"cell"``, stands for what is no array of numbers.
    close : callable
        Closes the file.
    """

    arrays: dict[str, StoredArray | str]
    close: Callable[[], None] = lambda: None


def listed_attribute(value: object) -> StoredArray | str:
    """Describe an attribute: an array if it has an axis of numbers.

    Parameters
    ----------
    value : object

    Returns
    -------
    StoredArray or str
    """
    try:
        values = as_complex(np.asarray(value))
    except ValueError:  # a ragged list
        return "attribute"
    is_array = values.ndim > 0 and values.dtype.kind in "biufc"
    return StoredArray(values.shape, values.dtype, lambda: values) if is_array else "attribute"


def complex_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Complex type of two real fields in native byte order; other types as they are.

    Parameters
    ----------
    dtype : dtype

    Returns
    -------
    dtype

    Examples
    --------
    >>> complex_dtype(np.dtype([("real", ">f4"), ("imag", ">f4")]))
    dtype('complex64')
    """
    if dtype.names in PAIRS:
        parts = {str(dtype[field].newbyteorder("=")) for field in dtype.names}
        if parts in ({"float32"}, {"float64"}):
            return np.result_type(parts.pop(), np.complex64)
    return dtype


def as_complex(values: NDArray[Any]) -> NDArray[Any]:
    """Complex numbers of an array of two real fields; other arrays as they are.

    Parameters
    ----------
    values : ndarray

    Returns
    -------
    ndarray
        Of the same shape.

    Examples
    --------
    >>> as_complex(np.array([(1, 2)], dtype=[("real", "f4"), ("imag", "f4")]))
    array([1.+2.j], dtype=complex64)
    """
    wanted = complex_dtype(values.dtype)
    if values.dtype.names is None or wanted.kind != "c":
        return values
    part = np.empty(0, wanted).real.dtype
    packed = np.dtype([(name, part) for name in values.dtype.names])
    return values.astype(packed, copy=False).view(wanted)
