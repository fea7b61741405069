"""Point clouds in files: csv, npy, npz, mat and ply, told apart by their extension."""

from __future__ import annotations

import struct
import zipfile
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.arrays import mat5, mat73
from isacbench.files.arrays.hdf5_datasets import is_hdf5
from isacbench.files.arrays.npy_files import read_array, read_members
from isacbench.files.checked_files import CLOUD_BYTES, require_file, require_writable
from isacbench.files.escaping import quoted, shortened
from isacbench.files.text_table import TextLine, check_finite, format_rows, is_number, parse_rows, read_lines
from isacbench.model.cloud_files.ply import read_ply, write_ply

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

POINT_COLUMNS = ["x", "y", "z", "v", "power"]
"""Columns of a cloud in tables and csv files: positions in m, radial velocity in m/s, power."""


Floats = NDArray[np.float64]
T = TypeVar("T")

_MAT4_HEAD = struct.Struct("<5i")
_MAT4_TYPES = 5000
_MAT4_BYTES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}
"""Head of a matrix of MATLAB's version 4: its type in four digits, of which the third one tells the size."""

_CLOUD = tuple(POINT_COLUMNS)
_POINT = _CLOUD[:-1]


class Points(NamedTuple):
    """Scatterers as a scenario's points file lists them.

    Attributes
    ----------
    xyz : ndarray of float64, shape (n, 3)
        Positions in metres.
    velocity : ndarray of float64, shape (n,)
        Radial velocities in m/s, positive when approaching.
    amplitude : ndarray of float64, shape (n,)
        Echo amplitudes |G|, 1 where the file has none.
    """

    xyz: Floats
    velocity: Floats
    amplitude: Floats


def read_point_table(path: str | Path) -> Floats:
    r"""Read the points of a cloud; `isacbench.model.cloud.PointCloud.read` makes a cloud of them.

    Parameters
    ----------
    path : str or Path
        File in one of these formats, told apart by the extension:

        - csv: header ``x,y,z,v,power`` in any order, power optional, or no
          header and 4 or 5 columns in that order;
        - npy: an array of shape (n, 4) or (n, 5);
        - npz and mat (MATLAB's -v4 to -v7.3): arrays ``xyz`` (n, 3),
          ``velocity`` (n,) and optionally ``power`` (n,), or exactly one
          array of shape (n, 4) or (n, 5) under any name;
        - ply: element vertex with x, y, z, v (or velocity), optionally power.

        A missing power is 1. Nothing is ever unpickled.

    Returns
    -------
    ndarray of float64, shape (n, 4) or (n, 5)
        Columns x, y, z in m, v in m/s and, where the file has it, power; n may be 0.

    Raises
    ------
    InputError
        If the file is missing, damaged, of another kind or larger than 256
        MiB, or holds a value that is not finite; the message names the file
        and the place.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "cloud.csv"
    >>> _ = path.write_text("x,y,z,v\n1,2,3,4\n")
    >>> read_point_table(path).tolist()
    [[1.0, 2.0, 3.0, 4.0]]
    """
    path = Path(path)
    read = _by_extension(path, _READERS)
    _require_file(path)
    return read(path)


