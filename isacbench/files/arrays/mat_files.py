"""Arrays in MATLAB's mat files of versions 4 to 7, read by SciPy in a process of its own.

Some damaged files end the process in which SciPy reads them. So it is not the user's.
Version 7.3 is HDF5, see `isacbench.files.arrays.hdf5_files`.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from functools import partial
from signal import Signals
from typing import TYPE_CHECKING, Any

import numpy as np

from isacbench.errors import InputError
from isacbench.files.arrays.hdf5_files import list_hdf5
from isacbench.files.arrays.stored_arrays import SPARSE, ArrayFile, StoredArray
from isacbench.files.checked_files import HELD_BYTES, require_file

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
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
    from scipy.io.matlab import MatlabOpaque

    # SciPy gives the last of several variables of one name. All objects have the name None to it.
    warnings.filterwarnings("error", 'Duplicate variable name "(?!None")')
    load = partial(loadmat, path, appendmat=False)
    try:
        variables = {name: value for name, value in load().items() if not name.startswith("__")}
        found = dict(entry for variable in variables.items() for entry in _sendable(*variable))
        if isinstance(variables.get("None"), MatlabOpaque):
            del found["None"]
            found |= dict.fromkeys(_object_names(load), "object")
    except Exception as error:  # Damaged files surface as anything that a parser can raise.
        sys.exit(f"{type(error).__name__}: {error}")
    pickle.dump(found, sys.stdout.buffer, protocol=5)


def _object_names(load: Callable[..., dict[str, Any]]) -> list[str]:
    """Names of MATLAB's objects: of as many as are wanted, SciPy gives the last."""
    names: list[str] = []
    while True:
        name = load(variable_names=["None"] * (1 + len(names)))["None"]["s0"].item().decode("latin1")
        if name in names:
            return names
        names.append(name)


def _sendable(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any] | str]]:
    """Arrays and kinds of a variable by their names; the fields of a structure are named after it."""
    if not isinstance(value, np.ndarray):
        yield name, "unreadable" if isinstance(value, str) else SPARSE
    elif type(value) is not np.ndarray:
        yield name, "object"
    elif value.dtype.kind in "biufc":
        yield name, value
    elif value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _sendable(f"{name}/{field}", value.flat[0][field])
    else:
        yield name, OTHER_KINDS.get(value.dtype.kind, "object")


if __name__ == "__main__":
    _send_variables(sys.argv[1])
