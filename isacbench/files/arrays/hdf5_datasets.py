"""Datasets of HDF5 files: whether a file has any, and whether one holds its numbers itself and in full."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

from isacbench.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    import h5py

SIGNATURE = b"\x89HDF\r\n\x1a\n"


SIGNATURE_PLACES = (0, 512)
"""Where it stands: at the beginning, or behind MATLAB's header."""


MATLAB_ATTRIBUTE = "MATLAB_class"
"""MATLAB writes it beside every array, and the array's axes in reverse."""


def is_hdf5(path: Path) -> bool:
    """Whether a file is HDF5, with or without a header of MATLAB's."""
    with path.open("rb") as file:
        head = file.read(SIGNATURE_PLACES[-1] + len(SIGNATURE))
    return any(head[place:].startswith(SIGNATURE) for place in SIGNATURE_PLACES)


def require_own(name: str, dataset: h5py.Dataset) -> None:
    """Refuse numbers that lie in other files: HDF5 opens whatever they name, and gives zeros otherwise.

    Parameters
    ----------
    name : str
        What the message calls the dataset.
    dataset : h5py.Dataset

    Raises
    ------
    InputError
        If its storage is external or virtual.
    """
    if dataset.is_virtual or dataset.external:
        raise InputError(
            f"{name}: keeps its numbers in other files; allowed is a file that holds them itself"
        )


def require_filled(name: str, dataset: h5py.Dataset) -> None:
    """Refuse a dataset of which parts were never written; HDF5 would give zeros for them.

    Parameters
    ----------
    name : str
        What the message calls the dataset.
    dataset : h5py.Dataset

    Raises
    ------
    InputError
        With the numbers of chunks that were written and that there should be.
    """
    if dataset.is_virtual or dataset.external:
        return
    if dataset.chunks is None:
        present, wanted = int(dataset.id.get_storage_size() > 0), int(dataset.size > 0)
    else:
        present = dataset.id.get_num_chunks()
        wanted = prod(-(-length // part) for length, part in zip(dataset.shape, dataset.chunks, strict=True))
    if present < wanted:
        raise InputError(f"{name}: is not complete: {present} of {wanted} chunks were written")
