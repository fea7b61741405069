"""Arrays as files list them: shape and type, complex numbers stored as pairs, and too many of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.checked_files import binary_size

if TYPE_CHECKING:
    from pathlib import Path


class Listed(NamedTuple):
    """What a file says of an array that it holds.

    Attributes
    ----------
    shape : tuple of int
    dtype : dtype
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def too_large(path: Path, limit_bytes: int) -> InputError:
    """Build the exception for a file whose arrays take more memory together than is allowed."""
    allowed = binary_size(limit_bytes)
    return InputError(f"{path}: its arrays take more than {allowed}, which is what is allowed")


PAIRS = (("real", "imag"), ("r", "i"))
"""Names of the two fields by which files without complex numbers spell them."""


def complex_dtype(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Complex type, in native byte order, of two real fields; other types as they are.

    Examples
    --------
    >>> complex_dtype(np.dtype([("real", ">f4"), ("imag", ">f4")]))
    dtype('complex64')
    """
    if dtype.names in PAIRS:
        parts = {str(dtype[field].newbyteorder("=")) for field in dtype.names}
        if parts == {"float32"}:
            return np.dtype(np.complex64)
        if parts == {"float64"}:
            return np.dtype(np.complex128)
    return dtype.newbyteorder("=") if dtype.kind == "c" else dtype


def as_complex(values: NDArray[Any]) -> NDArray[Any]:
    """Complex numbers of an array of two real fields; other arrays as they are.

    Examples
    --------
    >>> as_complex(np.array([(1, 2)], dtype=[("real", "f4"), ("imag", "f4")]))
    array([1.+2.j], dtype=complex64)
    """
    wanted = complex_dtype(values.dtype)
    if values.dtype.names is None or wanted.kind != "c":
        return values
    real, imag = values.dtype.names
    part = np.empty(0, wanted).real.dtype
    packed = np.dtype([(real, part), (imag, part)])
    return values.astype(packed, copy=False).view(wanted)
