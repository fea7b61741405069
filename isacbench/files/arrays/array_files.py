"""Files of arrays, told apart by their suffix."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from isacbench.errors import InputError
from isacbench.files.arrays.hdf5_files import list_hdf5
from isacbench.files.arrays.mat_files import list_mat
from isacbench.files.arrays.npy_files import list_npy, list_npz
from isacbench.files.arrays.zarr_stores import list_zarr
from isacbench.files.escaping import shortened

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from isacbench.files.arrays.stored_arrays import ArrayFile, StoredArray

FORMATS: dict[str, tuple[str, Callable[[Path], ArrayFile]]] = {
    ".npy": ("npy", list_npy),
    ".npz": ("npz", list_npz),
    ".mat": ("mat", list_mat),
    ".h5": ("HDF5", list_hdf5),
    ".hdf5": ("HDF5", list_hdf5),
    ".zarr": ("zarr", list_zarr),
    ".zip": ("zarr", list_zarr),
}
"""Name of the format and function that lists the arrays, by suffix."""


@contextmanager
def listed_arrays(path: Path) -> Iterator[ArrayFile]:
    """List the arrays of a file, and name the file in whatever its parser raises meanwhile.

    The file is closed if the ``with`` block raises, and open otherwise.

    Parameters
    ----------
    path : Path
        Of a suffix in `FORMATS`, in upper or lower case.

    Yields
    ------
    ArrayFile

    Raises
    ------
    InputError
        If the file is damaged or of another kind than its suffix says.
    """
    kind, list_arrays = FORMATS[path.suffix.lower()]
    try:
        file = list_arrays(path)
        try:
            yield file
        except BaseException:
            file.close()
            raise
    except InputError:
        raise
    except Exception as error:  # Damaged files surface as anything that a parser can raise.
        raise InputError(f"{path}: cannot be read as {kind}: {shortened(str(error))}") from error


def listed(entries: dict[str, StoredArray | str]) -> str:
    """Name entries of a file with their types and shapes, in the length of a message.

    Parameters
    ----------
    entries : dict of str to StoredArray or str
        Of an `ArrayFile`.

    Returns
    -------
    str
    """
    return shortened(", ".join(f"{name} ({entry})".strip() for name, entry in entries.items()))
