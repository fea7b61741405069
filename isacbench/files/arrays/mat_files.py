"""Arrays in MATLAB's mat files of versions 4 to 7, read by SciPy in a process of its own.

Some damaged files end the process in which SciPy reads them. So it is not the user's.
Version 7.3 is HDF5, see `isacbench.files.arrays.hdf5_files`.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from signal import Signals
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.hdf5_files import list_hdf5
from isacbench.files.arrays.stored_arrays import ArrayFile, StoredArray
from isacbench.files.checked_files import HELD_BYTES, require_file

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

OTHER_KINDS = {"U": "char", "O": "cell", "V": "struct"}
"""Classes of MATLAB by the kind of the NumPy type that SciPy reads them as."""


def list_mat(path: Path) -> ArrayFile:
    """List the arrays of a mat file; of versions before 7.3 they are read at once.

    Parameters
    ----------
    path : Path

    Returns
    -------
    ArrayFile

    Raises
    ------
    InputError
        If the file is damaged, no mat file, or larger than `HELD_BYTES`.
    """
    import h5py

    if h5py.is_hdf5(path):
        return list_hdf5(path)
    require_file(path, HELD_BYTES)
    arrays = {
        name: value if isinstance(value, str) else _in_memory(value)
        for name, value in _read_apart(path).items()
    }
    return ArrayFile(arrays)


def _in_memory(values: NDArray[Any]) -> StoredArray:
    return StoredArray(values.shape, values.dtype, lambda: values, drops_ones=True)


def _read_apart(path: Path) -> dict[str, NDArray[Any] | str]:
    """Read a file by `_send_variables` in another process."""
    command = [sys.executable, "-W", "ignore", "-m", __name__, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as reader:
        assert reader.stdout is not None
        assert reader.stderr is not None
        try:
            # From our own process, which sends numbers and words alone.
            found: dict[str, NDArray[Any] | str] = pickle.load(reader.stdout)
        except (EOFError, pickle.UnpicklingError):
            told = reader.stderr.read().decode("utf-8", "replace").strip()
            if reader.wait() < 0:
                told = f"SciPy's reader was ended by {Signals(-reader.returncode).name}"
            raise InputError(f"{path}: cannot be read as mat: {told}") from None
    return found


def _send_variables(path: str) -> None:
    """Pickle the variables of a mat file to the standard output: arrays of numbers, kinds of others."""
    from scipy.io import loadmat

    try:
        variables = loadmat(path, appendmat=False)
    except Exception as error:  # Damaged files surface as anything that a parser can raise.
        sys.exit(f"{type(error).__name__}: {error}")
    found = {name: _sendable(value) for name, value in variables.items() if not name.startswith("__")}
    pickle.dump(found, sys.stdout.buffer, protocol=5)


def _sendable(value: Any) -> NDArray[Any] | str:
    if not isinstance(value, np.ndarray):
        return "sparse matrix"
    if type(value) is np.ndarray and value.dtype.kind in "biufc":
        return value
    return OTHER_KINDS.get(value.dtype.kind, "object")


if __name__ == "__main__":
    _send_variables(sys.argv[1])