def write_point_table(points: Floats, path: str | Path) -> None:
    """Write the points of a cloud, so that reading them returns the same doubles.

    Parameters
    ----------
    points : ndarray of float64, shape (n, 5)
        Columns x, y, z in m, v in m/s and power; any number of rows.
    path : str or Path
        File to write, or to overwrite; its extension, one of csv, npy, npz,
        mat and ply, decides the format.

    Raises
    ------
    InputError
        If the extension is another or the file cannot be written.
    """
    path = Path(path)
    write = _by_extension(path, _WRITERS)
    _refuse_folder(path, "cannot be written: Is a directory")
    require_writable(path)
    try:
        write(points, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def read_points_csv(path: str | Path) -> Points:
    """Read the scatterers of a scenario: header ``x,y,z,v``, optionally ``amplitude``, in any order.

    Parameters
    ----------
    path : str or Path
        The csv file.

    Returns
    -------
    Points
        At least one.

    Raises
    ------
    InputError
        If the file is missing or holds no points, on a missing or another
        column, or on a value that is not a finite number.
    """
    path = Path(path)
    _require_file(path)
    header, rows = _csv_lines(path)
    columns = _header_columns(path, header, (*_POINT, "amplitude"))
    table = _csv_columns(path, rows, columns)
    if not table["v"].size:
        raise InputError(f"{path}: holds no points below its header")
    xyz = np.column_stack([table[name] for name in "xyz"])
    return Points(xyz, table["v"], table.get("amplitude", np.ones(len(xyz))))


def _by_extension(path: Path, handlers: Mapping[str, T]) -> T:
    """Pick what handles a path by its extension, upper or lower case."""
    try:
        return handlers[path.suffix.lower()]
    except KeyError:
        found = f"extension {path.suffix!r}" if path.suffix else "no extension"
        raise InputError(f"{path}: has {found}; a cloud takes {', '.join(handlers)}") from None


def _require_file(path: Path) -> None:
    """Refuse what is not a file, or larger than any cloud."""
    _refuse_folder(path, "is a directory, not a file")
    require_file(path, CLOUD_BYTES)


def _refuse_folder(path: Path, reason: str) -> None:
    with suppress(OSError):  # which others tell in their words
        if path.is_dir():
            raise InputError(f"{path}: {reason}")


def _csv_lines(path: Path) -> tuple[TextLine, Iterator[TextLine]]:
    """First line of a csv file, and the others."""
    lines = read_lines(path)
    first = next(lines, None)
    if first is None:
        raise InputError(f"{path}: is empty; a header {','.join(_POINT)} is wanted at least")
    return first, lines


def _header_columns(path: Path, header: TextLine, allowed: Sequence[str]) -> list[str]:
    """Column names of a header that must hold x, y, z and v, may hold the rest, and nothing else."""
    columns = [name.strip() for name in header.text.split(",")]
    place = f"{path}: row {header.number}"
    takes = f"takes the columns {', '.join(_POINT)} and optionally {allowed[-1]}"
    for name in columns:
        if name not in allowed:
            raise InputError(f"{place}: unknown column {quoted(name)}; the file {takes}")
        if columns.count(name) > 1:
            raise InputError(f"{place}: column {name} appears twice; the file {takes}")
    for name in _POINT:
        if name not in columns:
            raise InputError(f"{place}: column {name} is missing; the file {takes}")
    return columns


def _csv_columns(path: Path, rows: Iterable[TextLine], columns: Sequence[str]) -> dict[str, Floats]:
    """Columns of the rows of a csv file by name."""
    return dict(zip(columns, parse_rows(path, rows, columns, delimiter=",").T, strict=True))


def _read_csv(path: Path) -> Floats:
    first, others = _csv_lines(path)
    fields = first.text.split(",")
    if any(map(is_number, fields)):
        if len(fields) not in (4, 5):
            raise InputError(
                f"{path}: row {first.number}: {len(fields)} fields; without a header a cloud takes "
                f"4 or 5 ({', '.join(_CLOUD)})"
            )
        rows = chain([first], others)
        return parse_rows(path, rows, _CLOUD[: len(fields)], delimiter=",")
    table = _csv_columns(path, others, _header_columns(path, first, _CLOUD))
    return np.column_stack([table[name] for name in _CLOUD if name in table])


def _write_csv(points: Floats, path: Path) -> None:
    rows = format_rows(points, delimiter=",")
    path.write_text("\n".join([",".join(_CLOUD), *rows, ""]), encoding="ascii", newline="\n")


@contextmanager
def _parsing(path: Path, kind: str) -> Iterator[None]:
    """Name the file and its kind in whatever the parser of a binary format raises."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # Damaged files surface as anything, tokenize.TokenError included.
        raise InputError(f"{path}: cannot be read as {kind}: {shortened(str(error))}") from error


def _read_npy(path: Path) -> Floats:
    with _parsing(path, "npy"), path.open("rb") as file:
        array = read_array(file, path.stat().st_size, CLOUD_BYTES)
    if not _is_table(array):
        raise InputError(f"{path}: takes real numbers of shape (n, 4) or (n, 5), not {_describe(array)}")
    return _points_of_table(path, array)


def _write_npy(points: Floats, path: Path) -> None:
    # An open file, because numpy appends the extension to a path that ends in .NPY.
    with path.open("wb") as file:
        np.save(file, points)


def _read_npz(path: Path) -> Floats:
    with _parsing(path, "npz"), zipfile.ZipFile(path) as archive:
        arrays = read_members(archive, path, CLOUD_BYTES)
    return _points_of_arrays(path, arrays)


def _write_npz(points: Floats, path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, xyz=points[:, :3], velocity=points[:, 3], power=points[:, 4])


def _read_mat(path: Path) -> Floats:
    with _parsing(path, "mat"):
        arrays = _arrays_of_mat(path)
    return _points_of_arrays(path, arrays)


def _arrays_of_mat(path: Path) -> Mapping[str, Any]:
    """Arrays of numbers of a mat file by name, and descriptions of its other variables."""
    if is_hdf5(path):
        return mat73.read_arrays(path, CLOUD_BYTES)
    return _arrays_of_mat4(path) if _is_mat4(path) else _arrays_of_mat5(path)


def _is_mat4(path: Path) -> bool:
    """Whether a file begins with a number, where later ones have text."""
    with path.open("rb") as file:
        return 0 in file.read(4)


def _arrays_of_mat4(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    _require_mat4_to_fit(path)
    return {name: value for name, value in loadmat(path, appendmat=False).items() if name[:2] != "__"}


def _require_mat4_to_fit(path: Path) -> None:
    """Refuse a file whose matrices take more bytes than it has: the parser would make room for them first."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as file:
        while at < size:
            file.seek(at)
            head = file.read(_MAT4_HEAD.size)
            order = "<" if int.from_bytes(head[:4], "little") < _MAT4_TYPES else ">"
            kind, rows, columns, is_complex, name_length = struct.unpack(f"{order}5i", head)
            if min(rows, columns, name_length) < 0:
                raise ValueError(f"a matrix of {rows} x {columns} numbers at byte {at}")
            takes = rows * columns * _MAT4_BYTES[kind // 10 % 10] * (2 if is_complex else 1)
            at += _MAT4_HEAD.size + name_length + takes
    if at > size:
        raise ValueError(f"truncated: its matrices take {at} bytes, it has {size}")


def _arrays_of_mat5(path: Path) -> dict[str, Any]:
    """Arrays of numbers, and what is said of all others: cells in cells in cells are not looked into."""
    found = mat5.list_arrays(path)
    numbers = {name: array for name, array in found.items() if array.listed.dtype.kind in "fiu"}
    mat5.require_at_most(path, numbers, CLOUD_BYTES)
    listed = {name: array.listed for name, array in found.items()}
    return {**listed, **{name: mat5.read_numbers(path, array) for name, array in numbers.items()}}


def _write_mat(points: Floats, path: Path) -> None:
    from scipy.io import savemat

    # xyz last: a file cut off between two arrays, which the parser accepts, then lacks what it cannot lack.
    arrays = {"power": points[:, 4], "velocity": points[:, 3], "xyz": points[:, :3]}
    path.open("wb").close()  # Says why a file cannot be written, which savemat does not.
    savemat(path, arrays, appendmat=False, oned_as="column")


def _points_of_arrays(path: Path, arrays: Mapping[str, Any]) -> Floats:
    """Build points from named arrays: xyz, velocity and power, or the only table among them."""
    if "xyz" in arrays or "velocity" in arrays:
        return _points_of_parts(path, arrays)
    tables = [name for name, array in arrays.items() if _is_table(array)]
    if len(tables) != 1:
        held = ", ".join(f"{name} ({_describe(array)})" for name, array in arrays.items()) or "nothing"
        found = f"several could be the cloud: {', '.join(tables)}" if tables else f"it holds {held}"
        found = shortened(found)
        raise InputError(
            f"{path}: takes xyz (n, 3) and velocity (n), optionally power (n), "
            f"or exactly one array of shape (n, 4) or (n, 5); {found}"
        )
    return _points_of_table(path, arrays[tables[0]])


def _points_of_parts(path: Path, arrays: Mapping[str, Any]) -> Floats:
    """Build points from the arrays xyz, velocity and, if there, power."""
    for name in ("xyz", "velocity"):
        if name not in arrays:
            raise InputError(f"{path}: has no array {name}, but takes both xyz (n, 3) and velocity (n)")
    xyz = arrays["xyz"]
    if not (_is_real(xyz) and xyz.ndim == 2 and xyz.shape[1] == 3):
        raise InputError(f"{path}: xyz takes real numbers of shape (n, 3), not {_describe(xyz)}")
    parts = [xyz]
    for name in ("velocity", "power"):
        if name in arrays:
            part = arrays[name]
            # MATLAB knows no vectors: a row, a column and a vector are the same here.
            if not (_is_real(part) and part.size == len(xyz) == max(part.shape, default=1)):
                raise InputError(
                    f"{path}: {name} takes {len(xyz)} real numbers, one a row of xyz, not {_describe(part)}"
                )
            parts.append(part.ravel())
    return _points_of_table(path, np.column_stack(parts))


def _points_of_table(path: Path, array: NDArray[Any]) -> Floats:
    """Build points from an array (n, 4) or (n, 5) of real numbers, rows counted from 1 in messages."""
    values = array.astype(np.float64, copy=False)
    check_finite(path, values, _CLOUD[: values.shape[1]], range(1, len(values) + 1))
    return values


def _is_real(value: Any) -> bool:
    """Whether a value is an array of integers or floats."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiu"


def _is_table(value: Any) -> bool:
    """Whether a value is an array that could be a cloud."""
    return _is_real(value) and value.ndim == 2 and value.shape[1] in (4, 5)


def _describe(value: Any) -> str:
    """Shape and type of an array, for messages; text that says it already, as it is."""
    return f"{value.dtype} of shape {value.shape}" if hasattr(value, "dtype") else str(value)


_READERS: dict[str, Callable[[Path], Floats]] = {
    ".csv": _read_csv,
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".mat": _read_mat,
    ".ply": read_ply,
}
_WRITERS: dict[str, Callable[[Floats, Path], None]] = {
    ".csv": _write_csv,
    ".npy": _write_npy,
    ".npz": _write_npz,
    ".mat": _write_mat,
    ".ply": write_ply,
}
