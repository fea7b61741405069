"""Arrays in zarr stores of versions 2 and 3, in a folder or in a zip file."""

from __future__ import annotations

import re
import warnings
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.stored_arrays import (
    ArrayFile,
    ChunkedArray,
    as_complex,
    complex_dtype,
    listed_attribute,
)

if TYPE_CHECKING:
    from pathlib import Path

    import zarr
    from numpy.typing import NDArray

    from isacbench.files.arrays.stored_arrays import Box, StoredArray

MOST_CHUNKS = 2**22
"""Of an array: more would hold less than thirty numbers each of a cube at the paper's size."""


def list_zarr(path: Path) -> ArrayFile:
    """List everything in a zarr store by its path.

    Parameters
    ----------
    path : Path
        A folder or a zip file.

    Returns
    -------
    ArrayFile
    """
    import zarr
    from zarr.storage import LocalStore, ZipStore

    store = LocalStore(path, read_only=True) if path.is_dir() else ZipStore(path, mode="r")
    try:
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            # Consolidated metadata lack what was added later.
            root = zarr.open(store, mode="r", use_consolidated=False)
            members = [("", root), *(root.members(max_depth=None) if isinstance(root, zarr.Group) else ())]
        text = "\n".join(str(warning.message) for warning in told)
        skipped = re.findall(r"Object at (.+) is not recognized", text)
        entries: dict[str, StoredArray | str] = dict.fromkeys(skipped, "no zarr array")
        for name, member in sorted(members, key=itemgetter(0)):
            entries.update({f"{name}@{key}": listed_attribute(value) for key, value in member.attrs.items()})
            if isinstance(member, zarr.Array):
                entries[name] = zarr_array(member, f"{path}: {name}" if name else str(path))
            elif name and not member.nmembers():
                entries[name] = "empty group"
    except BaseException:
        store.close()
        raise
    return ArrayFile(entries, store.close)


def zarr_array(array: zarr.Array[Any], name: str) -> ChunkedArray:
    """Describe an open zarr array.

    Parameters
    ----------
    array : zarr.Array
    name : str
        Name in messages.

    Returns
    -------
    ChunkedArray
    """

    def require_filled() -> None:
        if array.nchunks > MOST_CHUNKS:  # which would be looked for one by one
            raise InputError(f"{name}: has {array.nchunks} chunks; allowed are at most {MOST_CHUNKS}")
        present, wanted = array.nchunks_initialized, array.nchunks
        if present < wanted:
            raise InputError(
                f"{name}: lacks {wanted - present} of {wanted} chunks; if they hold zeros, "
                "write them with the zarr setting write_empty_chunks"
            )

    def read_box(box: Box) -> NDArray[Any]:
        return as_complex(np.asarray(array[box]))

    def read() -> NDArray[Any]:
        require_filled()
        return read_box((slice(None),) * array.ndim)

    return ChunkedArray(
        array.shape,
        complex_dtype(array.dtype),
        read,
        chunks=array.chunks,
        read_box=read_box,
        require_filled=require_filled,
    )
