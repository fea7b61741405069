"""Point clouds in files: csv, npy, npz, mat and ply, told apart by their extension."""

from __future__ import annotations

from contextlib import closing
from itertools import chain
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeGuard, TypeVar

import numpy as np
from numpy.typing import NDArray

from isacbench.errors import InputError
from isacbench.files.arrays.array_files import listed, listed_arrays
from isacbench.files.arrays.stored_arrays import TEXTS, StoredArray
from isacbench.files.checked_files import CLOUD_BYTES, binary_size, require_file, require_writable
from isacbench.files.escaping import quoted, shortened
from isacbench.files.text_table import TextLine, check_finite, format_rows, parse_rows, read_lines
from isacbench.model.cloud_files.ply import read_ply, write_ply
from isacbench.model.cloud_files.power_names import require_no_power
from isacbench.number_text import is_number

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

POINT_COLUMNS = ["x", "y", "z", "v", "power"]
"""Columns of a cloud in tables and csv files: positions in m, radial velocity in m/s, power."""


Floats = NDArray[np.float64]
T = TypeVar("T")

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
          array of shape (n, 4) or (n, 5) under any name, and none larger;
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
    require_file(path, CLOUD_BYTES)
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
    header, *rows = _csv_lines(path)
    columns = _header_columns(path, header, (*_POINT, "amplitude"))
    table = dict(zip(columns, parse_rows(path, rows, columns, delimiter=",").T, strict=True))
    if not rows:
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


def _csv_lines(path: Path) -> list[TextLine]:
    """Lines of a csv file, one at least."""
    lines = read_lines(path)
    if not lines:
        raise InputError(f"{path}: is empty; at least the header {','.join(_POINT)} is required")
    return lines


def _header_columns(path: Path, header: TextLine, allowed: Sequence[str]) -> list[str]:
    """Column names of a header that must hold x, y, z and v, may hold the rest, and nothing else."""
    columns = [name.strip() for name in header.text.split(",")]
    faults = chain(
        (f"unknown column {quoted(name)}" for name in columns if name not in allowed),
        (f"column {name} appears twice" for name in columns if columns.count(name) > 1),
        (f"column {name} is missing" for name in _POINT if name not in columns),
    )
    fault = next(faults, None)
    if fault is not None:
        raise InputError(
            f"{path}: row {header.number}: {fault}; the file takes the columns {', '.join(_POINT)} and "
            f"optionally {allowed[-1]}"
        )
    return columns


def _read_csv(path: Path) -> Floats:
    lines = _csv_lines(path)
    fields = lines[0].text.split(",")
    if not any(map(is_number, fields)):
        columns = _header_columns(path, lines[0], _CLOUD)
        table = parse_rows(path, lines[1:], columns, delimiter=",")
        return table[:, [columns.index(name) for name in _CLOUD if name in columns]]
    if len(fields) not in (4, 5):
        raise InputError(
            f"{path}: row {lines[0].number}: {len(fields)} fields; without a header a cloud takes "
            f"4 or 5 ({', '.join(_CLOUD)})"
        )
    return parse_rows(path, lines, _CLOUD[: len(fields)], delimiter=",")


def _write_csv(points: Floats, path: Path) -> None:
    rows = format_rows(points, delimiter=",")
    path.write_text("\n".join([",".join(_CLOUD), *rows, ""]), encoding="ascii", newline="\n")


def _read_arrays(path: Path) -> Floats:
    """Read a file of arrays: xyz, velocity and power, or the only table among them."""
    with listed_arrays(path) as file, closing(file):
        chosen = _chosen_arrays(path, file.arrays)
        if sum(array.n_bytes for array in chosen) > CLOUD_BYTES:
            raise InputError(
                f"{path}: its arrays take more than the {binary_size(CLOUD_BYTES)} that are allowed"
            )
        xyz, *others = [array.read() for array in chosen]
        values = np.column_stack([xyz, *(other.ravel() for other in others)]).astype(np.float64, copy=False)
        if values.shape[1] < len(_CLOUD):
            rest = {name: array for name, array in file.arrays.items() if array not in chosen}
            require_no_power(path, (name for name in rest if _may_be_power(rest[name], len(values))))
    check_finite(path, values, _CLOUD[: values.shape[1]], range(1, len(values) + 1))
    return values


