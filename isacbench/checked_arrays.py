"""Types of arrays, a door for those from outside, which refuses what NumPy cuts off, and parts of them.

`numpy.asarray` takes masked numbers for valid ones, texts for numbers, and
columns of a table by their place; casts to other types cut off imaginary parts
and fractions.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from isacbench.errors import InputError

Floats = NDArray[np.float64]
Complex = NDArray[np.complexfloating[Any, Any]]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

KINDS = {"f": "real numbers", "i": "whole numbers", "c": "real or complex numbers"}


def checked_array(what: str, values: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Convert values to an array of a type, if that loses nothing; else refuse them by their name, `what`.

    The type is of float, int or complex; float32 and complex64 leave values of
    higher precision as they are. Values are neither masked, nor have they a
    unit, nor names of columns. What needs no conversion is not copied.

    Examples
    --------
    >>> checked_array("velocity", [1, 2]).tolist()
    [1.0, 2.0]
    >>> checked_array("snapshots", np.ones(2), np.complex64).dtype
    dtype('complex128')
    """
    wanted = np.dtype(dtype)
    allowed = KINDS[wanted.kind]
    plain = unmasked_array(what, values)
    if not plain.size and plain.dtype == np.float64:  # an empty list
        return np.asarray(plain, dtype=wanted)
    if wanted in (np.float32, np.complex64) and plain.dtype.kind in "fiu" + wanted.kind:
        wanted = np.result_type(wanted, plain)
    if plain.dtype.kind not in "fiuc" or not np.can_cast(plain.dtype, wanted, "same_kind"):
        raise InputError(f"{what} holds {plain.dtype}; allowed are {allowed}")
    return plain.astype(wanted, copy=False)


def unmasked_array(what: str, values: ArrayLike) -> NDArray[Any]:
    """Convert values to an array of whatever type they have, if they have no mask, names or unit."""
    if type(values) is np.ndarray and values.dtype.names is None:
        return values
    _require_plain(what, values)
    try:
        array: NDArray[Any] = np.asanyarray(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{what} is no array: {error}") from error
    _require_plain(what, array)
    return np.asarray(array)


def _require_plain(what: str, values: Any) -> None:
    """Refuse masks, names and units, in sequences as well: NumPy drops them."""
    if named_columns(values) is not None:
        raise InputError(f"{what} is a table of named columns; allowed is an array of numbers")
    if any(hasattr(type(values), name) for name in ("unit", "units")):
        raise InputError(f"{what} has a unit; allowed are plain numbers")
    if n_masked := int(np.count_nonzero(np.ma.getmask(values))):
        raise InputError(f"{what} has {n_masked} masked numbers of {np.size(values)}; drop or fill them")
    for row in values if isinstance(values, list | tuple) else ():
        if not isinstance(row, float | int | complex):
            # The index of a row of a DataFrame has the names of columns.
            names: list[Any] = getattr(getattr(row, "index", None), "tolist", list)()
            if names and all(isinstance(name, str) for name in names):
                raise InputError(f"{what} has rows of named columns; allowed is an array of numbers")
            _require_plain(what, row)


def named_columns(values: object) -> dict[str, Any] | None:
    """Find the columns of a table: a DataFrame, a structured array, an Arrow table, a mapping, a named tuple.

    None for what has no names of columns. Numbers are no names.

    Examples
    --------
    >>> list(named_columns({"x": [1.0], "y": [2.0]}))
    ['x', 'y']
    >>> named_columns([[1.0, 2.0]]) is None
    True
    """
    table: Any = values
    if isinstance(values, Mapping):
        labels: Any = list(values)
    elif isinstance(values, np.ndarray | np.void):
        labels = values.dtype.names
    elif isinstance(values, tuple):
        labels = getattr(values, "_fields", None)
        table = dict(zip(labels, values, strict=True)) if labels else values
    else:
        labels = getattr(values, "column_names", getattr(values, "columns", None))
    if labels is None or all(isinstance(label, int | np.integer) for label in labels):
        return None
    return {str(label): table[label] for label in labels}


def freeze_arrays(owner: object, *names: str, dtype: DTypeLike = np.float64) -> None:
    """Replace arrays of a frozen dataclass by read-only copies of a type, in its ``__post_init__``.

    Raises `InputError` if a conversion would lose something.
    """
    for name in names:
        values = checked_array(name, getattr(owner, name), dtype).astype(dtype, order="K", copy=True)
        values.setflags(write=False)
        object.__setattr__(owner, name, values)


def parts_of(n: int, n_together: int) -> Iterator[slice]:
    """Divide n things into parts of so many, of one at least."""
    step = max(n_together, 1)
    for first in range(0, n, step):
        yield slice(first, min(first + step, n))