def _chosen_arrays(path: Path, arrays: Mapping[str, StoredArray | str]) -> list[StoredArray]:
    """Find the arrays that make a cloud: the table, or xyz, velocity and, if there, power."""
    if "xyz" in arrays or "velocity" in arrays:
        return _parts(path, arrays)
    outer = [name for name in arrays if not set("/@") & {*name}] or arrays
    tables = {name: array for name in outer if _is_table(array := arrays[name])}
    if len(tables) == 1:
        _require_no_other_points(path, arrays, *tables.items())
        return list(tables.values())
    if "" in arrays:
        raise InputError(f"{path}: takes real numbers of shape (n, 4) or (n, 5), not {arrays['']}")
    held = listed({name: array for name, array in arrays.items() if "@" not in name}) or "nothing"
    found = f"several could be the cloud: {', '.join(tables)}" if tables else f"it holds {held}"
    raise InputError(
        f"{path}: takes xyz (n, 3) and velocity (n), optionally power (n), "
        f"or exactly one array of shape (n, 4) or (n, 5); {shortened(found)}"
    )


def _require_no_other_points(
    path: Path, arrays: Mapping[str, StoredArray | str], table: tuple[str, StoredArray]
) -> None:
    """Refuse a table without a name, such as the pose of a sensor, where other arrays may be the points."""
    n, n_columns = table[1].shape
    others: dict[str, StoredArray | str] = {
        name: array
        for name, array in arrays.items()
        if "@" not in name and _is_real(array)
        if prod(array.shape) > n * n_columns or (array.shape[1:] in ((3,), (4,), (5,)) and array.shape[0] > n)
    }
    if others:
        raise InputError(
            f"{path}: {table[0]} may be the cloud, and so may {shortened(listed(others))}; allowed are the "
            "names xyz (n, 3) and velocity (n), optionally power (n), or no other such array"
        )


def _parts(path: Path, arrays: Mapping[str, StoredArray | str]) -> list[StoredArray]:
    """Find the arrays xyz, velocity and, if there, power."""
    for name in ("xyz", "velocity"):
        if name not in arrays:
            raise InputError(f"{path}: has no array {name}, but takes both xyz (n, 3) and velocity (n)")
    xyz = arrays["xyz"]
    if not (_is_real(xyz) and len(xyz.shape) == 2 and xyz.shape[1] == 3):
        raise InputError(f"{path}: xyz takes real numbers of shape (n, 3), not {xyz}")
    parts, n = [xyz], xyz.shape[0]
    for name in ("velocity", "power"):
        if name in arrays:
            part = arrays[name]
            # MATLAB knows no vectors: a row, a column and a vector are the same here.
            if not (_is_real(part) and prod(part.shape) == n == max(part.shape, default=1)):
                raise InputError(f"{path}: {name} takes {n} real numbers, one a row of xyz, not {part}")
            parts.append(part)
    return parts


def _is_real(array: StoredArray | str) -> TypeGuard[StoredArray]:
    """Tell if an entry of a file is an array of integers or floats."""
    return isinstance(array, StoredArray) and array.dtype.kind in "fiu"


def _is_table(array: StoredArray | str) -> TypeGuard[StoredArray]:
    """Tell if an entry of a file is an array that could be a cloud."""
    return _is_real(array) and len(array.shape) == 2 and array.shape[1] in (4, 5)


def _may_be_power(array: StoredArray | str, n: int) -> bool:
    """Tell if an entry of a file may have a number for each of n points; texts and scalars do not."""
    if isinstance(array, str):
        return array not in TEXTS
    return array.dtype.kind in "biufcV" and array.shape != () and prod(array.shape) >= min(n, 2) > 0


def _write_npy(points: Floats, path: Path) -> None:
    # An open file, because numpy appends the extension to a path that ends in .NPY.
    with path.open("wb") as file:
        np.save(file, points)


def _write_npz(points: Floats, path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, xyz=points[:, :3], velocity=points[:, 3], power=points[:, 4])


def _write_mat(points: Floats, path: Path) -> None:
    from scipy.io import savemat

    # xyz last: a file cut off between two arrays, which the parser accepts, then lacks what it cannot lack.
    arrays = {"power": points[:, 4], "velocity": points[:, 3], "xyz": points[:, :3]}
    path.open("wb").close()  # Says why a file cannot be written, which savemat does not.
    savemat(path, arrays, appendmat=False, oned_as="column")


_READERS: dict[str, Callable[[Path], Floats]] = {
    ".csv": _read_csv,
    ".npy": _read_arrays,
    ".npz": _read_arrays,
    ".mat": _read_arrays,
    ".ply": read_ply,
}
_WRITERS: dict[str, Callable[[Floats, Path], None]] = {
    ".csv": _write_csv,
    ".npy": _write_npy,
    ".npz": _write_npz,
    ".mat": _write_mat,
    ".ply": write_ply,
}
